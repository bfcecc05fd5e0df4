"""LowCmd and LowState between g1stream and a process of Unitree's C++ SDK, over real DDS."""

import numpy as np
import pytest
from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication

from g1stream.dds.domain import Participant
from g1stream.dds.endpoints import RawReader, RawWriter
from g1stream.dds.messages import LOWCMD, LOWSTATE, LowCmd, LowState

N_MOTORS = 29
# What the SDK's Python binding calls the fields, beside their names on the wire.
COMMAND = {"q_target": "q", "dq_target": "dq", "kp": "kp", "kd": "kd", "tau_ff": "tau"}
MOTOR = {"q": "q", "dq": "dq", "tau_est": "tau_est", "temperature": "temperature", "voltage": "vol"}
IMU = {"quat": "quaternion", "omega": "gyroscope", "accel": "accelerometer", "rpy": "rpy"}

either_order = pytest.mark.parametrize("first", ["sdk", "ours"])


@pytest.fixture
def sdk_as(start_peer, domain_zero):
    """Start the SDK as a `controller` or a `robot`, and wait until it is there."""

    def start(role):
        peer = start_peer("cpp_peer.py", role)
        peer.wait_ready()
        return peer

    return start


def sealed(cls, sample):
    """A golden sample as a message."""
    message = cls()
    message.load(bytes.fromhex(sample["cdr"]))
    return message


def command_as_the_sdk_names_it(command):
    return {theirs: getattr(command, ours).tolist() for theirs, ours in COMMAND.items()}


def state_as_the_sdk_names_it(state):
    motor = {theirs: state.view(f"motor_state.{ours}")[:N_MOTORS] for theirs, ours in MOTOR.items()}
    # Of the two temperatures of a motor the binding shows the first.
    motor["temperature"] = motor["temperature"][:, 0]
    return {
        "motor": {name: values.tolist() for name, values in motor.items()},
        "imu": {theirs: getattr(state, ours).tolist() for theirs, ours in IMU.items()},
        "mode_machine": int(state.mode_machine),
    }


def assert_sdk_sees(fields, writer, data, peer):
    """Write a sample until the SDK shows these fields.

    It stores a sample in parts, and so may show a mixture with the one before for a moment.
    """
    seen = None
    for _ in range(600):
        writer.write(data)
        report = peer.next_report(within=0.05)
        seen = report["fields"] if report else seen
        if seen == fields:
            return
    assert seen == fields, peer.errors()


SENT = {
    "controller": (LOWSTATE, state_as_the_sdk_names_it),
    "robot": (LOWCMD, command_as_the_sdk_names_it),
}


@either_order
@pytest.mark.parametrize("role", SENT)
def test_sdk_reads_ours(first, role, sdk_as, domain_zero, golden):
    topic, named = SENT[role]
    peer = sdk_as(role) if first == "sdk" else None
    with Participant(domain_zero, "lo") as participant:
        writer = RawWriter(participant, topic)
        peer = peer or sdk_as(role)
        # The first sample is all zeros, as what the SDK shows before it has any; so it comes last.
        for sample in reversed(golden[topic.name.removeprefix("rt/")]):
            message = sealed(topic.message, sample)
            assert_sdk_sees(named(message), writer, message.seal(), peer)
    assert "CRC Error" not in peer.errors()


@either_order
def test_we_read_every_byte_of_the_sdks_lowcmd(first, sdk_as, domain_zero, golden, until):
    state = sealed(LowState, golden["lowstate"][1])
    peer = sdk_as("controller") if first == "sdk" else None
    with Participant(domain_zero, "lo") as participant:
        writer = RawWriter(participant, LOWSTATE)
        reader = RawReader(participant, LOWCMD, depth=1000)
        peer = peer or sdk_as("controller")
        assert_sdk_sees(state_as_the_sdk_names_it(state), writer, state.seal(), peer)
        for sample in golden["lowcmd"]:
            told = sealed(LowCmd, sample)
            peer.tell(command_as_the_sdk_names_it(told))
            expected = LowCmd()
            for field in COMMAND.values():
                getattr(expected, field)[:] = getattr(told, field)
            expected.motor_mode = 1
            # The SDK repeats the mode_machine of the LowState it has read.
            expected.mode_machine[()] = state.mode_machine
            data = expected.seal()
            until(lambda data=data: data in {s.data for s in reader.take()}, "that command")


@either_order
def test_we_read_every_byte_of_the_sdks_lowstate(first, sdk_as, domain_zero, golden, until):
    peer = sdk_as("robot") if first == "sdk" else None
    with Participant(domain_zero, "lo") as participant:
        reader = RawReader(participant, LOWSTATE, depth=100)
        peer = peer or sdk_as("robot")
        for sample in golden["lowstate"]:
            told = sealed(LowState, sample)
            peer.tell({**state_as_the_sdk_names_it(told), "tick": int(told.tick)})
            expected = LowState()
            for field in IMU.values():
                getattr(expected, field)[:] = getattr(told, field)
            for field in ("q", "dq", "tau_est", "vol"):
                path = f"motor_state.{field}"
                expected.view(path)[:N_MOTORS] = told.view(path)[:N_MOTORS]
            path = "motor_state.temperature"
            expected.view(path)[:N_MOTORS, 0] = told.view(path)[:N_MOTORS, 0]
            expected.tick[()] = told.tick
            expected.mode_machine[()] = told.mode_machine
            data = expected.seal()
            until(lambda data=data: data in {s.data for s in reader.take()}, "that state")


@pytest.mark.parametrize("role", SENT)
def test_sdk_rejects_a_wrong_checksum(role, sdk_as, domain_zero, golden, until):
    """So that its taking over of our samples elsewhere proves our checksum right."""
    topic, shown = SENT[role]
    samples = golden[topic.name.removeprefix("rt/")]
    first, second = (sealed(topic.message, sample) for sample in samples[1:3])
    peer = sdk_as(role)
    with Participant(domain_zero, "lo") as participant:
        writer = RawWriter(participant, topic)
        assert_sdk_sees(shown(first), writer, first.seal(), peer)
        second.crc[()] ^= np.uint32(1)
        spoilt = second.tobytes()
        until(lambda: writer.write(spoilt) and "CRC Error" in peer.errors(), "a complaint")
        assert peer.next_report(within=0.2) is None
        assert_sdk_sees(shown(second), writer, second.seal(), peer)


def test_sdk_announces_our_types(sdk_as, domain_zero, until):
    """The compiled types of the C++ SDK have the identity of ours."""
    ours = {}
    for topic in (LOWCMD, LOWSTATE):
        idl = topic.message.idl_type.__idl__
        idl.populate()
        ours[topic.name] = idl.get_type_id()
    with Participant(domain_zero, "lo") as participant:
        discovered = BuiltinDataReader(participant.entity, BuiltinTopicDcpsPublication)
        sdk_as("robot")
        theirs = {}

        def complete():
            theirs.update({s.topic_name: s.type_id for s in discovered.take(100)})
            return set(ours) <= set(theirs)

        until(complete, "the SDK's writers in discovery")
        assert {name: theirs[name] for name in ours} == ours
