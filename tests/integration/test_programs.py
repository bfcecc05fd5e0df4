"""The programs as a user runs them: real processes, real DDS on loopback, real MuJoCo."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from mcap.reader import make_reader

from g1stream.analysis.tracking import errors_of_run
from g1stream.app.session import open_session
from g1stream.app.stream import stream
from g1stream.config import DdsConfig, load_config
from g1stream.dds.domain import Participant
from g1stream.dds.endpoints import RawWriter
from g1stream.dds.messages import LOWSTATE, LowCmd, LowState
from g1stream.types import Phase
from threads import in_thread

if TYPE_CHECKING:
    from collections.abc import Callable

    from g1stream.control.loop import StreamLoop

#: Beside another simulator a slow machine skips ticks, and a robot on its feet falls.
pytestmark = pytest.mark.alone

RAMP = 0.5
PLAY = 2.0


PATIENT = Path(__file__).parents[1] / "data" / "patient.toml"
"""Settings for a machine on which the simulator may be kept waiting by other work."""


def stream_arguments(domain_id: int, *more: object) -> list[object]:
    short = ["--ramp", RAMP, "--start", 2.0, "--config", PATIENT]
    return ["stream", "demo", "--domain", domain_id, *short, *more]


def run(arguments: list[object], timeout: float = 60.0) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "g1stream", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=timeout, check=False)


def times(path: Path) -> dict[str, np.ndarray[Any, Any]]:
    """(N, 2) log and publish times by topic, read with the stock reader."""
    found: dict[str, list[tuple[int, int]]] = {}
    with path.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages():
            found.setdefault(channel.topic, []).append((message.log_time, message.publish_time))
    return {topic: np.array(pairs) for topic, pairs in found.items()}


@pytest.fixture(scope="module")
def played(
    tmp_path_factory: pytest.TempPathFactory, module_domain_id: int, running: Callable[..., Any]
) -> tuple[Path, dict[str, Any]]:
    """A session of two seconds of the bundled motion on our bridge, and what stream printed."""
    domain_id = module_domain_id
    path = tmp_path_factory.mktemp("played") / "session.mcap"
    with running("sim", "--domain", domain_id):
        done = run(stream_arguments(domain_id, "--duration", PLAY, "--record", path, "--json"))
    assert done.returncode == 0, done.stderr
    return path, json.loads(done.stdout)


def test_a_motion_is_played_and_recorded(played):
    path, summary = played
    assert summary["stream"]["reason"] == ""
    recorded = times(path)
    for topic in ("/tf", "/measured/tf", "/lowstate", "/sportmodestate", "/log"):
        assert len(recorded[topic]) > 0, topic
    assert len(recorded["/lowcmd"]) == summary["stream"]["commands"]
    assert summary["recorder"]["lost"]["/reference"] == 0


def test_a_robot_stands_on_its_feet_and_squats_at_the_end(running, tmp_path, domain_id):
    """Where the demo lifts its right foot, at 8.6 s."""
    pytest.importorskip("daqp")
    path = tmp_path / "feet.mcap"
    part = ["--ramp", 1.5, "--start", 7.8, "--duration", 1.5, "--rate", 125, "--config", PATIENT]
    on_feet = ["stream", "demo", "--domain", domain_id, "--support", "feet", *part]
    with running("sim", "--domain", domain_id, "--support", "free"):
        done = run([*on_feet, "--record", path, "--json"])
    assert done.returncode == 0, done.stderr
    stream = json.loads(done.stdout)["stream"]
    assert (stream["support"], stream["feedforward_changes"]) == ("feet", [])
    session = open_session(path)
    base, reference = session.base, session.reference
    height = np.interp(reference.time, base.time, base.position[:, 2])
    assert height[reference.phase == Phase.PLAY].min() > 0.7
    assert height[reference.phase == Phase.HOLD][-1] < 0.62


def test_a_stream_knows_its_tracking_error_without_the_recording(running, tmp_path, domain_id):
    """By the states that its loop received; the recorder gets those that came in between, too."""
    loops: list[StreamLoop] = []
    part = {"ramp": RAMP, "start": 2.0, "duration": PLAY}
    config = load_config(PATIENT, {f"stream.{key}": value for key, value in part.items()})
    config = config.model_copy(update={"dds": DdsConfig(domain=domain_id)})
    with running("sim", "--domain", domain_id):
        summary = stream("demo", config, record=tmp_path / "s.mcap", on_loop=loops.append)
    recorded = summary.tracking
    found = errors_of_run(loops[0].report.error, np.ones(29, bool))
    assert found is not None
    assert recorded is not None
    assert found.sums.n == pytest.approx(recorded.compared_states, rel=0.2)
    assert found.duration == pytest.approx(recorded.compared_s, rel=0.01)
    assert found.overall == pytest.approx(recorded.all_joints.rmse_rad, rel=0.1)
    assert found.max_abs.max() == pytest.approx(recorded.all_joints.max_abs_rad, rel=0.1)


def test_every_message_was_published_before_it_was_received(played):
    recorders_own = {"/scene", "/measured/scene", "/ghost/scene", "/measured/robot_description"}
    recorded = times(played[0])
    for topic, pairs in recorded.items():  # its own at one instant
        later = pairs[:, 0] - pairs[:, 1]
        assert (later == 0 if topic in recorders_own else later > 0).all(), topic
    assert np.array_equal(recorded["/lowcmd"][:, 1], recorded["/reference"][:, 1])


def test_the_robot_follows_in_every_phase(played):
    session = open_session(played[0])
    phases = session.reference.phase
    order = [Phase.RAMP, Phase.PLAY, Phase.HOLD, Phase.DAMP]
    assert list(dict.fromkeys(phases.tolist())) == order
    play = phases == Phase.PLAY
    # The motion is sampled at the deadlines: two ticks are a period, or several, apart.
    steps = np.diff(session.reference.motion_time[play]) * 500
    assert np.allclose(steps, np.round(steps), atol=1e-6)
    at = np.searchsorted(session.measured.publish_time, session.reference.publish_time[play])
    error = (
        session.measured.q[np.minimum(at, len(session.measured.q) - 1)]
        - (session.reference.q[play])
    )
    moved = np.ptp(session.reference.q[play], axis=0)
    rmse = np.sqrt((error**2).mean())
    assert moved.max() > 0.3
    assert rmse < 0.15


def test_damping_ends_every_session(played):
    path, _ = played
    last = LowCmd()
    with path.open("rb") as file:
        for _, _, message in make_reader(file).iter_messages(topics=["/lowcmd"]):
            last.load(message.data)
    assert last.crc_matches()
    assert not last.kp.any()
    assert not last.tau.any()
    assert (last.kd > 0).all()


def test_a_demo_makes_session_picture_and_summary(domain_id, tmp_path):
    where = ["--domain", domain_id, "--out", tmp_path / "d"]
    done = run(["demo", "--config", PATIENT, "--duration", 2, *where])
    assert done.returncode == 0, done.stderr
    assert open_session(tmp_path / "d/session.mcap").complete
    assert (tmp_path / "d/tracking.png").read_bytes()[:4] == b"\x89PNG"
    assert "all_joints.rmse_rad" in (tmp_path / "d/report.html").read_text()
    assert "RMSE" in done.stdout
    assert done.stdout.count("session.mcap") == 1
    assert re.search(r"played \d\.\d of 14\.0 s", done.stdout)
    again = run(["demo", *where])
    assert again.returncode == 2
    assert "exists already" in again.stderr


def test_a_recorder_is_nobody_to_play_to(domain_id, tmp_path):
    """A LowState comes, but who reads LowCmd only records it: nothing may be sent into the void."""
    config = tmp_path / "short.toml"
    config.write_text("[stream]\nwait = 2.0\n")

    def publish(stop: threading.Event) -> None:
        state = LowState()
        state.quaternion[0] = 1.0
        with Participant(domain_id, "lo") as participant:
            writer = RawWriter(participant, LOWSTATE)
            while not stop.wait(0.002):
                writer.write(state.seal())

    with in_thread(publish):
        where = ["--domain", domain_id, "--record", tmp_path / "void.mcap"]
        done = run(["stream", "demo", "--config", config, *where])
    assert done.returncode == 1
    assert "no subscriber on rt/lowcmd" in done.stdout
    assert "/lowcmd" not in times(tmp_path / "void.mcap")
