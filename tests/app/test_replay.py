"""What a replay hands to the streamer, and what it refuses to."""

import numpy as np
import pytest

from g1stream.app import replay as program
from g1stream.app.replay import replay
from g1stream.dds.messages import LowCmd, Reference
from g1stream.errors import ConfigError, RecordingError
from g1stream.robot.joints import JOINT_NAMES
from g1stream.session.writer import SessionWriter
from g1stream.types import Phase

T0 = 1_700_000_000_000_000_000
PERIOD = 4_000_000
KNEE = JOINT_NAMES.index("left_knee_joint")
PHASES = [Phase.RAMP] * 20 + [Phase.PLAY] * 60 + [Phase.DAMP] * 20


@pytest.fixture
def handed(monkeypatch):
    """What `stream` is called with, instead of playing."""
    calls = []
    monkeypatch.setattr(program, "stream", lambda *args, **named: calls.append((args, named)))
    return calls


def knee_at(i):
    return 0.3 + 0.001 * i


def reference(i, phase):
    message = Reference()
    message.q[KNEE] = knee_at(i)
    message.root_quat_wxyz[0] = 1.0
    message.phase[()] = phase
    message.motion_time[()] = 2.0 + i * PERIOD / 1e9
    return message.tobytes()


@pytest.fixture
def write(tmp_path):
    """A session with a command and, if there are to be any, a reference every PERIOD."""

    def make(references):
        path = tmp_path / "session.mcap"
        with SessionWriter(path) as writer:
            for i, phase in enumerate(PHASES):
                stamp = T0 + i * PERIOD
                writer.write("/lowcmd", LowCmd().seal(), stamp + 9, stamp)
                if references:
                    writer.write("/reference", reference(i, phase), stamp + 9, stamp)
        return path

    return make


def test_the_reference_is_a_motion_at_the_speed_asked_for(write, handed):
    replay(write(references=True), speed=0.5)
    ((motion, _),) = [args for args, _ in handed]
    assert motion.n_frames == 60
    assert motion.fps == 125
    np.testing.assert_allclose(
        motion.joint_pos[:, KNEE], [knee_at(i) for i in range(20, 80)], atol=1e-9
    )


def test_without_a_reference_there_is_no_motion_to_replay(write, handed):
    with pytest.raises(RecordingError, match="no messages on /reference"):
        replay(write(references=False))
    assert not handed


@pytest.mark.parametrize("speed", [0.0, -1.0, float("nan"), float("inf")])
def test_a_speed_that_is_none(write, handed, speed):
    with pytest.raises(ConfigError, match="speed"):
        replay(write(references=True), speed=speed)
    assert not handed
