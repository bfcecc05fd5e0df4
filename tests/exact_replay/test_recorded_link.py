"""Recorded commands go out in place of the loop's own while the motion plays, and only then."""

import numpy as np
import pytest

from g1stream.config import load_config
from g1stream.control.commands import MAX_STEP_TIME
from g1stream.control.link import DdsLink
from g1stream.control.make_loop import make_loop
from g1stream.dds.domain import Participant
from g1stream.dds.messages import LowCmd, Reference
from g1stream.errors import SafetyError
from g1stream.exact_replay.commands import RecordedCommands
from g1stream.exact_replay.recorded_link import RecordedLink
from g1stream.motion.motion import Motion
from g1stream.motion.trajectory import Trajectory
from g1stream.robot.model import G1
from g1stream.testing import FakeClock, FakeLink
from g1stream.types import Phase

TIMES = np.array([0.0, 0.002, 0.004, 0.010])


def command(number, mode_machine=5):
    message = LowCmd()
    message.q[:] = number
    message.mode_machine[()] = mode_machine
    return message.seal()


def reference(phase, motion_time=0.0):
    message = Reference()
    message.phase[()] = phase
    message.motion_time[()] = motion_time
    return message.tobytes()


VELOCITY = np.full(29, 20.0)
#: By how much a joint may be moved at once, rad.
MAX_STEP = 20.0 * MAX_STEP_TIME
RECORDED = [command(0.1 * number) for number in range(4)]
OWN = command(99.0)


def recorded(times, commands):
    q = np.zeros((len(commands), 29), np.float32)  # not used by the link
    return RecordedCommands(times, commands, q, VELOCITY)


@pytest.fixture
def sent(monkeypatch):
    """What reaches the wire: (command, reference, stamp)."""
    reached = []
    monkeypatch.setattr(DdsLink, "send", lambda self, *sent: reached.append(sent))
    return reached


@pytest.fixture
def link(domain_id, sent):
    with Participant(domain_id, "lo") as participant:
        yield RecordedLink(participant, recorded(TIMES, RECORDED))


@pytest.mark.parametrize(
    ("motion_time", "number"),
    [
        (-1.0, 0),
        (0.0, 0),
        (0.0009, 0),
        (0.0011, 1),
        (0.0029, 1),
        (0.0069, 2),
        (0.0071, 3),
        (9.0, 3),
    ],
)
def test_the_nearest_in_time_goes_out_bit_for_bit(link, sent, motion_time, number):
    asked = reference(Phase.PLAY, motion_time)
    link.send(OWN, asked, 7)
    assert sent == [(RECORDED[number], asked, 7)]


@pytest.mark.parametrize("phase", [Phase.RAMP, Phase.HOLD, Phase.DAMP])
def test_in_other_phases_the_commands_are_the_loops(link, sent, phase):
    link.send(OWN, reference(phase), 7)
    assert sent[0][0] == OWN


def test_a_command_for_another_robot_is_not_sent(link, sent):
    with pytest.raises(SafetyError, match=r"mode_machine 5.* has 2"):
        link.send(command(99, mode_machine=2), reference(Phase.PLAY), 7)
    assert not sent


def test_a_jump_into_the_recorded_commands_is_refused(link, sent):
    link.send(command(MAX_STEP + 0.01), reference(Phase.RAMP), 7)
    with pytest.raises(SafetyError, match=r"left_hip_pitch_joint .* 0.410 rad"):
        link.send(OWN, reference(Phase.PLAY), 9)
    assert len(sent) == 1


def test_a_jump_out_of_the_recorded_commands_is_refused(link, sent):
    link.send(command(0.1), reference(Phase.RAMP), 7)
    link.send(OWN, reference(Phase.PLAY, 9.0), 8)
    with pytest.raises(SafetyError, match=r"98.700 rad"):
        link.send(OWN, reference(Phase.HOLD), 9)
    assert len(sent) == 2


def test_commands_of_the_loop_itself_are_not_checked(link, sent):
    for own in (0.0, 5.0):
        link.send(command(own), reference(Phase.RAMP), 7)
    assert len(sent) == 2


@pytest.mark.parametrize("before", [Phase.RAMP, Phase.PLAY])
def test_nothing_prevents_damping(link, sent, before):
    link.send(command(0.0), reference(before), 7)
    link.send(OWN, reference(Phase.DAMP), 8)
    assert sent[-1][0] == OWN


@pytest.fixture
def play(domain_id, monkeypatch):
    """Play at 500 Hz what was recorded: all joints go up by 2 rad and down again, at full speed.

    Gives the report, the times of the commands of PLAY, s, their joint targets, rad, and the link.
    """
    times = np.arange(250) * 0.002
    q = 2.0 - 20.0 * np.abs(0.1 - times.clip(max=0.2))
    clock = FakeClock()
    link = FakeLink(clock)
    monkeypatch.setattr(DdsLink, "send", lambda _, *sent: FakeLink.send(link, *sent))
    config = load_config(over={"stream.ramp": 0.2, "stream.feedforward": "none"})
    still = Trajectory(Motion.from_arrays(np.zeros((26, 29)), fps=50))
    with Participant(domain_id, "lo") as participant:
        replayed = RecordedLink(participant, recorded(times, [command(one) for one in q]))
        link.send = replayed.send

        def run(stall):
            """The loop is not scheduled for so long, s, from 50 ms of the motion on."""

            def after_send(n):
                if len(link.in_phase(Phase.PLAY)) == 25:
                    clock.oversleeps[clock.now() + 2_000_000] = round(stall * 1e9)

            link.on_send = after_send
            report = make_loop(config, G1.default(), still, link, clock).run()
            sent = link.in_phase(Phase.PLAY)
            when = np.array([one.time for one in sent]) / 1e9
            return report, when, np.array([one.command.q[0] for one in sent]), link

        yield run


def test_what_was_due_while_the_loop_stood_still_is_skipped(play):
    """As far as the joint gets in 20 ms; the others follow later."""
    report, times, q, _ = play(0.04)
    assert report.skipped == 20
    assert not report.reason
    steps, between = np.abs(np.diff(q)), np.diff(times)
    assert steps.max() == pytest.approx(MAX_STEP, abs=1e-5)
    assert report.delay == 22_000_000
    assert (steps <= 20.0 * between + 1e-5).all()


def test_not_after_longer_than_the_state_timeout(play):
    report, _, q, link = play(0.102)
    assert "the loop stalled" in report.reason
    assert np.abs(np.diff(q)).max() == pytest.approx(0.04, abs=1e-5)
    assert link.in_phase(Phase.DAMP)
