"""The summary of a session, which `stream`, `record`, `demo` and `info` print and `--json` dumps.

Field names are those of the JSON, with units. None means unknown.
"""

from __future__ import annotations

import math
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from pydantic import computed_field

from g1stream.analysis.body import TerminationMetrics
from g1stream.analysis.tracking import UNSURE, TrackingSummary
from g1stream.robot.joints import JOINT_GROUPS, JOINT_NAMES, N_JOINTS
from g1stream.session.records import (
    AttachedInfo,
    ClockStep,
    Int,
    MotionInfo,
    ParametersInfo,
    Percentiles,
    PhaseInterval,
    PhaseName,
    Record,
    RecorderSummary,
    StreamSummary,
)
from g1stream.text import counted, labelled, listed, short_name, table
from g1stream.types import Phase

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from g1stream.session.records import BalanceSummary, FeedForwardChange

__all__ = [
    "TO_ITS_END",
    "MessageStats",
    "SuccessMetrics",
    "Summary",
    "Termination",
    "most",
    "outcome",
    "session_facts",
    "stream_facts",
]

TO_ITS_END: Final = 0.1
"""A motion that was played to within this of the requested end, s, was played to its end."""

_LABEL: Final = 14
_MOST_JOINTS: Final = 3
_MOST_PROBLEMS: Final = 10
#: Labels of the facts that the short text has.
_BRIEF: Final = {
    *("session", "part of", "log", "motion", "reference", "joints", "ended"),
    *("commands", "lateness", "states", "balance", "time", "slowed", "stalls"),
    *("clamped", "too fast", "too strong", "saturated"),
}
#: A time scale this far from 1 is shown.
_SLOW: Final = 0.02
#: A longer wait of the motion for the robot's time is shown, s.
_WAITED: Final = 0.05
#: Supports with which the pelvis moves like the robot, or like the motion.
_MOVES: Final = {"follow", "free", "feet"}
#: Text for a part of a session.
_WHOLE: Final = "a longer session. The end and the problems of the stream are those of the whole"
#: Text for an unknown end.
_UNTOLD: Final = "not recorded"


class Termination(Record):
    """How a session ended.

    Attributes:
        reason: why the stream ended early; empty if it ended as asked, None if unknown.
        undamped_in: phase in which the stream process ended without DAMP; None if it damped.
        guard: message of the guard process when it damped the robot; None if it did not.
        played_s: played length of the motion, in its own time.
        motion_s: duration of the motion.
        start_s: requested start in the motion.
    """

    reason: str | None = None
    undamped_in: PhaseName | None = None
    guard: str | None = None
    played_s: float | None = None
    motion_s: float | None = None
    start_s: float = 0.0


class SuccessMetrics(Record):
    """Whether the motion was played to its end and followed.

    Attributes:
        completed: whether the stream played the requested part; None if unknown.
        progress: played fraction of the requested part, 0 to 1.
        links: the distance of the links that is used: `world` if nothing holds the pelvis,
            otherwise `root_relative` or `pelvis_frame`.
        max_link_error_mm: largest mean distance of all links in a frame.
        success: completed, with this distance at most 500 mm in every frame, as in PHC, OmniH2O
            and ASAP; None if one of the two is unknown.
        success_strict: completed within BeyondMimic's limits on heights of pelvis, hands and feet
            (250 mm) and the pelvis's tilt (0.8) instead of this distance; None if something holds
            the pelvis.
        success_sonic: completed within SONIC's limits on those heights (250 mm) and the pelvis's
            attitude (1 rad); None likewise.
        spoilt_by_ms: see `Summary`. A spoilt run has not failed: instead of false, the three
            results above are None.
    """

    completed: bool | None = None
    progress: float | None = None
    links: str | None = None
    max_link_error_mm: float | None = None
    success: bool | None = None
    success_strict: bool | None = None
    success_sonic: bool | None = None
    spoilt_by_ms: float | None = None


