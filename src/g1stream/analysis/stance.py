"""A reference that a robot on its feet can follow: feet that stand still, under the robot.

Of a motion as it comes, even of one that means to stand, the feet slide by millimetres, sink into
the floor and turn, and its centre of pressure may be outside of the soles. Here the feet are put
where they are on average while they stand, flat on the floor; a foot that is lifted comes back
there. The pelvis keeps its height above them and its attitude; it is moved sideways until the
centre of pressure is inside the soles that stand; and the joints of the legs follow from both.
Waist and arms are not changed. docs/feet.md has the method.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.analysis.ground import beyond_support, zero_moment_point
from g1stream.errors import MotionError
from g1stream.motion.blend import minimum_jerk
from g1stream.motion.trajectory import Trajectory
from g1stream.robot.dynamics import GRAVITY, BaseMotion, InverseDynamics
from g1stream.robot.joints import JOINT_GROUPS, JOINT_NAMES
from g1stream.robot.kinematics import forward_kinematics
from g1stream.robot.rotations import quat_conj, quat_from_rpy, quat_mul, quat_rotate, yaw_of
from g1stream.robot.soles import OFF_FLOOR, SIDES, Soles, bent_legs
from g1stream.types import Floats

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from g1stream.motion.motion import Motion
    from g1stream.robot.model import G1

__all__ = ["Standing", "on_standing_legs", "stand"]

#: A foot that is so much higher than the other is lifted, from when it was higher by the second
#: figure until it is not, m.
_LIFTED: Final = 0.03, 0.01
#: A foot that stands so far from where it mostly stands steps, m.
_STEPS: Final = 0.1
#: A lifted foot comes off its place, and back, within this, s.
_LEAVES: Final = 0.1
#: How far the centre of pressure is kept from the edge of the support polygon, m.
_MARGIN: Final = 0.02
#: A centre of pressure this near to where it shall be is there, m, and attempts to get it there.
_NEAR: Final = 0.002
_ATTEMPTS: Final = 12
#: A knee is bent by this at least, rad: a stretched one cannot lift the pelvis.
_KNEE: Final = 0.12
_BENT: Final = 0.4  # where the search begins
#: The pelvis is lowered by these steps, m, and by no more than this.
_STEP: Final = 0.005
_LOWEST: Final = 0.15
#: The feet are where they shall be, m and rad, and iterations until they are.
_EXACT: Final = 1e-6
_ITERATIONS: Final = 40
#: An iteration turns no joint by more, rad; added to the squares of a leg's singular values.
_LARGEST_TURN: Final = 0.3
_DAMPING: Final = 1e-6
#: Legs that do not play the motion are bent by this angle at hip and ankle, rad.
_STANCE: Final = 0.35
#: Stretches of frames that an error names.
_NAMED: Final = 3


@dataclass(frozen=True)
class Standing:
    """A motion that can be played on the feet, and what was changed for it.

    Attributes:
        motion: the changed motion, its feet flat, on a floor at height 0 unless they are lifted.
        moved_mm: how far a foot that stands was moved relative to the other at most.
        turned_deg: by how much a foot was turned at most.
        lowered_mm: by how much the pelvis was lowered over the feet.
        shifted_mm: by how much it was moved sideways over the feet at most.
        joint_deg: by how much the angle of a leg's joint was changed at most.
        joint: which one.
    """

    motion: Motion
    moved_mm: float
    turned_deg: float
    lowered_mm: float
    shifted_mm: float
    joint_deg: float
    joint: str

    def __str__(self) -> str:
        """What was changed, in one line."""
        return (
            f"to stand: feet moved by up to {self.moved_mm:.0f} mm and turned by up to "
            f"{self.turned_deg:.1f}°, pelvis lowered by {self.lowered_mm:.0f} mm and shifted by "
            f"up to {self.shifted_mm:.0f} mm, {self.joint} turned by up to {self.joint_deg:.1f}°"
        )


def stand(motion: Motion, robot: G1) -> Standing:
    """The motion with its feet planted but for when they are lifted.

    Args:
        motion: whose feet stay where they are, but for lifting one at a time.
        robot: the G1.

    Raises:
        MotionError: it cannot be played on the feet; the frames are named.
        RobotError: the soles of this robot are not known.
    """
    soles = Soles(robot)
    poses = forward_kinematics(robot, motion.joint_pos, motion.root_pos, motion.root_quat_wxyz)
    feet, turns = poses.pos[:, soles.links], poses.quat_wxyz[:, soles.links]
    lifted = _find_lifted(motion, feet, soles.positions(poses))
    both = ~lifted.any(axis=1)
    heading = yaw_of(turns[both])
    mean = np.arctan2(np.sin(heading).mean(axis=0), np.cos(heading).mean(axis=0))
    flat = quat_from_rpy(np.stack([0.0 * mean, 0.0 * mean, mean], axis=-1))
    turned = 2.0 * np.arccos(np.abs(quat_mul(quat_conj(flat), turns)[..., 0]).clip(0.0, 1.0))
    middle = feet.mean(axis=1, keepdims=True)
    apart = (feet - middle)[both]
    planted = middle[both][0] + apart.mean(axis=0)
    planted[:, 2] = -soles.corners[..., 2].min()
    # The pelvis is over the feet that stand as it was.
    away = np.stack([_leaving(one, motion.fps) for one in lifted.T], axis=1)[..., np.newaxis]
    stands = 1.0 - away
    root = motion.root_pos + (stands * (planted - feet)).sum(axis=1) / stands.sum(axis=1)
    off = (feet - feet[:, ::-1]) - (planted - planted[::-1])
    legs = _Legs(robot, soles, planted + away * off, flat)
    flying = legs.touches.sum(axis=1) == 0
    if flying.any():
        raise _refused(motion, "both feet are lifted", flying)
    lowered, joint_pos = legs.lowered(motion, root)
    while True:
        low = root - [0.0, 0.0, lowered]
        try:
            shifted = _balanced(replace(motion, joint_pos=joint_pos, root_pos=low), robot, legs)
            break
        except _OutOfReachError as error:
            lowered += 2.0 * _STEP
            if lowered > _LOWEST:
                raise error.refusal from None
            joint_pos, _ = legs.reach(joint_pos, root - [0.0, 0.0, lowered], motion.root_quat_wxyz)
    change = np.abs(shifted.joint_pos - motion.joint_pos)
    joint = int(change.max(axis=0).argmax())
    return Standing(
        shifted,
        moved_mm=1e3 * float(np.linalg.norm(apart - apart.mean(axis=0), axis=-1).max()),
        turned_deg=float(np.degrees(turned.max())),
        lowered_mm=1e3 * lowered,
        shifted_mm=1e3 * float(np.linalg.norm((shifted.root_pos - low)[:, :2], axis=-1).max()),
        joint_deg=float(np.degrees(change.max())),
        joint=JOINT_NAMES[joint],
    )


def on_standing_legs(motion: Motion, robot: G1, played: NDArray[np.bool_]) -> Motion:
    """The motion of some joints of an upright robot, whose legs stand with bent knees.

    Args:
        motion: its pelvis is not used.
        robot: the G1.
        played: (29,) the joints that play it; waist and arms that do not are at 0.
    """
    pose = bent_legs(_STANCE)
    upright = np.tile([1.0, 0.0, 0.0, 0.0], (motion.n_frames, 1))
    soles = Soles(robot)
    still = np.zeros((1, 3))
    poses = forward_kinematics(robot, pose[np.newaxis], still, upright[:1])
    root = np.tile([0.0, 0.0, -soles.positions(poses)[..., 2].min()], (motion.n_frames, 1))
    return replace(
        motion,
        joint_pos=np.where(played, motion.joint_pos, pose),
        root_pos=root,
        root_quat_wxyz=upright,
    )


def _find_lifted(motion: Motion, feet: Floats, corners: Floats) -> NDArray[np.bool_]:
    """Which foot is lifted (T, 2); never both.

    The floor is where the lower foot is, because retargeted feet float and sink.

    Raises:
        MotionError: a foot steps, or is lifted where the motion begins or ends.
    """
    lowest = corners[..., 2].reshape(-1, 2, 4).min(axis=2)
    above = lowest - lowest.min(axis=1, keepdims=True)
    lifted = np.zeros(above.shape, np.bool_)
    for foot in range(len(SIDES)):
        for first, stop in _stretches(above[:, foot] > _LIFTED[1]):
            lifted[first:stop, foot] = above[first:stop, foot].max() > _LIFTED[0]
    both = ~(lifted[:, 0] | lifted[:, 1])
    mostly = np.median(feet[both] if both.any() else feet, axis=0)
    moved = np.linalg.norm((feet - mostly)[..., :2], axis=-1)
    for foot, side in enumerate(SIDES):
        steps = (moved[:, foot] > _STEPS) & ~lifted[:, foot]
        if steps.any():
            raise _refused(motion, f"the {side} foot steps", steps)
    ends = np.isin(np.arange(len(both)), (0, len(both) - 1)) & ~both
    if ends.any():
        raise _refused(motion, "a foot is lifted at the beginning or the end,", ends)
    return lifted


def _leaving(lifted: NDArray[np.bool_], fps: float) -> Floats:
    """How far a foot follows the motion instead of standing (T,): 1 while it is lifted, or 0."""
    from scipy.ndimage import distance_transform_edt

    if not lifted.any():
        return np.zeros(len(lifted))
    frames: Floats = distance_transform_edt(~lifted)  # to the nearest one in which it is
    away: Floats = 1.0 - minimum_jerk(frames / (fps * _LEAVES))[0]
    return away


def _stretches(where: NDArray[np.bool_]) -> NDArray[np.intp]:
    """First frame and the one after the last of each stretch, (N, 2)."""
    edges: NDArray[np.intp] = np.flatnonzero(np.diff(where, prepend=False, append=False))
    return edges.reshape(-1, 2)


class _OutOfReachError(Exception):
    """The legs are too short for where the pelvis is."""

    def __init__(self, refusal: MotionError) -> None:
        self.refusal = refusal


def _refused(motion: Motion, why: str, where: NDArray[np.bool_]) -> MotionError:
    edges = _stretches(where)
    named = ", ".join(f"{first} to {stop - 1}" for first, stop in edges[:_NAMED])
    more = f" and {len(edges) - _NAMED} more stretches" if len(edges) > _NAMED else ""
    return MotionError(
        f"{motion.name} cannot be played on its feet: {why} in frames {named}{more}.",
        "Play a part in which the feet can stand (--start, --duration), or hold the robot and give "
        "--support hanging.",
    )


class _Legs:
    """The joints of the legs for given feet: (T, 2, 3) m, and (2, 4) how they are turned."""

    def __init__(self, robot: G1, soles: Soles, feet: Floats, turns: Floats) -> None:
        self._robot, self._soles = robot, soles
        self._feet, self._turns = feet, turns
        self._joints = [list(JOINT_GROUPS[f"{side}_leg"]) for side in SIDES]
        self._links = [
            [int(np.flatnonzero(robot.joint_of_link == joint)[0]) for joint in joints]
            for joints in self._joints
        ]
        self._knees = [JOINT_NAMES.index(f"{side}_knee_joint") for side in SIDES]
        corners = quat_rotate(turns[:, np.newaxis], soles.corners) + feet[:, :, np.newaxis]
        self.corners: Floats = corners.reshape(-1, 8, 3)
        floor = -soles.corners[..., 2].min()
        self.touches = np.repeat(feet[..., 2] < floor + OFF_FLOOR, 4, axis=1)

    def lowered(self, motion: Motion, root: Floats) -> tuple[float, Floats]:
        """By how much the pelvis has to be lowered, m, and the joints (T, 29) then.

        Raises:
            MotionError: the legs do not reach the floor.
        """
        # From a stretched knee the search could bend it the wrong way.
        lowered, joint_pos = 0.0, motion.joint_pos.copy()
        for hip, _, _, knee, ankle, _ in self._joints:
            bend = np.maximum(0.0, _BENT - joint_pos[:, knee])
            joint_pos[:, knee] += bend
            joint_pos[:, [hip, ankle]] -= 0.5 * bend[:, np.newaxis]
        while True:
            pos = root - [0.0, 0.0, lowered]
            joint_pos, error = self.reach(joint_pos, pos, motion.root_quat_wxyz)
            short = (joint_pos[:, self._knees].min(axis=1) < _KNEE) | (error > _EXACT)
            if not short.any():
                return lowered, joint_pos
            if lowered >= _LOWEST:
                raise _refused(motion, "the legs do not reach the floor", short)
            lowered += _STEP

    def reach(
        self, joint_pos: Floats, root_pos: Floats, root_quat: Floats
    ) -> tuple[Floats, Floats]:
        """Joints (T, 29) with the feet in place, and the errors that remain (T,), m or rad.

        Newton's method with damped steps, all frames at once.
        """
        q = joint_pos.copy()
        for _ in range(_ITERATIONS):
            poses = forward_kinematics(self._robot, q, root_pos, root_quat)
            worst = np.zeros(len(q))
            for foot, (joints, links) in enumerate(zip(self._joints, self._links, strict=True)):
                link = self._soles.links[foot]
                turn = quat_mul(self._turns[foot], quat_conj(poses.quat_wxyz[:, link]))
                turn *= np.sign(turn[:, :1])
                off = np.concatenate(
                    [self._feet[:, foot] - poses.pos[:, link], 2.0 * turn[:, 1:]], axis=1
                )
                worst = np.maximum(worst, np.abs(off).max(axis=1))
                axes = quat_rotate(poses.quat_wxyz[:, links], self._robot.axis[links])
                lever = poses.pos[:, link, np.newaxis] - poses.pos[:, links]
                rows = np.concatenate([np.cross(axes, lever), axes], axis=2)  # J^T
                square = rows.transpose(0, 2, 1) @ rows + _DAMPING * np.eye(6)
                step = (rows @ np.linalg.solve(square, off[:, :, np.newaxis]))[:, :, 0]
                q[:, joints] += np.clip(step, -_LARGEST_TURN, _LARGEST_TURN)
            if worst.max() < _EXACT:
                break
        return q, worst


def _balanced(motion: Motion, robot: G1, legs: _Legs) -> Motion:
    """The motion with its pelvis moved so that the centre of pressure is inside the soles.

    A shift s of the mass moves the centre of pressure by s - (h/g) s''. So a wanted shift of the
    centre of pressure gives s as the solution of a tridiagonal system: the mass begins to move
    before the centre of pressure has to.

    Raises:
        MotionError: it cannot be, because the motion is too fast.
        _OutOfReachError: the legs are too short for that.
    """
    from scipy.linalg import solveh_banded

    dynamics = InverseDynamics(robot)
    touches = legs.touches[..., np.newaxis]
    middle = (touches * legs.corners[..., :2]).sum(axis=1) / touches.sum(axis=1)
    for _ in range(_ATTEMPTS):
        points, height = _pressure(motion, dynamics)
        outside = beyond_support(points, legs.corners, legs.touches) + _MARGIN
        if outside.max() <= _NEAR:
            return motion
        inward = middle - points
        distance = np.linalg.norm(inward, axis=1, keepdims=True)
        wanted = np.maximum(outside, 0.0)[:, np.newaxis] * inward / np.maximum(distance, 1e-9)
        stiffness = height / GRAVITY * motion.fps**2
        bands = np.full((2, motion.n_frames), -stiffness)
        bands[1] = 1.0 + 2.0 * stiffness
        bands[1, [0, -1]] = 1.0 + stiffness
        root = motion.root_pos.copy()
        root[:, :2] += solveh_banded(bands, wanted)
        joint_pos, error = legs.reach(motion.joint_pos, root, motion.root_quat_wxyz)
        if error.max() > _EXACT:
            why = _refused(motion, "the legs do not reach the floor", error > _EXACT)
            raise _OutOfReachError(why)
        motion = replace(motion, joint_pos=joint_pos, root_pos=root)
    raise _refused(motion, "the centre of pressure leaves the soles", outside > _MARGIN)


def _pressure(motion: Motion, dynamics: InverseDynamics) -> tuple[Floats, float]:
    """The centre of pressure (T, 2), m, and about the height of the mass above it, m."""
    point = Trajectory(motion).sample_many(np.arange(motion.n_frames) / motion.fps)
    wrench = np.empty((motion.n_frames, 6))
    for k in range(motion.n_frames):
        base = BaseMotion(
            point.root_quat_wxyz[k],
            point.root_ang_vel[k],
            point.root_lin_acc[k],
            point.root_ang_acc[k],
        )
        joints = point.joint_pos[k], point.joint_vel[k], point.joint_acc[k]
        wrench[k] = dynamics.solve("follow", *joints, base).wrench
    force = wrench[:, :3]
    moment = quat_rotate(point.root_quat_wxyz, wrench[:, 3:]) + np.cross(point.root_pos, force)
    return zero_moment_point(force, moment), float(point.root_pos[:, 2].mean())
