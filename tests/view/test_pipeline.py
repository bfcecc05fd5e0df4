import numpy as np
import pytest
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.Log_pb2 import Log as LogLine

from g1stream.config import RecordConfig
from g1stream.dds.messages import (
    LOG,
    LOWSTATE,
    REFERENCE,
    Batch,
    Log,
    LowState,
    Reference,
)
from g1stream.recorder.recorder import raw_messages
from g1stream.robot.joints import JOINT_GROUPS
from g1stream.robot.model import G1
from g1stream.session.source import MemorySource
from g1stream.testing import SyntheticSession
from g1stream.view.pipeline import Decimator, MessagePipeline, Track, TrackingError
from written_sessions import decoded

T0 = 1_700_000_000_000_000_000


def batch(message, times, **fields):
    """One sample per time with these fields, received 50 us after it was published."""
    for name, value in fields.items():
        if isinstance(value, str):
            setattr(message, name, value)
        else:
            getattr(message, name)[...] = value
    return Batch([message.tobytes()] * len(times), [t + 50_000 for t in times], list(times))


def batches_of(times):
    upright = np.array([1.0, 0.0, 0.0, 0.0])
    return {
        REFERENCE.name: batch(Reference(), times, q=0.5, dq=0.25, root_quat_wxyz=upright),
        LOWSTATE.name: batch(LowState(), times, q=0.25, tau_est=3.0, quaternion=upright),
        LOG.name: batch(Log(), times[:1], level=3, name="stream", text="late"),
    }


def make_pipeline(channels):
    return MessagePipeline(G1.default(), RecordConfig(channels=channels))


TIMES = [T0 + 2_000_000 * i for i in range(50)]
JOINT_STATES = {f"/{name}/joint_states" for name in ("reference", "measured", "tracking_error")}


def transforms(messages, i):
    """By child frame."""
    made = FrameTransforms.FromString(bytes(messages.payloads[i])).transforms
    return {one.child_frame_id: one for one in made}


def joint_states(messages, i):
    return JointStates.FromString(bytes(messages.payloads[i])).joints


def test_batches_become_what_viewers_show():
    pipeline = make_pipeline("full")
    made = {messages.topic: messages for messages in pipeline.encode(batches_of(TIMES))}
    assert {topic: len(messages.payloads) for topic, messages in made.items()} == {
        "/reference/joint_states": 50,
        "/measured/joint_states": 50,
        "/tf": 10,
        "/measured/tf": 10,
        "/ghost/tf": 10,
        "/measured/path": 1,
        "/timing/commands": 2,
        "/timing/states": 2,
        "/tracking_error/joint_states": 50,
        "/tracking_error/limbs": 10,
    }
    for messages in made.values():
        assert set(messages.log_times - messages.publish_times) == {50_000}
    error = joint_states(made["/tracking_error/joint_states"], 7)
    assert [(joint.position, joint.velocity) for joint in error] == [(0.25, 0.25)] * 29
    measured = joint_states(made["/measured/joint_states"], 7)
    assert {(joint.position, joint.effort) for joint in measured} == {(0.25, 3.0)}
    assert tuple(joint.name for joint in measured) == G1.default().joint_names
    limbs = joint_states(made["/tracking_error/limbs"], 3)
    assert {joint.name: joint.position for joint in limbs} == dict.fromkeys(JOINT_GROUPS, 0.25)
    pelvis = transforms(made["/measured/tf"], 1)["measured/pelvis"]
    assert pelvis.timestamp.ToNanoseconds() == TIMES[5]
    ghost = transforms(made["/ghost/tf"], 1)
    root = ghost["ghost/pelvis"]
    assert root.parent_frame_id == "measured/pelvis"
    assert (root.rotation.w, root.translation.x, root.translation.z) == (1.0, 0.0, 0.0)
    same = transforms(made["/tf"], 1)["left_knee_link"]
    assert ghost["ghost/left_knee_link"].rotation == same.rotation
    assert pipeline.encode({}) == []


