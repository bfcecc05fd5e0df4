import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from g1stream.view.measured_base import MeasuredBase

TIMES = np.arange(5) * 10_000_000


def wxyz(rotations):
    return np.roll(rotations.as_quat(), 1, axis=-1)


def spin(yaws, roll=0.1, pitch=-0.2):
    return Rotation.from_euler("ZYX", [[yaw, pitch, roll] for yaw in yaws])


def same(quats, rotations):
    turned = Rotation.from_quat(np.roll(quats, -1, axis=-1)) * rotations.inv()
    np.testing.assert_allclose(turned.magnitude(), 0.0, atol=1e-9)


def posed(base, times, quats):
    """The poses of states, once they have been taken in."""
    base.add_states(times, quats)
    return base.poses(times, quats)


@pytest.mark.parametrize("power_on_yaw", [1.0, -3.0])
def test_measured_yaw_is_aligned_with_the_reference_at_the_start(power_on_yaw):
    base = MeasuredBase()
    base.add_references(TIMES, np.zeros((5, 3)), wxyz(spin([0.5] * 5, 0, 0)))
    true_yaws = 0.5 + 0.1 * np.arange(5)
    _, quats = posed(base, TIMES, wxyz(spin(true_yaws + power_on_yaw)))
    same(quats, spin(true_yaws))
    assert base.yaw_offset == pytest.approx(-power_on_yaw)


def test_yaw_is_aligned_once():
    base = MeasuredBase()
    base.add_references(TIMES, np.zeros((5, 3)), wxyz(spin([1.0] * 5)))
    posed(base, TIMES[:1], wxyz(spin([0.0])))
    base.add_references(TIMES + 50_000_000, np.zeros((5, 3)), wxyz(spin([2.0] * 5)))
    _, quats = posed(base, TIMES + 50_000_000, wxyz(spin([0.3] * 5)))
    same(quats, spin([1.3] * 5))


def test_without_a_reference_the_imu_quaternion_is_unchanged_or_upright():
    base = MeasuredBase()
    imu = wxyz(spin([0.7] * 5))
    imu[0] = 0.0
    positions, quats = posed(base, TIMES, imu)
    np.testing.assert_array_equal(quats[0], [1.0, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(quats[1:], imu[1:], rtol=0, atol=1e-15)
    np.testing.assert_array_equal(positions, np.zeros((5, 3)))
    assert (base.yaw_offset, base.source) == (None, "none")


def test_without_sportmodestate_the_position_is_the_references():
    base = MeasuredBase()
    path = np.stack([np.linspace(0, 1, 5), np.zeros(5), np.full(5, 0.8)], axis=-1)
    base.add_references(TIMES, path, wxyz(spin([0.0] * 5)))
    positions, _ = posed(base, TIMES + 5_000_000, wxyz(spin([0.0] * 5)))
    np.testing.assert_allclose(positions[:4, 0], np.linspace(0, 1, 5)[:4] + 0.125)
    np.testing.assert_allclose(positions[4], path[4])
    assert base.source == "reference"


def test_a_measured_position_is_rotated_by_the_yaw_offset_about_the_start():
    base = MeasuredBase()
    base.add_references(TIMES, np.full((5, 3), 9.0), wxyz(spin([np.pi / 2] * 5, 0, 0)))
    walked = np.stack([2.0 + np.arange(5), np.full(5, 3.0), np.full(5, 0.8)], axis=-1)
    base.add_positions(TIMES, walked)
    positions, _ = posed(base, TIMES, wxyz(spin([0.0] * 5, 0, 0)))
    # It walks where it looks: along x by its own account, along y in the reference's world.
    np.testing.assert_allclose(positions[:, 0], 2.0, atol=1e-12)
    np.testing.assert_allclose(positions[:, 1], 3.0 + np.arange(5), atol=1e-12)
    np.testing.assert_allclose(positions[:, 2], 0.8, atol=1e-12)
    assert base.source == "sportmodestate"


@pytest.mark.parametrize("bad", [0.0, np.nan, 3.0])
def test_yaw_is_aligned_at_the_first_state_with_a_valid_quaternion(bad):
    base = MeasuredBase()
    base.add_references(TIMES, np.zeros((5, 3)), wxyz(spin([0.5] * 5)))
    imu = wxyz(spin([0.2] * 5))
    imu[:3] = np.full(4, bad)
    _, quats = posed(base, TIMES[:2], imu[:2])
    same(quats, spin([0.5] * 2))  # what the reference has
    assert base.yaw_offset is None
    _, quats = posed(base, TIMES[2:], imu[2:])
    same(quats, spin([0.5] * 3))  # before the first valid one, it is that
    imu[:] = bad
    same(base.poses(TIMES + 60_000_000, imu)[1], spin([0.5] * 5))  # the last that was valid


def test_an_attitude_that_is_not_valid_is_the_last_valid_one_however_batches_are_cut():
    sent = wxyz(spin([0.0, 0.2, 0.4, 0.6, 0.8]))
    sent[2] = 0.0
    for cut in range(1, 5):
        base = MeasuredBase()
        parts = [posed(base, TIMES[part], sent[part])[1] for part in (slice(0, cut), slice(cut, 5))]
        same(np.concatenate(parts), spin([0.0, 0.2, 0.2, 0.6, 0.8]))
