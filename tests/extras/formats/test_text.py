import tracemalloc

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from g1stream.errors import MotionError
from g1stream.extras.formats.text import read_text
from g1stream.input_limits import CSV_LINE
from g1stream.motion.readers import find_motion, load_motion
from g1stream.robot.joints import JOINT_NAMES
from known_motions import COLUMNS, assert_read_or_refused, assert_same, bare, changed, csv, rows_of


def test_the_order_of_the_quaternion_is_that_of_the_header(load):
    order = ("Frame", "X", "Y", "Z", "quat_w", "quat_x", "quat_y", "quat_z", *JOINT_NAMES)
    rows = rows_of(3)
    w_first = load(csv([[*row[:4], row[7], *row[4:7], *row[8:]] for row in rows], order))
    evidence = find_motion(w_first.source).open().evidence
    assert evidence.used["pelvis"] == "root_pos, root_quat_wxyz, wxyz"
    assert_same(w_first, load(csv(rows)))


def header(change):
    """A change to the first line."""
    return lambda text: change(text.split("\n", 1)[0]) + "\n" + text.split("\n", 1)[1]


SPELLINGS = {
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


EULER = ("root_rotateX", "root_rotateY", "root_rotateZ", *(f"{n}_dof" for n in JOINT_NAMES))


@pytest.mark.parametrize(
    ("content", "place", "offenders"),
    [
        (bare(rows_of(3)).replace("\n", ",x\n", 1), "line 1, column 37", ["'x'"]),
        (changed(1, 12, "left_toe"), "", ["left_knee_joint", "left_toe"]),
        (changed(1, 8, "W"), "line 1", ["QW"]),
        (changed(1, 12, ""), "line 1, column 12", ["empty name"]),
        (changed(1, 3, "X"), "line 1, column 3 (X)", ["same name"]),
        (csv(rows_of(5)).replace(",", ";"), "line 1", ["joint names"]),
        (csv([[1] * 32], EULER), "line 1", ["Euler angles", "degrees", "root_rotateX"]),
        (csv([]), "", ["no frame"]),
        ("", "", ["empty"]),
        (" \r\n\n", "", ["empty"]),
        ("1,2,3\n4,5,6\n", "line 1", ["3 columns"]),
        (b"MP3\x04\x00\x00not text", "line 1", ["binary"]),
        (b"Frame,X\n1,\xff\xfe\n", "line 2", ["byte 10", "UTF-8"]),
        ("0," * CSV_LINE, "line 1", ["longer"]),
    ],
)
def test_faults_are_named_with_their_place(load, content, place, offenders):
    with pytest.raises(MotionError) as caught:
        load(content)
    assert "clip" in caught.value.cause
    assert not place or caught.value.cause.startswith(f"clip.csv, {place}: ")
    assert all(offender in caught.value.cause for offender in offenders)
    assert caught.value.remedy


def test_memory_is_in_proportion_to_the_file():
    content = bare(rows_of(20)).encode() * 500
    tracemalloc.start()
    try:
        table = read_text(content, "clip.csv").arrays["table"]
        assert table.shape == (10_000, 36)
        assert tracemalloc.get_traced_memory()[1] < len(content)
    finally:
        tracemalloc.stop()


@given(line=st.just(1), column=st.integers(1, 37), cell=st.text(max_size=6))
@settings(max_examples=50, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_name_of_a_column_is_read_or_refused(load, line, column, cell):
    assert_read_or_refused(load, changed(line, column, cell))
