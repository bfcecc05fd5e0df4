import numpy as np

from g1stream.view.pipeline import Track, TrackingError

T0 = 1_700_000_000_000_000_000
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
