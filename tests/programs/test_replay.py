"""What a replay hands to the streamer, and what it refuses to."""

import numpy as np
import pytest

from g1stream.config import Config
from g1stream.control.phases import Phase
from g1stream.dds.messages import LowCmd, Reference
from g1stream.errors import ConfigError, RecordingError, SafetyError
from g1stream.programs import replay as program
from g1stream.programs.replay import replay
from g1stream.recording.writer import SessionWriter
from g1stream.robot.joints import JOINT_NAMES

T0 = 1_700_000_000_000_000_000
PERIOD = 4_000_000
N = 100
KNEE = JOINT_NAMES.index("left_knee_joint")


@pytest.fixture
def handed(monkeypatch):
    """What `stream` is called with, instead of playing."""
    calls = []
    monkeypatch.setattr(program, "stream", lambda *args, **named: calls.append((args, named)))
    return calls


def knee_at(i):
    return 0.3 + 0.001 * i


def command(i, **changes):
    message = LowCmd()
    message.q[KNEE] = knee_at(i)
    message.kp[:] = 40.0
    for name, value in changes.items():
        getattr(message, name)[...] = value
    return message.seal()


def reference(i, phase):
    message = Reference()
    message.q[KNEE] = knee_at(i)
    message.root_quat_wxyz[0] = 1.0
    message.phase[()] = phase
    message.motion_time[()] = 2.0 + i * PERIOD / 1e9
    return message.tobytes()


@pytest.fixture
def write(tmp_path):
    def make(commands, phases=None):
        path = tmp_path / "session.mcap"
        with SessionWriter(path) as writer:
            for i, data in enumerate(commands):
                stamp = T0 + i * PERIOD
                writer.write("/lowcmd", data, stamp + 9, stamp)
                if phases is not None:
                    writer.write("/reference", reference(i, phases[i]), stamp + 9, stamp)
        return path

    return make


PHASES = [Phase.RAMP] * 20 + [Phase.PLAY] * 60 + [Phase.DAMP] * 20


def test_the_reference_is_a_motion_at_the_speed_asked_for(write, handed):
    replay(write(map(command, range(N)), PHASES), speed=0.5)
    ((motion, _),) = [args for args, _ in handed]
    assert motion.n_frames == 60
    assert motion.fps == 125
    np.testing.assert_allclose(
        motion.joint_pos[:, KNEE], [knee_at(i) for i in range(20, 80)], atol=1e-9
    )


def test_exact_hands_over_the_commands_of_play_when_they_were_due(write, handed):
    commands = [command(i) for i in range(N)]
    replay(write(commands, PHASES), exact=True, speed=2.0)
    link = handed[0][1]["make_link"].keywords
    assert link["commands"] == commands[20:80]
    np.testing.assert_allclose(link["times"], np.arange(60) * 0.002, atol=1e-12)


def test_without_a_reference_the_commands_that_held_the_robot_are_the_motion(write, handed):
    commands = [command(i, kp=40.0 if 10 <= i < 90 else 0.0) for i in range(N)]
    replay(write(commands), exact=True)
    (motion, _), named = handed[0]
    assert named["make_link"].keywords["commands"] == commands[10:90]
    assert motion.n_frames == 80
    assert motion.fps == 250
    np.testing.assert_allclose(
        motion.joint_pos[:, KNEE], [knee_at(i) for i in range(10, 90)], atol=1e-6
    )


def test_without_a_reference_there_is_no_motion_to_replay(write, handed):
    with pytest.raises(RecordingError, match="no messages on /reference"):
        replay(write(map(command, range(N))))
    assert not handed


def damaged(data):
    return data[:100] + bytes([data[100] ^ 1]) + data[101:]


@pytest.mark.parametrize(
    ("odd", "told"),
    [
        (command(0, q=9.0), "q of 9.000 rad, beyond its limits"),
        (command(0, dq=99.0), "dq of 99.000 rad/s, beyond its limits"),
        (command(0, tau=900.0), "tau of 900.000 Nm, beyond its limits"),
        (command(0, kp=2000.0), "kp of 2000.000 Nm/rad, beyond its limits"),
        (command(0, kd=80.0), "kd of 80.000 Nm s/rad, beyond its limits"),
        (command(0, tau=np.nan), "tau of left_hip_pitch_joint that is not finite"),
        (command(0, mode_pr=1), "mode_pr 1"),
        (damaged(command(0)), "checksum"),
    ],
)
def test_one_command_that_must_not_be_sent_refuses_them_all(write, handed, odd, told):
    commands = [command(i) for i in range(N)]
    commands[50] = odd
    with pytest.raises(SafetyError, match=told):
        replay(write(commands, PHASES), exact=True)
    assert not handed


def test_what_was_not_played_does_not_matter(write, handed):
    commands = [command(i) for i in range(N)]
    commands[5] = command(0, q=9.0)
    replay(write(commands, PHASES), exact=True)
    assert len(handed) == 1


@pytest.mark.parametrize("speed", [0.0, -1.0, float("nan"), float("inf")])
def test_a_speed_that_is_none(write, handed, speed):
    with pytest.raises(ConfigError, match="speed"):
        replay(write(map(command, range(N)), PHASES), speed=speed)


def test_commands_are_not_looped(write, handed):
    config = Config.model_validate({"stream": {"loop": True}})
    with pytest.raises(ConfigError, match="looped"):
        replay(write(map(command, range(N)), PHASES), config, exact=True)


def test_a_session_without_commands_that_held_the_robot(write, handed):
    with pytest.raises(RecordingError, match="no commands that played"):
        replay(write([command(i, kp=0.0) for i in range(N)]), exact=True)
