"""Motions made of motions: a part, the mirror image, another speed, one after the other.

Each says in `Motion.operations` what was done. The methods of `Motion` call these functions.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.errors import MotionError
from g1stream.motion.blend import COAST, blend_frames
from g1stream.motion.trajectory import resample
from g1stream.robot.joints import N_JOINTS
from g1stream.robot.model import G1
from g1stream.robot.rotations import quat_from_yaw, quat_mul, quat_rotate, yaw_of
from g1stream.robot.soles import Soles
from g1stream.robot.symmetry import MIRROR, mirror_of_joints

if TYPE_CHECKING:
    from g1stream.motion.motion import Motion
    from g1stream.types import Floats

__all__ = [
    "at_speed",
    "fixed_root",
    "height_of_floor",
    "joined",
    "looped",
    "mirrored",
    "on_floor",
    "resampled",
    "trimmed",
]

#: A blend is no longer than this, s.
_LONGEST_BLEND: Final = 60.0
#: A motion that is repeated has no more frames: ten hours at 30 fps.
_MOST_FRAMES: Final = 1_000_000
#: A sole that is slower than this stands, m/s.
_STANDS: Final = 0.25
#: A mirrored turn: the vector part of a quaternion is a pseudovector.
_MIRROR_QUAT: Final = np.concatenate([[1.0], -MIRROR])


def resampled(motion: Motion, fps: float) -> Motion:
    """See `Motion.resample`."""
    points = [point for _, point in resample(motion, fps, 0, motion.n_frames)]
    return replace(
        motion,
        operations=(*motion.operations, f"resampled to {fps:g} fps"),
        fps=fps,
        joint_pos=np.concatenate([point.joint_pos for point in points]),
        root_pos=np.concatenate([point.root_pos for point in points]),
        root_quat_wxyz=np.concatenate([point.root_quat_wxyz for point in points]),
    )


def trimmed(motion: Motion, start: float, end: float | None) -> Motion:
    """See `Motion.trim`."""
    last = motion.duration if end is None else end
    margin = 0.5 / motion.fps
    if not (-margin < start and last < motion.duration + margin and last - start > margin):
        raise MotionError(
            f"{motion.name} has no part from {start:g} to {last:g} s; it takes "
            f"{motion.duration:.2f} s.",
            f"Give a start and an end from 0 to {motion.duration:.2f} s, two frames or more apart.",
        )
    first, behind = round(start * motion.fps), round(last * motion.fps) + 1
    part = motion.frames(max(first, 0), min(behind, motion.n_frames))
    done = f"trimmed to {start:g} to {last:g} s"
    return replace(part, operations=(*motion.operations, done))


def mirrored(motion: Motion) -> Motion:
    """See `Motion.mirrored`."""
    joint, sign = mirror_of_joints(G1.default())
    mirror = replace(
        motion,
        joint_pos=sign * motion.joint_pos[:, joint],
        root_pos=MIRROR * motion.root_pos,
        root_quat_wxyz=_MIRROR_QUAT * motion.root_quat_wxyz,
    )
    return _done(mirror, "mirrored")


def at_speed(motion: Motion, factor: float) -> Motion:
    """See `Motion.at_speed`."""
    if not (np.isfinite(factor) and factor > 0):
        raise MotionError(
            f"{motion.name} cannot be played at {factor:g} times its speed.",
            "Give a factor above 0, such as 0.5.",
        )
    return _done(replace(motion, fps=motion.fps * factor), f"at {factor:g} times its speed")


def fixed_root(motion: Motion) -> Motion:
    """See `Motion.fixed_root`."""
    fixed = replace(
        motion,
        root_pos=np.broadcast_to(motion.root_pos[0], motion.root_pos.shape),
        root_quat_wxyz=np.broadcast_to(motion.root_quat_wxyz[0], motion.root_quat_wxyz.shape),
    )
    return _done(fixed, "pelvis fixed as in the first frame")


def on_floor(motion: Motion, robot: G1) -> Motion:
    """See `Motion.on_floor`."""
    height = height_of_floor(motion, robot)
    if height is None:
        raise MotionError(
            f"{motion.name} cannot be put on the floor: no foot stands in it.",
            "Leave it where it is.",
        )
    lowered = replace(motion, root_pos=motion.root_pos - [0.0, 0.0, height])
    way = "raised" if height < 0 else "lowered"
    return _done(lowered, f"{way} by {abs(height) * 1e3:.1f} mm, onto the floor")


def height_of_floor(motion: Motion, robot: G1) -> float | None:
    """How high the floor is on which the feet of a motion stand, m; None where none stands.

    It is the median height of the lowest corner of both soles over the frames in which that corner
    is slower than 0.25 m/s: a foot that was retargeted slides a little.

    Raises:
        RobotError: the robot's soles are not known.
    """
    corners = Soles(robot).path(motion.joint_pos, motion.root_pos, motion.root_quat_wxyz)
    speed = np.linalg.norm(np.gradient(corners, axis=0), axis=-1) * motion.fps
    lowest = corners[..., 2].argmin(axis=1)[:, np.newaxis]
    slow = np.take_along_axis(speed, lowest, axis=1) < _STANDS
    heights = np.take_along_axis(corners[..., 2], lowest, axis=1)[slow]
    return float(np.median(heights)) if heights.size else None


def joined(motion: Motion, other: Motion, blend: float) -> Motion:
    """See `Motion.then`."""
    if not 0.0 <= blend <= _LONGEST_BLEND:
        raise MotionError(
            f"A blend of {blend:g} s is not possible.", f"Give 0 to {_LONGEST_BLEND:g} s."
        )
    about = f"then {other.name}"
    about += f" ({', '.join(other.operations)})" if other.operations else ""
    about += f" after a blend of {blend:g} s"
    fps = max(motion.fps, other.fps)
    first, second = (one if one.fps == fps else one.resample(fps) for one in (motion, other))
    n_steps = max(1, round(blend * fps))
    second = _continued(first, second, n_steps / fps)
    linear, quat = [_linear(first)], [first.root_quat_wxyz]
    if n_steps > 1:
        coasting = np.full(N_JOINTS + 3, COAST)
        coasting[N_JOINTS : N_JOINTS + 2] = n_steps / fps  # over the ground it keeps on going
        path, turned = blend_frames(
            (_linear(first)[-2:], _linear(second)[:2]),
            (first.root_quat_wxyz[-2:], second.root_quat_wxyz[:2]),
            fps,
            n_steps,
            coasting,
        )
        linear.append(path)
        quat.append(turned)
    joint_pos, root_pos = np.split(np.concatenate([*linear, _linear(second)]), [N_JOINTS], axis=1)
    both = replace(
        first,
        name=f"{motion.name}+{other.name}",
        operations=motion.operations,
        joint_pos=joint_pos,
        root_pos=root_pos,
        root_quat_wxyz=np.concatenate([*quat, second.root_quat_wxyz]),
        source=None,
        sha256=None,
        warnings=tuple(dict.fromkeys(motion.warnings + other.warnings)),
        parts=(*(motion.parts or (motion,)), *(other.parts or (other,))),
    )
    return _done(both, about)


def looped(motion: Motion, n: int, blend: float) -> Motion:
    """See `Motion.looped`."""
    if n < 1 or n * (motion.n_frames + blend * motion.fps) > _MOST_FRAMES:
        raise MotionError(
            f"{motion.name} cannot be repeated {n} times.",
            f"Give a number from 1 on with which it has {_MOST_FRAMES} frames at most.",
        )
    if n == 1:
        return motion
    # Each repetition is the same blend and motion again, from where the one before has led.
    twice = joined(motion, motion, blend)
    blended = twice.frames(motion.n_frames, twice.n_frames)
    first, last = motion.root_quat_wxyz[[0, -1]]
    angle = yaw_of(last) - yaw_of(first)
    led = quat_rotate(quat_from_yaw(angle), motion.root_pos[0])
    step = twice.root_pos[-motion.n_frames] - led
    turns = quat_from_yaw(angle * np.arange(n - 1))[:, np.newaxis]
    steps = quat_rotate(turns, step)
    pos = quat_rotate(turns, blended.root_pos) + np.cumsum(steps, axis=0) - steps
    quat = quat_mul(turns, blended.root_quat_wxyz)
    return replace(
        twice,
        name=motion.name,
        joint_pos=np.concatenate([motion.joint_pos, np.tile(blended.joint_pos, (n - 1, 1))]),
        root_pos=np.concatenate([motion.root_pos, pos.reshape(-1, 3)]),
        root_quat_wxyz=np.concatenate([motion.root_quat_wxyz, quat.reshape(-1, 4)]),
        source=motion.source,
        sha256=motion.sha256,
        parts=motion.parts,
        operations=(*motion.operations, f"{n} times with blends of {blend:g} s"),
    )


def _done(motion: Motion, what: str) -> Motion:
    return replace(motion, operations=(*motion.operations, what))


def _linear(motion: Motion) -> Floats:
    """(T, 32) joint angles, rad, and root position, m."""
    return np.concatenate([motion.joint_pos, motion.root_pos], axis=1)


def _continued(first: Motion, second: Motion, seconds: float) -> Motion:
    """The second motion moved and turned over the ground to where the first one leads.

    Its heading is that in which the first one ends. Its place is where the pelvis gets to within
    the time between them at the mean of its velocities on either side; where it rests on both
    sides, that is where the first one ends.
    """
    turn = yaw_of(first.root_quat_wxyz[-1]) - yaw_of(second.root_quat_wxyz[0])
    turned = quat_from_yaw(turn)
    path = quat_rotate(turned, second.root_pos - second.root_pos[0])
    last, before = first.root_pos[-1], first.root_pos[-2]
    travel = (last - before + path[1] - path[0]) / 2.0 * first.fps * seconds
    path[:, :2] += last[:2] + travel[:2]
    path[:, 2] = second.root_pos[:, 2]
    return replace(second, root_pos=path, root_quat_wxyz=quat_mul(turned, second.root_quat_wxyz))
