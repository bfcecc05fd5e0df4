"""How closely the robot of a session followed its reference."""

from __future__ import annotations

from typing import TYPE_CHECKING

from g1stream.analysis.metrics import compare, track
from g1stream.errors import RecordingError
from g1stream.session.streams import Measured, Reference

if TYPE_CHECKING:
    from g1stream.analysis.metrics import Comparison, Tracking
    from g1stream.session.session import Session

__all__ = ["comparison", "nothing_compared", "tracking"]


def tracking(session: Session) -> Tracking:
    """How closely the robot followed its reference while the motion was played (phase PLAY).

    At the stamp of each LowState the reference is interpolated between the two that were published
    before and after it. Nothing is shifted in time, so that coming late is an error, too;
    `delay` says how much of it that is.

    Args:
        session: with a reference and a measured state.

    Returns:
        `rmse`, `mean`, `max_abs` (29,) rad and `max_abs_at` (29,) s, joints in motor order;
        `overall`, one RMSE of all joints, rad; `rmse_by_limb`; `worst_joint`; `delay` with its
        `seconds`; and what they come from, at N instants: `error` (N, 29) rad, reference -
        measured, and `compared`, with `reference` and `measured` (N, 29) rad, `time` (N,) s since
        the first reference and `motion_time` (N,) s since the motion's first frame.

    Raises:
        RecordingError: there is nothing to compare, or the file is damaged.
    """
    compared = comparison(session)
    nothing = nothing_compared(session, compared)
    if compared is None or nothing:
        raise RecordingError(
            f"How well it was followed cannot be told from {session.path}: {nothing}.",
            "Record while a robot, or a simulator, publishes its state and a motion is streamed.",
        )
    return track(compared)


def comparison(session: Session) -> Comparison | None:
    """Reference and measurement at the same instants; None where one of them was not recorded.

    Raises:
        RecordingError: the file is damaged.
    """
    if _absent(session):
        return None
    return compare(session.reference.read("motion_time", "phase", "q"), session.measured.read("q"))


def nothing_compared(session: Session, compared: Comparison | None) -> str:
    """Why there is nothing to compare, as a part of a sentence; empty where there is."""
    if compared is None:
        return f"no messages on {' and '.join(_absent(session))}"
    return "" if len(compared.time) else "no state came while the motion was played"


def _absent(session: Session) -> list[str]:
    return [t for t in (Reference.topic, Measured.topic) if not session.topics.get(t)]
