import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from scipy.interpolate import make_interp_spline
from scipy.special import stdtrit

from g1stream.analysis.tracking import Delays, _t_975, compare
from g1stream.app.session import open_session
from g1stream.errors import RecordingError
from g1stream.robot.joints import JOINT_GROUPS
from g1stream.types import Phase
from known_sessions import MOTION

#: How far a straight line between references is from the fastest sine here, rad: h^2/8 max|ddq|.
STRAIGHT = 0.002**2 / 8 * 0.6 * (2 * np.pi * 1.25) ** 2

SAG = np.linspace(-0.2, 0.1, 29)


def test_the_quantile_of_a_confidence_interval():
    freedom = np.arange(4, 1000)
    quantiles = [_t_975(int(one)) for one in freedom]
    np.testing.assert_allclose(quantiles, stdtrit(freedom, 0.975), rtol=4e-4)


def test_the_rmse_of_a_robot_that_is_late_or_sags(play):
    delay = 0.04
    late, sagging = compare(*play(delay)), compare(*play(offset=-SAG))
    # sin(a) - sin(a - wd) = 2 sin(wd/2) cos(a - wd/2), whose RMS over a period is sqrt(2) sin(wd/2)
    expected = np.sqrt(2) * MOTION.amplitude * np.sin(MOTION.omega * delay / 2)
    np.testing.assert_allclose(late.rmse, expected, atol=STRAIGHT)
    np.testing.assert_allclose(late.mean, 0.0, atol=STRAIGHT)
    np.testing.assert_allclose(late.max_abs, np.sqrt(2) * expected, rtol=1e-4, atol=STRAIGHT)
    np.testing.assert_allclose(sagging.mean, SAG, atol=STRAIGHT)
    np.testing.assert_allclose(sagging.rmse, np.abs(SAG), atol=STRAIGHT)


@pytest.mark.parametrize("delay", [-0.0113, 0.0, 0.1204])
def test_the_delay_is_found_beside_a_sag(play, delay):
    # 3.3 s are no whole number of periods, so that the joints' means differ from place to place.
    phases = ((Phase.RAMP, 0.5), (Phase.PLAY, 3.3), (Phase.HOLD, 0.3))
    tracking = compare(*play(delay, -SAG, phases))
    assert tracking.delay.seconds == pytest.approx(delay, abs=1e-4)
    np.testing.assert_allclose(tracking.delay.rmse, np.abs(SAG), atol=3e-4)
    np.testing.assert_allclose(tracking.delay.std, 0.0, atol=3e-4)


def test_a_smaller_answer_is_not_a_delay(play, change):
    reference, measured = play(0.03)
    tracking = compare(reference, change(measured, q=0.7 * measured.q))
    assert tracking.delay.seconds == pytest.approx(0.03, abs=1e-4)
    reference_rms = np.sqrt(np.mean(np.square(compare(reference, measured).reference), axis=0))
    np.testing.assert_allclose(tracking.delay.rmse, 0.3 * reference_rms, atol=3e-4)


@pytest.mark.parametrize("phase", [0.0, 0.25, 0.5, 0.75])
@pytest.mark.parametrize("rate", [25, 50, 100, 200])
def test_held_targets_are_late_by_the_mean_over_their_steps(rate, phase):
    late_by, found = delay_of_steps(rate, phase / rate)
    assert found.seconds == pytest.approx(late_by, abs=5e-5)
    assert found.ci95 < 1e-4


@pytest.mark.parametrize("made_every", [0.005, 0.02])
def test_states_that_are_sent_more_often_than_made_are_late_by_their_mean_age(made_every):
    late_by, found = delay_of_steps(500, 0.0, made_every=made_every)
    assert found.seconds == pytest.approx(late_by, abs=5e-5)


def test_a_long_run_is_not_compared_in_step_with_a_policy():
    late_by, found = delay_of_steps(50, 0.006, length=310.0)
    assert abs(found.seconds - late_by) < found.ci95 < 2e-4


