"""A motion changed for a robot on its feet: the feet stand still, or step.

In recorded motions the feet slide by millimetres even while standing, sink into the floor and turn,
and the centre of pressure may be outside of the soles. Here the feet are put flat on the floor
(`footing`), the pelvis is moved sideways until the centre of pressure is inside the standing soles,
and the leg joints follow from both (`legs`). docs/feet.md describes the method.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from g1stream.errors import ConfigError
from g1stream.extras.physics.batch_dynamics import BatchInverseDynamics
from g1stream.extras.physics.footing import CannotStandError, find_footing
from g1stream.extras.physics.ground import (
    TRUSTED_FRICTION,
    Flags,
    beyond_support,
    zero_moment_point,
)
from g1stream.extras.physics.legs import Legs, LegsTooShortError
from g1stream.motion.limits import POSITION_TOLERANCE
from g1stream.motion.motion import Motion
from g1stream.motion.trajectory import Trajectory
from g1stream.robot.dynamics import GRAVITY
from g1stream.robot.joints import JOINT_NAMES, LEGS
from g1stream.robot.kinematics import BLOCK, LinkPoses, forward_kinematics
from g1stream.robot.model import G1
from g1stream.robot.soles import Soles, bent_legs
from g1stream.types import Floats

__all__ = ["Standing", "on_standing_legs", "stand", "stand_part"]

#: Time for which the robot stands still before and after a part, s, because frames that are not
#: played do not define where the feet stand.
_STILL: Final = 0.5
#: Step of lowering the pelvis, and its maximum, m.
_LOWERED_BY, _LOWEST = 0.005, 0.15
#: Distance of the centre of pressure from the edge of the support polygon, m.
_MARGIN: Final = 0.02
#: The wrench of the floor is averaged with this standard deviation, s.
_AVERAGED: Final = 0.05
#: Largest error of the centre of pressure, m, and the most iterations.
_NEAR: Final = 0.002
_ATTEMPTS: Final = 16
#: A pelvis shift with a larger acceleration slips, m/s².
_SLIPS: Final = TRUSTED_FRICTION * GRAVITY
#: Frames with a smaller shift of the pelvis are not changed, m.
_MOVED: Final = 1e-7
#: Bend of hips and ankles of legs that do not play the motion, rad.
_STANCE: Final = 0.35


@dataclass(frozen=True)
class Standing:
    """A motion that can be played on the feet, and its changes.

    Attributes:
        motion: the changed motion, with flat feet on a floor at height 0 unless they are lifted.
        upper_body: the legs only stand, because only waist and arms play the motion.
        levelled_mm: largest distance of the lower foot from the floor, its usual height.
        moved_mm: largest shift of a standing foot, relative to the point between both feet.
        turned_deg: largest rotation of a foot.
        lowered_mm: by how much the pelvis was lowered over the feet.
        shifted_mm: largest sideways shift of the pelvis over the feet.
        joint_deg: largest change of a leg joint's angle.
        joint: name of that joint.
    """

    motion: Motion = field(repr=False)
    upper_body: bool
    levelled_mm: float
    moved_mm: float
    turned_deg: float
    lowered_mm: float
    shifted_mm: float
    joint_deg: float
    joint: str

    def __str__(self) -> str:
        sizes = (
            ("floor levelled by up to", f"{self.levelled_mm:.0f}", " mm"),
            ("feet moved by up to", f"{self.moved_mm:.0f}", " mm"),
            ("feet turned by up to", f"{self.turned_deg:.1f}", "°"),
            ("pelvis lowered by", f"{self.lowered_mm:.0f}", " mm"),
            ("pelvis shifted by up to", f"{self.shifted_mm:.0f}", " mm"),
            (f"{self.joint} turned by up to", f"{self.joint_deg:.1f}", "°"),
        )
        # Changes below a millimetre or a tenth of a degree are not listed.
        changes = [f"{what} {size}{unit}" for what, size, unit in sizes if float(size)]
        how = ["on legs that stand"] if self.upper_body else []
        how += [f"with changes to stand: {', '.join(changes)}"] if changes else []
        return ", ".join(how)


def stand(
    motion: Motion, robot: G1, played: Flags | None = None, trajectory: Trajectory | None = None
) -> Standing:
    """Change a motion so that a robot can play it on its feet, which stand or step.

    If the `played` (29,) joints do not include the legs, the legs stand (`on_standing_legs`). If
    they include both legs, other joints keep the initial pose.
    """
    if played is not None and 0 < np.count_nonzero(played[:LEGS]) < LEGS:
        raise ConfigError(
            "On its feet, a robot needs all joints of both legs, but only some of them play.",
            "Select arms, waist, both legs or all joints (stream.joints).",
        )
    upper_body = played is not None and not played[:LEGS].any()
    if played is not None and not played[robot.present].all():
        trajectory = None
        if upper_body:
            motion = on_standing_legs(motion, robot, played)
        else:
            still = np.where(played, motion.joint_pos, motion.joint_pos[0])
            motion = replace(motion, joint_pos=still)
    soles = Soles(robot)
    footing = find_footing(motion, robot, soles)
    legs = Legs(robot, soles, footing.feet, footing.turns, motion.fps)
    root = motion.root_pos + footing.shift
    trajectory = trajectory or Trajectory(motion)
    bent, lowered = legs.bent(motion), 0.0
    while True:
        low = root - [0.0, 0.0, lowered]
        try:
            shifted = _balanced(legs.reach(bent, low), trajectory, robot, legs)
            break
        except LegsTooShortError:
            lowered += _LOWERED_BY
            if lowered > _LOWEST:
                raise
    _refuse_beyond_limits(shifted, robot)
    shift = (shifted.root_pos - low)[:, :2]
    _refuse_slipping(shifted, shift)
    change = np.abs(shifted.joint_pos - motion.joint_pos)
    joint = int(change.max(axis=0).argmax())
    return Standing(
        motion=shifted,
        upper_body=upper_body,
        levelled_mm=1e3 * footing.levelled,
        moved_mm=1e3 * footing.moved,
        turned_deg=float(np.degrees(footing.turned)),
        lowered_mm=1e3 * lowered,
        shifted_mm=1e3 * float(np.linalg.norm(shift, axis=-1).max()),
        joint_deg=float(np.degrees(change.max())),
        joint=JOINT_NAMES[joint],
    )


def stand_part(
    motion: Motion,
    robot: G1,
    frames: range,
    played: Flags | None = None,
    trajectory: Trajectory | None = None,
) -> Standing:
    """Some frames of a motion, changed by `stand`; the robot stands still before and after them.

    The changed motion keeps its length, and errors have its frame numbers.
    """
    if len(frames) == motion.n_frames:
        return stand(motion, robot, played, trajectory)
    still, everywhere = max(1, round(_STILL * motion.fps)), np.arange(motion.n_frames)
    around = everywhere[max(0, frames.start - still) : frames.stop + still]
    shown = around.clip(frames[0], frames[-1])
    try:
        standing = stand(motion.at_frames(shown), robot, played)
    except CannotStandError as error:
        forbidden = np.zeros(motion.n_frames, np.bool_)
        forbidden[shown[error.frames]] = True
        raise CannotStandError(motion, error.what, forbidden, slower=error.slower) from None
    rows = everywhere.clip(around[0], around[-1]) - around[0]
    return replace(standing, motion=standing.motion.at_frames(rows))


def on_standing_legs(motion: Motion, robot: G1, played: Flags) -> Motion:
    """The motion of the `played` (29,) joints on standing legs; other joints are at 0."""
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


def _refuse_beyond_limits(motion: Motion, robot: G1) -> None:
    """Raise CannotStandError if a leg joint is beyond its limit, which would tilt the sole."""
    pos = motion.joint_pos[:, :LEGS]
    lower, upper = robot.lower[:LEGS], robot.upper[:LEGS]
    beyond = np.maximum(lower - pos, pos - upper)
    joint = int(beyond.max(axis=0).argmax())
    if (where := beyond[:, joint] > POSITION_TOLERANCE).any():
        raise CannotStandError(motion, f"{JOINT_NAMES[joint]} gets beyond its limit", where)


def _refuse_slipping(motion: Motion, shift: Floats) -> None:
    """Raise CannotStandError if the pelvis's shift (T, 2) needs more than the friction."""
    acc = np.zeros(len(shift))
    acc[1:-1] = np.linalg.norm(np.diff(shift, 2, axis=0), axis=-1) * motion.fps**2
    if (slips := acc > _SLIPS).any():
        raise CannotStandError(
            motion, "the feet slip when they keep the mass over them,", slips, slower=True
        )


