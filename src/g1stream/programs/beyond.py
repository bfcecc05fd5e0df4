"""What a motion asks for beyond the robot's limits, told before it is played."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from g1stream.motion.check import check_motion

if TYPE_CHECKING:
    from g1stream.config import Config
    from g1stream.motion.motion import Motion
    from g1stream.programs.outcome import Interval
    from g1stream.robot.model import G1

__all__ = ["beyond_limits"]

#: By so much a spline overshoots its frames between them, which is not worth a warning, rad.
_SLIGHT: Final = 0.02


def beyond_limits(motion: Motion, robot: G1, config: Config, interval: Interval) -> list[str]:
    """Warnings, a sentence each, of joints that are asked further or faster than they can.

    Args:
        motion: with the robot's joints.
        robot: whose limits.
        config: the rate of commands, and what is kept from the limits.
        interval: the part of the motion that is played.
    """
    part, first = _played(motion, interval)
    margin = config.safety.position_margin
    report = check_motion(part, robot, rate=config.stream.rate, position_margin=margin)
    begun = first / motion.fps
    warnings = []
    held = [one for one in report.held if abs(one.value - one.limit) > _SLIGHT]
    if held:
        worst = held[0]
        warnings.append(
            f"{motion.name} asks {worst.joint} for {worst.value:.2f} rad at "
            f"{begun + worst.time:.2f} s, and its limit is {worst.limit:.2f}"
            f"{_others(len(held) - 1)}. Commands are held at the limits."
        )
    if report.too_fast:
        fast = report.too_fast[0]
        warnings.append(
            f"{motion.name} asks {fast.joint} for {fast.value:.1f} rad/s at "
            f"{begun + fast.time:.2f} s, and its limit is {fast.limit:g}"
            f"{_others(len(report.too_fast) - 1)}. Joints follow as fast as their motors can."
        )
    return warnings


def _played(motion: Motion, interval: Interval) -> tuple[Motion, int]:
    """The frames between which a motion is played, and the number of the first."""
    if interval.loop:
        return motion, 0
    end = motion.duration if interval.length is None else interval.start + interval.length
    stop = min(motion.n_frames, math.ceil(end * motion.fps) + 1)
    first = max(0, min(math.floor(interval.start * motion.fps), stop - 2))
    return motion.frames(first, stop), first


def _others(n: int) -> str:
    return f"; {n} other joint{'s' * (n != 1)} beyond theirs" if n else ""
