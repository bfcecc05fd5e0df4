"""Make the summary of a session, from its file or from the programs that recorded it."""

from __future__ import annotations

import socket
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from g1stream._version import __version__
from g1stream.analysis.summary import MessageStats, Summary, Termination, most
from g1stream.analysis.tracking import NothingToCompareError, parallel, tracking
from g1stream.config import Config
from g1stream.control.lowstate import LONGEST_INTERVAL
from g1stream.control.stop import REMEDIES
from g1stream.errors import RecordingError
from g1stream.events import GUARD
from g1stream.input_limits import NUMBER
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.rotations import is_unit
from g1stream.session.recording import once
from g1stream.session.records import (
    Percentiles,
    RecorderSummary,
    SessionInfo,
    StreamSummary,
    read_record,
)
from g1stream.session.streams import (
    STREAMS,
    ArmCommandStream,
    CommandStream,
    MeasuredStream,
    ReferenceStream,
    Stream,
    Warnings,
    without_steps,
)
from g1stream.text import counted
from g1stream.types import Floats, Phase

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from g1stream.analysis.tracking import TrackingSummary
    from g1stream.session.recording import Recording
    from g1stream.session.records import MotionInfo, ParametersInfo, PhaseInterval

__all__ = [
    "SUMMARY_COLUMNS",
    "find_problems",
    "flat",
    "message_stats",
    "percentiles",
    "played",
    "summarise",
    "summarise_run",
]

SUMMARY_COLUMNS: Final[Mapping[type[Stream], tuple[str, ...]]] = {
    **dict.fromkeys(STREAMS.values(), ("publish_time",)),
    ReferenceStream: ("motion_time", "phase", "played", "q"),
    CommandStream: ("mode_machine", "mode_pr"),
    MeasuredStream: ("q", "imu_quat_wxyz", "mode_machine", "mode_pr", "tick"),
}
"""The columns of a session that `summarise` reads."""

# A robot's motion visibly changes from these thresholds on; smaller values are only figures.
#: A publish interval of more than so many medians is a gap.
_GAP: Final = 3.0
#: Lateness of a command, s, and fraction of skipped commands.
_LONG_OVERRUN: Final = 0.02
_MOST_SKIPPED: Final = 0.01
#: Simulated time over real time. At 0.8 joints accelerate 1.6 times as hard as in the motion.
_SLOW_SIMULATOR: Final = 0.8
#: Time by which joints may seem to be ahead of their commands, s; feed-forward may overshoot.
_IMPOSSIBLE: Final = 0.005
#: RMSE of a joint that does not follow, rad. The profile robot stops at such an error.
_FAR: Final = 0.3
#: A stop or jump of the robot's time by this, s, changes the controller's task.
_STALL: Final = 0.04
#: A recording that goes on for this long after the last reference did not just end first, ns.
_SILENCE: Final = 500_000_000
#: Number of commands whose CRC is checked, evenly spaced in a longer session.
_MOST_CHECKED: Final = 5000


