"""Offsets against cyclonedds' own serialiser, and C structs against this machine's compiler."""

import ctypes
import struct

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from g1stream.dds import types
from g1stream.dds.layout import CDR_HEADER, Crc, Layout, members

seeds = st.integers(0, 2**32 - 1)
# The first motor's mode sits closer to what follows it than the others' do.
OUT_OF_STEP = {("LowCmd_", "motor_cmd.mode"), ("LowState_", "motor_state.mode")}


def viewable(idl_type):
    return [
        (path, field)
        for path, field in Layout.of(idl_type).fields.items()
        if (idl_type.__name__, path) not in OUT_OF_STEP
    ]


few = settings(max_examples=10, suppress_health_check=[HealthCheck.function_scoped_fixture])


@few
@given(seed=seeds)
def test_every_field_is_where_cyclone_puts_it(seed, idl_type, random_instance):
    instance, values = random_instance(idl_type, seed)
    data = instance.serialize(use_version_2=False)
    layout = Layout.of(idl_type)
    assert data[: len(CDR_HEADER)] == CDR_HEADER
    payload = np.frombuffer(data, np.uint8, offset=len(CDR_HEADER))
    assert payload.size == layout.size
    assert set(values) == set(layout.fields)
    for path, value in values.items():
        assert layout[path].read(payload).ravel().tolist() == value, path


def test_a_sample_is_padded_to_words(idl_type):
    layout = Layout.of(idl_type)
    assert layout.sample_size % 4 == 0
    assert 0 <= layout.sample_size - len(CDR_HEADER) - layout.size < 4


def test_fields_share_no_byte(idl_type):
    layout = Layout.of(idl_type)
    covered = np.concatenate(
        [
            (field.offsets[..., np.newaxis] + np.arange(field.dtype.itemsize)).ravel()
            for field in layout.fields.values()
        ]
    )
    assert covered.size == np.unique(covered).size
    assert covered.max() == layout.size - 1


def c_places(element, struct, base=0):
    """Offset and size of each primitive of a ctypes struct, in order."""
    for name, (member, length) in members(element).items():
        start = base + getattr(struct, name).offset
        kind = dict(struct._fields_)[name]
        kind = kind if length is None else kind._type_
        for i in range(1 if length is None else length):
            place = start + i * ctypes.sizeof(kind)
            if isinstance(member, str):
                yield place, ctypes.sizeof(kind)
            else:
                yield from c_places(member, kind, place)


def test_c_struct_is_the_compilers(idl_type, c_struct):
    layout, struct = Layout.of(idl_type), c_struct(idl_type)
    assert layout.struct_bytes.size == ctypes.sizeof(struct)
    in_cdr = sorted(
        (int(start), field.dtype.itemsize)
        for field in layout.fields.values()
        for start in field.offsets.flat
    )
    expected = np.full(ctypes.sizeof(struct), layout.size)
    for (start, size), (place, c_size) in zip(in_cdr, c_places(idl_type, struct), strict=True):
        assert size == c_size
        expected[place : place + size] = np.arange(start, start + size)
    assert layout.struct_bytes.tolist() == expected.tolist()


@few
@given(seed=seeds)
def test_view_and_read_agree(seed, idl_type, random_payload):
    payload = random_payload(idl_type, seed)
    for path, field in viewable(idl_type):
        view, read = field.view(payload), field.read(payload)
        assert view.shape == read.shape == field.offsets.shape, path
        assert view.dtype == read.dtype == field.dtype, path
        assert view.tobytes() == read.tobytes(), path


def test_writing_a_view_changes_its_field_and_nothing_else(idl_type):
    for _, field in viewable(idl_type):
        payload = np.zeros(Layout.of(idl_type).size, np.uint8)
        view = field.view(payload)
        view[...] = np.arange(1, view.size + 1).reshape(view.shape)
        assert field.read(payload).ravel().tolist() == list(range(1, view.size + 1))
        places = field.offsets[..., np.newaxis] + np.arange(field.dtype.itemsize)
        payload[places] = 0
        assert not payload.any()


@pytest.mark.parametrize(("name", "path"), sorted(OUT_OF_STEP))
def test_out_of_step_is_an_error_and_not_a_wrong_view(name, path):
    layout = Layout.of(getattr(types, name))
    with pytest.raises(ValueError, match="evenly spaced"):
        layout[path].view(np.zeros(layout.size, np.uint8))


def test_read_takes_whole_batches(idl_type, random_payload):
    batch = np.stack([random_payload(idl_type, seed) for seed in range(6)])
    for field in Layout.of(idl_type).fields.values():
        read = field.read(batch)
        assert read.shape == (6, *field.offsets.shape)
        for i in range(6):
            assert read[i].tobytes() == field.read(batch[i]).tobytes()
        nested = field.read(batch.reshape(2, 3, -1))
        assert nested.tobytes() == read.tobytes()
        assert nested.shape == (2, 3, *field.offsets.shape)


def test_what_is_read_is_a_copy(random_payload):
    payload = random_payload(types.IMUState_, 1)
    field = Layout.of(types.IMUState_)["quaternion"]
    before = field.read(payload)
    kept = before.copy()
    payload[:] = 0
    assert before.tobytes() == kept.tobytes()


def test_layout_is_derived_once(idl_type):
    assert Layout.of(idl_type) is Layout.of(idl_type)
    assert Layout.of(idl_type).typename == idl_type.__idl_typename__


def test_unknown_field_is_a_key_error():
    with pytest.raises(KeyError, match="qd"):
        Layout.of(types.LowCmd_)["motor_cmd.qd"]


# The checksum against its definition, over a C struct that this machine lays out.

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
