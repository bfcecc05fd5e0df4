"""Places of the feet of a motion while they stand and while they move.

Each foot keeps its position and heading until it is lifted. Its next place, relative to the other
foot, is the average while both stand, until the next lift of either.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np

from g1stream.errors import MotionError
from g1stream.extras.physics.ground import Flags, stretches
from g1stream.motion.blend import minimum_jerk
from g1stream.motion.motion import Motion
from g1stream.robot.kinematics import pose_blocks
from g1stream.robot.model import G1
from g1stream.robot.rotations import quat_conj, quat_from_yaw, quat_mul, wrap_angle, yaw_of
from g1stream.robot.soles import SIDES, Soles
from g1stream.text import ranges
from g1stream.types import Floats

#: A foot is lifted if it is higher than the other by the first value. The lift begins and ends
#: where it is higher by the second value, m.
_LIFTED: Final = 0.03, 0.01
#: The robot is in the air if both feet are higher by this than the lower one usually is, m.
_HOPS: Final = 0.1
#: Time in which a lifted foot leaves its place, and reaches the next one, s.
_LEAVES: Final = 0.1
#: A standing foot slides if it is so far from its place, m, or turned from it, rad.
_SLIDES: Final = 0.1, 0.25
#: Number of ranges of frames in an error message.
_NAMED: Final = 3


class CannotStandError(MotionError):
    """A motion cannot be played on the robot's own feet because of `what` in `frames` (T,).

    `why` is both in words; `slower` means that playing it slower may help.
    """

    def __init__(self, motion: Motion, what: str, frames: Flags, *, slower: bool = False) -> None:
        spans = [(first, stop - 1) for first, stop in stretches(frames)]
        noun = "frames" if frames.sum() > 1 else "frame"
        self.why = f"{what} in {noun} {ranges(spans, _NAMED)}"
        self.what, self.frames, self.slower = what, frames, slower
        super().__init__(
            f"{motion.name} cannot be played on its feet: {self.why}.",
            "Play a part without these frames, or hold the robot.",
        )


class Footing(NamedTuple):
    """Places of the feet in T frames of a motion."""

    feet: Floats  # (T, 2, 3) m, world, the links of the feet
    turns: Floats  # (T, 2, 4) wxyz, foot to world; the feet are level
    shift: Floats  # (T, 3) m, mean shift of the standing feet
    moved: float  # m, largest shift of a standing foot, relative to the point between both feet
    turned: float  # rad, largest rotation of a foot
    levelled: float  # m, largest distance of the lower foot from its usual height


class _Lift(NamedTuple):
    """A lift of a foot, 0 or 1: the frames from `first` up to, but not including, `stop`."""

    first: int
    stop: int
    foot: int


def find_footing(motion: Motion, robot: G1, soles: Soles) -> Footing:
    """Find the places of the feet. A lifted foot follows the motion relative to the other."""
    of_feet = [
        (poses.pos[:, soles.links], poses.quat_wxyz[:, soles.links], soles.positions(poses))
        for _, poses in pose_blocks(
            robot, motion.joint_pos, motion.root_pos, motion.root_quat_wxyz, soles.links
        )
    ]
    feet, turns, corners = (np.concatenate(parts) for parts in zip(*of_feet, strict=True))
    lowest = corners[..., 2].reshape(-1, 2, 4).min(axis=2)
    floor = lowest.min(axis=1, keepdims=True)
    above = lowest - floor
    levelled = floor[:, 0] - np.median(floor)
    if (hops := levelled > _HOPS).any():
        raise CannotStandError(motion, "no foot is on the floor", hops)
    lifted = _find_lifted(above)
    both: Flags = np.asarray(~lifted.any(axis=1))
    lifts = _in_order(motion, lifted)
    headings = yaw_of(turns)
    middle = feet.mean(axis=1, keepdims=True)
    apart = feet - middle
    # From the middle of a lift, in which the foot follows the motion, to the middle of the next.
    begins = [0, *((lift.first + lift.stop) // 2 for lift in lifts), len(feet)]
    places, planted, moved = np.empty_like(feet), np.empty_like(headings), 0.0
    place, heading = np.empty((2, 3)), np.empty(2)
    for lift, (begin, end) in zip([None, *lifts], pairwise(begins), strict=True):
        now = slice(begin, end)
        stands = both[now]
        between, turn = apart[now][stands], _mean_angle(headings[now][stands])
        mean = between.mean(axis=0)
        mean[:, 2] = 0.0  # both stand on the floor
        if lift is None:
            place, heading = middle[0] + mean, turn
        else:
            foot, other = lift.foot, 1 - lift.foot
            place[foot] = place[other] + mean[foot] - mean[other]
            heading[foot] += wrap_angle(turn[foot] - heading[foot])
        place[:, 2] = soles.height
        places[now], planted[now] = place, heading
        moved = max(moved, float(np.linalg.norm(between - mean, axis=-1).max()))
        _refuse_sliding(motion, feet, headings, lifted, now)
    for first, stop, foot in lifts:
        before, after = planted[[first - 1, stop], foot]
        way = minimum_jerk(np.arange(1, stop - first + 1) / (stop - first + 1))[0]
        planted[first:stop, foot] = before + way * (after - before)
    level = quat_from_yaw(planted)
    away = np.stack([_leaving(one, motion.fps) for one in lifted.T], axis=1)[..., np.newaxis]
    stood = 1.0 - away
    off = (feet - feet[:, ::-1]) - (places - places[:, ::-1])
    off[..., 2] = above  # by its sole, because a foot on its toes has a raised link
    return Footing(
        places + away * off,
        level,
        (stood * (places - feet)).sum(axis=1) / stood.sum(axis=1),
        moved,
        float(2.0 * np.arccos(np.abs(quat_mul(quat_conj(level), turns)[..., 0]).clip(0, 1)).max()),
        float(np.abs(levelled).max()),
    )


def _find_lifted(above: Floats) -> Flags:
    """Which foot is lifted (T, 2), from its height above the other; never both.

    The lower foot defines the floor, because retargeted feet float and sink.
    """
    lifted = np.zeros(above.shape, np.bool_)
    for foot in range(len(SIDES)):
        for first, stop in stretches(above[:, foot] > _LIFTED[1]):
            lifted[first:stop, foot] = above[first:stop, foot].max() > _LIFTED[0]
    return lifted


def _in_order(motion: Motion, lifted: Flags) -> list[_Lift]:
    """The lifts of both feet in order. The robot must stand on both before and after each."""
    ends = np.zeros(len(lifted), np.bool_)
    for first, stop in stretches(np.asarray(lifted.any(axis=1))):
        ends[first:stop] = first == 0 or stop == len(lifted)
    if ends.any():
        raise CannotStandError(motion, "a foot is lifted at the beginning or the end,", ends)
    lifts = sorted(
        _Lift(first, stop, foot)
        for foot, one in enumerate(lifted.T)
        for first, stop in stretches(one).tolist()
    )
    hurried = np.zeros(len(lifted), np.bool_)
    for one, other in pairwise(lifts):
        if one.foot != other.foot and other.first - one.stop < _LEAVES * motion.fps:
            hurried[one.stop - 1 : other.first + 1] = True
    if hurried.any():
        raise CannotStandError(
            motion, f"both feet are lifted within {_LEAVES} s", hurried, slower=True
        )
    return lifts


def _refuse_sliding(
    motion: Motion, feet: Floats, headings: Floats, lifted: Flags, now: slice
) -> None:
    """Raise CannotStandError if a standing foot is far from its usual place `now`."""
    both = ~lifted[now].any(axis=1)
    mostly = np.median(feet[now][both], axis=0)
    away = np.linalg.norm((feet[now] - mostly)[..., :2], axis=-1)
    turned = np.abs(wrap_angle(headings[now] - _mean_angle(headings[now][both])))
    far = (away > _SLIDES[0]) | (turned > _SLIDES[1])
    for foot, side in enumerate(SIDES):
        slides = np.zeros(len(feet), np.bool_)
        slides[now] = far[:, foot] & ~lifted[now, foot]
        if slides.any():
            raise CannotStandError(motion, f"the {side} foot slides", slides)


def _leaving(lifted: Flags, fps: float) -> Floats:
    """How much a foot follows the motion instead of standing (T,): 1 while lifted, down to 0."""
    from scipy.ndimage import distance_transform_edt

    if not lifted.any():
        return np.zeros(len(lifted))
    frames: Floats = distance_transform_edt(~lifted)  # distance to the nearest lifted frame
    return 1.0 - minimum_jerk(frames / (fps * _LEAVES))[0]


def _mean_angle(angles: Floats) -> Floats:
    """The mean (2,) of angles (T, 2), rad."""
    mean: Floats = np.arctan2(np.sin(angles).mean(axis=0), np.cos(angles).mean(axis=0))
    return mean
