"""What a robot on its feet can play instead of what it cannot: slower, a part, or the arms."""

from __future__ import annotations

from math import ceil, floor
from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.extras.physics.footing import CannotStandError
from g1stream.extras.physics.ground import stretches
from g1stream.extras.physics.stance import stand_part
from g1stream.motion.limits import Interval
from g1stream.robot.joints import LEGS
from g1stream.session.records import Record

if TYPE_CHECKING:
    from g1stream.extras.physics.ground import Flags
    from g1stream.motion.motion import Motion
    from g1stream.robot.model import G1

__all__ = ["Instead", "Part", "find_instead", "longest_part"]

#: The joints that almost any motion can be played with, on legs that stand.
_UPPER_BODY: Final = "arms,waist"
#: No part is shorter, s. Frames this near to one that forbids a part are not in it, s.
_LEAST: Final = 1.0
_NEAR: Final = 0.1
#: Each try takes a check; a dance of two minutes needs 43.
_TRIES: Final = 60
#: A part in which no joint moves by more is not worth playing, rad.
_MOVES: Final = 0.05
#: Speeds that are tried where a motion is too fast.
_SPEEDS: Final = (0.7, 0.5, 0.25)


class Part(Record, frozen=True):
    """A part of a motion, in hundredths of a second.

    Attributes:
        start_s: where it begins.
        duration_s: how long it is.
    """

    start_s: float
    duration_s: float

    @classmethod
    def of_frames(cls, frames: range, fps: float) -> Part:
        """From the first of some frames to the last, and no more."""
        start, end = ceil(100.0 * frames[0] / fps), floor(100.0 * frames[-1] / fps)
        return cls(start_s=start / 100.0, duration_s=(end - start) / 100.0)

    def __str__(self) -> str:
        """As flags of `stream`."""
        return f"--start {self.start_s:g} --duration {self.duration_s:g}"


class Instead(Record, frozen=True):
    """What a robot on its feet can play instead of what it cannot; that it stands has been tried.

    Attributes:
        asked: what it cannot play.
        speed: times the speed, at which it can; None: at none that was tried, or a part was asked.
        part: the longest part that was found; None: none of a second.
        upper_body: what arms and waist can play on legs that stand; None: no part of a second, or
            the legs do not play.
    """

    asked: Part
    speed: float | None
    part: Part | None
    upper_body: Part | None

    def __str__(self) -> str:
        """As flags of `stream` and `motion`."""
        ways = [f"play it at {self.speed:g} times this speed (--speed)"] if self.speed else []
        ways += [f"give {self.part}, the longest part found"] if self.part else []
        if self.upper_body:
            part = "" if self.upper_body == self.asked else f" {self.upper_body}"
            ways.append(f"give --joints {_UPPER_BODY}{part}")
        return "; or ".join(ways)


def longest_part(
    motion: Motion, robot: G1, frames: range, forbidden: Flags, played: Flags | None = None
) -> Part | None:
    """The longest part that is found of those that can be played on the feet.

    Where a foot stands is an average over a part, so that a longer one may exist.

    Args:
        motion: of which to play a part.
        robot: the G1.
        frames: where to look for it.
        forbidden: (T,) the frames of the motion that forbid to play all of these.
        played: (29,) the joints that play it; all if None.

    Returns:
        The part; None if none of a second in which a joint moves was found.

    Raises:
        ConfigError: some joints of the legs play it, and others do not.
        RobotError: the soles of this robot are not known.
    """
    from scipy.ndimage import binary_dilation

    near = max(1, round(_NEAR * motion.fps))
    playing = motion.joint_pos if played is None else motion.joint_pos[:, played]
    forbidden = forbidden.copy()
    for _ in range(_TRIES):
        free = ~binary_dilation(forbidden, iterations=near)
        free[: frames.start] = free[frames.stop :] = False
        spans = [
            (stop - first, first)
            for first, stop in stretches(free).tolist()
            if stop - first > _LEAST * motion.fps
            and np.ptp(playing[first:stop], axis=0).max() > _MOVES
        ]
        if not spans:
            return None
        length, first = max(spans, key=lambda span: (span[0], -span[1]))
        part = Part.of_frames(range(first, first + length), motion.fps)
        tried = Interval(part.start_s, part.duration_s, motion.duration).frames(motion)
        try:
            stand_part(motion, robot, tried, played)
        except CannotStandError as error:
            forbidden |= error.frames
        else:
            return part
    return None


def find_instead(
    motion: Motion,
    robot: G1,
    frames: range,
    refused: CannotStandError,
    played: Flags | None = None,
) -> Instead:
    """Find what can be played on the feet instead of some frames of a motion.

    Args:
        motion: whose frames cannot.
        robot: the G1.
        frames: that cannot.
        refused: why.
        played: (29,) the joints that play it; all if None.

    Raises:
        RobotError: the soles of this robot are not known.
    """

    def refusal(one: Motion, played: Flags | None) -> CannotStandError | None:
        try:
            stand_part(one, robot, frames, played)
        except CannotStandError as error:
            return error
        return None

    # Of a part, the seconds would be others, too.
    speeds = _SPEEDS if refused.slower and len(frames) == motion.n_frames else ()
    asked = Part.of_frames(frames, motion.fps)
    upper_body = None
    if played is None or played[:LEGS].any():
        upper = robot.select(_UPPER_BODY)
        error = refusal(motion, upper)
        upper_body = longest_part(motion, robot, frames, error.frames, upper) if error else asked
    return Instead(
        asked=asked,
        speed=next((one for one in speeds if not refusal(motion.at_speed(one), played)), None),
        part=longest_part(motion, robot, frames, refused.frames, played),
        upper_body=upper_body,
    )