class MessageStats(Record):
    """Statistics of a topic's messages; for derived topics only their number.

    Attributes:
        count: number of messages in the file.
        lost: number of samples known to be lost.
        rate_hz: messages per second from the first to the last publish time.
        gaps: publish intervals of more than 3 medians.
        longest_interval_s: between two publish times.
        latency_us: log time - publish time, including any offset of the clocks; None if both are
            simulated.
        clock_offset_s: offset to add to publish times to get the recorder's clock; 0 if no offset
            can be detected.
        clock_steps: steps of the publisher's clock, which are taken out as well.
    """

    count: Int
    lost: Int | None = None
    rate_hz: float | None = None
    gaps: Int | None = None
    longest_interval_s: float | None = None
    latency_us: Percentiles | None = None
    clock_offset_s: float | None = None
    clock_steps: list[ClockStep] = []


class Summary(Record):
    """Contents and results of a session.

    Attributes:
        files_bytes: path of each file -> size, oldest first.
        complete: whether all files are there and were closed properly.
        selected: whether it is a part of a longer session. The counters of stream and recorder, and
            the reason of the end, are then those of the whole session.
        first_ns, last_ns: log times of the first and the last message, since the epoch; the last as
            if the clock had not been set in between.
        simulated: whether its times are simulated, as in a rollout.
        host, domain, interface: where it was recorded or streamed.
        versions: versions of g1stream and the packages that it used.
        motion: the motion that was played.
        attached: how the motion was found, if it was attached afterwards.
        log: how another program's log was interpreted; empty for a session.
        params: given parameters of the robot; None for the default ones.
        settings: settings that differ from the defaults, keyed like `stream.rate`.
        gains: lowest and highest kp in N·m/rad and kd in N·m·s/rad.
        joints: names of the joints that played the motion; None if unknown.
        absent: names of the joints that the robot lacks.
        phases: in order.
        termination: how it ended.
        recorder: counters of the recorder.
        tracking: the tracking error.
        spoilt_by_ms: longest stop or jump of the robot's own time in PLAY, if above 40 ms and if
            nothing held the pelvis; the run then does not show the quality of its controller.
        success, terminations: for a robot that nothing held; only `g1stream info` sets them, from
            `metrics`.
        topics: statistics of each topic's messages.
        attachments_bytes: name -> size.
        problems: problems, a sentence each, the most important first.
        stream: counters of the stream.
    """

    files_bytes: dict[str, Int] = {}
    complete: bool | None = None
    selected: bool = False
    first_ns: Int | None = None
    last_ns: Int | None = None
    simulated: bool = False
    host: str | None = None
    domain: Int | None = None
    interface: str | None = None
    versions: dict[str, str] = {}
    motion: MotionInfo | None = None
    attached: AttachedInfo | None = None
    log: dict[str, str] = {}
    params: ParametersInfo | None = None
    settings: dict[str, Any] | None = None
    gains: dict[str, tuple[float, float]] | None = None
    joints: list[str] | None = None
    absent: list[str] = []
    phases: list[PhaseInterval] = []
    termination: Termination = Termination()
    recorder: RecorderSummary | None = None
    tracking: TrackingSummary | None = None
    spoilt_by_ms: float | None = None
    success: SuccessMetrics | None = None
    terminations: TerminationMetrics | None = None
    topics: dict[str, MessageStats] = {}
    attachments_bytes: dict[str, Int] = {}
    problems: list[str] = []
    stream: StreamSummary | None = None

    @property
    def requested_s(self) -> float | None:
        """Requested length of the motion, s; None if it is the whole motion.

        With a policy the motion has been cut, and has standing before and after it.
        """
        asked = None if self.by_policy else (self.settings or {}).get("stream.duration")
        return float(asked) if isinstance(asked, (int, float)) else None

    @property
    def by_policy(self) -> bool:
        """Whether the stream's targets were those of a policy, not the motion."""
        return bool((self.settings or {}).get("stream.policy"))

    @property
    def moves(self) -> bool:
        """Whether the pelvis moved as the robot did, or as the motion did, as far as is known."""
        if self.attached:
            return self.attached.moves
        return self.stream is not None and self.stream.support in _MOVES

    @property
    def held(self) -> str:
        """The support that held the pelvis, so that it did not move as in the motion; or ""."""
        return self.stream.support or "" if self.stream and not self.moves else ""

    @computed_field  # type: ignore[prop-decorator]
    @property
    def duration_s(self) -> float | None:
        """From the first message to the last, s."""
        if self.first_ns is None or self.last_ns is None:
            return None
        return (self.last_ns - self.first_ns) / 1e9

    def __str__(self) -> str:
        """The result in one screen of `WIDTH` columns: what went wrong, and how well it went."""
        tracking, stream = self.tracking, stream_facts(self._counted) if self._counted else []
        facts = [one for one in session_facts(self) if one[0] in _BRIEF]
        delay = [("delay", _delay(self, tracking))] if tracking else []
        lost = {topic: one.lost for topic, one in self.topics.items() if one.lost}
        return _text(
            _lines([*_verdict(self), *facts]),
            _limb_table(tracking) if tracking else [],
            _lines(
                [
                    *delay,
                    *_success(self),
                    *(one for one in stream if one[0] in _BRIEF),
                    ("lost", ", ".join(f"{n} on {topic}" for topic, n in lost.items())),
                ]
            ),
        )

    @property
    def details(self) -> str:
        """All that is known, as text of `WIDTH` columns."""
        tracking, delay = self.tracking, []
        if tracking:
            excluded = f"; {tracking.excluded_states} in gaps of the reference excluded"
            compared = f"{counted(tracking.compared_states, 'state')} over "
            compared += f"{tracking.compared_s:.2f} s of PLAY"
            compared += excluded if tracking.excluded_states else ""
            delay = [
                ("delay", _delay(self, tracking)),
                ("without it", _without_delay(tracking)),
                ("compared", compared),
            ]
        return _text(
            _lines([*_verdict(self), *session_facts(self)]),
            _limb_table(tracking) if tracking else [],
            _lines([*delay, *_success(self)]),
            _lines(stream_facts(self._counted) if self._counted else []),
            _message_lines(self),
        )

    @property
    def _counted(self) -> StreamSummary | None:
        """The counters of the stream, which are those of the whole session."""
        return None if self.selected else self.stream


