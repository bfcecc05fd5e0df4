import numpy as np
import pytest

from g1stream.errors import RecordingError
from g1stream.session.format import encode_log
from g1stream.session.records import ClockStep
from g1stream.session.streams import (
    LogEvent,
    MeasuredStream,
    ReferenceStream,
    Stream,
    without_steps,
)
from g1stream.types import Phase

T0 = 1_700_000_000_000_000_000
N = 5


@pytest.fixture
def reads():
    """The names of the columns that were asked for, one list for each pass over the file."""
    return []


@pytest.fixture
def measured(reads):
    whole = {
        name: np.arange(N) for name in ("log_time", "publish_time", *MeasuredStream.wire_fields())
    } | {"q": np.arange(N * 29.0).reshape(N, 29)}

    def load(names):
        reads.append(names)
        return {name: whole[name] for name in names}

    return MeasuredStream(load)


def reference(phases, latency=0, start=0.0):
    """A sample each 0.1 s; PLAY begins `start` seconds into the motion."""
    seconds = 0.1 * np.arange(len(phases))
    times = T0 + np.round(seconds * 1e9).astype(np.int64)
    phase = np.array(phases, np.uint8)
    first = phases.index(Phase.PLAY) if Phase.PLAY in phases else len(phases)
    motion_time = start + np.maximum(0, seconds - 0.1 * first)
    return ReferenceStream(
        log_time=times + latency, publish_time=times, phase=phase, motion_time=motion_time
    )


def test_the_first_column_reads_all_in_one_pass_and_named_columns_those_alone(measured, reads):
    part = measured[1:].read("q", "log_time")
    assert part.q is part.read("q").q
    assert reads == [["log_time", "publish_time", "q"]]
    reads.clear()
    assert measured.gyroscope is measured.gyroscope
    assert measured.dq.shape == (N,)
    assert len(reads) == 1


def test_float32_becomes_float64_where_it_is_used_as_an_attribute():
    values = np.arange(N * 29, dtype=np.float32).reshape(N, 29) / 3
    whole = {"log_time": np.arange(N), "publish_time": np.arange(N), "q": values}
    stream = MeasuredStream(lambda names: {name: whole[name] for name in names})
    stream.read("q")
    assert stream.recorded("q") is values
    assert stream[1:3].recorded("q").dtype == np.float32
    for q in (stream.rows("q", slice(None)), stream.q):
        assert q.dtype == np.float64
        np.testing.assert_array_equal(q, values)
    stream.drop("q")
    np.testing.assert_array_equal(stream.rows("q", [4]), values[4:])


@pytest.mark.parametrize(
    "index", [slice(1, 4), np.array([True, False, True, False, False]), np.array([4, 0])]
)
def test_parts_of_a_stream(measured, index):
    part = measured[index]
    assert type(part) is MeasuredStream
    for name in ("log_time", "q", "gyroscope"):
        np.testing.assert_array_equal(getattr(part, name), getattr(measured, name)[index])
        with pytest.raises(ValueError, match="read-only"):
            getattr(part, name)[0] = 0
    np.testing.assert_array_equal(part.time, measured.time[index])


@pytest.mark.parametrize("start", [0.0, 2.5])
def test_time_is_that_of_the_motion_on_the_recorders_clock(start):
    phases = [Phase.RAMP, Phase.RAMP, Phase.PLAY, Phase.PLAY]
    stream = reference(phases, latency=3_200_000_000, start=start)
    assert stream.start_ns == T0 + 3_400_000_000 - round(start * 1e9)
    np.testing.assert_allclose(stream.time, start + np.array([-0.2, -0.1, 0.0, 0.1]))


def test_without_play_time_is_0_at_the_first_sample():
    np.testing.assert_allclose(reference([Phase.RAMP, Phase.RAMP]).time, [0.0, 0.1])


@pytest.mark.parametrize("start", [np.nan, 1e300])
def test_motion_times_that_cannot_be_are_passed_over(start):
    np.testing.assert_allclose(reference([Phase.PLAY] * 2, start=start).time, [0.0, 0.1])


def test_a_phase_lasts_until_the_next_one_begins():
    # DAMP to RAMP is a difference of unsigned numbers.
    phases = reference([Phase.DAMP, Phase.RAMP, Phase.RAMP, Phase.PLAY, Phase.DAMP]).phases
    assert [one.phase for one in phases] == [Phase.DAMP, Phase.RAMP, Phase.PLAY, Phase.DAMP]
    np.testing.assert_allclose([one.start_s for one in phases], [-0.3, -0.2, 0.0, 0.1])
    assert [one.end_s for one in phases] == [*(one.start_s for one in phases[1:]), phases[-1].end_s]
    assert phases[1].duration_s == pytest.approx(0.2)


def test_a_number_that_stands_for_no_phase_is_named():
    with pytest.raises(RecordingError, match="99"):
        _ = reference([Phase.PLAY, 99]).phases