@once
def summarise(session: Recording) -> Summary:
    """The summary of a recorded session.

    Raises:
        RecordingError: the file is damaged.
    """
    with suppress(RecordingError):  # whoever uses a column says what is wrong with it
        session.read(SUMMARY_COLUMNS)  # in one pass
    info, problems = read_record(SessionInfo, session.metadata)
    info = info or SessionInfo()
    stream, wrong = read_record(StreamSummary, session.metadata.get("stream"), "stream")
    problems += wrong
    recorder, wrong = read_record(RecorderSummary, session.metadata.get("recorder"), "recorder")
    problems += wrong
    try:
        followed = tracking(session).summary()
    except NothingToCompareError:
        followed = None
    streams = {
        topic: samples
        for topic, kind in STREAMS.items()
        if session.topics.get(topic) and len(samples := session.stream(kind))
    }
    logged = [without_steps(one.log_time, session.clock_steps) for one in streams.values()]
    lost = recorder.lost if recorder else {}
    topics = {
        topic: message_stats(streams[topic], lost.get(topic))
        if topic in streams
        else MessageStats(count=n)
        for topic, n in sorted(session.topics.items())
        if n
    }
    simulated = (info.log_clock or "").startswith("simulated")
    if simulated:  # its latency is only a parameter of the rollout
        for stats in topics.values():
            stats.latency_us = None
    missing = {JOINT_NAMES.index(name) for name in info.absent if name in JOINT_NAMES}
    gains = [
        (name, [value for i, value in enumerate(values) if i not in missing])
        for name, values in (info.gains or {}).items()
    ]
    summary = Summary(
        joints=info.joints or (list(followed.joints) if followed else None),
        absent=info.absent,
        files_bytes={str(path): path.stat().st_size for path in session.paths},
        complete=session.complete,
        selected=bool(session.metadata.get("selected")),
        first_ns=min((int(one.min()) for one in logged), default=None),
        last_ns=max((int(one.max()) for one in logged), default=None),
        simulated=simulated,
        host=info.host,
        domain=info.domain,
        interface=info.interface,
        versions={**({"g1stream": info.g1stream} if info.g1stream else {}), **info.versions},
        motion=info.motion,
        attached=session.attached,
        log=info.log,
        params=info.params,
        settings=None if info.config is None else _changed_settings(info.config),
        gains={name: (min(values), max(values)) for name, values in gains if values} or None,
        phases=session.phases,
        termination=_termination(session, info, stream, recorder, streams),
        stream=stream,
        recorder=recorder,
        # An error over several motions would describe none of them.
        tracking=followed if played(session.phases) <= 1 else None,
        topics=topics,
        attachments_bytes={name: len(data) for name, data in session.attachments.items()},
    )
    if summary.moves and summary.tracking:
        summary.spoilt_by_ms = _longest_stall(session)
    summary.problems = [
        *find_problems(summary),
        *_file_problems(session),
        *_sample_problems(session),
        *_other_than_stop(Warnings(session.log).texts(_last_command(session)), summary),
        *problems,
    ]
    return summary


def message_stats(stream: Stream, lost: int | None = None) -> MessageStats:
    """The rate, gaps and latency of a topic with at least one message, and its `lost` samples."""
    times_ns = np.sort(stream.published)
    intervals = np.diff(times_ns) / 1e9
    span = float(times_ns[-1] - times_ns[0]) / 1e9
    return MessageStats(
        count=len(times_ns),
        lost=lost,
        rate_hz=len(intervals) / span if span > 0 else None,
        gaps=int(np.sum(intervals > _GAP * np.median(intervals))) if len(intervals) else 0,
        longest_interval_s=float(intervals.max()) if len(intervals) else None,
        latency_us=percentiles(stream.latency / 1e3),
        clock_offset_s=stream.clock_offset / 1e9,
        clock_steps=list(stream.clock_steps),
    )


def percentiles(values: Floats) -> Percentiles:
    """Percentiles of at least one value."""
    p50, p99, p99_9, longest = np.percentile(values, (50, 99, 99.9, 100)).tolist()
    return Percentiles(p50=p50, p99=p99, p99_9=p99_9, max=longest)


def summarise_run(
    config: Config,
    *,
    motion: MotionInfo | None = None,
    params: ParametersInfo | None = None,
    termination: Termination | None = None,
    stream: StreamSummary | None = None,
    recorder: RecorderSummary | None = None,
    tracking: TrackingSummary | None = None,
) -> Summary:
    """The summary of a run from the counters of its programs, without reading a file."""
    recorded = recorder or RecorderSummary()
    path = Path(recorded.path)
    steps = sum(step.step_ns for step in recorded.clock_steps)
    summary = Summary(
        files_bytes={str(path): path.stat().st_size} if path.is_file() else {},
        first_ns=recorded.first_ns,
        last_ns=recorded.last_ns and recorded.last_ns - steps,
        host=socket.gethostname(),
        domain=config.dds.domain,
        interface=config.dds.interface,
        versions={"g1stream": __version__},
        motion=motion,
        params=params,
        settings=_changed_settings(config.model_dump(mode="json")),
        termination=termination or Termination(),
        stream=stream,
        recorder=recorder,
        tracking=tracking,
        topics={
            topic: MessageStats(count=n, lost=recorded.lost.get(topic))
            for topic, n in recorded.counts.items()
        },
    )
    summary.problems = [*find_problems(summary), *_other_than_stop(recorded.warnings, summary)]
    return summary


