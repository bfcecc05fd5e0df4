"""How a motion that was played is told, by the program that played it and from its recording.

Pure, and quick to import.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

__all__ = ["carried", "counted", "is_whole", "most", "played"]

#: Of many joints those with most are named.
_NAMED: Final = 3

#: Played to within this of what was left of the motion, s, it was played to its end: that is a tick
#: at the lowest rate, and the last digit of what is told.
_WHOLE: Final = 0.1


def is_whole(start: float, length: float, motion: float) -> bool:
    """Whether so much of a motion from `start` on is all of it, as far as is told; in s."""
    return abs(motion - start - length) < _WHOLE


def played(start: float, length: float, motion: float) -> str:
    """What was played of a motion, once, from `start` on; in s."""
    whence = f"from {start:.1f} s " if start else ""
    if is_whole(start, length, motion):
        return f"played {whence}to its end"
    return f"played {length:.1f} of {motion:.1f} s{whence and f', {whence}on'}"


def carried(kind: str, support: str | None, events: Sequence[Mapping[str, Any]]) -> str:
    """What commands carried beside the position, and when that changed.

    Args:
        kind: velocity, or dynamics, which is velocity and torque.
        support: how the robot was taken to be held, which matters to the torque alone.
        events: the changes, in order: motion_time in s, kind, reason; of a file, as far as known.
    """
    text = f"{kind} ({support})" if support and kind == "dynamics" else kind
    if not events:
        return text
    first, *more = events
    text += f" until {_when(first)} of the motion, then {_kind(first)}"
    text += f": {first['reason']}" if first.get("reason") else ""
    if more:
        text += (
            f"; {counted(len(more), 'change')} after that, the last at {_when(more[-1])} "
            f"to {_kind(more[-1])}"
        )
    return text


def _when(event: Mapping[str, Any]) -> str:
    seconds = event.get("motion_time")
    return "? s" if seconds is None else f"{seconds:.1f} s"


def _kind(event: Mapping[str, Any]) -> str:
    return str(event.get("kind") or "?")


def most(ticks: Mapping[str, int], n: int = _NAMED) -> str:
    """The first joints and their ticks, and how many others there are."""
    named = ", ".join(f"{joint} {count}" for joint, count in list(ticks.items())[:n])
    left = len(ticks) - n
    return f"{named} and {counted(left, 'more joint')}" if left > 0 else named


def counted(n: int, what: str) -> str:
    """`1 tick`, `2 ticks`."""
    return f"{n} {what}{'s' * (n != 1)}"
