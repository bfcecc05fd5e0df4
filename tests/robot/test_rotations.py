import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from g1stream.robot.rotations import (
    quat_conj,
    quat_from_axis_angle,
    quat_from_rpy,
    quat_from_yaw,
    quat_mul,
    quat_rotate,
    quat_rotate_inverse,
    quat_to_rpy,
    rotation_vector,
    tilt_of,
    wrap_angle,
    wxyz_from_xyzw,
    xyzw_from_wxyz,
    yaw_of,
)

RNG = np.random.default_rng(4)
SHAPE = (6, 5)
N = 30


def scipy_rotation(quat_wxyz):
    return Rotation.from_quat(quat_wxyz.reshape(-1, 4)[:, [1, 2, 3, 0]])


def assert_same_rotation(quat_wxyz, rotation):
    turn = scipy_rotation(quat_wxyz) * rotation.inv()
    np.testing.assert_allclose(turn.magnitude(), 0, atol=1e-14)


QUATS, OTHERS = (
    Rotation.random(N, rng=RNG).as_quat()[:, [3, 0, 1, 2]].reshape(*SHAPE, 4) for _ in range(2)
)


def test_product_is_the_composition():
    product = quat_mul(QUATS, OTHERS)
    assert product.shape == QUATS.shape
    assert_same_rotation(product, scipy_rotation(QUATS) * scipy_rotation(OTHERS))


def test_conjugate_undoes():
    identity = quat_mul(QUATS, quat_conj(QUATS))
    np.testing.assert_allclose(identity, np.broadcast_to([1, 0, 0, 0], identity.shape), atol=1e-15)


def test_rotate_and_back():
    vectors = RNG.normal(size=(*SHAPE, 3))
    turned = quat_rotate(QUATS, vectors)
    expected = scipy_rotation(QUATS).apply(vectors.reshape(-1, 3)).reshape(vectors.shape)
    np.testing.assert_allclose(turned, expected, atol=1e-14)
    np.testing.assert_allclose(quat_rotate_inverse(QUATS, turned), vectors, atol=1e-14)


def test_axis_angle():
    axis = RNG.normal(size=(N, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    angle = RNG.uniform(-6, 6, N)
    assert_same_rotation(
        quat_from_axis_angle(axis, angle), Rotation.from_rotvec(axis * angle[:, None])
    )


def test_rpy_both_ways():
    rpy = RNG.uniform([-np.pi, -np.pi / 2, -np.pi], [np.pi, np.pi / 2, np.pi], (N, 3))
    quat = quat_from_rpy(rpy)
    assert_same_rotation(quat, Rotation.from_euler("xyz", rpy))
    for same in (quat, -quat):
        np.testing.assert_allclose([quat_to_rpy(one) for one in same], rpy, atol=1e-12)
    np.testing.assert_allclose(yaw_of(quat), rpy[:, 2], atol=1e-12)


@pytest.mark.parametrize("pitch", [np.pi / 2, -np.pi / 2])
def test_rpy_at_the_poles_is_the_same_rotation(pitch):
    quat = quat_from_rpy(np.array([0.4, pitch, -1.1]))
    rpy = np.array(quat_to_rpy(quat))
    assert rpy[1] == pytest.approx(pitch, abs=1e-14)
    assert_same_rotation(quat_from_rpy(rpy), scipy_rotation(quat))


def test_orders_are_each_others_inverse():
    np.testing.assert_array_equal(wxyz_from_xyzw(np.array([[1, 2, 3, 4.0]])), [[4, 1, 2, 3]])
    np.testing.assert_array_equal(xyzw_from_wxyz(np.array([[4, 1, 2, 3.0]])), [[1, 2, 3, 4]])


def test_tilt_is_the_angle_between_the_vertical_axes():
    for rotation in Rotation.random(50, rng=np.random.default_rng(3)):
        expected = np.arccos(rotation.apply([0, 0, 1])[2])
        assert tilt_of(wxyz_from_xyzw(rotation.as_quat())) == pytest.approx(expected, abs=1e-7)


def test_a_yaw_is_a_turn_about_the_vertical():
    yaw = RNG.uniform(-3.0, 3.0, SHAPE)
    assert yaw_of(quat_from_yaw(yaw)) == pytest.approx(yaw)
    assert tilt_of(quat_from_yaw(0.7)) == pytest.approx(0.0, abs=1e-7)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_vector_of_a_small_turn(sign):
    turns = RNG.normal(scale=1e-4, size=(*SHAPE, 3))
    quats = Rotation.from_rotvec(turns.reshape(-1, 3)).as_quat()[:, [3, 0, 1, 2]]
    found = rotation_vector(sign * quats.reshape(*SHAPE, 4))
    np.testing.assert_allclose(found, turns, atol=1e-10)
    assert np.linalg.norm(rotation_vector(np.array([0.0, 0.0, 0.0, 1.0]))) == 2.0  # a half turn


def test_angles_are_wrapped():
    assert wrap_angle(np.array([3.5, -3.5, 0.5, 13.0])) == pytest.approx(
        [3.5 - 2.0 * np.pi, 2.0 * np.pi - 3.5, 0.5, 13.0 - 4.0 * np.pi]
    )
