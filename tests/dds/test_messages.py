"""Samples as bytes and as fields."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from g1stream.dds.layout import CDR_HEADER, Layout
from g1stream.dds.messages import (
    LOWCMD,
    LOWSTATE,
    TOPICS,
    Log,
    LowCmd,
    LowState,
    Message,
    Reference,
    Samples,
    SecondaryImu,
)
from g1stream.errors import WireError

MESSAGES = list(dict.fromkeys(topic.message for topic in TOPICS))
each_message = pytest.mark.parametrize("cls", MESSAGES, ids=lambda c: c.__name__)
with_motors = pytest.mark.parametrize(
    ("cls", "array", "fields"),
    [
        (LowCmd, "motor_cmd", ("q", "dq", "tau", "kp", "kd")),
        (LowState, "motor_state", ("q", "dq", "ddq", "tau_est")),
    ],
)


@pytest.fixture
def random_sample(random_payload):
    """The bytes of a random sample, as Cyclone hands it over."""

    def make(cls, seed=1):
        whole = CDR_HEADER + random_payload(cls.idl_type, seed).tobytes()
        return whole.ljust(Layout.of(cls.idl_type).sample_size, b"\0")

    return make


#: Attributes of messages that are no view of a single field.
_NO_FIELDS = ("payload", "_modes", "target", "_buttons", "_words", "_reading_words", "weight")


@each_message
def test_bytes_go_in_and_out_unaltered(cls, random_sample):
    message = cls()
    for seed in (1, 2):
        message.load(random_sample(cls, seed))
        assert message.tobytes() == random_sample(cls, seed)


@each_message
def test_a_new_message_is_zero(cls):
    data = cls().tobytes()
    assert data[:4] == CDR_HEADER
    assert not any(data[4:])


@each_message
def test_every_attribute_shows_the_field_of_its_name(cls, random_sample):
    """Attributes are views, named like the fields of the type or of a struct in it."""
    message = cls()
    message.load(random_sample(cls))
    shown = {k: v for k, v in vars(message).items() if isinstance(v, np.ndarray)}
    shown = {k: v for k, v in shown.items() if k not in _NO_FIELDS}
    assert shown
    for name, view in shown.items():
        paths = [p for p in message.layout.fields if p.split(".")[-1] == name]
        (path,) = paths if len(paths) == 1 else (p for p in paths if p.startswith("motor_"))
        whole = message.layout[path].read(message.payload)
        assert view.tobytes() == whole[tuple(slice(n) for n in view.shape)].tobytes(), name
        view[...] = 7
        part = message.layout[path].read(message.payload)[tuple(slice(n) for n in view.shape)]
        assert (part == 7).all()


def test_the_weight_is_the_position_of_a_motor_that_no_g1_has(random_sample):
    command = LowCmd()
    command.load(random_sample(LowCmd))
    command.weight[()] = 0.25
    assert command.layout["motor_cmd.q"].read(command.payload)[29] == 0.25


def test_readings_are_what_the_loop_uses_of_a_state(random_sample):
    state = LowState()
    state.load(random_sample(LowState))
    fields = (state.q, state.dq, state.tau_est)
    imu = (state.quaternion, state.gyroscope, state.accelerometer)
    readings = state.readings()
    assert readings.tobytes() == np.concatenate([*fields, *imu]).tobytes()
    state.q[:] = 7.0
    assert not (readings == 7.0).any()  # a copy


def test_a_target_is_the_fields_of_a_reference_from_q_on(random_sample):
    reference = Reference()
    reference.load(random_sample(Reference))
    names = ("q", "dq", "ddq", "tau", "root_pos", "root_quat_wxyz", "root_lin_vel", "root_ang_vel")
    parts = [getattr(reference, name) for name in names]
    assert reference.target.tobytes() == np.concatenate(parts).tobytes()
    reference.target[:] = 3.0
    assert all((part == 3.0).all() for part in parts)


@with_motors
def test_motors_are_the_first_29(cls, array, fields):
    message = cls()
    for name in fields:
        getattr(message, name)[:] = np.arange(1, 30)
    message.motor_mode = np.arange(1, 30)
    for name in (*fields, "mode"):
        values = message.layout[f"{array}.{name}"].read(message.payload)
        assert values.tolist() == [*range(1, 30), 0, 0, 0, 0, 0, 0]
    assert message.motor_mode.tolist() == list(range(1, 30))


@with_motors
def test_one_mode_for_all_motors(cls, array, fields):
    message = cls()
    message.motor_mode = 1
    modes = message.layout[f"{array}.mode"].read(message.payload)
    assert modes.tolist() == [1] * 29 + [0] * 6


@each_message
@pytest.mark.parametrize(
    "spoil",
    [
        lambda data: b"",
        lambda data: data[:3],
        lambda data: data[:-1],
        lambda data: data + b"\0",
        lambda data: b"\x00\x00" + data[2:],  # big endian
        lambda data: b"\x00\x07" + data[2:],  # XCDR2
    ],
    ids=["empty", "header cut", "cut", "too long", "big endian", "XCDR2"],
)
def test_what_is_no_sample_is_refused_and_changes_nothing(cls, spoil, random_sample):
    message = cls()
    message.load(random_sample(cls))
    with pytest.raises(WireError) as caught:
        message.load(spoil(random_sample(cls, 2)))
    assert cls.idl_type.__idl_typename__ in caught.value.cause
    assert "XCDR1" in caught.value.remedy
    assert message.tobytes() == random_sample(cls)


def test_options_in_the_header_are_taken_over(random_sample):
    """Some writers tell there how many bytes they padded with."""
    data = random_sample(SecondaryImu)
    data = data[:3] + b"\x02" + data[4:]
    imu = SecondaryImu()
    imu.load(data)
    assert imu.tobytes() == data


def test_bytes_taken_are_a_copy():
    command = LowCmd()
    command.q[:] = 1.0
    before = command.tobytes()
    command.q[:] = 2.0
    assert before != command.tobytes()


@pytest.mark.parametrize("cls", [LowCmd, LowState])
def test_a_sealed_message_matches_until_it_changes(cls):
    message = cls()
    message.q[:] = np.linspace(-1, 1, 29)
    assert not message.crc_matches()
    data = message.seal()
    assert message.crc_matches()
    message.q[7] += 1e-3
    assert not message.crc_matches()
    message.load(data)
    assert message.crc_matches()
    assert message.seal() == data


def test_messages_do_not_share_a_buffer():
    one, other = LowCmd(), LowCmd()
    one.q[:] = 1.0
    assert not other.q.any()


def test_a_field_can_be_viewed_by_its_path():
    state = LowState()
    state.view("motor_state.temperature")[4] = (40, 60)
    assert state.layout["motor_state.temperature"].read(state.payload)[4].tolist() == [40, 60]


def test_a_message_is_a_type_and_no_more():
    assert all(issubclass(cls, Message) for cls in MESSAGES)
    assert len({cls.idl_type.__idl_typename__ for cls in MESSAGES}) == len(MESSAGES)
    assert {topic.message for topic in TOPICS} == set(MESSAGES)


# Texts


def test_log_texts_go_round():
    log = Log()
    log.name, log.text = "stream", "PLAY -> DAMP: der Rumpf kippt, 1.2 rad, 傾き"
    again = Log()
    again.load(log.tobytes())
    assert (again.name, again.text) == (log.name, log.text)
    assert again.text.endswith("傾き")


def test_a_shorter_text_leaves_nothing_of_a_longer_one():
    log = Log()
    log.text = "x" * 240
    log.text = "short"
    assert log.text == "short"
    assert b"x" not in log.tobytes()


@pytest.mark.parametrize("character", ["é", "傾", "🤖"])
def test_a_character_cut_in_two_is_left_out(character):
    size = len(character.encode())
    for kept in range(size):
        log = Log()
        log.text = "x" * (240 - kept) + character + "more"
        assert log.text == "x" * (240 - kept)
        log.name = "x" * (16 - kept) + character
        assert log.name == "x" * (16 - kept)
    log.text = "x" * (240 - size) + character + "more"
    assert log.text == "x" * (240 - size) + character


@pytest.mark.slow
@given(st.text(max_size=300))
def test_what_is_kept_of_a_text_is_its_beginning(text):
    log = Log()
    log.text = text
    readable = text.encode(errors="replace").decode()
    assert readable.rstrip("\0").startswith(log.text)
    if len(readable.encode()) <= 240:
        assert log.text == readable.rstrip("\0")


def test_a_text_that_has_no_utf8_is_told_all_the_same():
    log = Log()
    log.text = b"motion-\xff.csv".decode(errors="surrogateescape")
    assert log.text == "motion-?.csv"


def test_received_bytes_that_are_no_text_do_no_harm():
    log = Log()
    log.view("text")[:4] = (0x61, 0xFF, 0xFE, 0x62)
    assert log.text == "a��b"


def test_fields_of_a_batch_are_those_the_official_sdk_serialised(golden):
    states = golden["lowstate"]
    samples = Samples(LOWSTATE, [bytes.fromhex(state["cdr"]) for state in states])
    np.testing.assert_array_equal(samples["tick"], [state["tick"] for state in states])
    np.testing.assert_array_equal(samples["version"], [state["version"] for state in states])
    for name in ("quaternion", "temperature"):
        expected = [state["imu_state"][name] for state in states]
        np.testing.assert_array_equal(samples[f"imu_state.{name}"], expected)
    temperatures = [[motor[5] for motor in state["motor_state"][:29]] for state in states]
    np.testing.assert_array_equal(samples["motor_state.temperature"], temperatures)
    assert samples["motor_state.q"].dtype == np.float32


def test_an_empty_batch_has_empty_fields():
    samples = Samples(LOWCMD, [])
    assert samples["motor_cmd.q"].shape == (0, 29)
    assert samples["crc"].shape == (0,)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda cdr: cdr[:-1],
        lambda cdr: cdr + b"\0",
        lambda cdr: b"",
        lambda cdr: b"\0\0" + cdr[2:],
    ],
)
def test_what_is_not_a_sample_of_the_type_is_refused(golden, spoil):
    good = bytes.fromhex(golden["lowcmd"][0]["cdr"])
    with pytest.raises(WireError, match="LowCmd_"):
        Samples(LOWCMD, [good, spoil(good)])
