"""Batches of raw samples, against what the official SDK put into them."""

import numpy as np
import pytest

from g1stream.dds.topics import LOWCMD, LOWSTATE
from g1stream.session.samples import Samples


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
    ("spoil", "message"),
    [
        (lambda cdr: cdr[:-1], "a sample has 1003 bytes"),
        (lambda cdr: cdr + b"\0", "a sample has 1005 bytes"),
        (lambda cdr: b"", "a sample has 0 bytes"),
        (lambda cdr: b"\0\0" + cdr[2:], r"1004 bytes, encoding 0x0000, .* encoding 0x0001"),
    ],
)
def test_what_is_not_a_sample_of_the_type_is_refused(golden, spoil, message):
    good = bytes.fromhex(golden["lowcmd"][0]["cdr"])
    with pytest.raises(ValueError, match=message):
        Samples(LOWCMD, [good, spoil(good)])
