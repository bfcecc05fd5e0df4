import numpy as np
import pytest

from g1stream.dds.layout import CDR_HEADER, Layout
from g1stream.dds.messages import (
    LOWCMD,
    LOWSTATE,
    TOPICS,
    Log,
    LowCmd,
    LowState,
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


@each_message
def test_bytes_go_in_and_out_unaltered(cls, random_sample):
    message = cls()
    for seed in (1, 2):
        message.load(random_sample(cls, seed))
        assert message.tobytes() == random_sample(cls, seed)


@each_message
def test_every_attribute_shows_the_field_of_its_name(cls, random_sample):
    """Attributes are views, named like the fields of the type or of a struct in it."""
    message = cls()
    message.load(random_sample(cls))
    fields = {path.split(".")[-1]: path for path in sorted(message.layout.fields)}  # of motors last
    shown = {name: view for name, view in vars(message).items() if name in fields}
    assert shown
    for name, view in shown.items():
        path = fields[name]
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
    message.motor_mode = 1
    assert message.layout[f"{array}.mode"].read(message.payload).tolist() == [1] * 29 + [0] * 6


SPOILT = [
    pytest.param(lambda data: b"", id="empty"),
    pytest.param(lambda data: data[:-1], id="cut"),
    pytest.param(lambda data: data + b"\0", id="too long"),
    pytest.param(lambda data: b"\x00\x00" + data[2:], id="big endian"),
    pytest.param(lambda data: b"\x00\x07" + data[2:], id="XCDR2"),
]


@pytest.mark.parametrize("spoil", SPOILT)
def test_what_is_no_sample_is_refused_and_changes_nothing(spoil, random_sample):
    message, good = LowCmd(), random_sample(LowCmd)
    message.load(good)
    with pytest.raises(WireError, match="LowCmd_"):
        message.load(spoil(random_sample(LowCmd, 2)))
    assert message.tobytes() == good
    with pytest.raises(WireError, match="LowCmd_"):
        Samples(LOWCMD, [good, spoil(good)])


def test_options_in_the_header_are_taken_over(random_sample):
    """Some writers tell there how many bytes they padded with."""
    data = random_sample(SecondaryImu)
    data = data[:3] + b"\x02" + data[4:]
    imu = SecondaryImu()
    imu.load(data)
    assert imu.tobytes() == data


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
    assert message.seal() == data


# Texts


def test_log_texts_go_round():
    log, again = Log(), Log()
    log.name, log.text = "stream", "PLAY -> DAMP: der Rumpf kippt, 1.2 rad, 傾き"
    again.load(log.tobytes())
    assert (again.name, again.text) == ("stream", "PLAY -> DAMP: der Rumpf kippt, 1.2 rad, 傾き")


def test_a_shorter_text_leaves_nothing_of_a_longer_one():
    log = Log()
    log.text = "x" * 240
    log.text = "short"
    assert log.text == "short"
    assert b"x" not in log.tobytes()


@pytest.mark.parametrize("character", ["é", "🤖"])
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


def test_bytes_that_are_no_text_do_no_harm():
    log = Log()
    log.text = b"motion-\xff.csv".decode(errors="surrogateescape")
    assert log.text == "motion-?.csv"
    log.view("text")[:4] = (0x61, 0xFF, 0xFE, 0x62)
    assert log.text.startswith("a\ufffd\ufffdb")


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


@with_motors
def test_samples_tell_whose_checksum_is_right(cls, array, fields, random_sample):
    topic, message = LOWCMD if cls is LowCmd else LOWSTATE, cls()
    data = []
    for seed in range(6):
        message.load(random_sample(cls, seed))
        data.append(message.seal() if seed % 3 else message.tobytes())
    assert Samples(topic, data).crc_matches().tolist() == [False, True, True] * 2
