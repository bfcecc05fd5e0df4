"""How a session ended, and how much of its motion was played until then."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from g1stream.analysis.formatting import is_whole, played
from g1stream.types import Phase

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from g1stream.session.session import Session
    from g1stream.session.summary import PhaseInterval

__all__ = ["Ending", "ending", "part"]

#: A recording that goes on for so long, ns, after the last reference has not merely ended first.
_SILENCE: Final = 500_000_000


@dataclass(frozen=True)
class Ending:
    """How a session ended; None for what was not recorded.

    Attributes:
        reason: why the streamer ended early; empty when it ended as asked.
        vanished_in: the phase in which the streamer vanished, without having damped the robot;
            None where it did not.
        played: for how long PLAY lasted, s.
        motion: how long the motion lasts, s.
        start: where in the motion it was to begin, s.
    """

    reason: str | None
    vanished_in: Phase | None
    played: float | None
    motion: float | None
    start: float = 0.0

    def as_dict(self) -> dict[str, Any]:
        """The ending as JSON values."""
        return {
            "reason": self.reason,
            "vanished_in": self.vanished_in and self.vanished_in.name,
            "played_s": self.played,
            "motion_s": self.motion,
            "start_s": self.start,
        }

    def __str__(self) -> str:
        if self.vanished_in is not None:
            how = f"in {self.vanished_in.name}: the streamer vanished, without DAMP"
        elif self.reason is None:
            how = "not recorded"
        elif self.reason:
            how = f"early: {self.reason}"
        else:
            how = "at the motion's end" if self._whole else "as asked"
        return how + self._how_much()

    @property
    def _whole(self) -> bool:
        if self.played is None or self.motion is None:
            return True
        return is_whole(self.start, self.played, self.motion)

    def _how_much(self) -> str:
        if self.played is None or self.motion is None or (self._whole and not self.start):
            return ""
        if self.played > self.motion - self.start and not self._whole:
            return f"; played {self.played:.1f} s, the motion of {self.motion:.1f} s repeatedly"
        return f"; {played(self.start, self.played, self.motion)}"


def ending(session: Session, spans: Sequence[PhaseInterval]) -> Ending:
    """How a session ended.

    Args:
        session: whose last words count, and who was still heard after its last reference.
        spans: its phases.
    """
    told, motion = session.metadata.get("stream") or {}, part(session.metadata, "motion")
    frames, fps = motion.get("frames"), motion.get("fps")
    return Ending(
        reason=told.get("reason"),
        vanished_in=_vanished_in(session, spans),
        played=sum(s.duration_s for s in spans if s.phase is Phase.PLAY) if spans else None,
        motion=(frames - 1) / fps if frames and fps else None,
        start=part(part(session.metadata, "config"), "stream").get("start") or 0.0,
    )


def part(metadata: Mapping[str, Any], key: str) -> dict[str, Any]:
    """The values under a key; none where there is something else, as anybody's file may have."""
    values = metadata.get(key)
    return values if isinstance(values, dict) else {}


def _vanished_in(session: Session, spans: Sequence[PhaseInterval]) -> Phase | None:
    """The last phase, if the references stopped in it and not because the recording did."""
    if not spans or spans[-1].phase >= Phase.DAMP or session.metadata.get("stream"):
        return None
    recorder = session.metadata.get("recorder") or {}
    # A streamer's own recorder ends after it, and is told how it went.
    outlived = "config" in session.metadata and recorder and not recorder.get("stopped")
    end = max(int(stream.log_time[-1]) for stream in session.times.values())
    silence = end - int(session.reference.log_time[-1])
    return spans[-1].phase if outlived or silence > _SILENCE else None
