"""Pictures of a session, by their pixels, and the files that they are in."""

import dataclasses
import os
import subprocess
import sys
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image

from g1stream.app.session import open_session
from g1stream.cli.render import parse_size
from g1stream.errors import ConfigError, RecordingError, RobotError
from g1stream.extras.video.render import AZIMUTHS, render
from g1stream.robot.model import G1

SIZE = (96, 96)


@pytest.fixture(autouse=True)
def primitives(monkeypatch):
    """Shapes that are drawn fast."""
    monkeypatch.setattr("g1stream.extras.video.render.with_shapes", lambda robot: robot)


@pytest.fixture
def sessions(play, write_session):
    """Sessions by what is in them: `off` has one arm elsewhere than asked."""
    offset = np.zeros(29)
    offset[15] = -1.5  # left shoulder pitch
    reference, measured = play(0.0)
    return {
        "same": open_session(write_session(reference, measured, name="same.mcap")),
        "off": open_session(write_session(*play(0.0, offset), name="off.mcap")),
        "reference": open_session(write_session(reference, None, name="reference.mcap")),
        "measured": open_session(write_session(None, measured, name="measured.mcap")),
    }


def _picture(session, path, **how):
    video = render(session, path, **({"start": 1.0, "size": SIZE} | how))
    return video, np.asarray(Image.open(path)).astype(int)


def _bluish(picture):
    """Pixels of the ghost below the text, which has neither the floor's blue nor the sky's."""
    red, blue = picture[30:, :, 0], picture[30:, :, 2]
    return int((blue - red > 90).sum())


@pytest.mark.slow
def test_the_ghost_shows_where_the_robot_is_elsewhere(sessions, tmp_path):
    video, same = _picture(sessions["same"], tmp_path / "same.png", size=(240, 240))
    assert (video.frames, video.shown, video.meshes) == (1, "measured and ghost", False)
    _, off = _picture(sessions["off"], tmp_path / "off.png", size=(240, 240))
    assert same.shape == off.shape == (240, 240, 3)
    assert _bluish(off) > 3 * _bluish(same) + 100


@pytest.mark.slow
def test_an_error_that_nobody_sees_leaves_no_ghost(play, write_session, tmp_path):
    offset = np.zeros(29)
    offset[15] = 0.002  # left shoulder pitch: a millimetre at the hand
    near = open_session(write_session(*play(0.0, offset), name="near.mcap"))
    _, picture = _picture(near, tmp_path / "near.png", size=(240, 240))
    assert _bluish(picture) == 0


@pytest.mark.parametrize("camera", AZIMUTHS)
def test_the_whole_robot_is_in_the_picture(sessions, tmp_path, camera):
    _, ghost = _picture(sessions["reference"], tmp_path / "out.png", size=(200, 200), camera=camera)
    blue = ghost[..., 2] - ghost[..., 0] > 90
    rows, columns = np.flatnonzero(blue.any(axis=1)), np.flatnonzero(blue.any(axis=0))
    assert rows[0] > 2
    assert rows[-1] < 197
    assert columns[0] > 2
    assert columns[-1] < 197
    assert np.ptp(rows) > 80


@pytest.mark.parametrize("kind", ["reference", "measured"])
def test_one_of_the_two_is_shown_alone(sessions, tmp_path, kind):
    video, picture = _picture(sessions[kind], tmp_path / "out.png")
    assert video.shown == kind
    corner = picture[:30, :60]
    assert (corner.min(axis=-1) > 230).any()  # the text
    assert (corner.max(axis=-1) < 90).mean() > 0.2  # its ground
    assert picture[30:].std() > 10


@pytest.mark.slow
def test_an_mp4_has_the_frames_the_size_and_the_rate_that_were_asked_for(sessions, tmp_path):
    import av

    path = tmp_path / "out.mp4"
    video = render(sessions["off"], path, start=1.0, duration=0.5, fps=20, size=(128, 96))
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
        assert (stream.average_rate, stream.width, stream.height) == (20, 128, 96)
    assert len(frames) == video.frames == 10
    assert dataclasses.astuple(video)[2:4] == (1.0, 0.5)
    assert np.abs(frames[0].astype(int) - frames[-1]).max() > 50  # the robot moves


@pytest.mark.slow
def test_a_gif_lasts_as_long_as_the_session(sessions, tmp_path):
    sessions["off"].render(tmp_path / "out.gif", start=1.0, duration=0.5, fps=30, size=SIZE)
    with Image.open(tmp_path / "out.gif") as gif:
        assert gif.n_frames == 15
        durations = []
        for frame in range(gif.n_frames):
            gif.seek(frame)
            durations.append(gif.info["duration"])
    assert sum(durations) == 500


@pytest.mark.parametrize(
    ("name", "how", "error"),
    [
        ("out.avi", {}, ConfigError),
        ("out.mp4", {"size": (95, 96)}, ConfigError),
        ("out.png", {"size": (0, 96)}, ConfigError),
        ("out.gif", {"fps": 0.0}, ConfigError),
        ("out.png", {"start": 100.0}, RecordingError),
        ("out.png", {"start": float("nan")}, RecordingError),
        ("there.png", {}, RecordingError),
        ("missing/out.png", {}, RecordingError),
    ],
)
def test_what_cannot_be_written_leaves_nothing(sessions, tmp_path, name, how, error):
    (tmp_path / "there.png").write_text("mine")
    before = sorted(tmp_path.iterdir())
    with pytest.raises(error):
        render(sessions["same"], tmp_path / name, **({"start": 1.0, "size": SIZE} | how))
    assert sorted(tmp_path.iterdir()) == before
    assert (tmp_path / "there.png").read_text() == "mine"


@pytest.mark.slow
def test_no_opengl_is_an_error(sessions, tmp_path):
    out = tmp_path / "out.png"
    environment = os.environ | {"MUJOCO_GL": "egl", "PYOPENGL_PLATFORM": "osmesa"}  # contradict
    command = [sys.executable, "-m", "g1stream", "render", sessions["same"].path, out]
    ended = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert ended.returncode == 2
    assert "Traceback" not in ended.stderr
    assert not out.exists()


def test_a_robot_without_shapes_is_an_error(sessions, tmp_path, monkeypatch):
    root = ElementTree.fromstring(G1.default().urdf)
    for link in root.iter("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(shape)
    bare = G1.from_urdf(ElementTree.tostring(root, encoding="unicode"), "bare.urdf")
    monkeypatch.setattr("g1stream.extras.video.render.with_shapes", lambda robot: bare)
    with pytest.raises(RobotError, match="shapes"):
        render(sessions["same"], tmp_path / "out.png", start=1.0, size=SIZE)


def test_a_size_has_two_numbers():
    assert parse_size("640x480") == (640, 480)
    for wrong in ("640", "x480", "640x480x3", "-1x4", "640 x 480"):
        with pytest.raises(ConfigError):
            parse_size(wrong)
