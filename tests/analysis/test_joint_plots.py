import numpy as np
import pytest

from g1stream.analysis.plots import draw
from g1stream.app.session import open_session
from g1stream.errors import ConfigError, RecordingError


@pytest.fixture
def session(play, write_session):
    return open_session(write_session(*play(0.04)))


def _panels(figure):
    return [(axes.get_title("left"), axes.get_ylabel()) for axes in figure.axes]


def test_a_row_for_each_joint_and_a_column_for_each_quantity(session):
    figure = session.plot("*_knee", ["error", "q"])
    rows = [
        (joint, quantity)
        for joint in ("left_knee", "right_knee")
        for quantity in ("error, deg", "position, deg")
    ]
    assert _panels(figure) == rows
    (line,) = figure.axes[0].get_lines()
    np.testing.assert_allclose(line.get_ydata(), np.degrees(session.tracking().error[:, 3]))
    assert [axes.get_xlabel() for axes in figure.axes[2:]] == ["time since the motion began, s"] * 2


def test_the_quantities_of_few_joints_are_below_each_other(session):
    figure = session.plot("left_knee", ["q", "error", "dq"])
    labels = "position, deg", "error, deg", "velocity, deg/s"
    assert _panels(figure) == [("left_knee", label) for label in labels]
    tops = [axes.get_subplotspec().rowspan.start for axes in figure.axes]
    assert tops == [0, 1, 2]
    width, height = figure.get_size_inches()
    assert 1.0 < width / height < 2.0
    assert [axes.get_xlabel() for axes in figure.axes] == ["", "", "time since the motion began, s"]
    two = session.plot(["left_knee", "right_knee"], ["q", "error", "dq"])
    assert [name for name, _ in _panels(two)] == ["left_knee", "right_knee"] * 3


def test_more_joints_than_the_overview_has_room_for(session):
    assert len(session.plot("left_*").axes) == len(session.plot("left_leg, left_arm").axes) == 13
    assert len(session.plot(["left_knee", "left_*_roll"]).axes) == 5 + 2  # error and RMSE


def test_a_session_without_a_reference(play, write_session):
    figure = open_session(write_session(measured=play().measured)).plot("left_knee")
    assert _panels(figure) == [("left_knee", "position, deg")]
    assert len(figure.axes[0].get_lines()) == 1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "begins"), [("a.png", b"\x89PNG"), ("a.SVG", b"<?xml"), ("a.pdf", b"%PDF")]
)
def test_its_format_is_that_of_its_name(session, tmp_path, name, begins):
    draw(session, tmp_path / name, "waist", ["tau"])
    assert (tmp_path / name).read_bytes().startswith(begins)


def test_what_cannot_be_drawn(session, play, write_session, tmp_path):
    with pytest.raises(ConfigError, match=r"a\.bmp"):
        draw(session, tmp_path / "a.bmp")
    (tmp_path / "a.png").write_text("older")
    with pytest.raises(RecordingError, match="--force"):
        draw(session, tmp_path / "a.png", force=False)
    for pattern in ("", "left_tail", "*_tail", "left_knee,left_tail"):
        with pytest.raises(ConfigError):
            session.plot(pattern)
    with pytest.raises(RecordingError):
        session.plot([])
    alone = open_session(write_session(reference=play().reference, name="alone.mcap"))
    with pytest.raises(RecordingError):
        alone.plot(what=["error"])
    assert (tmp_path / "a.png").read_text() == "older"