def _other_than_stop(logged: Iterable[str], summary: Summary) -> Iterator[str]:
    """The logged warnings without the end of the stream, which the summary has with its remedy."""
    reason = summary.stream and summary.stream.reason
    return (text for text in logged if not (reason and text.endswith(reason)))


def find_problems(summary: Summary) -> Iterator[str]:
    """The problems that the summary shows, a sentence each, the most important first."""
    undamped, stream, recorder = summary.termination.undamped_in, summary.stream, summary.recorder
    if undamped is not None:
        yield f"The stream process ended in {undamped.name} without DAMP: the robot was not damped."
    if guard := summary.termination.guard:
        yield f"{guard[0].upper()}{guard[1:]}."
    if spoilt := summary.spoilt_by_ms:
        yield (
            f"The robot's time stopped or jumped by {spoilt:.0f} ms in PLAY while nothing held its "
            "pelvis. This run does not show the quality of the controller or policy. Play it again "
            "on a machine without other load."
        )
    if stream:
        yield from _stream_problems(stream)
    if recorder:
        if summary.first_ns is None and not recorder.stopped:
            yield "Nothing was received."
        yield from _recorder_problems(recorder)
    gaps = {
        t: s for t, s in summary.topics.items() if (s.longest_interval_s or 0.0) >= LONGEST_INTERVAL
    }
    if gaps:
        longest = max(stats.longest_interval_s or 0.0 for stats in gaps.values()) * 1e3
        numbers = ", ".join(f"{topic} {stats.gaps}" for topic, stats in gaps.items())
        yield f"Gaps between publish times: {numbers}; the longest {longest:.1f} ms."
    for topic, stats in summary.topics.items():
        if stats.clock_offset_s:
            yield (
                f"The publish times of {topic} are {-stats.clock_offset_s:+.3f} s off the "
                "recorder's clock."
            )
        if stats.clock_steps:
            set_by = ", ".join(f"{step.step_ns / 1e9:+.3f}" for step in stats.clock_steps)
            yield f"The clock of the publisher of {topic} was set by {set_by} s."
    tracking = None if summary.by_policy else summary.tracking  # a policy may leave the motion
    joints = tracking.joints if tracking else {}
    if far := {name: one.rmse_rad for name, one in joints.items() if one.rmse_rad > _FAR}:
        worst = max(far, key=far.__getitem__)
        yield (
            f"{counted(len(far), 'joint')} did not follow the reference: RMSE above {_FAR:g} rad, "
            f"{worst} {far[worst]:.2f} rad. {REMEDIES['tracking']}"
        )
    if ahead := _ahead_of_commands(summary):
        yield (
            f"The joints move {ahead * 1e3:.1f} ms before their commands are sent, which is "
            "impossible: the robot's clock is behind the recorder's, or the reference is wrong."
        )


def _ahead_of_commands(summary: Summary) -> float:
    """Time by which the joints seem to move before their commands, s; 0 if that is possible.

    A policy's targets are not the motion, so the robot may be ahead of that.
    """
    tracking, attached = summary.tracking, summary.attached
    if not tracking or tracking.all_joints.delay_s is None or (attached and attached.by_robot):
        return 0.0
    preview = summary.stream and summary.stream.preview_s
    if (preview is None and not attached) or summary.by_policy:
        return 0.0
    ahead = -tracking.all_joints.delay_s - (preview or 0.0)
    return ahead if ahead > _IMPOSSIBLE else 0.0


def _stream_problems(stream: StreamSummary) -> Iterator[str]:
    if stream.reason:
        remedy = REMEDIES.get(stream.stop, "") if stream.stop else ""
        yield f"The stream ended early: {stream.reason}." + (f" {remedy}" if remedy else "")
    for finding in stream.findings:
        yield f"{finding.cause.rstrip('.')}. {finding.remedy}".strip()
    late = stream.lateness_us.max if stream.lateness_us else 0.0
    if stream.skipped_ticks and (
        late >= _LONG_OVERRUN * 1e6 or stream.skipped_ticks > _MOST_SKIPPED * (stream.commands or 0)
    ):
        yield f"{counted(stream.skipped_ticks, 'tick')} skipped by the stream."
    if stream.time_scale is not None and stream.time_scale < _SLOW_SIMULATOR:
        so = "and so did the motion"
        if stream.waited_s is None:
            faster = 1.0 / stream.time_scale
            so = f"so the robot had to move {faster:.1f} times as fast as the motion"
        yield (
            f"The simulator ran at {stream.time_scale:.2f} of real time, {so}: it needs more CPU."
        )
    if stream.saturated_ticks:
        ticks = most(stream.saturated_ticks)
        yield f"Ticks with feed-forward torques clamped to their limits: {ticks}."


