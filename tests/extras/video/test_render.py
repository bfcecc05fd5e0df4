import dataclasses
import json
import os
import subprocess
import sys
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image

import g1stream
from g1stream.app.session import open_session
from g1stream.cli.main import main
from g1stream.config import load_config
from g1stream.errors import ConfigError, RecordingError, RobotError
from g1stream.extras.video.render import AZIMUTHS, Poses, render
from g1stream.extras.video.render_cli import parse_size
from g1stream.robot.model import G1
from g1stream.types import Phase

SIZE = (96, 96)


@pytest.fixture(autouse=True)
def primitives(monkeypatch):
    """Shapes that are drawn fast."""
    monkeypatch.setattr("g1stream.extras.video.render.with_shapes", lambda robot: robot)


@pytest.fixture
def session(play, write_session):
    """Writes a session: of one robot, or of both with the left shoulder off by an angle, rad."""

    def write(kind=None, off=0.0):
        offset = np.zeros(29)
        offset[15] = off
        played = play(0.0, offset, ((Phase.RAMP, 0.1), (Phase.PLAY, 1.7), (Phase.HOLD, 0.1)))
        streams = played._asdict() if kind is None else {kind: getattr(played, kind)}
        return open_session(write_session(**streams, name=f"{kind} {off}.mcap"))

    return write


def _picture(session, path, **how):
    video = render(session, path, **({"start": 1.0, "size": SIZE} | how))
    return video, np.asarray(Image.open(path)).astype(int)


def _bluish(picture):
    """Pixels of the ghost below the text, which has neither the floor's blue nor the sky's."""
    red, blue = picture[30:, :, 0], picture[30:, :, 2]
    return int((blue - red > 90).sum())


@pytest.mark.slow
def test_the_ghost_shows_where_the_robot_is_elsewhere(session, tmp_path):
    """At 2 mrad, a millimetre at the hand, there is none."""
    video, near = _picture(session(off=0.002), tmp_path / "near.png", size=(240, 240))
    assert (video.frames, video.shown, video.meshes) == (1, "measured and ghost", False)
    _, off = _picture(session(off=-1.5), tmp_path / "off.png", size=(240, 240))
    assert near.shape == off.shape == (240, 240, 3)
    assert _bluish(near) == 0
    assert _bluish(off) > 100


@pytest.mark.parametrize("camera", AZIMUTHS)
def test_the_whole_robot_is_in_the_picture(session, tmp_path, camera):
    _, ghost = _picture(session("reference"), tmp_path / "out.png", size=(200, 200), camera=camera)
    blue = ghost[..., 2] - ghost[..., 0] > 90
    rows, columns = np.flatnonzero(blue.any(axis=1)), np.flatnonzero(blue.any(axis=0))
    assert min(rows[0], columns[0]) > 2
    assert max(rows[-1], columns[-1]) < 197
    assert np.ptp(rows) > 80


@pytest.mark.parametrize("kind", ["reference", "measured"])
def test_one_of_the_two_is_shown_alone(session, tmp_path, kind):
    video, picture = _picture(session(kind), tmp_path / "out.png")
    assert video.shown == kind
    corner = picture[:30, :60]
    assert (corner.min(axis=-1) > 230).any()  # the text
    assert (corner.max(axis=-1) < 90).mean() > 0.2  # its ground
    assert picture[30:].std() > 10


@pytest.mark.slow
def test_an_mp4_has_the_frames_the_size_and_the_rate_that_were_asked_for(session, tmp_path):
    import av

    path = tmp_path / "out.mp4"
    video = render(session(off=-1.5), path, start=1.0, duration=0.5, fps=20, size=(128, 96))
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
        assert (stream.average_rate, stream.width, stream.height) == (20, 128, 96)
    assert len(frames) == video.frames == 10
    assert dataclasses.astuple(video)[2:4] == (1.0, 0.5)
    assert np.abs(frames[0].astype(int) - frames[-1]).max() > 50  # the robot moves


@pytest.mark.slow
def test_a_gif_lasts_as_long_as_the_session(session, tmp_path):
    session(off=-1.5).render(tmp_path / "out.gif", start=1.0, duration=0.5, fps=30, size=SIZE)
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
def test_what_cannot_be_written_leaves_nothing(session, tmp_path, name, how, error):
    same = session()
    (tmp_path / "there.png").write_text("mine")
    before = sorted(tmp_path.iterdir())
    with pytest.raises(error):
        render(same, tmp_path / name, **({"start": 1.0, "size": SIZE} | how))
    assert sorted(tmp_path.iterdir()) == before
    assert (tmp_path / "there.png").read_text() == "mine"


@pytest.mark.slow
def test_no_opengl_is_an_error(session, tmp_path):
    out = tmp_path / "out.png"
    environment = os.environ | {"MUJOCO_GL": "egl", "PYOPENGL_PLATFORM": "osmesa"}  # contradict
    command = [sys.executable, "-m", "g1stream", "render", session().path, "-o", out]
    ended = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert ended.returncode == 2
    assert "Traceback" not in ended.stderr
    assert not out.exists()


def test_a_robot_without_shapes_is_an_error(session, tmp_path, monkeypatch):
    root = ElementTree.fromstring(G1.default().urdf)
    for link in root.iter("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(shape)
    bare = G1.from_urdf(ElementTree.tostring(root, encoding="unicode"), "bare.urdf")
    monkeypatch.setattr("g1stream.extras.video.render.with_shapes", lambda robot: bare)
    with pytest.raises(RobotError, match="shapes"):
        render(session(), tmp_path / "out.png", start=1.0, size=SIZE)


def test_the_command_says_what_it_wrote_as_json(session, tmp_path, capsys):
    path = tmp_path / "out.gif"
    given = ["render", str(session().path), "-o", str(path), "--size", "96x96", "--fps", "5"]
    assert main([*given, "--start", "0.5", "--duration", "1", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    with Image.open(path) as picture:
        assert (told["path"], told["frames"]) == (str(path), picture.n_frames)
    assert (told["start"], told["duration"]) == (0.5, 1.0)


def test_a_size_has_two_numbers():
    assert parse_size("640x480") == (640, 480)
    for wrong in ("640", "x480", "640x480x3", "-1x4", "640 x 480"):
        with pytest.raises(ConfigError):
            parse_size(wrong)


def test_the_error_in_a_video_is_that_of_the_joints_that_play():
    over = {"stream.ramp": 0.5, "stream.hold": 0.1, "stream.damp": 0.5, "stream.others": "free"}
    config = load_config(over=over)
    arms = g1stream.rollout("demo", seconds=0.5, joints="arms", config=config)
    shown, tracking = Poses(arms, np.array([0.4])), arms.tracking()
    at = np.abs(tracking.time - 0.4).argmin()
    expected = np.degrees(np.sqrt(np.mean(tracking.error[at, 15:] ** 2)))
    assert f"{expected:.2f} deg" in shown.text(0)
