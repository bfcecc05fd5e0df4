"""What the picture shows, before it is drawn."""

import numpy as np
import pytest

from g1stream.analysis.plot_data import LONGEST_VIEW, binned_rms, joints_to_show, make_scene
from g1stream.robot.joints import JOINT_GROUPS
from g1stream.types import Phase


def test_times_are_the_motions_and_angles_degrees(play, motion):
    reference, measured = play(0.03)
    scene = make_scene(reference, measured)
    playing = reference.phase == Phase.PLAY
    np.testing.assert_allclose(scene.times[playing], reference.motion_time[playing], atol=1e-9)
    done = np.degrees(motion.at(scene.state_times - 0.03))
    np.testing.assert_allclose(scene.measured, done, atol=1e-6)
    np.testing.assert_allclose(scene.error_times, scene.compared.motion_time, atol=1e-9)


def test_phases_follow_each_other(play):
    scene = make_scene(*play())
    assert [span.phase.name for span in scene.phases] == ["RAMP", "PLAY", "HOLD", "DAMP"]
    starts = [span.start_s for span in scene.phases]
    assert starts == pytest.approx([-0.5, 0.0, 4.0, 4.3], abs=1e-9)
    assert [span.end_s for span in scene.phases[:-1]] == starts[1:]


def test_damping_asks_for_no_angle(play):
    reference, measured = play()
    scene = make_scene(reference, measured)
    damping = reference.phase == Phase.DAMP
    assert np.isnan(scene.asked[damping]).all()
    np.testing.assert_array_equal(scene.asked[~damping], np.degrees(reference.q[~damping]))


def test_the_busiest_joint_of_each_limb_and_the_worst_of_the_others(play):
    sag = np.zeros(29)
    sag[[1, 28]] = 0.3, 0.4
    scene = make_scene(*play(offset=sag))
    # The amplitudes grow from joint to joint, except for the 13th, which stands still.
    busiest, others = joints_to_show(scene)
    assert busiest == [joints[-1] for joints in JOINT_GROUPS.values()]
    assert others == [1]  # 28 sags more, but is shown already


def test_a_short_session_is_shown_whole(play):
    scene = make_scene(*play())
    assert scene.view == (scene.phases[0].start_s, scene.phases[-1].end_s)


@pytest.mark.parametrize(
    ("worst_at", "start"), [(1.0, -0.5), (23.0, 13.0), (39.5, 40.0 - LONGEST_VIEW)]
)
def test_a_long_session_is_shown_around_its_greatest_error(play, worst_at, start, change):
    reference, measured = play(phases=((Phase.RAMP, 0.5), (Phase.PLAY, 40.002)))
    q = measured.q.copy()
    q[np.searchsorted(make_scene(reference, measured).state_times, worst_at), 11] += 2.0
    view = make_scene(reference, change(measured, q=q)).view
    assert view == pytest.approx((start, start + LONGEST_VIEW), abs=0.005)


def test_rms_in_bins_keeps_the_whole_errors_rms():
    rng = np.random.default_rng(4)
    times, errors = np.arange(2000) * 0.002, rng.normal(size=(2000, 6))
    times[1:] += 0.0005  # none on the edge between two bins
    middles, rms = binned_rms(times, errors)
    np.testing.assert_allclose(np.diff(middles), 0.1)
    assert np.sqrt(np.mean(rms[:40] ** 2)) == pytest.approx(np.sqrt(np.mean(errors**2)), rel=1e-12)
    assert rms[7] == pytest.approx(np.sqrt(np.mean(errors[350:400] ** 2)), rel=1e-12)


def test_a_bin_without_states_has_no_rms():
    times = np.concatenate([np.arange(100) * 0.002, 1.0 + np.arange(100) * 0.002])
    middles, rms = binned_rms(times, np.ones((200, 2)))
    empty = (middles > 0.2) & (middles < 1.0)
    assert np.isnan(rms[empty]).all()
    np.testing.assert_allclose(rms[middles < 0.2], 1.0)


def test_one_state_is_one_bin():
    middles, rms = binned_rms(np.array([2.0]), np.array([[3.0, 4.0]]))
    assert len(middles) == 1
    assert rms == pytest.approx(np.sqrt([12.5]))


def test_a_session_without_play(play, change):
    reference, measured = play()
    scene = make_scene(change(reference, phase=np.full_like(reference.phase, Phase.RAMP)), measured)
    assert scene.tracking is None
    assert scene.times[0] == 0.0
    busiest, others = joints_to_show(scene)
    assert busiest == [joints[-1] for joints in JOINT_GROUPS.values()]
    assert others == []