def _recorder_problems(recorder: RecorderSummary) -> Iterator[str]:
    if recorder.stopped:
        yield f"The recording stopped early: {recorder.stopped}"
    for topic, names in recorder.publishers.items():
        yield f"Several programs published on {topic} at the same time: {', '.join(names)}."
    for topic, n in recorder.lost.items():
        if n:
            yield f"{counted(n, 'sample')} lost on {topic}."
    for topic, n in recorder.malformed.items():
        if n:
            yield f"{counted(n, 'malformed sample')} on {topic}."
    if n := recorder.dropped_datagrams:
        yield f"{counted(n, 'datagram')} dropped by the kernel: its receive buffer was full."
    for step in recorder.clock_steps:
        yield f"CLOCK_REALTIME of the recorder was set by {step.step_ns / 1e9:+.3f} s."


def played(phases: list[PhaseInterval]) -> int:
    """Number of motions that were played, counting repetitions."""
    return sum(one.phase is Phase.PLAY for one in phases)


def _file_problems(session: Recording) -> Iterator[str]:
    if (times := played(session.phases)) > 1:
        yield (
            f"{times} motions were played in this session, each with its own PLAY, so there is no "
            "single reference for the tracking. Record each into its own file."
        )
    if not session.closed:
        yield (
            "The recorder did not close the file. It ends with its last complete chunk, and the "
            "number of lost samples is unknown"
            + (
                f"; {counted(session.unread, 'byte')} after it are an incomplete record."
                if session.unread
                else "."
            )
        )


def _sample_problems(session: Recording) -> Iterator[str]:
    """Problems of the samples themselves, including samples that cannot be decoded."""
    try:
        yield from _ignored_commands(session)
        yield from _invalid_attitudes(session)
        yield from _parallel_motors(session)
    except RecordingError as error:
        yield error.cause


def _ignored_commands(session: Recording) -> Iterator[str]:
    """Commands that the robot ignores: for another kind of G1, or with a wrong CRC."""
    has = [
        kind
        for kind in (CommandStream, ArmCommandStream, MeasuredStream)
        if session.topics.get(kind.topic)
    ]
    if CommandStream in has and MeasuredStream in has:
        meant = session.command.read("mode_machine").mode_machine
        robots = np.unique(session.measured.read("mode_machine").mode_machine)
        if other := int((~np.isin(meant, robots)).sum()):
            yield (
                f"{_share(other, len(meant))} of the commands on {CommandStream.topic} have "
                f"another mode_machine than the robot ({int(robots[-1])}), which ignores them."
            )
    for kind in has:
        if kind is not MeasuredStream and len(session.stream(kind).read("mode_machine")):
            some = list(session.some(kind.topic, _MOST_CHECKED))
            if wrong := int((~session.samples(kind, some).crc_matches()).sum()):
                yield (
                    f"{_share(wrong, len(some))} of the commands on {kind.topic} have a wrong CRC: "
                    "the robot ignores them."
                )


def _parallel_motors(session: Recording) -> Iterator[str]:
    for stream, motors in parallel(session):
        if n := int(motors.sum()):
            yield (
                f"{_share(n, len(motors))} of {stream.topic} has a mode_pr other than 0: there, "
                "ankles and waist are the motors A and B instead of pitch and roll, and these "
                "joints are not compared."
            )


def _share(n: int, of: int) -> str:
    return "All" if n == of else f"{max(1, round(100 * n / of))} %"


