"""The wire against samples and types that Unitree's own SDK made on cyclonedds 0.10.2."""

import json
from pathlib import Path

import numpy as np
import pytest
from cyclonedds.idl._support import Endianness

from g1stream.dds import types
from g1stream.dds.layout import members
from g1stream.dds.messages import LowCmd, LowState, SecondaryImu, SportModeState
from g1stream.dds.motion_switcher import Request_, Response_

MESSAGES = {
    "lowcmd": LowCmd,
    "lowstate": LowState,
    "secondary_imu": SecondaryImu,
    "sportmodestate": SportModeState,
}
CHECKED = [(topic, i) for topic in ("lowcmd", "lowstate") for i in range(6)]
SAMPLES = CHECKED + [(topic, i) for topic in ("secondary_imu", "sportmodestate") for i in range(2)]
SDK_TYPES = json.loads((Path(__file__).parents[1] / "data" / "sdk_types.json").read_text())


each_sample = pytest.mark.parametrize(
    "sample", SAMPLES, ids=lambda s: f"{s[0]}-{s[1]}", indirect=True
)
each_checked_sample = pytest.mark.parametrize(
    "sample", CHECKED, ids=lambda s: f"{s[0]}-{s[1]}", indirect=True
)


@pytest.fixture
def sample(request, golden):
    """A message class, the golden sample's fields by path, and its bytes."""
    topic, i = request.param
    values = dict(golden[topic][i])
    data = bytes.fromhex(values.pop("cdr"))
    cls = MESSAGES[topic]
    return cls, fields_by_path(cls.idl_type, values), data


def fields_by_path(idl_type, values, prefix=""):
    """Golden values by dotted path, `motor_cmd.q` being a list with one value for each motor."""
    found = {}
    for name, (element, length) in members(idl_type).items():
        value, path = values[name], prefix + name
        if isinstance(element, str):
            found[path] = value
        elif length is None:
            found |= fields_by_path(element, value, f"{path}.")
        else:
            columns = dict(zip(members(element), zip(*value, strict=True), strict=True))
            found |= {f"{path}.{column}": list(columns[column]) for column in columns}
    return found


def places(field):
    """The offset of each byte of a field, one more axis than the field has."""
    return field.offsets[..., np.newaxis] + np.arange(field.dtype.itemsize)


def filled(cls, fields):
    """A message with these fields, set in the payload one by one."""
    message = cls()
    for path, value in fields.items():
        field = message.layout[path]
        values = np.asarray(value, dtype=field.dtype)
        message.payload[places(field)] = values[..., np.newaxis].view(np.uint8)
    return message


@each_sample
def test_every_field_is_where_the_sdk_puts_it(sample):
    cls, fields, data = sample
    message = cls()
    message.load(data)
    assert set(fields) == set(message.layout.fields)
    for path, value in fields.items():
        assert message.layout[path].read(message.payload).tolist() == value, path


@each_sample
def test_bytes_are_the_sdks(sample):
    cls, fields, data = sample
    assert filled(cls, fields).tobytes() == data


@each_checked_sample
def test_checksum_is_the_sdks(sample):
    cls, fields, data = sample
    message = filled(cls, {**fields, "crc": 0})
    assert message.seal() == data
    assert int(message.crc) == fields["crc"]


@each_checked_sample
def test_checksum_notices_any_byte(sample):
    cls, _, data = sample
    message = cls()
    message.load(data)
    assert message.crc_matches()
    # The gaps between fields are no part of a sample: CDR's are not those of the C struct that the
    # checksum is about.
    for place in np.concatenate([places(f).ravel() for f in message.layout.fields.values()]):
        message.payload[place] ^= 0x10
        assert not message.crc_matches(), place
        message.payload[place] ^= 0x10


@pytest.mark.parametrize(
    "idl_type",
    [
        types.LowCmd_,
        types.LowState_,
        types.IMUState_,
        types.SportModeState_,
        Request_,
        Response_,
    ],
    ids=lambda t: t.__idl_typename__,
)
def test_discovery_announces_the_very_type_of_the_sdk(idl_type):
    """A type that differs here is refused by peers at best; at worst it crashes them."""
    idl = idl_type.__idl__
    idl.populate()
    idl.fill_type_data()
    announced = [
        part.serialize(endianness=Endianness.Little, use_version_2=True)[4:].hex()
        for part in (idl.get_type_info(), idl.get_type_mapping())
    ]
    assert announced == SDK_TYPES[idl_type.__idl_typename__]
