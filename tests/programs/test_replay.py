"""What a replay hands to the streamer, and what it refuses to."""

import numpy as np
import pytest

from g1stream.config import Config
from g1stream.dds.messages import LowCmd, Reference
from g1stream.errors import ConfigError, RecordingError, SafetyError
from g1stream.programs import replay as program
from g1stream.programs.replay import replay
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.model import G1
from g1stream.session.writer import SessionWriter
from g1stream.types import Phase

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


def command(i, spare=None, **changes):
    message = LowCmd()
    message.q[KNEE] = knee_at(i)
    message.kp[:] = 40.0
    message.motor_mode = changes.pop("motor_mode", 1)
    message.payload[message.layout["motor_cmd.mode"].offsets[29:]] = changes.pop("spare_mode", 0)
    for name, value in changes.items():
        getattr(message, name)[...] = value
    for name, value in (spare or {}).items():
        message.view(f"motor_cmd.{name}")[29:] = value
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
    """Commands and, where phases are given, references; one every PERIOD, or at `ticks`."""

    def make(commands, phases=None, ticks=None):
        path = tmp_path / "session.mcap"
        with SessionWriter(path, force=True) as writer:
            for i, data in enumerate(commands):
                stamp = T0 + round((i if ticks is None else ticks[i]) * PERIOD)
                if data is not None:
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
    recorded = handed[0][1]["recorded"]
    assert recorded.data == commands[20:80]
    np.testing.assert_allclose(recorded.times, np.arange(60) * 0.002, atol=1e-12)


def test_without_a_reference_the_commands_that_held_the_robot_are_the_motion(write, handed):
    commands = [command(i, kp=40.0 if 10 <= i < 90 else 0.0) for i in range(N)]
    replay(write(commands), exact=True)
    (motion, _), named = handed[0]
    assert named["recorded"].data == commands[10:90]
    assert motion.n_frames == 80
    assert motion.fps == 250
    np.testing.assert_allclose(
        motion.joint_pos[:, KNEE], [knee_at(i) for i in range(10, 90)], atol=1e-6
    )


def test_without_a_reference_there_is_no_motion_to_replay(write, handed):
    with pytest.raises(RecordingError, match="/reference") as error:
        replay(write(map(command, range(N))))
    assert "--exact" in error.value.remedy
    assert not handed


def damaged(data):
    return data[:100] + bytes([data[100] ^ 1]) + data[101:]


@pytest.mark.parametrize(
    ("odd", "told"),
    [
        (command(0, q=9.0), "q = 9.000 rad for left_hip_pitch_joint"),
        (command(0, dq=99.0), "dq = 99.000 rad/s"),
        (command(0, tau=900.0), "tau = 900.000 N·m"),
        (command(0, kp=2000.0), "kp = 2000.000 N·m/rad"),
        (command(0, kd=80.0), "kd = 80.000 N·m·s/rad"),
        (command(0, tau=np.nan), "tau = nan N·m for left_hip_pitch_joint"),
        (command(0, mode_pr=1), "mode_pr 1"),
        (command(0, motor_mode=0), "mode 0 for left_hip_pitch_joint"),
        (damaged(command(0)), "CRC"),
        (command(0, spare={"q": 1e30}), r"q=1e\+30 for motor 29"),
        (command(0, spare={"tau": [0, 0, 0, 0, 0, np.nan]}), "tau=nan for motor 34"),
        (command(0, spare={"tau": 500.0}), "tau=500 for motor 29"),
        (command(0, spare={"kd": 8.0}), "kd=8 for motor 29"),
    ],
)
def test_one_command_that_must_not_be_sent_refuses_them_all(write, handed, odd, told):
    commands = [command(i) for i in range(N)]
    commands[50] = odd
    with pytest.raises(SafetyError, match=told):
        replay(write(commands, PHASES), exact=True)
    assert not handed


def test_motors_that_a_g1_has_not_may_be_enabled(write, handed):
    enabled, other = (command(0, spare_mode=mode) for mode in (1, 10))
    replay(write([enabled] * N, PHASES), exact=True)
    with pytest.raises(SafetyError, match="mode=10 for motor 29"):
        replay(write([other] * N, PHASES), exact=True)
    assert len(handed) == 1


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
    with pytest.raises(RecordingError, match="no commands"):
        replay(write([command(i, kp=0.0) for i in range(N)]), exact=True)


def exactly(path, **safety):
    replay(path, Config.model_validate({"safety": safety}), exact=True)


def test_the_margin_to_the_joint_limits_holds_for_recorded_commands(write, handed):
    lower = float(G1.load().lower[KNEE])
    at_limit = [command(i, q=np.where(np.arange(29) == KNEE, lower, 0.0)) for i in range(N)]
    path = write(at_limit, PHASES)
    exactly(path)
    with pytest.raises(SafetyError, match=r"safety.position_margin = 0.05 rad"):
        exactly(path, position_margin=0.05)
    assert len(handed) == 1


