"""The wire against samples and types that Unitree's own SDK made on cyclonedds 0.10.2."""

import json
from pathlib import Path

import numpy as np
import pytest
from cyclonedds.idl._support import Endianness

from g1stream.dds import types
from g1stream.dds.layout import CDR_HEADER, members
from g1stream.dds.messages import LowCmd, LowState

SAMPLES = [(topic, i) for topic in ("lowcmd", "lowstate") for i in range(6)]
MESSAGES = {"lowcmd": LowCmd, "lowstate": LowState}
SDK_TYPES = json.loads((Path(__file__).parents[1] / "data" / "sdk_types.json").read_text())


@pytest.fixture(params=SAMPLES, ids=lambda s: f"{s[0]}-{s[1]}")
def sample(request, golden):
    """A message class, the golden sample's fields by path, its CRC and its bytes."""
    topic, i = request.param
    values = dict(golden[topic][i])
    data = bytes.fromhex(values.pop("cdr"))
    cls = MESSAGES[topic]
    return cls, fields_by_path(cls.idl_type, values), values["crc"], data


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


def test_every_field_is_where_the_sdk_puts_it(sample):
    cls, fields, _, data = sample
    message = cls()
    message.load(data)
    assert set(fields) == set(message.layout.fields)
    for path, value in fields.items():
        read = message.layout[path].read(message.payload)
        assert read.tolist() == value, path


def test_bytes_and_checksum_are_the_sdks(sample):
    cls, fields, crc, data = sample
    message = cls()
    for path, value in fields.items():
        if path == "crc":
            continue
        field = message.layout[path]
        raw = np.asarray(value, dtype=field.dtype)[..., np.newaxis].view(np.uint8)
        message.payload[field.offsets[..., np.newaxis] + np.arange(field.dtype.itemsize)] = raw
    assert message.seal() == data
    assert int(message.crc) == crc


def test_checksum_notices_any_byte(sample):
    cls, _, _, data = sample
    message = cls()
    message.load(data)
    assert message.crc_matches()
    # The bytes between the fields are not part of the sample: alignment in CDR, and in the C struct
    # that the checksum is about.
    meaningful = np.zeros(message.layout.size, dtype=bool)
    for field in message.layout.fields.values():
        meaningful[field.offsets[..., np.newaxis] + np.arange(field.dtype.itemsize)] = True
    for place in np.flatnonzero(meaningful):
        message.payload[place] ^= 0x10
        assert not message.crc_matches(), place
        message.payload[place] ^= 0x10


def test_header_is_plain_little_endian_cdr(sample):
    *_, data = sample
    assert data[:4] == CDR_HEADER


@pytest.mark.parametrize(
    "idl_type",
    [types.LowCmd_, types.LowState_, types.IMUState_, types.SportModeState_],
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
