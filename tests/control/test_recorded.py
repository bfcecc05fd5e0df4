"""Recorded commands go out in place of the loop's own while the motion plays, and only then."""

import numpy as np
import pytest

from g1stream.control.link import DdsLink
from g1stream.control.phases import Phase
from g1stream.control.recorded import LEAP_TIME, PackedCommands, RecordedLink
from g1stream.dds.domain import Participant
from g1stream.dds.messages import LowCmd, Reference
from g1stream.errors import SafetyError

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
LEAP = 20.0 * LEAP_TIME
RECORDED = [command(0.1 * number) for number in range(4)]
OWN = command(99.0)


@pytest.fixture
def sent(monkeypatch):
    """What reaches the wire: (command, reference, stamp)."""
    reached = []
    monkeypatch.setattr(DdsLink, "send", lambda self, *sent: reached.append(sent))
    return reached


@pytest.fixture
def link(domain_id, sent):
    with Participant(domain_id, "lo") as participant:
        yield RecordedLink(participant, TIMES, RECORDED, VELOCITY)


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
def test_in_other_phases_the_loop_has_its_way(link, sent, phase):
    link.send(OWN, reference(phase), 7)
    assert sent[0][0] == OWN


def test_a_command_for_another_robot_is_not_sent(link, sent):
    with pytest.raises(SafetyError, match="for mode_machine 5, and this robot says 2"):
        link.send(command(99, mode_machine=2), reference(Phase.PLAY), 7)
    assert not sent


def test_the_robot_does_not_leap_into_what_is_recorded(link, sent):
    link.send(command(LEAP + 0.01), reference(Phase.RAMP), 7)
    with pytest.raises(SafetyError, match=r"left_hip_pitch_joint would leap by 0.410 rad into"):
        link.send(OWN, reference(Phase.PLAY), 9)
    assert len(sent) == 1


def test_nor_out_of_it(link, sent):
    link.send(command(0.1), reference(Phase.RAMP), 7)
    link.send(OWN, reference(Phase.PLAY, 9.0), 8)
    with pytest.raises(SafetyError, match=r"would leap by 98.700 rad out of"):
        link.send(OWN, reference(Phase.HOLD), 9)
    assert len(sent) == 2


def test_what_the_loop_does_by_itself_is_its_own_affair(link, sent):
    for own in (0.0, 5.0):
        link.send(command(own), reference(Phase.RAMP), 7)
    assert len(sent) == 2


@pytest.mark.parametrize("before", [Phase.RAMP, Phase.PLAY])
def test_nothing_keeps_a_robot_from_being_damped(link, sent, before):
    link.send(command(0.0), reference(before), 7)
    link.send(OWN, reference(Phase.DAMP), 8)
    assert sent[-1][0] == OWN


def test_packed_commands_come_out_bit_for_bit():
    rng = np.random.default_rng(1)
    given, packed = [], PackedCommands()
    for n in (1, 7, 0, 300):
        block = []
        for i in range(n):
            message = LowCmd()
            message.q[:], message.tau[:] = rng.normal(size=(2, 29))
            message.kp[:] = 40.0 + (n == 300 and i > 150)
            block.append(message.seal())
        packed.add(block)
        given += block
    assert len(packed) == len(given) == 308
    assert [packed[i] for i in range(len(packed))] == given


def test_packed_commands_take_a_third():
    packed = PackedCommands()
    message, rng = LowCmd(), np.random.default_rng(1)
    for _ in range(4):
        block = []
        for _ in range(1024):
            message.q[:], message.dq[:], message.tau[:] = rng.normal(size=(3, 29))
            block.append(message.seal())
        packed.add(block)
    assert packed.nbytes < 0.4 * len(packed) * len(packed[0])


@pytest.mark.parametrize("i", [-1, 2])
def test_no_other_command_is_packed(i):
    packed = PackedCommands()
    packed.add(RECORDED[:2])
    with pytest.raises(IndexError):
        packed[i]
