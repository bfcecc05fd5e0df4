"""What is said of motion files that are right, and of ones with something wrong in them."""

from pathlib import Path

import pytest

from g1stream.errors import MotionError
from g1stream.motion.file_check import MappedColumn, NormRange, check_file
from g1stream.motion.readers import load_motion
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.model import G1

ROBOT = G1.default()


@pytest.fixture
def clip(tmp_path):
    """Ten frames of the demo as a table to change, and how to check it."""
    header, *lines = Path(load_motion("demo").source).read_text().splitlines()[:11]
    columns, rows = header.split(","), [line.split(",") for line in lines]

    def check(change=lambda columns, rows: None):
        change(columns, rows)
        path = tmp_path / "clip.csv"
        path.write_text("\n".join(",".join(row) for row in [columns, *rows]))
        return check_file(path, ROBOT)

    return check


def test_a_motion_that_is_right(clip):
    report = clip()
    assert report.all_well
    assert (report.n_rows, report.n_columns, report.has_header) == (10, 37, True)
    assert [m.joint for m in report.mapped] == list(JOINT_NAMES)
    assert [m.column for m in report.mapped] == list(range(9, 38))
    assert (report.not_in_robot, report.not_in_file, report.fault) == ((), (), "")
    assert report.motion.duration == pytest.approx(9 / 30)
    assert report.quat_norms == NormRange(
        pytest.approx(1.0, abs=1e-5), pytest.approx(1.0, abs=1e-5)
    )


def test_a_bundled_motion_by_its_name():
    assert check_file("demo", ROBOT).all_well


def test_the_frame_rate_is_the_one_that_is_told():
    motion = check_file("demo", ROBOT, fps=15.0).motion
    assert motion.duration == pytest.approx(2 * check_file("demo", ROBOT).motion.duration)


def test_a_joint_that_the_robot_lacks_and_one_that_the_file_lacks(clip):
    def rename(columns, rows):
        columns[columns.index("left_knee_joint")] = "left_kneee_joint"

    report = clip(rename)
    assert not report.all_well
    assert report.not_in_robot == ("left_kneee_joint",)
    assert report.not_in_file == ("left_knee_joint",)
    assert len(report.mapped) == 28
    assert "left_kneee_joint" in report.fault
    assert report.motion is None
    assert report.quat_norms is not None


def test_a_file_without_a_header(tmp_path):
    lines = Path(load_motion("demo").source).read_text().splitlines()[1:]
    path = tmp_path / "lafan.csv"
    path.write_text("\n".join(line.split(",", 1)[1] for line in lines))
    report = check_file(path, ROBOT)
    assert report.all_well
    assert not report.has_header
    assert report.mapped[0] == MappedColumn(8, JOINT_NAMES[0])


def test_no_quaternions(clip):
    def rename(columns, rows):
        columns[columns.index("QW")] = "W"

    report = clip(rename)
    assert report.quat_norms is None
    assert "QW" in report.fault


def test_quaternions_that_are_not_unit_are_a_warning_and_no_fault(clip):
    def scale(columns, rows):
        for name in ("QX", "QY", "QZ", "QW"):
            rows[3][columns.index(name)] = str(2.24 * float(rows[3][columns.index(name)]))

    report = clip(scale)
    assert report.quat_norms.highest == pytest.approx(2.24, abs=1e-4)
    (warning,) = report.motion.warnings
    assert "frame 3, line 5, with the norm 2.24" in warning
    assert report.all_well


def test_limits_and_the_largest_step_are_found_with_their_frames(clip):
    def bend(columns, rows):
        rows[6][columns.index("left_knee_joint")] = "3.5"

    report = clip(bend)
    (violation,) = report.motion.limit_violations
    assert (violation.joint, violation.frame, violation.value) == ("left_knee_joint", 6, 3.5)
    assert report.motion.largest_step.joint == "left_knee_joint"
    assert report.motion.largest_step.frame in (5, 6)
    assert not report.all_well


def word(columns, rows):
    rows[2][4] = "half"


def nan(columns, rows):
    rows[2][4] = "nan"


def short(columns, rows):
    del rows[2][30:]


@pytest.mark.parametrize(
    ("change", "fault", "remedy"),
    [
        (word, "line 4, column 5 (QX): 'half' is not a finite number", "decimal number"),
        (nan, "line 4, column 5 (QX): 'nan' is not a finite number", "decimal number"),
        (short, "line 4: the row is too short, with 30 values for 37", "one value a column"),
    ],
)
def test_with_a_bad_row_the_rest_is_told_all_the_same(clip, change, fault, remedy):
    report = clip(change)
    assert fault in report.fault
    assert remedy in report.remedy
    assert (report.n_rows, report.n_columns, report.has_header) == (10, 37, True)
    assert [m.joint for m in report.mapped] == list(JOINT_NAMES)
    assert (report.motion, report.quat_norms) == (None, None)
    assert not report.all_well


def test_columns_that_nobody_names(tmp_path):
    path = tmp_path / "narrow.csv"
    path.write_text("1,2,3\n4,5,6\n")
    report = check_file(path, ROBOT)
    assert (report.n_rows, report.n_columns, report.has_header) == (2, 3, False)
    assert (report.mapped, report.not_in_robot, report.not_in_file) == ((), (), ())
    assert "3 values, and no header" in report.fault


def test_no_columns_at_all(clip):
    def join(columns, rows):
        columns[:] = [";".join(columns)]
        rows[:] = [[";".join(row)] for row in rows]

    report = clip(join)
    assert (report.n_rows, report.n_columns, report.mapped) == (10, 1, ())
    assert "no columns separated by commas" in report.fault


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "There is no motion file"),
        (b"", "is empty"),
        (b"\x89PNG\r\n", "not UTF-8"),
        (b"a,b\0", "binary"),
    ],
)
def test_nothing_to_look_at_is_an_error(tmp_path, content, message):
    path = tmp_path / "clip.csv"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(MotionError, match=message):
        check_file(path, ROBOT)


def test_a_frame_rate_that_is_none_is_an_error():
    with pytest.raises(MotionError, match="frames a second"):
        check_file("demo", ROBOT, fps=0.0)
