"""The wire against samples and types that Unitree's own SDK made on cyclonedds 0.10.2."""

import json
from pathlib import Path

import numpy as np
import pytest
from cyclonedds.idl._support import Endianness

from g1stream.dds.layout import members
from g1stream.dds.messages import LowCmd, LowState, SecondaryImu, SportModeState

MESSAGES = {
    "lowcmd": LowCmd,
    "lowstate": LowState,
    "secondary_imu": SecondaryImu,
    "sportmodestate": SportModeState,
}
SDK_TYPES = json.loads((Path(__file__).parents[1] / "data" / "sdk_types.json").read_text())


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


@pytest.mark.parametrize("topic", MESSAGES)
def test_every_field_is_where_the_sdk_puts_it(topic, golden):
    message = MESSAGES[topic]()
    for sample in golden[topic]:
        message.load(bytes.fromhex(sample["cdr"]))
        fields = fields_by_path(message.idl_type, sample)
        assert set(fields) == set(message.layout.fields)
        for path, value in fields.items():
            assert message.layout[path].read(message.payload).tolist() == value, path


@pytest.mark.parametrize("topic", ["lowcmd", "lowstate"])
def test_checksum_is_the_sdks(topic, golden):
    message = MESSAGES[topic]()
    for sample in golden[topic]:
        data = bytes.fromhex(sample["cdr"])
        message.load(data)
        assert message.crc_matches()
        message.crc[()] = 0
        assert message.seal() == data


@pytest.mark.parametrize("topic", ["lowcmd", "lowstate"])
def test_checksum_notices_any_byte(topic, golden):
    """The gaps between fields are no part of a sample: CDR's are not those of the C struct."""
    message = MESSAGES[topic]()
    message.load(bytes.fromhex(golden[topic][1]["cdr"]))
    for field in message.layout.fields.values():
        for place in np.add.outer(field.offsets, np.arange(field.dtype.itemsize)).flat:
            message.payload[place] ^= 0x10
            assert not message.crc_matches(), place
            message.payload[place] ^= 0x10


@pytest.mark.parametrize("name", [*MESSAGES, "Request_", "Response_"])
def test_discovery_announces_the_very_type_of_the_sdk(name):
    """A type that differs here is refused by peers at best; at worst it crashes them."""
    if name in MESSAGES:
        idl_type = MESSAGES[name].idl_type
    else:
        idl_type = getattr(pytest.importorskip("g1stream.extras.onboard.motion_service"), name)
    idl = idl_type.__idl__
    idl.populate()
    idl.fill_type_data()
    announced = [
        part.serialize(endianness=Endianness.Little, use_version_2=True)[4:].hex()
        for part in (idl.get_type_info(), idl.get_type_mapping())
    ]
    assert announced == SDK_TYPES[idl_type.__idl_typename__]
