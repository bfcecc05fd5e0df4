"""Example motions on both feet from formulas, for tests and documentation: squats and steps."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from g1stream.extras.physics.legs import Legs
from g1stream.motion.blend import minimum_jerk
from g1stream.motion.motion import Motion
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS
from g1stream.robot.model import G1
from g1stream.robot.rotations import quat_from_yaw, quat_rotate
from g1stream.robot.soles import Soles, bent_legs
from g1stream.types import Floats


def squatting(seconds: float, *, arms: float = 0.6, fps: float = 50.0) -> Motion:
    """A motion that squats every 4 s, swings both arms by `arms` rad and turns the waist."""
    time = np.arange(round(seconds * fps) + 1) / fps
    begun = minimum_jerk(time / 2.0)[0]

    def swing(hertz: float, phase: float = 0.0) -> Floats:
        return begun * np.sin(2.0 * np.pi * hertz * time + phase)

    knee = 0.75 + 0.25 * swing(0.25)
    angles: dict[str, Floats | float] = {"waist_yaw": 0.4 * swing(0.2)}
    for side, sign in (("left", 1.0), ("right", -1.0)):
        angles |= {
            f"{side}_hip_pitch": -0.5 * knee,
            f"{side}_knee": knee,
            f"{side}_ankle_pitch": -0.5 * knee,
            f"{side}_hip_roll": 0.05 * sign,
            f"{side}_ankle_roll": -0.05 * sign,
            f"{side}_shoulder_pitch": arms * swing(0.5, 1.0 + 0.5 * sign),
            f"{side}_shoulder_roll": sign * (0.3 + 0.5 * arms * (begun + swing(0.3, -np.pi / 2))),
            f"{side}_elbow": 0.5 + 0.5 * swing(0.7),
        }
    joint_pos = np.zeros((len(time), N_JOINTS))
    for name, angle in angles.items():
        joint_pos[:, JOINT_NAMES.index(f"{name}_joint")] = angle
    root_pos = np.tile([0.0, 0.0, 0.7], (len(time), 1))
    return Motion.from_arrays(joint_pos, root_pos, fps=fps, name="squatting")


def stepping(
    places: ArrayLike, *, period: float = 1.6, swing: float = 0.8, fps: float = 50.0
) -> Motion:
    """A motion that steps with alternating feet, left first, from rest to rest.

    A foot is lifted by 6 cm, for `swing` s in each `period`. The pelvis stays midway between the
    feet, and not over the standing one. `places` (N, 3) has x and y, m, and heading, rad, of step
    k: the pose of the robot if both feet were placed like the foot of that step, from 0, 0, 0.
    """
    goals = np.concatenate([np.zeros((1, 3)), np.asarray(places, dtype=np.float64)])
    robot = G1.default()
    soles = Soles(robot)
    time = np.arange(round((len(goals) + 1) * period * fps) + 1) / fps
    # The robot's place for each foot (T, 2, 3), and the foot's height.
    stand, height = np.zeros((len(time), 2, 3)), np.zeros((len(time), 2))
    for k, goal in enumerate(goals[1:]):
        foot = k % 2
        way = minimum_jerk((time - (k + 1) * period) / swing)[0][:, np.newaxis]
        stand[:, foot] += way * (goal - goals[max(0, k - 1)])
        height[:, foot] += 0.06 * (4.0 * way * (1.0 - way))[:, 0]
    heading = stand[..., 2]
    turns = quat_from_yaw(heading)
    feet = quat_rotate(turns, np.array([[0.0, 0.1, 0.0], [0.0, -0.1, 0.0]]))
    feet[..., :2] += stand[..., :2]
    feet[..., 2] = height + soles.height
    middle = stand.mean(axis=1)
    root_pos = np.column_stack([middle[:, :2], np.full(len(time), 0.7)])
    root_quat = quat_from_yaw(middle[:, 2])
    pose = np.tile(bent_legs(0.4), (len(time), 1))
    motion = Motion.from_arrays(pose, root_pos, root_quat, fps=fps, name="stepping")
    return Legs(robot, soles, feet, turns, fps).reach(motion, root_pos)