def _text(*sections: list[str]) -> str:
    return "\n\n".join("\n".join(lines) for lines in sections if lines)


def _verdict(summary: Summary) -> list[tuple[str, str]]:
    """The problems, first of all."""
    rest = len(summary.problems) - _MOST_PROBLEMS
    more = [f"and {rest} more; --json lists all"] if rest > 0 else []
    shown = (*summary.problems[:_MOST_PROBLEMS], *more) or ("none found",)
    return [("problems", text) for text in shown]


def outcome(summary: Summary) -> str:
    """The result of the session, in one sentence."""
    tracking, ended = summary.tracking, _ended(summary)
    parts = [f"ended {ended}".replace(f"ended {_UNTOLD}", "its end was not recorded")]
    if tracking:
        name, worst = tracking.worst
        parts.append(
            f"the joints followed with an RMSE of "
            f"{math.degrees(tracking.all_joints.rmse_rad):.2f} deg, at worst "
            f"{math.degrees(worst.max_abs_rad):.1f} deg ({name.removesuffix('_joint')} at "
            f"{worst.max_abs_at_s:.1f} s)"
        )
    elif summary.recorder or summary.stream or summary.first_ns is not None:
        parts.append("tracking error: not recorded")
    else:  # what `convert` makes of one
        parts.append("a motion that was not played")
    n = len(summary.problems)
    parts.append(counted(n, "problem") if n else "no problems found")
    text = "; ".join(parts if ended else parts[1:])
    return f"{text[0].upper()}{text[1:]}."


def most(ticks: Mapping[str, int]) -> str:
    """The first joints with their ticks, and the number of the others."""
    return listed([f"{joint} {n}" for joint, n in ticks.items()], _MOST_JOINTS, "joint")


