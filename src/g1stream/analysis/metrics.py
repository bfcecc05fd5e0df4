"""The metrics of a session, from its samples; docs/metrics.md defines each, with its formula.

Units are part of the names. None means unknown.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from pydantic import computed_field

from g1stream.analysis.body import (
    FPS,
    MEASURED_COLUMNS,
    REFERENCE_COLUMNS,
    ROOT_COLUMNS,
    BodyMetrics,
    body_metrics,
    frames,
)
from g1stream.analysis.summarise import SUMMARY_COLUMNS, percentiles, played, summarise
from g1stream.analysis.summary import TO_ITS_END, MessageStats, SuccessMetrics
from g1stream.analysis.torque import TorqueMetrics, torque_metrics
from g1stream.analysis.tracking import (
    NothingToCompareError,
    TrackingSummary,
    blocks,
    no_joints,
    pooled,
    rms,
    tracking,
)
from g1stream.errors import RobotError
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS
from g1stream.session.records import Int, Percentiles, Record
from g1stream.session.streams import (
    ArmCommandStream,
    BaseStream,
    CommandStream,
    MeasuredStream,
    ReferenceStream,
    without_steps,
)
from g1stream.types import Floats, Ints

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from g1stream.analysis.body import Frames
    from g1stream.analysis.summary import Summary
    from g1stream.analysis.tracking import ErrorStats, Tracking
    from g1stream.session.recording import Recording

__all__ = [
    "NAMED_METRICS",
    "Metrics",
    "TimingMetrics",
    "metrics",
    "timing_metrics",
]

NAMED_METRICS: Final = {
    "rmse": ("rad", "tracking.all_joints.rmse_rad"),
    "mae": ("rad", "tracking.all_joints.mae_rad"),
    "p99": ("rad", "tracking.all_joints.p99_rad"),
    "max": ("rad", "tracking.all_joints.max_abs_rad"),
    "bias": ("rad", "tracking.all_joints.bias_rad"),
    "delay": ("s", "tracking.all_joints.delay_s"),
    "velocity_rmse": ("rad/s", "tracking.all_joints.velocity_rmse_rad_s"),
    "mpjpe": ("mm", "body.pelvis_frame.mpjpe_mm"),
    "mpjpe_root": ("mm", "body.root_relative.mpjpe_mm"),
    "mpjpe_world": ("mm", "body.world.mpjpe_mm"),
    "e_vel": ("mm/frame", "body.world.vel_mm_per_frame"),
    "e_acc": ("mm/frame²", "body.world.acc_mm_per_frame2"),
    "torque_rms": ("N·m", "torque.rms_nm"),
    "torque_use": ("", "torque.use"),
    "saturated": ("", "torque.saturated"),
    "power": ("W", "torque.power_w"),
    "rate": ("Hz", "timing.rate_hz"),
    "lateness_p99": ("us", "timing.lateness_us.p99"),
    "state_age_p99": ("us", "timing.state_age_us.p99"),
    "delay_p99": ("s", "timing.state_to_command_p99_s"),
}
"""Metrics of a whole session by their names in conditions, with unit and place."""

#: A run fails if the mean distance of the links is larger, mm: PHC, H2O, OmniH2O, ASAP.
_MOST_LINK_ERROR: Final = 500.0
#: Termination of BeyondMimic's episodes: errors of heights, mm, and of the gravity direction.
_MOST_HEIGHT_ERROR: Final = 250.0
_MOST_GRAVITY_DIFFERENCE: Final = 0.8
#: An interval of more periods between two commands means that the stream skipped a tick.
_LEFT_OUT: Final = 1.5


class TimingMetrics(Record):
    """Timing of commands, states and messages, in the whole session.

    Attributes:
        rate_hz, nominal_rate_hz: LowCmds per second, achieved and nominal.
        interval_us: between the publish times of LowCmds.
        lateness_us: each write minus its deadline; None without data from the stream.
        lateness_histogram_us: lower edge of a 1 us bin -> ticks; None likewise.
        skipped_ticks: ticks that were a whole period late or more; None likewise.
        state_age_us: age of the newest LowState at each LowCmd, between the publish times.
        state_to_command_us: from the publish time of the LowState that a LowCmd was computed from
            to that LowCmd's; for another program's commands the same as `state_age_us`.
        topics: rate, gaps and wire latency of each DDS topic.
    """

    rate_hz: float | None = None
    nominal_rate_hz: float | None = None
    interval_us: Percentiles | None = None
    lateness_us: Percentiles | None = None
    lateness_histogram_us: dict[Int, Int] | None = None
    skipped_ticks: Int | None = None
    state_age_us: Percentiles | None = None
    state_to_command_us: Percentiles | None = None
    topics: dict[str, MessageStats]

    @computed_field  # type: ignore[prop-decorator]
    @property
    def state_to_command_p99_s(self) -> float | None:
        """The 99th percentile of `state_to_command_us`, s."""
        delays = self.state_to_command_us
        return None if delays is None else delays.p99 / 1e6


class Metrics(Record):
    """The results of a session.

    Attributes:
        success: whether the motion was played to its end and tracked.
        tracking: tracking error of the joints.
        body: tracking error of the links in space.
        torque: torque of the motors.
        timing: timing of commands, states and messages.
        missing: name of an attribute that is None -> the reason, a sentence.
    """

    success: SuccessMetrics
    tracking: TrackingSummary | None
    body: BodyMetrics | None
    torque: TorqueMetrics | None
    timing: TimingMetrics
    missing: dict[str, str]

    def named(self) -> dict[str, float | None]:
        """The `NAMED_METRICS` of this session; None for an unknown one."""
        return {name: self._at(path) for name, (_, path) in NAMED_METRICS.items()}

    def _at(self, path: str) -> float | None:
        found: Any = self
        for name in path.split("."):
            found = found and getattr(found, name)
        value: float | None = found
        return value


def metrics(session: Recording, joints: tuple[int, ...] | None = None) -> Metrics:
    """Compute the metrics of a session as far as its data allow.

    Args:
        session: session with one motion or none.
        joints: motor indices of the joints to use; all that played if None.

    Raises:
        RecordingError: the file is damaged.
    """
    more = {
        ReferenceStream: REFERENCE_COLUMNS,
        MeasuredStream: (*MEASURED_COLUMNS, "tau"),
        BaseStream: BaseStream.wire_fields(),
    }
    # In one pass, with the columns of the summary.
    session.read({kind: (*names, *more.get(kind, ())) for kind, names in SUMMARY_COLUMNS.items()})
    summary = summarise(session)
    missing: dict[str, str] = {}
    found = None
    if played(summary.phases) > 1:
        missing["tracking"] = "Several motions were played, so there is no single reference."
    else:
        try:
            found = tracking(session)
            found = found if joints is None else replace(found, joints=joints)
        except NothingToCompareError as error:
            missing["tracking"] = error.cause
    sampled = frames(session, found) if found else None
    if sampled:  # which holds what is needed of these
        session.reference.drop("dq", *ROOT_COLUMNS)
    body = torque = robot = None
    try:
        robot = session.robot
        if found and no_joints(session, found):
            missing["body"] = "With mode_pr 1 ankles and waist are motors, so no link is known."
        elif found and sampled:
            body = body_metrics(robot, sampled, found.joints)
    except RobotError as error:
        missing["body"] = error.cause
    if not session.topics.get(MeasuredStream.topic):
        missing["torque"] = f"The session has no messages on {MeasuredStream.topic}."
    elif robot is None:
        missing["torque"] = missing["body"]
    else:
        torque = torque_metrics(
            session,
            robot.torque_limit,
            found.states if found else None,
            found.joints if found else None,
        )
        if torque is None:
            missing["torque"] = "The robot reports no torques: all are 0 or not finite."
    if body is None and robot:
        missing["body"] = missing.get("tracking", "PLAY is too short.")
    return Metrics(
        success=_success(summary, found, body),
        tracking=found and _tracking(found, sampled),
        body=body,
        torque=torque,
        timing=timing_metrics(session, summary),
        missing=missing,
    )


def _tracking(tracking: Tracking, sampled: Frames | None) -> TrackingSummary:
    """All fields of `ErrorStats`, for all joints, limbs and each joint."""
    found = tracking.summary()
    # As precise as the positions were recorded, and joint by joint in memory.
    size = np.empty((N_JOINTS, len(tracking.time)), np.float32)
    for part in blocks(len(tracking.time)):
        asked, done = tracking.rows(part)
        size[:, part] = np.abs(asked - done).T
    mae = size.mean(axis=1, dtype=np.float64)
    velocity, acceleration = _velocity_errors(sampled) if sampled else (None, None)

    def fill(stats: ErrorStats, joints: Sequence[int]) -> None:
        chosen = list(joints)
        stats.mae_rad = float(mae[chosen].mean())
        stats.p99_rad = float(np.percentile(size[chosen], 99.0, overwrite_input=True))
        if velocity is not None:
            stats.velocity_rmse_rad_s = pooled(velocity[chosen])
        if acceleration is not None:
            stats.acceleration_rmse_rad_s2 = pooled(acceleration[chosen])
        if delay := tracking.delays.of(joints):
            stats.delay_s, stats.delay_ci95_s = delay.seconds, delay.ci95
            stats.correlation = delay.correlation

    fill(found.all_joints, tracking.joints)
    for limb, joints in tracking.limbs.items():
        fill(found.limbs[limb], joints)
    for joint in tracking.joints:
        fill(found.joints[JOINT_NAMES[joint]], [joint])
    return found


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
    spoilt = summary.spoilt_by_ms
    found = SuccessMetrics(completed=completed, progress=progress, spoilt_by_ms=spoilt)
    if body is None:
        return found
    moves = summary.moves
    if tracking and len(tracking.joints) + len(summary.absent) < N_JOINTS:
        moves = False  # another controller moves the legs, so the base is not the motion's
    links = "pelvis_frame"
    if moves and body.root_relative:
        links = "world" if body.world else "root_relative"
    followed = getattr(body, links).max_mm
    found.links, found.max_link_error_mm = links, followed
    if completed is None:
        return found

    def verdict(*, followed: bool) -> bool | None:
        return (completed and followed) or (None if spoilt else False)

    found.success = verdict(followed=followed <= _MOST_LINK_ERROR)
    if moves and (most := body.terminations):
        heights = max(most.max_anchor_height_mm, most.max_end_effector_height_mm)
        found.success_strict = verdict(
            followed=heights <= _MOST_HEIGHT_ERROR
            and most.max_gravity_difference <= _MOST_GRAVITY_DIFFERENCE
        )
        found.success_sonic = verdict(followed=most.sonic is None)
    return found


def _completed(summary: Summary, tracking: Tracking | None) -> tuple[bool | None, float | None]:
    """Whether the requested part was played, and the fraction of it."""
    ended = summary.termination
    reason = ended.guard or ended.undamped_in is not None or ended.reason
    completed = not reason if reason or ended.reason is not None else None
    if tracking is None or ended.motion_s is None:
        return completed, None
    asked = ended.motion_s - ended.start_s
    if summary.requested_s is not None:
        asked = min(asked, summary.requested_s)
    if (summary.settings or {}).get("stream.loop") or asked <= 0.0:
        return completed, None
    done = float(tracking.motion_time[-1]) - ended.start_s
    if completed is None:  # not in the summary, but its last frame was seen
        completed = done >= asked - TO_ITS_END or None
    return completed, min(1.0, max(0.0, done / asked)) if done < asked - TO_ITS_END else 1.0


def timing_metrics(session: Recording, summary: Summary) -> TimingMetrics:
    """The timing, from the summary and the publish times of our commands and of states."""
    # Beside commands for the arms, /lowcmd has those of the robot's own controller.
    ours = ArmCommandStream if session.topics.get(ArmCommandStream.topic) else CommandStream
    stream, command = summary.stream, summary.topics.get(ours.topic)
    late = None if summary.simulated else stream  # a simulation waits for the loop
    found = TimingMetrics(
        rate_hz=command and command.rate_hz,
        nominal_rate_hz=stream and stream.nominal_rate_hz,
        lateness_us=late and late.lateness_us,
        lateness_histogram_us=late and late.lateness_histogram_us,
        skipped_ticks=stream and stream.skipped_ticks,
        topics={t: stats for t, stats in summary.topics.items() if stats.gaps is not None},
    )
    if command is None or not command.rate_hz:
        return found
    commands = np.sort(session.stream(ours).published)
    found.interval_us = percentiles(np.diff(commands) / 1e3)
    if "/lowstate" in found.topics:
        order = np.argsort(session.measured.published, kind="stable")
        states = session.measured.published[order]
        # The file of a recorder that was killed or failed may lack states that commands have used.
        whole = session.closed and not (summary.recorder and summary.recorder.stopped)
        seen = (commands <= states[-1]) | whole
        newest = np.searchsorted(states, commands, side="right") - 1
        found.state_age_us = _ages(commands, states, newest, seen)
        found.state_to_command_us = found.state_age_us
        if session.topics.get(ReferenceStream.topic) and len(commands) > 1:
            logged = without_steps(session.measured.log_time, session.clock_steps)
            received = np.maximum.accumulate(logged[order])
            used = np.searchsorted(received, _prepared(commands), side="right") - 1
            used = np.minimum(used, newest[1:])
            found.state_to_command_us = _ages(commands[1:], states, used, seen[1:])
    return found


def _prepared(commands: Ints) -> Ints:
    """The time at which a stream took the LowState of each command but the first, ns.

    That is the time of the command before it. After skipped ticks it took the newest state.
    """
    intervals = np.diff(commands)
    late = intervals > _LEFT_OUT * np.median(intervals)
    return np.where(late, commands[1:], commands[:-1])


def _ages(
    commands: Ints, states: Ints, of: NDArray[np.intp], seen: NDArray[np.bool_]
) -> Percentiles | None:
    """Ages of the states `of` at the commands, us; an index of -1 is a command without a state."""
    known = (of >= 0) & seen
    return percentiles((commands[known] - states[of[known]]) / 1e3) if known.any() else None