def test_a_margin_that_leaves_nothing_is_explained(write, handed):
    with pytest.raises(ConfigError, match="position_margin"):
        exactly(write(map(command, range(N)), PHASES), position_margin=0.49)


def knees(targets):
    return [command(i, q=np.where(np.arange(29) == KNEE, q, 0.0)) for i, q in enumerate(targets)]


@pytest.mark.parametrize("phases", [PHASES, None])
def test_a_spliced_recording_would_make_the_robot_leap(write, handed, phases):
    spliced = np.where(np.arange(N) < 50, 0.3, 0.9)
    with pytest.raises(SafetyError, match=r"left_knee_joint by 0.600 rad in one step"):
        exactly(write(knees(spliced), phases))
    assert not handed


def test_as_fast_as_the_joint_can_is_no_leap(write, handed):
    speed = float(G1.load().velocity[KNEE])
    there = np.minimum(speed * np.arange(N) * PERIOD / 1e9, 2.0)
    path = write(knees(there), [Phase.PLAY] * N)
    exactly(path)
    with pytest.raises(SafetyError, match="in one step"):
        replay(path, exact=True, speed=1.2)
    assert len(handed) == 1


def with_hole(n):
    """All commands but n in the middle of PLAY."""
    return [None if 40 <= i < 40 + n else command(i) for i in range(N)]


def test_a_short_gap_is_bridged(write, handed):
    exactly(write(with_hole(10), PHASES))
    assert len(handed) == 1


def test_a_gap_in_which_the_robot_goes_far_is_a_leap(write, handed):
    fast = np.minimum(15.0 * np.arange(N) * PERIOD / 1e9, 2.0)
    whole = knees(fast)
    path = write([None if 22 <= i < 31 else one for i, one in enumerate(whole)], PHASES)
    with pytest.raises(SafetyError, match=r"by 0.600 rad .* allow 0.400"):
        exactly(path)
    exactly(write(whole, PHASES))


@pytest.mark.parametrize(
    ("missing", "told"),
    [((40, 66), "0.076 to 0.184 s"), ((20, 50), "0.000 to 0.120 s"), ((50, 80), "0.116 to 0.236")],
)
def test_one_command_does_not_stand_for_many(write, handed, missing, told):
    commands = [None if missing[0] <= i < missing[1] else command(i) for i in range(N)]
    path = write(commands, PHASES)
    with pytest.raises(SafetyError, match=told):
        exactly(path)
    exactly(path, state_timeout=0.2)
    with pytest.raises(SafetyError, match=r"limit 0.2 s"):
        replay(
            path,
            Config.model_validate({"safety": {"state_timeout": 0.2}}),
            exact=True,
            speed=0.5,
        )
    assert len(handed) == 1


def test_two_motions_in_one_session_are_not_played_through_each_other(write, handed, monkeypatch):
    def reference_of_two(i, phase, whole=reference):
        return whole(i if i < 50 else i - 25, phase)

    monkeypatch.setitem(globals(), "reference", reference_of_two)
    with pytest.raises(SafetyError, match="more than one motion"):
        exactly(write(knees([0.3] * N), PHASES))
    assert not handed


def test_a_leap_is_one_at_any_rate(write, handed):
    """The robot is commanded at 500 Hz whatever was recorded."""
    path = write(knees(0.3 + 1.9 * (np.arange(N) % 2)), ticks=np.arange(N) * 0.0999e9 / PERIOD)
    with pytest.raises(SafetyError, match=r"by 1\.900 rad .* allow 0\.400"):
        exactly(path)


@pytest.mark.parametrize("odd", [np.nan, np.inf, 2.0])
def test_a_motion_without_times_is_none(write, handed, monkeypatch, odd):
    def reference_of_odd_times(i, phase):
        message = Reference()
        message.phase[()] = phase
        message.motion_time[()] = odd if odd == 2.0 or i == 50 else 0.004 * i
        return message.tobytes()

    monkeypatch.setitem(globals(), "reference", reference_of_odd_times)
    with pytest.raises(RecordingError, match="motion times"):
        exactly(write(knees([0.3] * N), PHASES))


def test_without_a_reference_no_reference_is_recommended(write, handed):
    with pytest.raises(SafetyError) as caught:
        exactly(write(knees(np.where(np.arange(N) < 50, 0.3, 0.9))))
    assert "leave out --exact" not in caught.value.remedy


def test_every_block_of_commands_is_checked(write, handed, monkeypatch):
    monkeypatch.setattr("g1stream.exact_replay.commands._BLOCK", 7)
    commands = [command(i) for i in range(N)]
    exactly(write(commands, PHASES))
    recorded = handed[0][1]["recorded"]
    assert recorded.data == commands[20:80]
    assert recorded.q[:, KNEE] == pytest.approx([knee_at(i) for i in range(20, 80)])
    with pytest.raises(SafetyError, match="CRC"):
        exactly(write([*commands[:79], damaged(commands[79]), *commands[80:]], PHASES))
