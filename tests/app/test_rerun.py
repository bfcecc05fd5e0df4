"""What is on DDS as a Rerun recording, and what happens where there is no viewer."""

from __future__ import annotations

import socket
import subprocess
import sys
import threading
import time
from collections import Counter

import numpy as np
import pytest

from g1stream.app.rerun import log_live, show_live
from g1stream.config import Config
from g1stream.dds.domain import Participant
from g1stream.dds.endpoints import RawWriter
from g1stream.dds.messages import LOWSTATE, REFERENCE, LowState, Reference
from g1stream.errors import ConfigError, RobotError
from g1stream.robot.model import G1
from g1stream.types import Phase

rr = pytest.importorskip("rerun", reason="Rerun needs Python 3.11")

T0, PERIOD = 1_700_000_000_000_000_000, 2_000_000
JOINT = "joints/left_knee_joint"


class Recording(rr.RecordingStream):
    """Counts what it is sent, by entity."""

    def __init__(self):
        super().__init__("g1stream")
        self.sent = Counter()

    def send_columns(self, entity_path, *columns, **more):
        self.sent[entity_path] += 1
        super().send_columns(entity_path, *columns, **more)


def _scalars(path, entity):
    """Times, ns, and values of an entity."""
    from rerun.chunk import RrdReader

    times, values = [], []
    for chunk in RrdReader(path).stream():
        if chunk.entity_path == f"/{entity}" and not chunk.is_static:
            table = chunk.to_record_batch()
            times += table.column("publish_time").cast("int64").to_pylist()
            values += table.column("Scalars:scalars").flatten().to_pylist()
    return np.array(times), np.array(values)


@pytest.mark.dds
def test_what_is_published_is_logged(domain_id, tmp_path, until, monkeypatch):
    monkeypatch.setattr("g1stream.viewers.rerun_log.with_shapes", lambda robot: robot)
    config = Config.model_validate({"dds": {"domain": domain_id}})
    stop, recording = threading.Event(), Recording()
    recording.save(tmp_path / "live.rrd")
    logging = threading.Thread(target=log_live, args=(config, G1.load(), recording, stop.is_set))
    reference, state = Reference(), LowState()
    reference.root_quat_wxyz[:] = state.quaternion[:] = [1.0, 0.0, 0.0, 0.0]
    reference.phase[...] = Phase.PLAY
    with Participant(domain_id, "lo") as participant:
        writers = [RawWriter(participant, topic, 100) for topic in (REFERENCE, LOWSTATE)]
        logging.start()
        try:
            until(lambda: all(writer.matched for writer in writers), "the observer")
            number = 0
            while recording.sent[f"{JOINT}/error"] < 2 and number < 5000:
                reference.q[:], state.q[:29] = 0.01 * number, 0.01 * number - 0.25
                for writer, message in zip(writers, (reference, state), strict=True):
                    writer.write(message.tobytes(), T0 + number * PERIOD)
                number += 1
                time.sleep(PERIOD / 1e9)
        finally:
            stop.set()
            logging.join()
    recording.disconnect()
    for what, offset in {"position/reference": 0.0, "position/measured": -0.25}.items():
        times, values = _scalars(tmp_path / "live.rrd", f"{JOINT}/{what}")
        assert len(times) > 50
        np.testing.assert_allclose(values, 0.01 * ((times - T0) // PERIOD) + offset, atol=1e-5)
    times, values = _scalars(tmp_path / "live.rrd", f"{JOINT}/error")
    assert len(times) > 50
    np.testing.assert_allclose(values, 0.25, atol=1e-5)


def test_no_viewer_is_an_error(monkeypatch):
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    with pytest.raises(ConfigError):
        show_live(Config(), f"127.0.0.1:{port}")
    with pytest.raises(ConfigError):
        show_live(Config(), "viewer")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(ConfigError):
        show_live(Config())


@pytest.fixture
def viewers(monkeypatch):
    """The viewers that are started; they never listen."""
    started = []

    def start(*arguments, new_session):
        idle = [sys.executable, "-c", "import time; time.sleep(60)"]
        started.append(subprocess.Popen(idle, start_new_session=new_session))
        return started[-1]

    monkeypatch.setattr("g1stream.app.rerun._start_viewer", start)
    return started


def test_to_stop_while_the_viewer_starts_ends_it(viewers):
    show_live(Config(), should_stop=lambda: True)
    assert [viewer.poll() is not None for viewer in viewers] == [True]


def test_no_viewer_is_started_for_a_robot_that_cannot_be_shown(viewers, tmp_path):
    with pytest.raises(RobotError):
        show_live(Config(robot=str(tmp_path / "absent.urdf")))
    assert viewers == []