def _balanced(motion: Motion, trajectory: Trajectory, robot: G1, legs: Legs) -> Motion:
    """The motion with its pelvis moved so that the centre of pressure is inside the soles.

    A shift s of the mass, assumed to be at the pelvis's height h, moves the centre of pressure by
    s - (h/g) s''. A desired shift of the centre of pressure therefore gives s as the solution of a
    tridiagonal system, in which the mass begins to move before the centre of pressure does.
    `trajectory` has the pelvis's attitude.
    """
    from scipy.linalg import solveh_banded

    dynamics = BatchInverseDynamics.of(robot)
    moved, wrench = np.ones(motion.n_frames, np.bool_), np.empty((motion.n_frames, 6))
    carries = legs.carries[..., np.newaxis]
    middle = (carries * legs.corners[..., :2]).sum(axis=1) / carries.sum(axis=1)
    lag = float(motion.root_pos[:, 2].mean()) / GRAVITY * motion.fps**2  # h/g, in frames²
    bands = np.full((2, motion.n_frames), -lag)
    bands[1] = 1.0 + 2.0 * lag
    bands[1, [0, -1]] = 1.0 + lag
    for attempt in range(_ATTEMPTS):
        _update_wrench(wrench, moved, trajectory.moved(motion), robot, dynamics)
        points, outside = _pressure(wrench, motion.fps, legs)
        if outside.max() <= _NEAR:
            return motion
        if (pulls := outside == np.inf).any():
            raise CannotStandError(
                motion, "the floor would have to pull at the feet", pulls, slower=True
            )
        if attempt == _ATTEMPTS - 1:
            break
        inward = middle - points
        distance = np.linalg.norm(inward, axis=1, keepdims=True)
        missing = np.maximum(outside + _NEAR, 0.0)[:, np.newaxis]
        wanted = missing * inward / np.maximum(distance, 1e-9)
        root = motion.root_pos.copy()
        shift = solveh_banded(bands, wanted)
        moved = np.abs(shift).max(axis=1) > _MOVED
        root[moved, :2] += shift[moved]
        motion = legs.reach(motion, root, moved)
    inside = round(1e3 * (_MARGIN - _NEAR))
    why = f"the centre of pressure cannot be kept {inside} mm inside the soles"
    raise CannotStandError(motion, why, outside > _NEAR, slower=True)