def delay_of_steps(rate, phase, *, length=20.0, made_every=None):
    """The mean delay of a robot that holds each target, 8 ms after it was sent; and ours."""

    def motion(seconds):
        frequency = np.array([0.31, 0.47, 0.83, 1.27, 1.9])
        return 0.4 * np.sin(2 * np.pi * frequency * seconds[:, None] + np.arange(5))

    times = np.arange(0.0, length + 1.0, 0.002)
    states = np.arange(0.5, length + 0.7, 0.002) + 0.0004
    made = np.floor(states / made_every) * made_every if made_every else states
    step = np.floor((made - 0.008 - phase) * rate) / rate + phase
    found = Delays(times, motion(times), states, motion(step)).of([0, 1, 2, 3, 4])
    return np.mean(states - step), found


def test_where_the_largest_error_is(play, change):
    reference, measured = play()
    q = measured.q.copy()
    # RAMP lasts 0.5 s; the state is the first after 2 s.
    q[np.searchsorted(measured.publish_time, reference.publish_time[0] + 2_000_000_000), 7] -= 0.9
    tracking = compare(reference, change(measured, q=q))
    assert tracking.max_abs[7] == pytest.approx(0.9, abs=STRAIGHT)
    assert tracking.max_abs_at[7] == pytest.approx(1.5007, abs=1e-6)


def test_only_what_was_played_counts(play, change):
    reference, measured = play()
    seconds = (measured.publish_time - reference.publish_time[0]) / 1e9 - 0.5
    q = np.where(((seconds < 0) | (seconds > 4))[:, None], 9.0, measured.q)
    tracking = compare(reference, change(measured, q=q))
    assert tracking.max_abs.max() < STRAIGHT
    assert (len(tracking.time), tracking.excluded) == (2000, 0)
    assert tracking.duration == pytest.approx(4.0)


def test_states_in_a_hole_of_the_reference_are_left_out_but_not_in_a_short_stall(play, take):
    reference, measured = play(0.04)
    at = (reference.publish_time - reference.publish_time[0]) / 1e9
    hole, stall = (at > 2.0) & (at < 2.3), (at > 3.0) & (at < 3.05)
    with_hole = compare(take(reference, ~(hole | stall)), measured)
    whole = compare(reference, measured)
    assert with_hole.excluded == len(whole.time) - len(with_hole.time) == 150
    assert with_hole.duration == pytest.approx(whole.duration - 0.3)
    kept = np.isin(whole.time, with_hole.time)
    np.testing.assert_array_equal(with_hole.measured, whole.measured[kept])
    close = np.abs(whole.motion_time[kept] - 2.525) > 0.03  # not beside the stall
    np.testing.assert_allclose(with_hole.reference[close], whole.reference[kept][close], atol=1e-12)


def test_the_order_of_the_file_does_not_matter(play, take):
    rng = np.random.default_rng(5)
    reference, measured = play(0.04)
    shuffled = [take(stream, rng.permutation(len(stream))) for stream in (reference, measured)]
    straight, other = compare(reference, measured), compare(*shuffled)
    np.testing.assert_allclose(other.rmse, straight.rmse, atol=1e-12)
    assert other.delay.seconds == pytest.approx(straight.delay.seconds, abs=1e-9)


def test_a_robot_with_a_clock_of_its_own(play, change):
    reference, measured = play(0.04)
    robot = change(measured, publish_time=measured.publish_time + 3_200_000_000)
    tracking, straight = compare(reference, robot), compare(reference, measured)
    # Its clock is set right up to the 0.1 ms that each message takes.
    assert tracking.delay.seconds == pytest.approx(straight.delay.seconds + 1e-4, abs=1e-6)
    np.testing.assert_allclose(tracking.rmse, straight.rmse, rtol=5e-3)


def test_a_recorder_that_came_late_still_finds_the_delay(play, take):
    reference, measured = play(0.06)
    late = reference.publish_time[0] + 4_000_000_000
    reference, measured = (take(s, s.publish_time > late) for s in (reference, measured))
    tracking = compare(reference, measured)
    assert len(tracking.time) == 249
    assert tracking.delay.seconds == pytest.approx(0.06, abs=1e-4)


