"""The torques and outer forces that a motion takes, frame by frame, for each support."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple, get_args

import numpy as np

from g1stream.analysis.ground import floor_forces
from g1stream.motion.trajectory import Trajectory
from g1stream.robot.dynamics import BaseMotion
from g1stream.robot.joints import N_JOINTS
from g1stream.robot.kinematics import LinkPoses, forward_kinematics
from g1stream.robot.rotations import quat_normalize, quat_rotate, tilt_of
from g1stream.types import Floats, Support

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from g1stream.analysis.ground import Flags
    from g1stream.motion.motion import Motion
    from g1stream.robot.dynamics import InverseDynamics
    from g1stream.robot.model import G1
    from g1stream.robot.soles import Soles

__all__ = ["Loads", "blocks", "movement_loads"]

#: Frames at once, so that memory grows with what is kept of a frame only.
_BLOCK: Final = 512
_UPRIGHT: Final = BaseMotion(np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3))


class Loads(NamedTuple):
    """What T frames take.

    Attributes:
        mass: kg, of the robot.
        weight: N.
        tau: by support, (T, 29) N·m, motor order.
        force: (T, 3) N, world, that has to act on the robot for its pelvis to move as in the
            motion; at rest its weight, upward.
        moment: (T, 3) N·m, world, of that force about the world's origin.
        hanging_tilt: (T,) rad, of the pelvis of a robot that hangs at rest.
    """

    mass: float
    weight: float
    tau: dict[Support, Floats]
    force: Floats
    moment: Floats
    hanging_tilt: Floats


def blocks(motion: Motion, robot: G1) -> Iterator[tuple[slice, LinkPoses]]:
    """The frames of a motion, some at a time, and the poses of the links in them."""
    for first in range(0, motion.n_frames, _BLOCK):
        part = slice(first, min(first + _BLOCK, motion.n_frames))
        yield (
            part,
            forward_kinematics(
                robot, motion.joint_pos[part], motion.root_pos[part], motion.root_quat_wxyz[part]
            ),
        )


def movement_loads(
    motion: Motion,
    robot: G1,
    dynamics: InverseDynamics,
    soles: Soles,
    corners: Floats,
    touches: Flags,
    progress: Callable[[float], None],
) -> Loads:
    """The torques of each support, and the force and moment that the pelvis's motion takes.

    Joints move as the spline through the frames, whose accelerations are greatest at frames. With
    `bolted` the pelvis is upright. With `hanging` it is at rest as the pose lets it hang: the mass
    centre below the carrier's. With `free` the floor exerts the force on the corners that touch it,
    as far as it can (`floor_forces`); the rest is left to an outer force on the pelvis.

    Args:
        motion: T frames.
        robot: the G1.
        dynamics: of the robot.
        soles: of its feet.
        corners: (T, 8, 3) m, world, of the soles.
        touches: (T, 8) whether a corner touches the floor.
        progress: called with the fraction that is done.
    """
    n_frames = motion.n_frames
    tau: dict[Support, Floats] = {
        support: np.zeros((n_frames, N_JOINTS)) for support in get_args(Support)
    }
    wrench, hanging_tilt = np.zeros((n_frames, 6)), np.zeros(n_frames)
    force, moment = wrench[:, :3], wrench[:, 3:]
    trajectory = Trajectory(motion)
    for part, poses in blocks(motion, robot):
        numbers = range(n_frames)[part]
        point = trajectory.sample_many(np.array(numbers) / motion.fps)
        for row, k in enumerate(numbers):
            joints = point.joint_pos[row], point.joint_vel[row], point.joint_acc[row]
            tau["bolted"][k] = dynamics.solve("bolted", *joints, _UPRIGHT).tau
            hanging = _hanging(dynamics, joints[0])
            hanging_tilt[k] = tilt_of(hanging.quat_wxyz)
            tau["hanging"][k] = dynamics.solve("hanging", *joints, hanging).tau
            led = BaseMotion(
                point.root_quat_wxyz[row],
                point.root_ang_vel[row],
                point.root_lin_acc[row],
                point.root_ang_acc[row],
            )
            solution = dynamics.solve("follow", *joints, led)
            tau["follow"][k], wrench[k] = solution.tau, solution.wrench
        moment[part] = quat_rotate(point.root_quat_wxyz, moment[part])
        moment[part] += np.cross(point.root_pos, force[part])
        pushes = np.zeros_like(corners[part])
        for row, k in enumerate(numbers):
            if (on := touches[k]).any():
                pushes[row, on] = floor_forces(corners[k, on], force[k], moment[k])
        tau["free"][part] = tau["follow"][part] - soles.torques(poses, corners[part], pushes)
        progress(part.stop / n_frames)
    return Loads(dynamics.mass, dynamics.mass * dynamics.gravity, tau, force, moment, hanging_tilt)


def _hanging(dynamics: InverseDynamics, q: Floats) -> BaseMotion:
    """The pelvis of a robot that hangs at rest, as it turns from upright without turning about z.

    In an upright pelvis's frame the lever from the mass centre to the carrier's has to be upward.
    """
    x, y, z = dynamics.momentum(q, np.zeros(N_JOINTS), _UPRIGHT).lever
    length = float(np.sqrt(x * x + y * y + z * z))
    # The shortest turn from u to z is the quaternion (1 + u . z, u x z).
    turn = np.array([max(length + z, 1e-9), y, -x, 0.0])
    return BaseMotion(quat_normalize(turn), np.zeros(3))