def session_facts(summary: Summary) -> list[tuple[str, str]]:
    """Time, place and settings of the run, as labels and texts."""
    motion, recorder, stream = summary.motion, summary.recorder, summary.stream
    ramp = ""
    if stream and stream.ramp_s is not None and stream.ramp_speed_rad_s is not None:
        ramp = f" (at most {stream.ramp_speed_rad_s:.2f} rad/s)"
    phases = [
        f"{one.phase.name} {one.duration_s:.2f} s" + ramp * (one.phase is Phase.RAMP)
        for one in summary.phases
    ]
    if ramp and stream and not phases and not summary.termination.reason:  # as it was planned
        phases = [f"RAMP {stream.ramp_s:.2f} s{ramp}"]
    settings = []
    if summary.settings is not None:
        settings = [f"{key} = {value}" for key, value in summary.settings.items()] or ["defaults"]
        settings += [f"{k} {low:g} to {high:g}" for k, (low, high) in (summary.gains or {}).items()]
    offsets = [
        f"{topic} {-delay.clock_offset_estimate_ns / 1e6:+.2f} ms ({', '.join(delay.hosts)})"
        for topic, delay in (recorder.delays if recorder else {}).items()
        if delay.clock_offset_estimate_ns is not None
    ]
    parts = [_motion(one, joined=True) for one in motion.parts] if motion else []
    attached = [f"{name} ({_size(n)})" for name, n in summary.attachments_bytes.items()]
    return _filled(
        ("session", _files(summary) if summary.files_bytes or recorder else ""),
        ("recorded", _recorded(summary) if summary.first_ns is not None else ""),
        ("part of", _WHOLE if summary.selected else ""),
        ("log", "; ".join(f"{name}: {text}" for name, text in summary.log.items())),
        ("motion", _motion(motion) if motion else ""),
        ("sha256", _hash(motion) if motion else ""),
        ("reference", _attached(summary.attached) if summary.attached else ""),
        ("joined of", "; ".join(parts)),
        ("joints", _joints(summary)),
        ("phases", ", ".join(phases)),
        ("ended", _ended(summary)),
        ("settings", "; ".join(settings)),
        ("parameters", str(summary.params) if summary.params else ""),
        ("clock offsets", ", ".join(offsets)),
        ("not published", ", ".join(recorder.absent) if recorder else ""),
        ("attached", ", ".join(attached)),
    )


def stream_facts(stream: StreamSummary) -> list[tuple[str, str]]:
    """The stream's counters, as labels and texts."""
    skipped, late = stream.skipped_ticks, stream.lateness_us
    commands = "none sent" if stream.commands == 0 else ""
    if stream.commands:
        commands = (
            f"{stream.commands}"
            + (f" at {stream.rate_hz:.2f} Hz" if stream.rate_hz is not None else "")
            + (f" (nominal {stream.nominal_rate_hz:g})" if stream.nominal_rate_hz else "")
            + (f", {counted(skipped, 'tick')} skipped" if skipped is not None else "")
        )
    lateness = states = time = slowed = ""
    if late:
        lateness = f"p50 {late.p50:.0f} us, p99 {late.p99:.0f}, p99.9 {late.p99_9:.0f}, max "
        of = " (of the commands sent, without skipped ticks)" if skipped else ""
        lateness += f"{late.max:.0f}{of}"
    if stream.states_received is not None:
        lost = "" if stream.states_lost is None else f", {stream.states_lost} lost"
        states = f"{stream.states_received} received by the stream{lost}"
    if stream.time_scale is not None and abs(stream.time_scale - 1.0) > _SLOW:
        time = f"the simulator ran at {stream.time_scale:.2f} of real time"
    if stream.waited_s and abs(stream.waited_s) > _WAITED:
        time = f"{time}; " if time else ""
        time += f"the motion waited {stream.waited_s:.2f} s for it"
    if stream.slowed not in (None, 1.0):
        slowed = f"{stream.slowed:g} times, to keep the joints' speed limits"
    held = (
        ("clamped", "joint targets at their limits", stream.clamped_ticks),
        ("too fast", "joint targets held back to the joint's speed", stream.speed_limited_ticks),
        ("too strong", "joint targets eased to the motor's torque", stream.torque_limited_ticks),
        ("saturated", "feed-forward torques at their limits", stream.saturated_ticks),
    )
    granted = [f"{g.what} {g.detail if g.granted else 'not granted'}" for g in stream.realtime]
    delay = stream.delay_s
    return _filled(
        ("commands", commands),
        ("lateness", lateness),
        ("states", states),
        ("feed-forward", _feedforward(stream)),
        ("balance", _balance(stream.balance) if stream.balance else ""),
        ("time", time),
        ("slowed", slowed),
        ("stalls", f"of the loop delayed the motion by {delay:.3f} s" if delay else ""),
        *((label, f"{what}, ticks: {most(ticks)}" if ticks else "") for label, what, ticks in held),
        ("real time", ", ".join(granted)),
    )