def test_standard_has_the_same_with_joint_states_as_often_as_transforms():
    standard, full = (
        {one.topic: one for one in make_pipeline(name).encode(batches_of(TIMES))}
        for name in ("standard", "full")
    )
    assert standard.keys() == full.keys() > JOINT_STATES
    for topic, whole in full.items():
        kept = slice(None, None, 5) if topic in JOINT_STATES else slice(None)
        thinned = standard[topic]
        assert thinned.publish_times.tolist() == whole.publish_times[kept].tolist()
        assert thinned.log_times.tolist() == whole.log_times[kept].tolist()
        assert list(map(bytes, thinned.payloads)) == list(map(bytes, whole.payloads))[kept]


def test_an_imu_that_sends_zeros_leaves_no_invalid_transform():
    batches = batches_of(TIMES) | {LOWSTATE.name: batch(LowState(), TIMES, quaternion=0.0)}
    made = {messages.topic: messages for messages in make_pipeline("standard").encode(batches)}
    for i in range(10):
        for one in transforms(made["/measured/tf"], i).values():
            q = one.rotation
            assert np.linalg.norm([q.w, q.x, q.y, q.z]) == pytest.approx(1.0)


def test_raw_makes_nothing_for_viewers():
    pipeline = make_pipeline("raw")
    assert pipeline.encode(batches_of(TIMES)) == pipeline.file_header(T0) == []
    assert pipeline.base is None


def test_samples_are_copied_byte_for_byte_and_log_lines_become_messages():
    batches = batches_of(TIMES)
    made = {messages.topic: messages for messages in raw_messages(batches)}
    assert made.keys() == {"/reference", "/lowstate", "/log"}
    for topic, name in (("/reference", REFERENCE.name), ("/lowstate", LOWSTATE.name)):
        assert list(made[topic].payloads) == batches[name].data
        assert set(made[topic].log_times - made[topic].publish_times) == {50_000}
    line = LogLine.FromString(made["/log"].payloads[0])
    assert (line.level, line.name, line.message) == (3, "stream", "late")


def test_timing_has_the_longest_interval_and_latency_of_each_span():
    pipeline = MessagePipeline(G1.default())
    start = T0 // 50_000_000 * 50_000_000
    first = [start + 2_000_000 * i for i in range(10)]
    later = [first[-1] + 30_000_000 + 2_000_000 * i for i in range(5)]
    found = []
    for times in (first, later):
        states = batch(LowState(), times)
        states.log_times[1] += 400_000
        made = pipeline.encode({LOWSTATE.name: states})
        found += [
            decoded(m.topic, p) for m in made if m.topic == "/timing/states" for p in m.payloads
        ]
    assert [(one.interval_ms, one.latency_ms) for one in found] == [
        (2.0, 0.45),
        (30.0, 0.05),
        (2.0, 0.45),
    ]