def test_a_delay_that_cannot_be_known_is_not_made_up(play, change):
    for delay in (-0.05, 0.3):
        assert compare(*play(delay)).delay is None
    reference, measured = play()
    still = compare(reference, change(measured, q=np.zeros_like(measured.q)))
    assert still.delay is None
    assert still.rmse[28] == pytest.approx(0.6 / np.sqrt(2), rel=1e-3)


def test_without_a_state_between_references_in_play_there_is_nothing(play, change, take):
    reference, measured = play()
    ramp_only = change(reference, phase=np.full_like(reference.phase, Phase.RAMP))
    alone = take(reference, np.flatnonzero(reference.phase == Phase.PLAY)[:1])
    early = take(measured, slice(0, 20))
    assert compare(ramp_only, measured) is None
    assert compare(alone, measured) is None
    assert compare(reference, early) is None


def test_a_position_that_is_not_finite_is_excluded(play, change):
    reference, measured = play()
    q = measured.q.copy()
    q[1000, 3], q[1001, 4] = np.nan, np.inf
    tracking = compare(reference, change(measured, q=q))
    assert (len(tracking.time), tracking.excluded) == (1998, 2)
    assert np.isfinite(tracking.rmse).all()


def test_a_session_gives_the_same_and_keeps_it(play, write_session):
    session = open_session(write_session(*play(0.04, -SAG)))
    found, expected = session.tracking(), compare(session.reference, session.measured)
    assert session.tracking() is found
    np.testing.assert_array_equal(found.error, expected.error)
    np.testing.assert_allclose(found.time, found.motion_time, atol=1e-6)
    assert found.worst_joint == "left_hip_pitch_joint"


@pytest.mark.parametrize("recorded", [(None, slice(None)), (slice(0, 200), slice(0, 200))])
def test_nothing_to_compare_is_an_error(play, take, write_session, recorded):
    streams = [
        which and take(stream, which) for stream, which in zip(play(), recorded, strict=True)
    ]
    with pytest.raises(RecordingError):
        open_session(write_session(*streams)).tracking()


@pytest.mark.slow
def test_the_rmse_is_that_of_another_reader(play, write_session):
    path = write_session(
        *play(0.04, SAG, ((Phase.RAMP, 0.1), (Phase.PLAY, 0.8), (Phase.HOLD, 0.1)))
    )
    seen = {"/reference": [], "/lowstate": []}
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages(topics=list(seen)):
            seen[channel.topic].append((message.publish_time, decoded))
    start = seen["/reference"][0][0]
    times = np.array([stamp - start for stamp, _ in seen["/reference"]]) / 1e9
    asked = make_interp_spline(times, np.array([m.q for _, m in seen["/reference"]]), k=1)
    played = times[[m.phase == 2 for _, m in seen["/reference"]]]
    after = times[np.searchsorted(times, played[-1]) + 1]
    states = np.array([(stamp - start) / 1e9 for stamp, _ in seen["/lowstate"]])
    q = np.array([[motor.q for motor in m.motor_state[:29]] for _, m in seen["/lowstate"]])
    inside = (states >= played[0]) & (states < after)
    error = asked(states[inside]) - q[inside]

    tracking = open_session(path).tracking()
    summary = tracking.summary()
    assert summary.compared_states == len(error) == 400
    assert summary.all_joints.rmse_rad == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-9)
    for limb, joints in JOINT_GROUPS.items():
        expected = np.sqrt(np.mean(error[:, list(joints)] ** 2))
        assert summary.limbs[limb].rmse_rad == pytest.approx(expected, rel=1e-9)
        assert tracking.rmse_by_limb[limb] == pytest.approx(expected, rel=1e-9)
    mean = error[:, 3].mean()
    assert summary.joints["left_knee_joint"].bias_rad == pytest.approx(mean, rel=1e-9)
