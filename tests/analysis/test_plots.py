import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread

from g1stream.analysis import plots
from g1stream.analysis.plots import draw
from g1stream.app.session import open_session
from g1stream.errors import ConfigError, RecordingError
from g1stream.robot.joints import JOINT_NAMES
from known_sessions import write_known

AXES = ("pitch", "roll", "yaw")
METADATA = {"motion": {"name": "dance"}, "stream": {"reason": "SIGINT"}}


@pytest.fixture(scope="module")
def session(play, tmp_path_factory):
    sag = np.zeros(29)
    sag[1] = 0.3
    path = tmp_path_factory.mktemp("plots") / "session.mcap"
    return open_session(write_known(path, *play(0.04, sag), METADATA))


@pytest.fixture
def figures(monkeypatch):
    """The figures that are saved from now on."""
    saved = []
    save = Figure.savefig

    def remember(figure, *args, **how):
        saved.append(figure)
        return save(figure, *args, **how)

    monkeypatch.setattr(Figure, "savefig", remember)
    return saved


def _words(figure):
    titles = [axes.get_title(loc) for axes in figure.axes for loc in ("left", "right")]
    texts = [*figure.texts, *(text for axes in figure.axes for text in axes.texts)]
    return [text.get_text() for text in texts] + titles


@pytest.mark.slow
def test_the_overview(session, figures, tmp_path):
    draw(session, tmp_path / "tracking.png")
    assert imread(tmp_path / "tracking.png").shape[:2] == (1000, 1600)
    assert [path.name for path in tmp_path.glob("tracking*")] == ["tracking.png"]
    words = " | ".join(_words(figures[0]))
    for what in ("dance", "40.0 ms", "2000 states", "SIGINT", "left_hip_roll"):
        assert what in words
    panel = next(a for a in figures[0].axes if a.get_title("left").startswith("left_hip_roll"))
    reference, measured = (np.asarray(line.get_ydata()) for line in panel.get_lines())
    stamps, state_stamps = session.reference.publish_time, session.measured.publish_time
    shown = (state_stamps >= stamps[0]) & (state_stamps <= stamps[-1])
    np.testing.assert_allclose(measured, np.degrees(session.measured.q[shown, 1]), atol=1e-9)
    # The last 0.2 s are DAMP, where no angle is asked for.
    asked = np.degrees(session.reference.q[:-100, 1])
    np.testing.assert_allclose(reference[:-100], asked, atol=1e-9)
    assert np.isnan(reference[-100:]).all()


@pytest.mark.slow
def test_all_texts_are_inside_and_apart(play, write_session, figures, tmp_path):
    reference, measured = play(0.04)
    # Long names and large errors.
    measured.q[:, [JOINT_NAMES.index(f"right_shoulder_{axis}_joint") for axis in AXES]] += 2.5
    draw(open_session(write_session(reference, measured)), tmp_path / "tracking.png")
    figure = figures[0]
    boxes = [text.get_window_extent() for text in figure.texts]
    boxes.append(figure.legends[0].get_window_extent())
    for axes in figure.axes:
        texts = (axes._left_title, axes._right_title, *axes.texts)
        boxes += [t.get_window_extent() for t in texts if t.get_text()]
    for i, box in enumerate(boxes):
        assert 0 <= box.x0 < box.x1 <= 1600
        assert 0 <= box.y0 < box.y1 <= 1000
        assert not any(box.overlaps(other) for other in boxes[:i])


def test_the_scale_of_the_error_is_that_of_play(play, write_session):
    """Otherwise a robot that is late in RAMP would hide it."""
    reference, measured = play(0.0, 0.1)
    usual = open_session(write_session(reference, measured, name="usual.mcap")).plot()
    measured.q[50:100] += 1.0
    figure = open_session(write_session(reference, measured, name="late.mcap")).plot()
    axes, other = (
        next(a for a in one.axes if a.get_title("left").startswith("RMS "))
        for one in (figure, usual)
    )
    assert axes.get_ylim() == pytest.approx(other.get_ylim())
    assert max(np.nanmax(line.get_ydata()) for line in axes.get_lines()) > axes.get_ylim()[1]


