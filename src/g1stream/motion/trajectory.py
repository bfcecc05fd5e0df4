"""A motion as a smooth function of time."""

from __future__ import annotations

from copy import copy
from typing import TYPE_CHECKING

from g1stream.motion.spline import Spline

if TYPE_CHECKING:
    from g1stream.motion.motion import Motion

__all__ = ["Trajectory"]


class Trajectory(Spline):
    """A motion that can be sampled at any time, in seconds from frame 0.

    Before the first frame and after the last it rests. With `loop` it repeats without end: a seam
    leads from the last frame back to frame 0.

    Args:
        motion: the motion to interpolate.
        loop: whether to repeat it.

    Attributes:
        motion: as given.
        duration: s, from frame 0 to the last frame.
        period: s, from frame 0 to the next frame 0 of a loop.
    """

    def __init__(self, motion: Motion, *, loop: bool = False) -> None:
        frames = motion.joint_pos, motion.root_pos, motion.root_quat_wxyz
        super().__init__(motion.fps, *frames, loop=loop)
        self.motion = motion

    def moved(self, motion: Motion) -> Trajectory:
        """The trajectory, without loop, of a motion with other joints and root positions."""
        if self.loop:
            return Trajectory(motion)
        other = copy(self)
        other.motion = motion
        other._refit(motion.joint_pos, motion.root_pos)
        return other
