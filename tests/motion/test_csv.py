import hashlib
import tracemalloc

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from g1stream.errors import MotionError
from g1stream.input_limits import CSV_LINE
from g1stream.motion.csv import read_csv
from g1stream.motion.readers import find_motion, load_motion
from g1stream.robot.joints import JOINT_NAMES

COLUMNS = ("Frame", "X", "Y", "Z", "QX", "QY", "QZ", "QW", *JOINT_NAMES)
KNEE = COLUMNS.index("left_knee_joint")


def rows_of(n_frames, seed=0):
    rng = np.random.default_rng(seed)
    values = rng.normal(size=(n_frames, 36))
    values[:, 3:7] = Rotation.random(n_frames, rng=rng).as_quat()
    return [[frame, *row] for frame, row in enumerate(values.tolist())]


def csv(rows, columns=COLUMNS):
    return "\n".join([",".join(columns), *(",".join(map(str, row)) for row in rows), ""])


def bare(rows):
    """Without header and frame numbers."""
    return csv([row[1:] for row in rows]).split("\n", 1)[1]


@pytest.fixture
def load(tmp_path):
    """Load a motion from text or bytes."""

    def load_content(content, **options):
        path = tmp_path / "clip.csv"
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return load_motion(path, **options)

    return load_content


def assert_same(motion, other):
    for name in ("joint_pos", "root_pos", "root_quat_wxyz"):
        np.testing.assert_array_equal(getattr(motion, name), getattr(other, name))


FIVE = csv(rows_of(5))


def changed(line, column, cell):
    """Five good frames but for one cell; lines and columns counted from 1."""
    lines = FIVE.split("\n")
    cells = lines[line - 1].split(",")
    cells[column - 1] = cell
    lines[line - 1] = ",".join(cells)
    return "\n".join(lines)


def test_foxglove_layout(load, tmp_path):
    rows = rows_of(4)
    content = csv(rows)
    motion = load(content)
    values = np.array(rows)
    assert (motion.name, motion.fps, load(content, fps=50).fps) == ("clip", 30.0, 50.0)
    with pytest.raises(MotionError, match="frames per second"):
        load(content, fps=0.0)
    assert motion.source == tmp_path / "clip.csv"
    assert motion.sha256 == hashlib.sha256(content.encode()).hexdigest()
    assert len(motion.warnings) == 1
    assert load(content, fps=30).warnings == ()
    np.testing.assert_array_equal(motion.root_pos, values[:, 1:4])
    np.testing.assert_array_equal(motion.joint_pos, values[:, 8:])
    evidence = find_motion(motion.source).open().evidence
    assert evidence.used == {
        "file": "CSV, 4 rows, 37 columns, named by a header",
        "joint order": "named by the file",
        "pelvis": "root_pos, root_quat_xyzw, xyzw",
    }
    assert evidence.assumed == {"frame rate": "30 fps"}
    assert (evidence.not_used, evidence.missing) == ((), ())
    given_rotations = Rotation.from_quat(values[:, 4:8])
    read = Rotation.from_quat(motion.root_quat_wxyz, scalar_first=True)
    assert (given_rotations.inv() * read).magnitude().max() < 1e-7


