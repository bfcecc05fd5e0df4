"""The checksum against its definition, bit by bit, over a C struct of this machine's making."""

import ctypes
import struct

import numpy as np
import pytest

from g1stream.dds import types
from g1stream.dds.crc import Crc
from g1stream.dds.layout import Layout

CHECKED = pytest.mark.parametrize("checked", [types.LowCmd_, types.LowState_])


def crc32_mpeg2(data):
    """CRC-32/MPEG-2, most significant bit first, a bit at a time."""
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte << 24
        for _ in range(8):
            crc = (crc << 1 ^ (0x04C11DB7 if crc & 0x80000000 else 0)) & 0xFFFFFFFF
    return crc


def test_the_definition_gives_the_catalogues_check_value():
    assert crc32_mpeg2(b"123456789") == 0x0376E6E7


def as_c(idl_type, c_struct, payload):
    """The payload's fields in a C struct, set one by one."""
    layout = Layout.of(idl_type)
    native = c_struct(idl_type)()
    for path, field in layout.fields.items():
        values = field.read(payload)
        for index in np.ndindex(values.shape):
            *parents, last = path.split(".")
            place, remaining = native, list(index)
            for parent in parents:
                place = getattr(place, parent)
                if isinstance(place, ctypes.Array):
                    place = place[remaining.pop(0)]
            if remaining:
                getattr(place, last)[remaining[0]] = values[index].item()
            else:
                setattr(place, last, values[index].item())
    return bytes(native)


@CHECKED
@pytest.mark.parametrize("seed", range(3))
def test_checksum_is_that_of_the_structs_words(checked, seed, c_struct, random_instance):
    instance, _ = random_instance(checked, seed)
    payload = np.frombuffer(instance.serialize(use_version_2=False), np.uint8, offset=4)
    words = as_c(checked, c_struct, payload)[:-4]
    swapped = struct.pack(f">{len(words) // 4}I", *struct.unpack(f"<{len(words) // 4}I", words))
    assert Crc(Layout.of(checked)).compute(payload) == crc32_mpeg2(swapped)


@CHECKED
def test_matches_only_its_own_checksum(checked, random_payload):
    layout = Layout.of(checked)
    crc, payload = Crc(layout), random_payload(checked, 5)
    stored = layout["crc"].view(payload)
    stored[()] = crc.compute(payload)
    assert crc.matches(payload)
    stored[()] ^= 1
    assert not crc.matches(payload)


@CHECKED
def test_the_stored_checksum_is_no_part_of_it(checked, random_payload):
    layout = Layout.of(checked)
    crc, payload = Crc(layout), random_payload(checked, 6)
    before = crc.compute(payload)
    layout["crc"].view(payload)[()] += 1
    assert crc.compute(payload) == before


@CHECKED
def test_payload_is_left_alone(checked, random_payload):
    payload = random_payload(checked, 7)
    before = payload.copy()
    Crc(Layout.of(checked)).compute(payload)
    assert payload.tolist() == before.tolist()
