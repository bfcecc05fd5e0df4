"""Offsets against cyclonedds' own serialiser. test_golden.py has those of C structs."""

import numpy as np
import pytest

from g1stream.dds import types
from g1stream.dds.layout import CDR_HEADER, Layout, leaves
from g1stream.dds.messages import TOPICS

# The first motor's mode sits closer to what follows it than the others' do.
OUT_OF_STEP = {("LowCmd_", "motor_cmd.mode"), ("LowState_", "motor_state.mode")}
each_topic = pytest.mark.parametrize(
    "topic", {topic.idl_type: topic for topic in TOPICS}.values(), ids=lambda topic: topic.name
)


def figures(element):
    """The primitives of a cyclonedds sample, in the order of the fields."""
    inside = vars(element).values() if hasattr(element, "__idl__") else element
    if not hasattr(inside, "__iter__"):
        return [element]
    return [figure for item in inside for figure in figures(item)]


@each_topic
def test_every_field_is_where_cyclone_puts_it(topic, make_sample, on_the_wire):
    sample, layout = make_sample(topic), Layout.of(topic.idl_type)
    data = on_the_wire(sample)
    assert data[: len(CDR_HEADER)] == CDR_HEADER
    assert len(data) == layout.sample_size
    payload = np.frombuffer(data, np.uint8, layout.size, len(CDR_HEADER))
    for leaf, value in zip(leaves(topic.idl_type), figures(sample), strict=True):
        assert layout[leaf.path].read(payload)[leaf.index] == value, leaf


@each_topic
def test_view_and_read_agree(topic, random_payload):
    payload = random_payload(topic.idl_type, 1)
    for path, field in Layout.of(topic.idl_type).fields.items():
        if (topic.idl_type.__name__, path) not in OUT_OF_STEP:
            view, read = field.view(payload), field.read(payload)
            assert view.shape == read.shape == field.offsets.shape, path
            assert view.dtype == read.dtype == field.dtype, path
            assert view.tobytes() == read.tobytes(), path


@pytest.mark.parametrize(("name", "path"), sorted(OUT_OF_STEP))
def test_out_of_step_is_an_error_and_not_a_wrong_view(name, path):
    layout = Layout.of(getattr(types, name))
    with pytest.raises(ValueError, match="evenly spaced"):
        layout[path].view(np.zeros(layout.size, np.uint8))


@each_topic
def test_read_takes_whole_batches(topic, random_payload):
    batch = np.stack([random_payload(topic.idl_type, seed) for seed in range(6)])
    for field in Layout.of(topic.idl_type).fields.values():
        read = field.read(batch)
        assert read.shape == (6, *field.offsets.shape)
        for i in range(6):
            assert read[i].tobytes() == field.read(batch[i]).tobytes()
        nested = field.read(batch.reshape(2, 3, -1))
        assert nested.tobytes() == read.tobytes()
        assert nested.shape == (2, 3, *field.offsets.shape)