def _filled(*facts: tuple[str, str]) -> list[tuple[str, str]]:
    return [(label, text) for label, text in facts if text]


def _lines(facts: Iterable[tuple[str, str]]) -> list[str]:
    """Lines of facts. A repeated label is printed once."""
    lines, before = [], ""
    for label, text in _filled(*facts):
        lines.append(labelled(("" if label == before else label).ljust(_LABEL), text))
        before = label
    return lines


def _files(summary: Summary) -> str:
    recorder = summary.recorder
    paths = [*summary.files_bytes] or [recorder.path if recorder else ""]
    more = f" to {Path(paths[-1]).name}, {len(paths)} files" if len(paths) > 1 else ""
    size = f", {_size(sum(summary.files_bytes.values()))}" if summary.files_bytes else ""
    removed = ", removed: nothing was received" if recorder and recorder.removed else ""
    return f"{paths[0] or 'not saved'}{more}{size}{removed}"


def _recorded(summary: Summary) -> str:
    begin = datetime.fromtimestamp((summary.first_ns or 0) / 1e9, timezone.utc)
    parts = ["in simulated time" if summary.simulated else f"{begin:%Y-%m-%d %H:%M:%S} UTC"]
    parts.append(f"{summary.duration_s or 0.0:.2f} s")
    parts += [f"on {summary.host}"] if summary.host else []
    parts += [f"domain {summary.domain} on {summary.interface}"] if summary.interface else []
    version = summary.versions.get("g1stream")
    return ", ".join(parts + ([f"by g1stream {version}"] if version else []))


def _motion(motion: MotionInfo, *, joined: bool = False) -> str:
    """A motion; of one that was joined with others its hash, because no other line has it."""
    frames = counted(motion.frames, "frame") if motion.frames else ""
    fps = f"{motion.fps:g} fps" if motion.fps else ""
    seconds = "" if motion.duration_s is None else f"{motion.duration_s:.2f} s"
    sha256 = f"sha256 {motion.sha256[:12]}" if motion.sha256 else ""
    told = (seconds, sha256) if joined else (frames, fps, seconds)
    return ", ".join(filter(None, (motion.name or "unknown", *told, *motion.operations)))


def _hash(motion: MotionInfo) -> str:
    """The start of the hash of the motion's file; joined motions come from no one file."""
    of = "" if motion.sha256 else "of its frames "
    value = motion.sha256 or motion.content_sha256 or ""
    return f"{of}{value[:12]}" if value else ""


def _joints(summary: Summary) -> str:
    """The joints that played the motion, with whole limbs by name; empty if all played."""
    if not summary.joints or not (summary.absent or len(summary.joints) < N_JOINTS):
        return ""
    played, missing, named = {*summary.joints}, {*summary.absent}, []
    for limb, joints in JOINT_GROUPS.items():
        names = {JOINT_NAMES[i] for i in joints}
        short = sorted(name.removesuffix("_joint") for name in names & played)
        named += [short_name(limb)] if played & names >= names - missing else short
    settings = summary.settings or {}
    rest = "only damp" if settings.get("stream.others") == "free" else "hold their pose"
    if settings.get("stream.via", "lowcmd") != "lowcmd":
        rest = "are the robot's own controller's"
    if settings.get("stream.support") == "feet":
        rest = "stand still"
    total = N_JOINTS - len(missing)
    others = f"; the others {rest}" if len(played) < total else ""
    lacks = ", ".join(name.removesuffix("_joint") for name in summary.absent)
    has = f"; the robot lacks {lacks}" if lacks else ""
    return f"{len(played)} of {total} play: {', '.join(named)}{others}{has}"


