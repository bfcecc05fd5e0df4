"""Commands in, states out: the servo law, the sensors, determinism, and what is refused."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from g1stream.errors import SimError
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS
from g1stream.robot.kinematics import forward_kinematics
from g1stream.robot.rotations import quat_rotate, quat_rotate_inverse
from g1stream.sim.model import TORQUE_LIMIT
from g1stream.sim.world import MotorCommand, World

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray

    from g1stream.robot.model import G1


GRAVITY = 9.81


def test_servo_law_and_torque_limits(
    robot: G1,
    rng: np.random.Generator,
    servo: Callable[..., MotorCommand],
    inner_pose: NDArray[np.float64],
) -> None:
    world = World(robot, joint_pos=inner_pose)
    saturated = np.zeros(N_JOINTS, dtype=bool)
    for _ in range(200):
        command = servo(
            q=rng.uniform(-2, 2, N_JOINTS),
            dq=rng.uniform(-5, 5, N_JOINTS),
            tau=rng.uniform(-10, 10, N_JOINTS),
            kp=rng.uniform(0, 100, N_JOINTS),
            kd=rng.uniform(0, 5, N_JOINTS),
        )
        before = world.state()
        world.step(command)
        wanted = (
            command.tau
            + command.kp * (command.q - before.q)
            + command.kd * (command.dq - before.dq)
        )
        applied = world.state().tau_est
        assert applied == pytest.approx(np.clip(wanted, -TORQUE_LIMIT, TORQUE_LIMIT), abs=1e-9)
        saturated |= np.abs(applied) == TORQUE_LIMIT
    assert saturated.all()


def test_only_enabled_motors_move(robot: G1, servo: Callable[..., MotorCommand]) -> None:
    enabled = np.arange(N_JOINTS) % 2 == 0
    world = World(robot)
    world.step(servo(tau=3.0, kp=0.0, kd=0.0, enabled=enabled))
    assert (world.state().tau_est == np.where(enabled, 3.0, 0.0)).all()


def test_imu_at_rest_reads_gravity_upward(robot: G1) -> None:
    state = World(robot).state()
    assert state.imu.quat_wxyz == pytest.approx([1, 0, 0, 0])
    assert state.imu.gyroscope == pytest.approx([0, 0, 0])
    assert state.imu.accelerometer == pytest.approx([0, 0, GRAVITY])


def test_torso_imu_turns_with_the_waist(
    robot: G1, servo: Callable[..., MotorCommand], run: Callable[..., None]
) -> None:
    pose = np.zeros(N_JOINTS)
    pose[[JOINT_NAMES.index("waist_yaw_joint"), JOINT_NAMES.index("waist_pitch_joint")]] = 0.7, 0.4
    world = World(robot, joint_pos=pose)
    run(world, servo(q=pose, kp=200.0, kd=10.0), 3.0)
    state = world.state()
    torso = forward_kinematics(
        robot, state.q[None], np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0, 0.0]])
    ).quat_wxyz[0, robot.link_index("imu_in_torso")]
    assert state.torso_imu.quat_wxyz == pytest.approx(torso, abs=1e-9)
    assert state.torso_imu.quat_wxyz[3] > 0.3  # mostly about z, the last in wxyz
    upward = quat_rotate_inverse(torso, np.array([0.0, 0.0, GRAVITY]))
    assert state.torso_imu.accelerometer == pytest.approx(upward, abs=1e-2)
    world.step(servo(tau=20.0 * (np.array(JOINT_NAMES) == "waist_yaw_joint")))
    world.step(servo(tau=20.0 * (np.array(JOINT_NAMES) == "waist_yaw_joint")))
    moved = world.state()
    in_world = quat_rotate(moved.torso_imu.quat_wxyz, moved.torso_imu.gyroscope)
    assert in_world[2] == pytest.approx(moved.dq[JOINT_NAMES.index("waist_yaw_joint")], rel=0.1)
    assert abs(in_world[2]) > 0.01


@pytest.mark.parametrize("support", ["bolted", "hanging"])
def test_same_commands_give_the_same_bits(
    robot: G1, support: str, servo: Callable[..., MotorCommand]
) -> None:
    def play() -> bytes:
        rng = np.random.default_rng(3)
        world, states = World(robot, support), b""
        for _ in range(200):
            world.step(servo(q=rng.uniform(-0.3, 0.3, N_JOINTS)))
            states += b"".join(
                np.asarray(part).tobytes()
                for field in world.state()
                for part in (field if isinstance(field, tuple) else (field,))
            )
        return states

    assert play() == play()


def test_float32_commands_are_obeyed_alike(
    robot: G1,
    rng: np.random.Generator,
    servo: Callable[..., MotorCommand],
    run: Callable[..., None],
) -> None:
    exact = servo(q=rng.uniform(-0.3, 0.3, N_JOINTS), tau=0.7)
    wire = MotorCommand(exact.enabled, *(values.astype(np.float32) for values in exact[1:]))
    worlds = World(robot), World(robot)
    for world, command in zip(worlds, (exact, wire), strict=True):
        run(world, command, 0.1)
    assert worlds[1].state().q == pytest.approx(worlds[0].state().q, abs=1e-6)


def test_states_are_the_callers_own(robot: G1, run: Callable[..., None]) -> None:
    world = World(robot)
    first = world.state()
    run(world, MotorCommand.off(), 0.1)
    assert first.time == 0
    assert not first.q.any()
    assert first.imu.accelerometer == pytest.approx([0, 0, GRAVITY])


@pytest.mark.parametrize(
    ("arguments", "value"),
    [
        ({"joint_pos": np.zeros(23)}, r"\(23,\)"),
        ({"joint_pos": np.full(N_JOINTS, np.nan)}, r"\(29,\)"),
        ({"timestep": 0.0}, "timestep 0.0"),
        ({"base_height": float("inf")}, "base height inf"),
    ],
)
def test_impossible_worlds_are_refused(robot: G1, arguments: dict[str, object], value: str) -> None:
    with pytest.raises(SimError, match=value):
        World(robot, **arguments)


def test_command_that_is_not_finite_is_refused(
    robot: G1, servo: Callable[..., MotorCommand]
) -> None:
    world = World(robot)
    command = servo()
    command.q[JOINT_NAMES.index("left_knee_joint")] = np.nan
    with pytest.raises(SimError, match="left_knee_joint"):
        world.step(command)
    world.step(servo())
    assert np.isfinite(world.state().q).all()


def test_a_state_that_cannot_be_integrated_is_an_error(
    robot: G1,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    servo: Callable[..., MotorCommand],
    run: Callable[..., None],
) -> None:
    monkeypatch.chdir(tmp_path)  # MuJoCo writes a log there
    world = World(robot)
    run(world, servo(), 0.01)
    world.data.qvel[:] = 1e12
    with pytest.raises(SimError, match=r"0\.010 s"):
        world.step(servo())
