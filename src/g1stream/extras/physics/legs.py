"""Inverse kinematics of the legs for given feet, for many frames at once."""

from __future__ import annotations

from dataclasses import replace
from math import ceil
from typing import Final

import numpy as np
from numpy.typing import NDArray

from g1stream.extras.physics.batch_dynamics import cross
from g1stream.extras.physics.footing import CannotStandError
from g1stream.extras.physics.ground import Flags
from g1stream.motion.motion import Motion
from g1stream.robot.joints import JOINT_GROUPS, JOINT_NAMES
from g1stream.robot.kinematics import BLOCK, forward_kinematics
from g1stream.robot.model import G1
from g1stream.robot.rotations import (
    quat_conj,
    quat_mul,
    quat_rotate,
    rotation_matrices,
    rotation_vector,
)
from g1stream.robot.soles import OFF_FLOOR, SIDES, Soles
from g1stream.types import Floats

#: A foot carries no load from this time before it is lifted, s, and at least from a frame before,
#: because the centre of pressure moves between two frames.
_UNLOADED: Final = 0.03
_TOO_SHORT: Final = "the legs are too short, or their knees all but stretched,"
#: Feet within this of their places have reached them, m and rad.
_EXACT: Final = 1e-6
#: Least bend of a knee, rad, because a stretched one cannot raise the pelvis.
_KNEE: Final = 0.12
_BENT: Final = 0.4  # start of the search
#: Most iterations until the feet have reached their places.
_ITERATIONS: Final = 40
#: Largest joint step of an iteration, rad; damping added to squared singular values of a leg.
_LARGEST_TURN: Final = 0.3
_DAMPING: Final = 1e-6


class LegsTooShortError(CannotStandError):
    """The legs cannot reach from the pelvis to the places of the feet."""


class Legs:
    """The leg joints for given feet: links (T, 2, 3), m, world, and turns (T, 2, 4) wxyz.

    Attributes:
        corners: (T, 8, 3) m, world, corners of the soles.
        carries: (T, 8) whether a corner is on a foot that may carry the robot: the foot stands
            on the floor at height 0, and is not about to be lifted.
    """

    def __init__(self, robot: G1, soles: Soles, feet: Floats, turns: Floats, fps: float) -> None:
        self._robot, self._soles = robot, soles
        self._feet, self._turns = feet, turns
        self._joints = [list(JOINT_GROUPS[f"{side}_leg"]) for side in SIDES]
        self._links = [
            [int(np.flatnonzero(robot.joint_of_link == joint)[0]) for joint in joints]
            for joints in self._joints
        ]
        self._knees = [JOINT_NAMES.index(f"{side}_knee_joint") for side in SIDES]
        corners = quat_rotate(turns[:, :, np.newaxis], soles.corners) + feet[:, :, np.newaxis]
        self.corners: Floats = corners.reshape(-1, 8, 3)
        self.carries = np.repeat(_carrying(feet[..., 2] < soles.height + OFF_FLOOR, fps), 4, axis=1)

    def bent(self, motion: Motion) -> Motion:
        """The motion with bent knees, because `reach` could bend a stretched one backwards."""
        joint_pos = motion.joint_pos.copy()
        for hip, _, _, knee, ankle, _ in self._joints:
            bend = np.maximum(0.0, _BENT - joint_pos[:, knee])
            joint_pos[:, knee] += bend
            joint_pos[:, [hip, ankle]] -= 0.5 * bend[:, np.newaxis]
        return replace(motion, joint_pos=joint_pos)

    def reach(self, motion: Motion, root_pos: Floats, moved: Flags | None = None) -> Motion:
        """The motion with other pelvis positions (T, 3), m, and the feet in place.

        Newton's method with damped steps, for many frames at once, until the feet are in place. In
        frames in which the pelvis is not `moved` (T,), they already are.
        """
        q, quat, error = motion.joint_pos.copy(), motion.root_quat_wxyz, np.zeros(motion.n_frames)
        left = np.arange(len(q)) if moved is None else np.flatnonzero(moved)
        for _ in range(_ITERATIONS):
            for first in range(0, len(left), BLOCK):
                some = left[first : first + BLOCK]
                error[some] = self._step(q, root_pos, quat, some)
            left = left[error[left] >= _EXACT]
        short = (q[:, self._knees].min(axis=1) < _KNEE) | (error >= _EXACT)
        if short.any():
            raise LegsTooShortError(motion, _TOO_SHORT, short)
        return replace(motion, joint_pos=q, root_pos=root_pos)

    def _step(
        self, q: Floats, root_pos: Floats, root_quat: Floats, frames: NDArray[np.intp]
    ) -> Floats:
        """Move the joints in N frames towards the places; return the distances before the step."""
        feet, links = self._soles.links, np.array(self._links)
        pose = q[frames], root_pos[frames], root_quat[frames]
        poses = forward_kinematics(self._robot, *pose, feet)
        turn = quat_mul(self._turns[frames], quat_conj(poses.quat_wxyz[:, feet]))
        away = self._feet[frames] - poses.pos[:, feet]
        off = np.concatenate([away, rotation_vector(turn)], axis=2)
        # Components are first, and (feet, joints, N) last.
        matrices, pos = rotation_matrices(poses.quat_wxyz.T[:, links]), poses.pos.T
        axes = (matrices * self._robot.axis[links].transpose(2, 0, 1)[..., np.newaxis]).sum(axis=1)
        lever = pos[:, feet, np.newaxis] - pos[:, links]
        rows = np.concatenate([cross(axes, lever), axes])
        jacobian = np.ascontiguousarray(rows.transpose(3, 1, 0, 2))  # (N, feet, 6, joints)
        transposed = jacobian.swapaxes(2, 3)
        square = jacobian @ transposed + _DAMPING * np.eye(6)
        step = (transposed @ np.linalg.solve(square, off[..., np.newaxis]))[..., 0]
        q[frames[:, np.newaxis], np.concatenate(self._joints)] += np.clip(
            step.reshape(len(frames), -1), -_LARGEST_TURN, _LARGEST_TURN
        )
        worst: Floats = np.abs(off).max(axis=(1, 2))
        return worst


def _carrying(stands: Flags, fps: float) -> Flags:
    """Which standing feet (T, 2) may carry the robot; at least one always does."""
    carries: Flags = stands.copy()
    for ahead in range(1, 1 + ceil(_UNLOADED * fps)):
        carries[:-ahead] &= stands[ahead:]
    neither = ~carries.any(axis=1)
    carries[neither] = stands[neither]
    return carries