@pytest.mark.parametrize("step", [3 * 10**9, -3 * 10**9])
@pytest.mark.parametrize(("shown", "left"), [(1.0, 0.0), (0.6, -0.4), (0.4, 0.4), (0.0, 0.0)])
def test_a_step_is_taken_out_where_the_times_show_most_of_it(step, shown, left):
    regular = T0 + 10_000_000 * np.arange(2 * N)
    later = np.arange(2 * N) >= N
    found = without_steps(regular + round(shown * step) * later, [ClockStep(step_ns=step)])
    np.testing.assert_array_equal(found, regular + round(left * step) * later)


@pytest.mark.parametrize("step", [0.05, -0.05, 2.0, -2.0])
def test_a_robot_whose_clock_is_set_keeps_its_place_in_time(step):
    sent = T0 + 2_000_000 * np.arange(5000)
    latency = np.random.default_rng(1).gamma(2.0, 100_000, 5000).astype(int)
    shown = sent + round(step * 1e9) * (np.arange(5000) >= 2000)
    robot = Stream(log_time=sent + latency, publish_time=shown)
    np.testing.assert_allclose(robot.published - sent, 0, atol=100_000)
    (found,) = robot.clock_steps
    assert found.step_ns == pytest.approx(step * 1e9, abs=100_000)
    assert found.at_ns == shown[2000]


@pytest.mark.parametrize("rate", [0.5, 50, 100, 200, 500])
@pytest.mark.parametrize("step", [0.01, 0.02, 0.05, -0.05, 1.0])
@pytest.mark.parametrize("here", [True, False])
def test_a_step_is_taken_out_at_its_place_at_any_rate(rate, step, here):
    true = T0 + np.round(np.arange(round(max(8, 6 * rate))) * 1e9 / rate).astype(np.int64)
    set_ns, later = round(step * 1e9), np.arange(len(true)) >= len(true) // 2
    noted = [ClockStep(at_ns=int(true[later][0]) + set_ns, step_ns=set_ns)]
    logged = true + set_ns * later
    sent = logged if here else true
    stream = Stream(log_time=logged + 100_000, publish_time=sent, host_steps=noted)
    np.testing.assert_array_equal(stream.published, true)
    assert stream.clock_steps == ()
    np.testing.assert_array_equal(stream.latency, 100_000)


def test_messages_that_are_rare_or_become_slower_set_no_clock():
    rare = T0 + 2_000_000_000 * np.arange(6)
    late = rare + 100_000 + 50_000_000 * (np.arange(6) == 3)
    assert Stream(log_time=late, publish_time=rare).clock_steps == ()
    sent = T0 + 2_000_000 * np.arange(5000)
    slower = sent + 100_000 + 15_000_000 * (np.arange(5000) >= 2500)
    stream = Stream(log_time=slower, publish_time=sent)
    assert stream.clock_steps == ()
    np.testing.assert_array_equal(stream.published, sent)


def test_two_steps_one_after_the_other_are_both_found():
    sent = T0 + 2_000_000 * np.arange(5000)
    shown = sent + 50_000_000 * ((np.arange(5000) >= 2000) & (np.arange(5000) < 2150))
    stream = Stream(log_time=sent + 100_000, publish_time=shown)
    assert [one.step_ns for one in stream.clock_steps] == [50_000_000, -50_000_000]
    np.testing.assert_array_equal(stream.published, sent)


def test_a_recorder_that_stalls_or_loses_messages_sets_no_clock():
    sent = T0 + 2_000_000 * np.arange(5000)
    for received in (
        np.maximum(sent, np.where(sent < sent[2500], 0, sent[3500])),  # stopped for 2 s
        np.maximum(sent, np.where(sent < sent[4900], 0, sent[-1])),  # and until the end
        sent + 300_000_000 * (np.arange(5000) % 50 == 0),  # single late ones
    ):
        assert Stream(log_time=received + 100_000, publish_time=sent).clock_steps == ()
    lost = np.r_[sent[:2000], sent[2100:]]
    assert Stream(log_time=lost + 100_000, publish_time=lost).clock_steps == ()


@pytest.mark.parametrize("step", [0.05, -0.05, 3.0])
def test_a_step_of_the_recorders_machine_is_in_both_times(step):
    true = T0 + 2_000_000 * np.arange(5000)
    set_ns, later = round(step * 1e9), np.arange(5000) >= 3000
    noted = [ClockStep(at_ns=int(true[3010]) + set_ns, step_ns=set_ns)]
    here = Stream(
        log_time=true + set_ns * later + 100_000,
        publish_time=true + set_ns * later,
        host_steps=noted,
    )
    away = Stream(log_time=true + set_ns * later + 100_000, publish_time=true, host_steps=noted)
    for stream in (here, away):
        np.testing.assert_array_equal(stream.published, true)
        assert stream.clock_steps == ()


def test_an_event_has_the_name_of_its_level():
    for level, name in ((2, "INFO"), (9, "UNKNOWN")):
        event = LogEvent.decode(encode_log(T0, level, "stream", "late"))
        assert event == (T0, name, "stream", "late")