def _longest_stall(session: Recording) -> float | None:
    """The longest step of the robot's time in PLAY, by publish times or ticks, ms; None if short.

    After the last state, the time to the end of PLAY is a step, too.
    """
    reference, measured = session.reference, session.measured.read("tick")
    playing = reference.published[reference.phase == Phase.PLAY]
    first, last = playing.min(), playing.max()
    order = np.argsort(measured.published, kind="stable")
    order = order[measured.published[order] >= first]
    times = measured.published[order]
    n = int(np.searchsorted(times, last)) + 1  # including the state that ends a stall at PLAY's end
    steps = np.diff(times[:n], append=last).clip(0) / 1e6
    ticks = np.diff(measured.tick[order][:n].astype(np.int64)) % 2**32
    ticks = ticks[ticks < 2**31]  # otherwise they restarted
    longest = max(float(steps.max()), float(ticks.max(initial=0)))
    return longest if longest > max(1e3 * _STALL, _GAP * float(np.median(steps))) else None


def _invalid_attitudes(session: Recording) -> Iterator[str]:
    if session.topics.get(MeasuredStream.topic):
        valid = is_unit(session.measured.read("imu_quat_wxyz").imu_quat_wxyz)
        if n := int((~valid).sum()):
            yield (
                f"The IMU's quaternion in {n} of {len(valid)} LowStates is not a rotation (0, 0, "
                "0, 0, for example). /measured/tf has the last valid one there, or the reference's."
            )


def _last_command(session: Recording) -> int:
    """Time of the last received command, ns since the epoch; 0 without commands."""
    has_commands = session.topics.get(CommandStream.topic)
    return int(session.command.log_time.max(initial=0)) if has_commands else 0


def _termination(
    session: Recording,
    info: SessionInfo,
    stream: StreamSummary | None,
    recorder: RecorderSummary | None,
    streams: Mapping[str, Stream],
) -> Termination:
    phases = session.phases
    settings = (info.config or {}).get("stream")
    start = 0.0
    if isinstance(settings, dict) and not settings.get("policy"):  # with one, the motion is cut
        start = settings.get("start") or 0.0
    guard = next((event.text for event in session.log if event.name == GUARD), None)
    known = session.attached is None  # without our reference, other phases are unknown
    undamped = None if guard or not known else _undamped_in(phases, info, stream, recorder, streams)
    reason = guard if undamped is None else "the stream process ended without DAMP"
    values = {
        "reason": stream.reason if stream else reason,
        "undamped_in": undamped,
        "guard": guard,
        "played_s": _played_s(session) if phases and played(phases) <= 1 else None,
        "motion_s": info.motion.duration_s if info.motion else None,
        "start_s": start,
    }
    return read_record(Termination, values)[0] or Termination()


def _played_s(session: Recording) -> float:
    """Played length of a motion in its own time, which clock changes do not affect."""
    reference = session.reference
    times = reference.motion_time[reference.phase == Phase.PLAY]
    forward = np.diff(times[np.abs(times) < NUMBER]).clip(0.0)  # a loop restarts it
    return float(forward.sum() + np.median(forward)) if len(forward) else 0.0


def _undamped_in(
    phases: list[PhaseInterval],
    info: SessionInfo,
    stream: StreamSummary | None,
    recorder: RecorderSummary | None,
    streams: Mapping[str, Stream],
) -> Phase | None:
    """The last phase, if the references ended in it but the recording went on."""
    if not phases or phases[-1].phase >= Phase.DAMP or stream:
        return None
    # The recorder of a stream ends after it, and receives its summary.
    outlived = info.config is not None and recorder is not None and not recorder.stopped
    end = max(int(stream.log_time[-1]) for stream in streams.values())
    silence = end - int(streams[ReferenceStream.topic].log_time[-1])
    return phases[-1].phase if outlived or silence > _SILENCE else None


def _changed_settings(config: Mapping[str, Any]) -> dict[str, Any]:
    """The settings that differ from this version's defaults, by key such as `stream.rate`."""
    defaults = flat(Config().model_dump(mode="json"))
    return {
        key: value
        for key, value in flat(config).items()
        # What an earlier version set and this one does not know is not compared.
        if value != defaults.get(key) and (key in defaults or key.startswith("gains."))
    }


def flat(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """The values in nested tables by key, such as `stream.rate`."""
    found: dict[str, Any] = {}
    for key, value in values.items():
        name = f"{prefix}{key}"
        found |= flat(value, f"{name}.") if isinstance(value, dict) else {name: value}
    return found
