"""What holds the base: where it starts, and with what force it is held."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
import pytest

from g1stream.errors import SimError
from g1stream.robot.rotations import quat_rotate
from g1stream.sim.world import World

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from g1stream.robot.model import G1
    from g1stream.sim.world import MotorCommand


GRAVITY = 9.81


def base_tilt(quat_wxyz: NDArray[np.float64]) -> float:
    """Angle between the base's z axis and the world's, rad."""
    return float(np.arccos(quat_rotate(quat_wxyz, np.array([0.0, 0.0, 1.0]))[2]))


def test_start_pose_and_height(robot: G1, inner_pose: NDArray[np.float64]) -> None:
    pose = inner_pose
    for support in ("bolted", "hanging"):
        state = World(robot, support, joint_pos=pose, base_height=1.2).state()
        assert state.q == pytest.approx(pose, abs=1e-15)
        assert state.base_pos == pytest.approx([0, 0, 1.2])
        assert state.time == 0


def test_hanging_robot_settles_upright_where_the_band_carries_it(
    robot: G1, servo: Callable[..., MotorCommand], masses: list[Any]
) -> None:
    world = World(robot, "hanging")
    weight = GRAVITY * sum(mass for _, mass, _ in masses)
    height, tilt = [], []
    for _ in range(4000):
        world.step(servo())
        height.append(world.state().base_pos[2])
        tilt.append(base_tilt(world.state().imu.quat_wxyz))
    assert np.mean(height[2000:]) == pytest.approx(3 - weight / 200, abs=0.003)
    assert np.ptp(height[2000:]) < 0.01
    assert max(tilt) < 0.15


def test_band_pulls_at_the_torso_by_its_law(
    robot: G1, servo: Callable[..., MotorCommand], run: Callable[..., None]
) -> None:
    """Newton and Euler on the whole robot: what changes its momenta must be band and weight."""
    world = World(robot, "hanging", base_height=1.1)
    world.data.qpos[0] = 0.5  # so that it pulls sideways too, and turns the robot
    run(world, servo(q=0.2), 0.2)
    model, data = world.model, world.data

    def momenta() -> NDArray[np.float64]:
        mujoco.mj_subtreeVel(model, data)
        return np.concatenate(
            [model.body_subtreemass[1] * data.subtree_linvel[1], data.subtree_angmom[1]]
        )

    state, start = world.state(), momenta()
    torso = [model.body(name).id for name in ("torso_link", "head_link", "logo_link")]
    centre = np.average(data.xipos[torso], axis=0, weights=model.body_mass[torso])
    arm = centre - data.subtree_com[1]
    world.step(servo(q=0.2))
    force, moment = ((momenta() - start) / world.timestep).reshape(2, 3)

    to_top = np.array([0.0, 0.0, 3.0]) - state.base_pos
    length = np.linalg.norm(to_top)
    speed = state.base_lin_vel @ to_top / length
    band = (200 * length - 100 * speed) * to_top / length
    assert abs(speed) > 0.1
    weight = np.array([0.0, 0.0, -GRAVITY * model.body_subtreemass[1]])
    assert force == pytest.approx(band + weight, abs=0.002 * np.linalg.norm(band))
    assert moment == pytest.approx(np.cross(arm, band), abs=0.002 * np.linalg.norm(band))


def test_unknown_support_is_refused(robot: G1) -> None:
    with pytest.raises(SimError, match=r"'floating'\. Choose from bolted, hanging"):
        World(robot, "floating")
