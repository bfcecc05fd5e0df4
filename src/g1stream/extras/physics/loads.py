"""The torques and outer forces that a motion takes, frame by frame, for each support."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, get_args

import numpy as np

from g1stream.extras.physics.batch_dynamics import BatchInverseDynamics
from g1stream.extras.physics.ground import floor_forces
from g1stream.robot.joints import N_JOINTS
from g1stream.robot.kinematics import pose_blocks
from g1stream.types import Floats, Support

if TYPE_CHECKING:
    from collections.abc import Callable

    from g1stream.extras.physics.ground import Flags
    from g1stream.motion.trajectory import Trajectory
    from g1stream.robot.kinematics import LinkPoses
    from g1stream.robot.model import G1
    from g1stream.robot.soles import Soles

__all__ = ["Loads", "movement_loads"]


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


def movement_loads(
    trajectory: Trajectory,
    robot: G1,
    soles: Soles,
    corners: Floats,
    touches: Flags,
    look: Callable[[slice, LinkPoses], None],
) -> Loads:
    """The torques of each support, and the force and moment that the pelvis's motion takes.

    Joints move as the spline through the frames, whose accelerations are greatest at frames. With
    `bolted` the pelvis is upright. With `hanging` it is at rest as the pose lets it hang: the mass
    centre below the carrier's. With `free` the floor exerts the force on the corners that touch it,
    as far as it can (`floor_forces`); the rest is left to an outer force on the pelvis.

    Args:
        trajectory: through T frames.
        robot: the G1.
        soles: of its feet.
        corners: (T, 8, 3) m, world, of the soles.
        touches: (T, 8) whether a corner touches the floor.
        look: called with some frames at a time, and the poses of the links in them.

    Raises:
        RobotError: the dynamics of this robot are not known.
    """
    dynamics, motion = BatchInverseDynamics.of(robot), trajectory.motion
    n_frames, feet = motion.n_frames, np.repeat(soles.links, 4).tolist()
    tau: dict[Support, Floats] = {
        support: np.zeros((n_frames, N_JOINTS)) for support in get_args(Support)
    }
    force, moment = np.zeros((2, n_frames, 3))
    hanging_tilt = np.zeros(n_frames)
    pose = motion.joint_pos, motion.root_pos, motion.root_quat_wxyz
    for part, poses in pose_blocks(robot, *pose):
        look(part, poses)
        point = trajectory.sample_many(np.arange(part.start, part.stop) / motion.fps)
        frames = dynamics.batch(poses, point.joint_vel, point.joint_acc)
        tau["bolted"][part] = frames.bolted()
        tau["hanging"][part], hanging_tilt[part] = frames.hanging()
        led = frames.follow(point.root_ang_vel, point.root_ang_acc, point.root_lin_acc)
        tau["follow"][part], force[part] = led.tau, led.force
        moment[part] = led.moment + np.cross(point.root_pos, led.force)
        pushes = floor_forces(corners[part], touches[part], force[part], moment[part])
        tau["free"][part] = led.tau - frames.torques_of(feet, corners[part], pushes)
    return Loads(dynamics.mass, dynamics.mass * dynamics.gravity, tau, force, moment, hanging_tilt)