def _update_wrench(
    wrench: Floats, moved: Flags, trajectory: Trajectory, robot: G1, dynamics: BatchInverseDynamics
) -> None:
    """Update the force and the moment (T, 6) on the robot in frames that moved (T,)."""
    motion, frames = trajectory.motion, np.flatnonzero(moved)
    for first in range(0, len(frames), BLOCK):
        part = frames[first : first + BLOCK]
        pose = motion.joint_pos[part], motion.root_pos[part], motion.root_quat_wxyz[part]
        poses = forward_kinematics(robot, *pose)
        point = trajectory.sample_many(part / motion.fps)
        base = point.root_ang_vel, point.root_ang_acc, point.root_lin_acc
        load = dynamics.batch(poses, point.joint_vel, point.joint_acc).follow(*base)
        force, moment = load.force, load.moment
        # Torque limits bound the acceleration of the arms in a jump. A joint that the robot
        # lacks has a limit of 0.
        excess = (np.abs(load.tau) / np.maximum(robot.torque_limit, 1.0))[:, LEGS:].max(axis=1)
        if (jump := excess > 1.0).any():
            possible = point.joint_acc[jump]
            possible[:, LEGS:] /= excess[jump, np.newaxis]
            jumping = LinkPoses(*(values[jump] for values in poses))
            less = dynamics.batch(jumping, point.joint_vel[jump], possible)
            load = less.follow(*(values[jump] for values in base))
            force[jump], moment[jump] = load.force, load.moment
        wrench[part, :3], wrench[part, 3:] = force, moment + np.cross(point.root_pos, force)


def _pressure(wrench: Floats, fps: float, legs: Legs) -> tuple[Floats, Floats]:
    """The centre of pressure (T, 2), m, and its distance from where it must be (T,), m.

    It is that of the wrench (T, 6) or of its average, whichever is closer, because a jump of a
    frame or two, which retargeting leaves in the arms, is too short to tip the robot. The average
    lags where a foot is lifted or lands. The distance is infinite if the floor does not push.
    """
    from scipy.ndimage import gaussian_filter1d

    points = zero_moment_point(wrench[:, :3], wrench[:, 3:])
    outside = beyond_support(points, legs.corners, legs.carries) + _MARGIN
    outside[wrench[:, 2] <= 0.0] = np.inf
    far = outside > -_NEAR
    if far.any():
        averaged = gaussian_filter1d(wrench, _AVERAGED * fps, axis=0)[far]
        others = zero_moment_point(averaged[:, :3], averaged[:, 3:])
        beyond = beyond_support(others, legs.corners[far], legs.carries[far]) + _MARGIN
        beyond[averaged[:, 2] <= 0.0] = np.inf
        nearer = (beyond < outside[far])[:, np.newaxis]
        points[far] = np.where(nearer, others, points[far])
        outside[far] = np.minimum(outside[far], beyond)
    return points, outside
