from contextlib import contextmanager

import numpy as np
import pytest

from g1stream.clock import SystemClock
from g1stream.config import SimConfig
from g1stream.dds.domain import Participant
from g1stream.dds.endpoints import RawReader
from g1stream.dds.messages import LOWCMD, LowCmd, LowState
from g1stream.errors import WireError
from g1stream.extras.onboard.motion_service import ApiEndpoint, MotionSwitcherClient, Request_
from g1stream.extras.onboard.simulated import MotionService
from g1stream.robot.joints import EXAMPLE_KD, EXAMPLE_KP
from g1stream.robot.model import G1
from g1stream.sim.bridge import Bridge
from g1stream.sim.robot import SimulatedRobot
from g1stream.sim.world import World
from threads import in_thread


@contextmanager
def simulating(domain_id, onboard=None):
    """A bridge that runs in a thread; yields what it reports in the end."""
    robot = SimulatedRobot(World(G1.default()), SimConfig())
    with Participant(domain_id, "lo") as participant:
        bridge = Bridge(
            participant, robot, "bolted", SystemClock(), onboard=MotionService(participant, onboard)
        )
        with in_thread(lambda stop: bridge.run(stop.is_set)):
            yield robot.report


def test_no_mode_is_active_unless_asked_for(domain_id):
    with simulating(domain_id) as report, Participant(domain_id, "lo") as ours:
        assert MotionSwitcherClient(ours).check().name == ""
        assert ours.writers(LOWCMD.name) == []
    assert report.commands == 0


def test_the_controller_publishes_from_select_to_release(domain_id, until):
    with simulating(domain_id, "ai") as report, Participant(domain_id, "lo") as ours:
        client = MotionSwitcherClient(ours)
        with pytest.raises(WireError, match="7004"):
            client.select("dance")
        assert client.check().name == "ai"
        until(lambda: report.commands > 20, "its commands")
        assert len(ours.writers(LOWCMD.name)) == 1
        client.release()
        until(lambda: not ours.writers(LOWCMD.name), "its publisher to go")
        client.select("normal")
        assert client.check().name == "normal"
        until(lambda: ours.writers(LOWCMD.name), "its publisher to return")
    assert report.refused == {}


def test_its_command_holds_the_pose(domain_id, until):
    state = LowState()
    state.q[:] = np.linspace(-0.2, 0.2, 29)
    state.mode_machine[()] = 5
    with Participant(domain_id, "lo") as theirs, Participant(domain_id, "lo") as ours:
        reader = RawReader(ours, LOWCMD)
        service = MotionService(theirs, "ai")
        until(lambda: reader.matched, "the controller")
        service.step(state.seal(), 1)
        first = state.q.copy()
        state.q[:] += 0.1  # it does not follow what is measured later
        received = []
        until(
            lambda: (service.step(state.seal(), 2), received.extend(reader.take()), received)[2],
            "its command",
        )
    command = LowCmd()
    command.load(received[-1].data)
    assert command.crc_matches()
    np.testing.assert_array_equal(command.q, first)
    assert (command.kp > EXAMPLE_KP).all()
    assert (command.kd > EXAMPLE_KD).all()
    assert int(command.mode_machine) == 5
    assert (command.motor_mode == 1).all()
    assert not command.dq.any()
    assert not command.tau.any()


def test_code_of_each_call(domain_id, until):
    calls = {
        (1, "{}"): 0,
        (1002, "no JSON"): 7001,
        (1002, "[]"): 7001,
        (1002, '{"name": 3}'): 7001,
        (1003, "{}"): 0,
        (1004, "{}"): 3203,
        (99999, ""): 3203,
    }
    answers = {}
    with Participant(domain_id, "lo") as theirs, Participant(domain_id, "lo") as ours:
        service, client = MotionService(theirs), ApiEndpoint(ours, serves=False)

        def answered():
            for number, call in enumerate(calls):
                client.write(Request_.deserialize(_request(number, *call)))
            service.step(LowState().seal(), 1)
            answers.update({one.header.identity.id: one for one in client.take()})
            return len(answers) == len(calls)

        until(answered, "the answers")
    assert [answers[number].header.status.code for number in range(7)] == list(calls.values())
    assert [answers[number].data for number in range(7)] == ["1.0.0.1", *[""] * 6]


def test_a_call_without_reply_is_obeyed_in_silence(domain_id, until):
    with Participant(domain_id, "lo") as theirs, Participant(domain_id, "lo") as ours:
        service, client = MotionService(theirs, "ai"), ApiEndpoint(ours, serves=False)
        request = Request_.deserialize(_request(1, 1003, "{}", noreply=True))

        def released():
            client.write(request)
            service.step(LowState().seal(), 1)
            return not ours.writers(LOWCMD.name)

        until(lambda: ours.writers(LOWCMD.name), "the controller")
        until(released, "the release")
        assert client.take() == []


def _request(number, api, parameter, *, noreply=False):
    """A Request_, as bytes laid out by hand."""
    text = parameter.encode() + b"\0"
    data = b"\x00\x01\x00\x00" + number.to_bytes(8, "little") + api.to_bytes(8, "little")
    data += bytes(8) + bytes(4) + bytes([noreply]) + bytes(3)
    data += len(text).to_bytes(4, "little") + text + bytes(-len(text) % 4) + bytes(4)
    return data