def _ended(summary: Summary) -> str:
    """How the session ended and how much was played; empty if both are unknown."""
    termination = summary.termination
    start, played, motion = termination.start_s, termination.played_s, termination.motion_s
    asked = summary.requested_s
    rest = None if motion is None else motion - start
    whole = played is None or rest is None or abs(rest - played) < TO_ITS_END
    if termination.undamped_in is not None:
        how = f"in {termination.undamped_in.name}: {termination.reason}"
    elif termination.reason:
        how = f"early: {termination.reason}"
    elif termination.reason is not None:
        how = "at the motion's end" if whole else "as asked"
    elif played is not None:
        how = _UNTOLD
    else:
        return ""
    if played is None or rest is None or (whole and not start):
        return how
    if not played:
        return f"{how}; nothing was played"
    if whole:
        return f"{how}; played from {start:.1f} s to its end"
    if played > rest:
        return f"{how}; played {played:.1f} s of the motion of {motion:.1f} s, looped"
    of = f"{motion:.1f} s"
    if termination.reason and asked and asked < rest:
        of = f"the requested {asked:.1f} s"
    return f"{how}; played {played:.1f} of {of}" + (f" from {start:.1f} s" if start else "")


def _limb_table(tracking: TrackingSummary) -> list[str]:
    rows = [("limb", "RMSE rad", "RMSE deg", "max deg", "at s", "worst joint by RMSE", "deg")]
    for limb, error in {**tracking.limbs, "all joints": tracking.all_joints}.items():
        worst = error.worst_joint or ""
        rows.append(
            (
                short_name(limb),
                f"{error.rmse_rad:.4f}",
                f"{math.degrees(error.rmse_rad):.3f}",
                f"{math.degrees(error.max_abs_rad):.2f}",
                f"{error.max_abs_at_s:.2f}",
                worst.removesuffix("_joint"),
                f"{math.degrees(tracking.joints[worst].rmse_rad):.3f}",
            )
        )
    return table(rows, left=(0, 5))


def _success(summary: Summary) -> list[tuple[str, str]]:
    """Whether the run is a success, by each criterion."""
    found, ends = summary.success, summary.terminations
    if found is None:
        return []
    far, first = found.max_link_error_mm, ends and ends.sonic
    criteria = (
        ("mean link distance", found.success, "" if far is None else f"at most {far:.0f} mm"),
        ("BeyondMimic", found.success_strict, ""),
        ("SONIC", found.success_sonic, f"{first}" if first else ""),
    )
    void = "void" if found.spoilt_by_ms else "not known"
    answers = {True: "yes", False: "no", None: void}
    text = [
        f"{name} {answers[answer]}" + (f" ({detail})" if detail else "")
        for name, answer, detail in criteria
    ]
    return [("success", "; ".join(text))]


def _attached(info: AttachedInfo) -> str:
    return (
        f"attached afterwards, found by {info.by}: {info.first_s:.2f} to {info.last_s:.2f} s of "
        f"the motion at {info.speed:.3f} of its speed, similarity {info.similarity:.2f}"
    )


def _delay(summary: Summary, tracking: TrackingSummary) -> str:
    """The delay of the robot, and that of its commands, which are ahead to compensate it."""
    delay, within = tracking.all_joints.delay_s, tracking.all_joints.delay_ci95_s
    attached, preview = summary.attached, summary.stream and summary.stream.preview_s
    if attached and attached.by_robot:
        return "unknown: the robot's own joints gave the start of the motion"
    if delay is None:
        missing = "unknown: too little movement, or no delay explains the error"
        return missing if summary.topics else "only computed for recordings: give --record"
    sure = " (no 95 % interval: less than 5 s were compared)"
    if within is not None:
        sure = f" (95 %: ±{within * 1e3:.2g} ms)"
        if within > UNSURE:
            return f"unknown: {_late(delay, 'the reference')} fits best{sure}"
    if attached and preview is None:
        return f"the robot is {_late(delay, 'its commands')}{sure}"
    if not preview:
        return f"the robot is {_late(delay, 'the reference')}{sure}"
    return (
        f"commands {preview * 1e3:.1f} ms ahead of the reference (stream.preview), the robot "
        f"{_late(delay + preview, 'them')}: {_late(delay, 'the reference')}{sure}"
    )