@pytest.mark.parametrize(("rate", "kept"), [(1000, 100), (100, 100), (30, 30)])
def test_decimator_thins_a_fast_stream_evenly_and_keeps_a_slow_one(rate, kept):
    stamps = T0 + np.arange(rate) * (1_000_000_000 // rate)
    decimator = Decimator(100)
    picked = np.concatenate([part[decimator.pick(part)] for part in np.array_split(stamps, 20)])
    assert len(picked) == kept
    assert set(np.diff(picked)) == {1_000_000_000 // kept}


MS = 1_000_000
SLOPE = np.linspace(-2.0, 2.0, 29)


def ramp(times_ms, offset=0.0, delay_ms=0.1):
    """q rises by SLOPE each second; logged a little later."""
    stamps = T0 + np.round(np.asarray(times_ms) * MS).astype(np.int64)
    seconds = (stamps - T0)[:, np.newaxis] / 1e9
    logged = stamps + round(delay_ms * MS)
    return Track(stamps, logged, seconds * SLOPE + offset, np.tile(SLOPE, (len(stamps), 1)))


def errors_of(references, *states):
    """The errors of states, the first of which come before the references."""
    error = TrackingError(29)
    first, *others = states
    error.add_states(first)
    error.add_references(references)
    for later in others:
        error.add_states(later)
    return error.take()


def published_ms(errors):
    return ((errors.publish_times - T0) / MS).tolist()


def test_the_reference_is_interpolated_at_the_time_of_the_state():
    errors = errors_of(ramp(np.arange(0, 100, 2)), ramp(np.arange(10, 60, 3.3), offset=0.25))
    assert len(errors.publish_times) == len(np.arange(10, 60, 3.3))
    np.testing.assert_allclose(errors.q, -0.25, atol=1e-12)
    np.testing.assert_allclose(errors.dq, 0.0, atol=1e-12)


def test_log_time_is_that_of_the_last_sample_used():
    errors = errors_of(ramp([0, 10], delay_ms=5), ramp([5, 10], delay_ms=1))
    assert published_ms(errors) == [5, 10]
    assert ((errors.log_times - T0) / MS).tolist() == [15, 15]


def test_errors_do_not_depend_on_how_batches_are_cut():
    references, states = ramp(np.arange(0, 400, 2)), ramp(np.arange(1, 390, 1), offset=0.1)
    expected = errors_of(references, states).q
    cut, made = TrackingError(29), []
    for start in range(0, 400, 37):
        cut.add_states(states.where(slice(start, start + 37)))
        cut.add_references(references.where(slice(start // 2, (start + 37) // 2)))
        made.append(cut.take().q)
    cut.add_references(references.where(slice((start + 37) // 2, None)))
    made.append(cut.take().q)
    np.testing.assert_array_equal(np.concatenate(made), expected)


def test_states_before_the_first_reference_and_in_its_gaps_have_no_error():
    assert published_ms(errors_of(ramp([10, 20]), ramp([0, 5]), ramp([15]))) == [15]
    assert published_ms(errors_of(ramp([0, 10, 500, 510]), ramp([5, 250, 505]))) == [5, 505]


def test_waiting_samples_are_dropped_after_a_second():
    waiting, alone = TrackingError(29), TrackingError(29)
    for start in range(0, 5000, 1000):
        waiting.add_states(ramp(np.arange(start, start + 1000)))
        alone.add_references(ramp(np.arange(start, start + 1000)))
        assert len(waiting.take().q) == len(alone.take().q) == 0
    assert len(waiting._states.q) <= 1001
    assert len(alone._references.q) <= 1001


def test_a_state_that_comes_a_batch_late_finds_its_reference():
    error, published = TrackingError(29), []
    references, states = ramp(np.arange(0, 400, 2)), ramp(np.arange(1, 390, 2))
    for start in range(0, 250, 25):
        error.add_references(references.where(slice(start, start + 25)))
        error.add_states(states.where(slice(max(0, start - 25), start)))
        published += error.take().publish_times.tolist()
    assert published == states.publish_times.tolist()


@pytest.mark.parametrize("offset", [0.0, 0.05, -0.05, 3.2, -3.2])
def test_the_curve_of_errors_is_that_of_a_robot_with_another_clock(offset):
    source = MemorySource()
    SyntheticSession(2.0, clock_offset=offset, latency=0.001, bias=0.02).write(source)
    batches = {}
    for topic, messages in source.batches({"/lowstate", "/reference"}):
        name = {"/lowstate": LOWSTATE, "/reference": REFERENCE}[topic].name
        batch = batches.setdefault(name, Batch())
        batch.data += [bytes(one) for one in messages.data]
        batch.publish_times += messages.publish_times.tolist()
        batch.log_times += messages.log_times.tolist()
    pipeline = MessagePipeline(G1.default(), RecordConfig())
    made = {one.topic: one.payloads for one in pipeline.encode(batches)}
    states = (JointStates.FromString(bytes(one)) for one in made["/tracking_error/joint_states"])
    errors = [[joint.position for joint in state.joints] for state in states]
    assert len(errors) > 150
    # Beside the bias there is what the joints move in 1 ms, if the clocks' offset hides it.
    np.testing.assert_allclose(np.mean(errors), 0.02, atol=2e-3)
    np.testing.assert_allclose(errors, 0.02, atol=0.01)