def test_a_state_that_is_not_finite_leaves_the_rest_of_the_error(play, write_session):
    reference, measured = play(0.0, 0.1)
    end = open_session(write_session(reference, measured, name="good.mcap")).measured.time[-1]
    measured.q[300, 0] = measured.q[310, 3] = np.nan
    figure = open_session(write_session(reference, measured, name="nan.mcap")).plot()
    axes = next(a for a in figure.axes if a.get_title("left").startswith("RMS "))
    left, *others = (line.get_xydata() for line in axes.get_lines() if len(line.get_xdata()) > 2)
    for times, rms in (one.T for one in (left, *others)):
        assert np.isfinite(rms[times > end - 0.7]).any()


def test_a_session_that_ended_before_play(play, take, write_session, figures, tmp_path):
    streams = [take(stream, slice(0, 200)) for stream in play()]
    draw(open_session(write_session(*streams)), tmp_path / "tracking.png")
    assert "nothing to compare" in " ".join(_words(figures[0]))
    assert imread(tmp_path / "tracking.png").shape[:2] == (1000, 1600)


@pytest.mark.slow
@pytest.mark.parametrize(("worst_at", "start"), [(0.2, -0.5), (2.3, 1.3), (3.9, 2.5)])
def test_a_long_session_is_shown_around_its_greatest_error(
    play, write_session, monkeypatch, worst_at, start
):
    monkeypatch.setattr(plots, "LONGEST_VIEW", 2.0)
    reference, measured = play()
    times = (measured.publish_time - reference.publish_time[0]) / 1e9 - 0.5
    measured.q[np.searchsorted(times, worst_at), 11] += 2.0
    figure = open_session(write_session(reference, measured)).plot()
    assert figure.axes[0].get_xlim() == pytest.approx((start, start + 2.0), abs=0.005)


def _panels(figure):
    return [(axes.get_title("left"), axes.get_ylabel()) for axes in figure.axes]


def test_a_row_for_each_joint_and_a_column_for_each_quantity(session):
    figure = session.plot("*_knee", ["error", "q"])
    assert _panels(figure) == [
        (joint, quantity)
        for joint in ("left_knee", "right_knee")
        for quantity in ("error, deg", "position, deg")
    ]
    (line,) = figure.axes[0].get_lines()
    followed = session.tracking()
    in_play = np.isin(line.get_xdata(), followed.time)
    error = np.degrees(followed.error[:, 3])
    np.testing.assert_allclose(line.get_ydata()[in_play], error, atol=1e-6)


def test_the_quantities_of_few_joints_are_below_each_other(session):
    figure = session.plot("left_knee", ["q", "error", "dq"])
    labels = "position, deg", "error, deg", "velocity, deg/s"
    assert _panels(figure) == [("left_knee", label) for label in labels]
    assert [axes.get_subplotspec().rowspan.start for axes in figure.axes] == [0, 1, 2]
    assert [axes.get_xlabel() for axes in figure.axes][:2] == ["", ""]
    two = session.plot(["left_knee", "right_knee"], ["q", "error", "dq"])
    assert [name for name, _ in _panels(two)] == ["left_knee", "right_knee"] * 3


def test_more_joints_than_the_overview_has_room_for(session):
    assert len(session.plot("left_*").axes) == len(session.plot("left_leg, left_arm").axes) == 13
    assert len(session.plot(["left_knee", "left_*_roll"]).axes) == 5 + 2  # error and RMSE


def test_a_session_without_a_reference(play, write_session):
    figure = open_session(write_session(measured=play().measured)).plot("left_knee")
    assert _panels(figure) == [("left_knee", "position, deg")]
    assert len(figure.axes[0].get_lines()) == 1


def test_its_format_is_that_of_its_name(session, tmp_path):
    draw(session, tmp_path / "a.SVG", "waist", ["tau"])
    assert (tmp_path / "a.SVG").read_bytes().startswith(b"<?xml")


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
