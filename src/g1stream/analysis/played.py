"""What learning takes from a session, and whether it can be learned from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.control.state_checks import STALE
from g1stream.errors import RecordingError
from g1stream.input_limits import FRAMES
from g1stream.motion.correction import ATTACHMENT_NAME, GRID_STEP, Conditions, Correction
from g1stream.robot.joints import N_JOINTS
from g1stream.robot.model import G1
from g1stream.session.info import SessionInfo
from g1stream.session.records import read_record
from g1stream.session.stream_summary import StreamSummary

if TYPE_CHECKING:
    from pathlib import Path

    from g1stream.session.session import Session
    from g1stream.types import Floats

__all__ = ["SAME_INTERVAL", "Played", "read_played", "require_same"]

SAME_INTERVAL: Final = 0.1
"""Sessions that were played from and to within this, s, have played the same: a few LowStates."""

#: The torque may have been off for this long, s, such as after a late LowState.
_LONGEST_DROPOUT: Final = 0.5
#: A motion of which something can be learned, s: longer than the windows over which an error is
#: judged.
_SHORTEST: Final = 0.8


@dataclass(frozen=True, eq=False)
class Played:
    """A session that can be learned from.

    Attributes:
        conditions: what a correction that is learned from it holds for.
        path: its file.
        start: first motion time that was played, s.
        stop: the last one, s.
        time: (N,) motion time, s.
        error: (N, 29) rad, reference - measured.
        reference: (N, 29) rad.
        stalls: where states or commands were missing for a while, motion time in s.
        rmse: of all joints, rad.
        time_scale: simulated over real time.
        correction: that it was played with.
        lower: (29,) rad, limits of the joints.
        upper: (29,) rad.
    """

    conditions: Conditions
    path: Path
    start: float
    stop: float
    time: Floats
    error: Floats
    reference: Floats
    stalls: list[tuple[float, float]]
    rmse: float
    time_scale: float
    correction: Correction | None
    lower: Floats
    upper: Floats


def read_played(session: Session) -> Played:
    """A session with all that learning needs.

    Raises:
        RecordingError: it cannot be learned from; names why.
        ConfigError: the correction in it is damaged.
    """
    info, _ = read_record(SessionInfo, dict(session.metadata))
    stream, _ = read_record(StreamSummary, session.metadata.get("stream"))
    motion = info and info.motion
    if not (info and motion and motion.content_sha256 and info.gains and info.config and stream):
        raise _cannot(session, "it does not say what was streamed and how", "record it with")
    settings = info.config.get("stream")
    if not isinstance(settings, dict):
        raise _cannot(session, "its settings are damaged", "record it with")
    problems = {
        "it was ended early": stream.reason,
        "its motion was looped": settings.get("loop"),
        "only some joints were played": info.joints is not None and len(info.joints) < N_JOINTS,
        "its commands were recorded ones": stream.feedforward == "recorded",
        "its feed-forward was switched off while it played": _switched_off(stream),
        "its recording is not complete": not session.complete,
    }
    if reasons := [reason for reason, found in problems.items() if found]:
        raise _cannot(session, reasons[0], "repeat it, in one piece, with")
    data = session.attachments.get(ATTACHMENT_NAME)
    if info.correction and data is None:
        raise _cannot(
            session, "the correction that it was played with is missing", "repeat it with"
        )
    correction = None if data is None else Correction.from_bytes(data, session.path)
    robot = G1.from_urdf(
        session.attachments.get("robot.urdf", b"").decode(errors="replace"),
        f"robot.urdf of {session.path}",
    )
    kp, kd = (np.array(info.gains.get(name, ())) for name in ("kp", "kd"))
    rate = settings.get("rate")
    if not (kp.shape == kd.shape == (N_JOINTS,) and isinstance(rate, (int, float)) and rate > 0):
        raise _cannot(session, "its gains or its rate are damaged", "record it with")
    tracking = session.tracking()
    start, stop = tracking.motion_time[[0, -1]].tolist()
    elapsed = float(np.ptp(tracking.time))
    if not (0.0 <= stop - start < FRAMES * GRID_STEP and abs(elapsed - (stop - start)) < 1.0):
        raise _cannot(session, "its motion times do not fit its publish times", "repeat it with")
    if stop - start < _SHORTEST:
        raise _cannot(session, f"it has {stop - start:.2f} s of a motion", "record more of it with")
    return Played(
        Conditions(
            motion=motion.name or "",
            motion_sha256=motion.content_sha256,
            robot=robot.name,
            rate=float(rate),
            kp=kp,
            kd=kd,
            feedforward=stream.feedforward if stream.feedforward != "recorded" else None,
            support=stream.support,
        ),
        session.path,
        start,
        stop,
        tracking.motion_time,
        tracking.error,
        tracking.reference,
        _stalls(session, tracking.motion_time),
        tracking.overall,
        stream.time_scale or 1.0,
        correction,
        robot.lower,
        robot.upper,
    )


def _stalls(session: Session, states: Floats) -> list[tuple[float, float]]:
    """Where states, or commands, were missing for longer than `STALE`: begin and end, motion time.

    In s. The torque fades out then.
    """
    commands = session.sel("PLAY").reference.read("motion_time").motion_time
    return [
        (times[i], times[i + 1])
        for times in (states, commands)
        for i in np.flatnonzero(np.diff(times) > STALE)
    ]


def _switched_off(stream: StreamSummary) -> bool:
    """Whether the torque was off for longer than a moment."""
    off = 0.0
    for change in stream.feedforward_changes:
        off += change.motion_time_s if change.kind == "dynamics" else -change.motion_time_s
    return not 0.0 <= off <= _LONGEST_DROPOUT  # negative: never switched on again


def require_same(first: Played, other: Played) -> None:
    """RecordingError if two sessions are not repetitions of the same."""
    different = first.conditions.differences(other.conditions)
    if max(abs(first.start - other.start), abs(first.stop - other.stop)) > SAME_INTERVAL:
        different.append(
            f"played from {first.start:.2f} to {first.stop:.2f} s and from {other.start:.2f} to "
            f"{other.stop:.2f} s"
        )
    if different:
        raise RecordingError(
            f"{first.path} and {other.path} are not repetitions of the same: "
            f"{'; '.join(different)}.",
            "Learn from sessions of one motion, played in the same way.",
        )


def _cannot(session: Session, reason: str, remedy: str) -> RecordingError:
    return RecordingError(
        f"{session.path} cannot be learned from: {reason}.",
        f"{remedy.capitalize()} `g1stream stream MOTION --record FILE`.",
    )