@given(order=st.permutations(COLUMNS), seed=st.integers(0, 100))
@settings(max_examples=10, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_columns_may_be_in_any_order(load, order, seed):
    rows = rows_of(3, seed)
    shuffled = [[row[COLUMNS.index(name)] for name in order] for row in rows]
    assert_same(load(csv(shuffled, order)), load(csv(rows)))


def test_the_order_of_the_quaternion_is_that_of_the_header(load):
    order = ("Frame", "X", "Y", "Z", "quat_w", "quat_x", "quat_y", "quat_z", *JOINT_NAMES)
    rows = rows_of(3)
    w_first = load(csv([[*row[:4], row[7], *row[4:7], *row[8:]] for row in rows], order))
    evidence = find_motion(w_first.source).open().evidence
    assert evidence.used["pelvis"] == "root_pos, root_quat_wxyz, wxyz"
    assert_same(w_first, load(csv(rows)))


@given(cells=st.lists(st.floats(-1e9, 1e9), min_size=29 * 2, max_size=29 * 2))
@settings(max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_numbers_are_read_to_the_last_bit(load, cells):
    rows = [[frame, 0.0, 0.0, 0.8, 0.0, 0.0, 0.0, 1.0, *cells[frame::2]] for frame in (0, 1)]
    motion = load(csv(rows))
    assert motion.joint_pos.tolist() == [cells[0::2], cells[1::2]]


def header(change):
    """A change to the first line."""
    return lambda text: change(text.split("\n", 1)[0]) + "\n" + text.split("\n", 1)[1]


SPELLINGS = {
    "crlf": lambda text: text.replace("\n", "\r\n"),
    "cr": lambda text: text.replace("\n", "\r"),
    "bom": lambda text: "\ufeff" + text,
    "no last newline": lambda text: text.rstrip("\n"),
    "blank last lines": lambda text: text + "\n  \n\r\n",
    "spaces": lambda text: text.replace(",", " , "),
    "tabs": lambda text: text.replace(",", ",\t"),
    "no commas": lambda text: text.replace(",", " "),
    "comment": header(lambda line: f"# {line}"),
    "comments": header(lambda line: f"# of a dance\n# {line}"),
    "quotes": header(lambda line: ",".join(f'"{name}"' for name in line.split(","))),
    "without _joint": header(lambda line: line.lower().replace("_joint", "")),
    "pandas": header(lambda line: line.removeprefix("Frame")),
    "others": header(lambda x: x.replace("Q", "root_quat_").replace(",X,", ",root_pos_x,")),
}


@pytest.mark.parametrize("spelling", SPELLINGS.values(), ids=SPELLINGS)
def test_spellings_of_the_same_file(load, spelling):
    content = csv(rows_of(4))
    assert_same(load(spelling(content)), load(content))


@pytest.mark.parametrize("start", ["", "# left over,\n", "\n"])
def test_without_a_header(load, start):
    """As LAFAN1 is distributed for the G1, and as `numpy.savetxt` writes it."""
    rows = rows_of(5)
    for content in (bare(rows), start + bare(rows), bare(rows).replace(",", " ")):
        assert_same(load(content), load(csv(rows)))


def test_frames_may_be_numbered_from_anywhere_or_not_at_all(load):
    rows = rows_of(3)
    for content in (
        csv([[row[0] + 120, *row[1:]] for row in rows]),
        csv([row[1:] for row in rows], COLUMNS[1:]),
    ):
        assert_same(load(content), load(csv(rows)))


def test_columns_that_are_not_used_are_named(load):
    rows = [[*row, 1, 2] for row in rows_of(3)]
    (warning,) = load(csv(rows, (*COLUMNS, "mood", "foot_contact")), fps=30).warnings
    assert "mood" in warning
    assert "contact" not in warning  # as many files have
    motion = load(csv([row[8:] for row in rows_of(3)], JOINT_NAMES))
    assert not motion.root_pos.any()


def test_an_assumption_is_told_also_if_the_name_of_the_file_has_its_words(tmp_path):
    path = tmp_path / "walk 30 fps.csv"
    path.write_text(csv([[*row, 1] for row in rows_of(3)], (*COLUMNS, "mood")))
    assert len(load_motion(path).warnings) == 2


@pytest.mark.parametrize(("scale", "doubted"), [(1.05, False), (0.95, False), (2.24, True)])
def test_quaternion_far_off_is_made_unit_with_a_warning(load, scale, doubted):
    rows = rows_of(4)
    rows[0][4:8] = [value * 1.0009 for value in rows[0][4:8]]
    rows[1][4:8] = [value * 1.01 for value in rows[1][4:8]]
    rows[2][4:8] = [value * scale for value in rows[2][4:8]]
    motion = load(csv(rows), fps=30)
    (warning,) = motion.warnings
    for words in ("clip.csv", "2 of 4 quaternions", "frame 2, line 4", f"{scale:g}"):
        assert words in warning
    assert ("not a rounding error" in warning) is doubted
    np.testing.assert_allclose(np.linalg.norm(motion.root_quat_wxyz, axis=1), 1.0, atol=1e-15)


ZERO_QUAT = rows_of(4)
ZERO_QUAT[2][4:8] = [0.0] * 4
EULER = ("root_rotateX", "root_rotateY", "root_rotateZ", *(f"{n}_dof" for n in JOINT_NAMES))


@pytest.mark.parametrize(
    ("content", "place", "offenders"),
    [
        (changed(3, KNEE + 1, "abc"), "line 3, column 12 (left_knee_joint)", ["'abc'"]),
        (changed(4, 2, "nan"), "line 4, column 2 (X)", ["'nan'", "finite"]),
        (changed(6, 37, "-inf"), "line 6, column 37 (right_wrist_yaw_joint)", ["'-inf'"]),
        (changed(2, 4, "1_000"), "line 2, column 4 (Z)", ["'1_000'"]),
        (changed(2, 4, "\uff11"), "line 2, column 4 (Z)", ["'\uff11'"]),
        (changed(2, 4, " "), "line 2, column 4 (Z)", ["''"]),
        (changed(2, 4, "0,1"), "line 2", ["38 values", "37 columns"]),
        (csv(rows_of(3)) + "\n" + csv(rows_of(3)), "line 5", ["blank"]),
        (csv(rows_of(3)) + csv(rows_of(3)), "line 5, column 1 (Frame)", ["'Frame'"]),
        (bare(rows_of(3)).replace("\n", ",x\n", 1), "line 1, column 37", ["'x'"]),
        (changed(3, 1, "0"), "line 3, column 1 (Frame)", ["frame 0 follows frame 0"]),
        (changed(3, 1, "1.5"), "line 3, column 1 (Frame)", ["frame 1.5 follows frame 0"]),
        (changed(1, 12, "left_toe"), "", ["left_knee_joint", "left_toe"]),
        (changed(1, 8, "W"), "line 1", ["QW"]),
        (changed(1, 12, ""), "line 1, column 12", ["empty name"]),
        (changed(1, 3, "X"), "line 1, column 3 (X)", ["same name"]),
        (csv(rows_of(5)).replace(",", ";"), "line 1", ["joint names"]),
        (csv([[1] * 32], EULER), "line 1", ["Euler angles", "degrees", "root_rotateX"]),
        (csv([]), "", ["no frame"]),
        (csv(rows_of(1)), "", ["1 frame"]),
        (csv(ZERO_QUAT), "", ["frame 2, line 4", "zero"]),
        ("", "", ["empty"]),
        (" \r\n\n", "", ["empty"]),
        ("1,2,3\n4,5,6\n", "line 1", ["3 columns"]),
        (b"MP3\x04\x00\x00not text", "line 1", ["binary"]),
        (b"Frame,X\n1,\xff\xfe\n", "line 2", ["byte 10", "UTF-8"]),
        ("0," * CSV_LINE, "line 1", ["longer"]),
        (csv(rows_of(3)) + "1" * 2 * CSV_LINE, "line 5", ["longer"]),
    ],
)
def test_faults_are_named_with_their_place(load, content, place, offenders):
    with pytest.raises(MotionError) as caught:
        load(content)
    assert "clip" in caught.value.cause
    assert not place or caught.value.cause.startswith(f"clip.csv, {place}: ")
    assert all(offender in caught.value.cause for offender in offenders)
    assert caught.value.remedy


@given(line=st.integers(1, 6), column=st.integers(1, 37), cell=st.text(max_size=6))
@settings(max_examples=100, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_cell_is_read_or_refused(load, line, column, cell):
    try:
        motion = load(changed(line, column, cell).encode("utf-8", "surrogatepass"))
    except MotionError:
        return
    for array in (motion.joint_pos, motion.root_pos, motion.root_quat_wxyz):
        assert np.isfinite(array).all()


def test_memory_is_in_proportion_to_the_file():
    content = bare(rows_of(20)).encode() * 500
    tracemalloc.start()
    try:
        table = read_csv(content, "clip.csv").arrays["table"]
        assert table.shape == (10_000, 36)
        assert tracemalloc.get_traced_memory()[1] < len(content)
    finally:
        tracemalloc.stop()
