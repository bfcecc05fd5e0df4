"""What a robot on its feet can play instead of a motion that it cannot, as records and as text."""

from __future__ import annotations

from math import ceil, floor
from typing import Final

from g1stream.session.records import Record

__all__ = ["UPPER_BODY", "Instead", "Part"]

UPPER_BODY: Final = "arms,waist"
"""The joints that almost any motion can be played with, on legs that stand."""


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
            ways.append(f"give --joints {UPPER_BODY}{part}")
        return "; or ".join(ways)
