import hashlib
import tracemalloc

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from g1stream.errors import MotionError
from g1stream.input_limits import CSV_LINE
from g1stream.motion.csv import TextTable
from g1stream.motion.readers import find_motion
from g1stream.optional import EXTENSIONS
from known_motions import COLUMNS, assert_read_or_refused, assert_same, bare, changed, csv, rows_of

KNEE = COLUMNS.index("left_knee_joint")


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
    assert motion.warnings == ()
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


@given(cells=st.lists(st.floats(-1e9, 1e9), min_size=29 * 2, max_size=29 * 2))
@settings(max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_numbers_are_read_to_the_last_bit(load, cells):
    rows = [[frame, 0.0, 0.0, 0.8, 0.0, 0.0, 0.0, 1.0, *cells[frame::2]] for frame in (0, 1)]
    motion = load(csv(rows))
    assert motion.joint_pos.tolist() == [cells[0::2], cells[1::2]]


SPELLINGS = {
    "crlf": lambda text: text.replace("\n", "\r\n"),
    "cr": lambda text: text.replace("\n", "\r"),
    "bom": lambda text: "\ufeff" + text,
    "no last newline": lambda text: text.rstrip("\n"),
    "blank last lines": lambda text: text + "\n  \n\r\n",
    "spaces": lambda text: text.replace(",", " , "),
    "tabs": lambda text: text.replace(",", ",\t"),
}


@pytest.mark.parametrize("spelling", SPELLINGS.values(), ids=SPELLINGS)
def test_spellings_of_the_same_file(load, spelling):
    content = csv(rows_of(4))
    assert_same(load(spelling(content)), load(content))


def test_frames_may_be_numbered_from_anywhere_or_not_at_all(load):
    rows = rows_of(3)
    for content in (
        csv([[row[0] + 120, *row[1:]] for row in rows]),
        csv([row[1:] for row in rows], COLUMNS[1:]),
    ):
        assert_same(load(content), load(csv(rows)))


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
        (changed(3, 1, "0"), "line 3, column 1 (Frame)", ["frame 0 follows frame 0"]),
        (changed(3, 1, "1.5"), "line 3, column 1 (Frame)", ["frame 1.5 follows frame 0"]),
        (csv(rows_of(1)), "", ["1 frame"]),
        (csv(ZERO_QUAT), "", ["frame 2, line 4", "zero"]),
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


@given(line=st.integers(2, 6), column=st.integers(1, 37), cell=st.text(max_size=6))
@settings(max_examples=100, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_cell_is_read_or_refused(load, line, column, cell):
    assert_read_or_refused(load, changed(line, column, cell))


def test_lafan1_without_a_header_is_assumed_without_the_extra(load, monkeypatch):
    """Nothing tells its columns; with the extra `formats`, joint limits do."""
    monkeypatch.setitem(EXTENSIONS, "motion_formats", "g1stream.extras.absent:FORMATS")
    rows = rows_of(5)
    expected, found = load(csv(rows)), load(bare(rows))
    assert_same(found, expected)
    evidence = find_motion(found.source).open().evidence
    assert evidence.assumed.keys() == {"joint order", "pelvis", "frame rate"}
    assert len(found.warnings) == 3
    with pytest.raises(MotionError, match="`formats`"):
        load("1,2,3\n4,5,6\n")
    with pytest.raises(MotionError, match="line 2, column 1:"):
        load(bare(rows).replace("\n", "\nx", 1))


def test_memory_is_in_proportion_to_the_file():
    content = csv(rows_of(20)).split("\n", 1)[1].encode() * 500
    tracemalloc.start()
    try:
        assert TextTable(content, "clip.csv").values(1, 37).shape == (10_000, 37)
        assert tracemalloc.get_traced_memory()[1] < len(content)
    finally:
        tracemalloc.stop()