def _late(delay: float, what: str) -> str:
    return f"{abs(delay) * 1e3:.1f} ms {'behind' if delay >= 0 else 'ahead of'} {what}"


def _without_delay(tracking: TrackingSummary) -> str:
    if tracking.rmse_without_delay_rad is None:
        return ""
    return (
        f"RMSE {tracking.rmse_without_delay_rad:.4f} rad, and without each joint's mean error "
        f"{tracking.rmse_without_delay_and_mean_rad:.4f} rad"
    )


def _balance(balance: BalanceSummary) -> str:
    margin = 1e3 * balance.capture_margin_m
    unsolved = balance.unsolved_ticks
    return (
        f"capture point at worst {abs(margin):.0f} mm {'inside' if margin >= 0 else 'outside of'} "
        f"the soles; pelvis off by up to {balance.tilt_rad:.3f} rad in tilt, "
        f"{1e3 * balance.height_error_m:.0f} mm in height; feet off by up to "
        f"{1e3 * balance.feet_error_m:.0f} mm, with at least {100 * balance.carried:.0f} % of the "
        f"weight on them; {counted(balance.lifts, 'lift')}"
        + (f"; {counted(unsolved, 'tick')} without a solution" if unsolved else "")
    )


def _feedforward(stream: StreamSummary) -> str:
    if not stream.feedforward:
        return ""
    text = f"{stream.feedforward}"
    robot = f"robot {stream.robot}" if stream.robot else None
    about = ", ".join(filter(None, (stream.support, robot)))
    if about and stream.feedforward == "dynamics":
        text += f" ({about})"
    if not stream.feedforward_changes:
        return text
    first, *more = stream.feedforward_changes
    text += f" until {_change(first)}" + (f": {first.reason}" if first.reason else "")
    if more:
        text += f"; {counted(len(more), 'more change')}, the last at {_change(more[-1])}"
    return text


def _change(change: FeedForwardChange) -> str:
    return f"{change.motion_time_s:.1f} s of the motion, then {change.kind}"


def _message_lines(summary: Summary) -> list[str]:
    """A row for each DDS topic; for other topics only their number and messages."""
    topics = {
        topic: stats
        for topic, stats in summary.topics.items()
        if stats.rate_hz is not None or stats.lost is not None
    }
    others = [stats.count for topic, stats in summary.topics.items() if topic not in topics]
    rows: list[Sequence[str]] = [
        ("topic", "count", "lost", "Hz", "gaps", "longest ms", "p50 us", "p99 us", "max us")
    ]
    rows += [(topic, *_row(stats)) for topic, stats in topics.items()]
    lines = table(rows, left=(0,)) if topics else []
    if any(stats.latency_us for stats in topics.values()):
        lines += ["", "gaps: publish intervals over 3 medians; us: latency, log - publish time"]
    # A recorder always writes the robot's description.
    if others and not (summary.recorder and summary.first_ns is None):
        text = f"{len(others)}, with {counted(sum(others), 'message')}"
        lines += _lines([("other topics", text)])
    return lines


def _row(stats: MessageStats) -> list[str]:
    longest, us = stats.longest_interval_s, stats.latency_us
    return [
        str(stats.count),
        "" if stats.lost is None else str(stats.lost),
        "" if stats.rate_hz is None else f"{stats.rate_hz:.1f}",
        "" if stats.gaps is None else str(stats.gaps),
        "" if longest is None else f"{longest * 1e3:.1f}",
        *([f"{value:.0f}" for value in (us.p50, us.p99, us.max)] if us else [""] * 3),
    ]


def _size(n_bytes: int) -> str:
    return f"{n_bytes / 1e6:.1f} MB" if n_bytes >= 1e5 else f"{n_bytes / 1e3:.1f} kB"
