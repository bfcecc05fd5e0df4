"""Recorded commands go out in place of the loop's own while the motion plays, and only then."""

import numpy as np
import pytest

from g1stream.control.link import DdsLink
from g1stream.control.phases import Phase
from g1stream.control.recorded import RecordedLink
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


RECORDED = [command(number) for number in range(4)]
OWN = command(99)


@pytest.fixture
def sent(monkeypatch):
    """What reaches the wire: (command, reference, stamp)."""
    reached = []
    monkeypatch.setattr(DdsLink, "send", lambda self, *sent: reached.append(sent))
    return reached


@pytest.fixture
def link(domain_id, sent):
    with Participant(domain_id, "lo") as participant:
        yield RecordedLink(participant, TIMES, RECORDED)


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
