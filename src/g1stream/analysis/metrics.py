"""The metrics of a session, from its samples; docs/metrics.md defines them."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from g1stream.analysis.body_space import body_metrics
from g1stream.analysis.frames import FPS, MEASURED_COLUMNS, REFERENCE_COLUMNS, frames
from g1stream.analysis.summary import played
from g1stream.analysis.timing import timing_metrics
from g1stream.analysis.torque import torque_metrics
from g1stream.analysis.tracking import NothingToCompareError, blocks, pooled, rms
from g1stream.errors import RobotError
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS
from g1stream.session.metrics import (
    JointMetrics,
    LimbMetrics,
    Metrics,
    SuccessMetrics,
    TrackingMetrics,
)
from g1stream.session.streams import Base, Command, Measured, Reference, TorsoImu
from g1stream.session.summary import TO_ITS_END
from g1stream.types import Floats

if TYPE_CHECKING:
    from collections.abc import Sequence

    from g1stream.analysis.delay import Delay
    from g1stream.analysis.frames import Frames
    from g1stream.analysis.tracking import Tracking
    from g1stream.session.metrics import BodyMetrics
    from g1stream.session.session import Session
    from g1stream.session.summary import Summary

__all__ = ["metrics"]

#: Supports with which the pelvis moves as the robot does, or as the motion does.
_MOVES: Final = {"follow", "free", "feet"}
#: A run fails where the links are further away than this on average, mm: PHC, H2O, OmniH2O, ASAP.
_MOST_LINK_ERROR: Final = 500.0
#: What ends an episode of BeyondMimic: errors of heights, mm, and of the direction of gravity.
_MOST_HEIGHT_ERROR: Final = 250.0
_MOST_GRAVITY_DIFFERENCE: Final = 0.8


def metrics(session: Session, joints: tuple[int, ...] | None = None) -> Metrics:
    """The metrics of a session, whatever it holds.

    Args:
        session: of one motion or none.
        joints: motor indices of those that count; all that played if None.

    Raises:
        RecordingError: the file is damaged.
    """
    _read(session)
    summary = session.summary()
    missing: dict[str, str] = {}
    tracking = None
    if played(summary.phases) > 1:
        missing["tracking"] = "Several motions were played, so that there is no one reference."
    else:
        try:
            tracking = session.tracking()
            tracking = tracking if joints is None else replace(tracking, joints=joints)
        except NothingToCompareError as error:
            missing["tracking"] = error.cause
    sampled = frames(session, tracking) if tracking else None
    body = torque = robot = None
    try:
        robot = session.robot
        body = body_metrics(robot, sampled, tracking.joints) if tracking and sampled else None
    except RobotError as error:
        missing["body"] = error.cause
    if not session.topics.get(Measured.topic):
        missing["torque"] = f"It has no messages on {Measured.topic}."
    elif robot is None:
        missing["torque"] = missing["body"]
    else:
        torque = torque_metrics(
            session,
            robot.torque_limit,
            tracking.states if tracking else None,
            tracking.joints if tracking else None,
        )
        if torque is None:
            missing["torque"] = "The robot reports no torques: all are 0 or not finite."
    if body is None and robot:
        missing["body"] = missing.get("tracking", "PLAY is too short.")
    return Metrics(
        success=_success(summary, tracking, body),
        tracking=tracking and _tracking_metrics(tracking, sampled),
        body=body,
        torque=torque,
        timing=timing_metrics(session, summary),
        missing=missing,
    )


def _read(session: Session) -> None:
    """Read the columns that are needed in one pass, and with another what is made of commands."""
    session.read(
        {
            Reference: REFERENCE_COLUMNS,
            Measured: (*MEASURED_COLUMNS, "tau"),
            Base: (),
            TorsoImu: ("publish_time",),
        }
    )
    # Before anything else takes memory: the commands take much until their torque is known.
    if session.topics.get(Command.topic) and session.topics.get(Measured.topic):
        session.commanded_torque()


def _tracking_metrics(tracking: Tracking, sampled: Frames | None) -> TrackingMetrics:
    # As precise as the positions were recorded, and joint by joint in memory.
    size = np.empty(tracking.reference.shape[::-1], np.float32)
    for part in blocks(len(tracking.time)):
        size[:, part] = np.abs(tracking.reference[part] - tracking.measured[part]).T
    columns: dict[str, Floats] = {
        "rmse_rad": tracking.rmse,
        "mae_rad": size.mean(axis=1, dtype=np.float64),
        "p99_rad": np.array([np.percentile(one, 99.0) for one in size]),
        "mean_rad": tracking.mean,
        "max_abs_rad": tracking.max_abs,
        "max_abs_at_s": tracking.max_abs_at,
    }
    velocity, acceleration = _velocity_errors(sampled) if sampled else (None, None)
    if velocity is not None:
        columns["velocity_rmse_rad_s"] = velocity
    if acceleration is not None:
        columns["acceleration_rmse_rad_s2"] = acceleration
    joints = {
        name: JointMetrics(
            **{key: float(values[i]) for key, values in columns.items()},
            **_delay(tracking.delays.of([i])),
        )
        for i, name in enumerate(JOINT_NAMES)
        if i in tracking.joints
    }

    def limb(members: Sequence[int], delay: Delay | None) -> LimbMetrics:
        of = {name: values[list(members)] for name, values in columns.items()}
        worst, largest = int(of["rmse_rad"].argmax()), int(of["max_abs_rad"].argmax())
        rates = {key: pooled(of[key]) for key in of if key.startswith(("velocity", "acceleration"))}
        return LimbMetrics(
            rmse_rad=pooled(of["rmse_rad"]),
            mae_rad=float(of["mae_rad"].mean()),
            p99_rad=float(np.percentile(size[list(members)], 99.0, overwrite_input=True)),
            max_abs_rad=float(of["max_abs_rad"][largest]),
            max_abs_at_s=float(of["max_abs_at_s"][largest]),
            worst_joint=JOINT_NAMES[members[worst]],
            bias_rad=pooled(of["mean_rad"]),
            **rates,
            **_delay(delay),
        )

    return TrackingMetrics(
        compared_states=len(tracking.time),
        excluded_states=tracking.excluded,
        compared_s=tracking.duration,
        all_joints=limb(tracking.joints, tracking.delay),
        limbs={
            name: limb(members, tracking.delays.of(members))
            for name, members in tracking.limbs.items()
        },
        joints=joints,
    )


def _delay(delay: Delay | None) -> dict[str, Any]:
    if delay is None:
        return {}
    return {
        "delay_s": delay.seconds,
        "delay_ci95_s": delay.ci95,
        "correlation": delay.correlation,
    }


def _velocity_errors(sampled: Frames) -> tuple[Floats | None, Floats | None]:
    """(29,) RMSE of joint velocities, rad/s, and of their change per frame, rad/s^2."""
    error = sampled.reference.dq - sampled.measured.dq
    if not sampled.measured.dq.any() or not np.isfinite(error).all():
        return None, None
    change = np.diff(error, axis=0)[sampled.consecutive] * FPS
    return rms(error), rms(change) if len(change) else None


def _success(
    summary: Summary, tracking: Tracking | None, body: BodyMetrics | None
) -> SuccessMetrics:
    completed, progress = _completed(summary, tracking)
    found = SuccessMetrics(completed=completed, progress=progress)
    if body is None:
        return found
    moves = summary.stream is not None and summary.stream.support in _MOVES
    if tracking and len(tracking.joints) + len(summary.absent) < N_JOINTS:
        moves = False  # the base is not the motion's, but that of whoever moves the legs
    links = "pelvis_frame"
    if moves and body.root_relative:
        links = "world" if body.world else "root_relative"
    followed = getattr(body, links).max_mm
    found.links, found.max_link_error_mm = links, followed
    if completed is None:
        return found
    found.success = completed and followed <= _MOST_LINK_ERROR
    if moves and (most := body.terminations):
        found.success_strict = (
            completed
            and max(most.max_pelvis_height_mm, most.max_end_effector_height_mm)
            <= _MOST_HEIGHT_ERROR
            and most.max_gravity_difference <= _MOST_GRAVITY_DIFFERENCE
        )
    return found


def _completed(summary: Summary, tracking: Tracking | None) -> tuple[bool | None, float | None]:
    """Whether what was asked was played, and which share of it."""
    ended = summary.termination
    reason = ended.guard or ended.undamped_in is not None or ended.reason
    completed = not reason if reason or ended.reason is not None else None
    if tracking is None or ended.motion_s is None:
        return completed, None
    asked = ended.motion_s - ended.start_s
    stop = (summary.settings or {}).get("stream.duration")
    if isinstance(stop, (int, float)):
        asked = min(asked, float(stop))
    if (summary.settings or {}).get("stream.loop") or asked <= 0.0:
        return completed, None
    done = float(tracking.motion_time[-1]) - ended.start_s
    if completed is None:  # nobody told, but the last frame of it was seen
        completed = done >= asked - TO_ITS_END or None
    return completed, min(1.0, max(0.0, done / asked)) if done < asked - TO_ITS_END else 1.0
