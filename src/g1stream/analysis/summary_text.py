"""The summary of a session as text."""

from __future__ import annotations

import math
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Final

from g1stream.robot.joints import JOINT_GROUPS, JOINT_NAMES, N_JOINTS
from g1stream.session.summary import TO_ITS_END
from g1stream.text import counted, labelled, table
from g1stream.types import Phase

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from g1stream.session.info import MotionInfo
    from g1stream.session.records import Percentiles
    from g1stream.session.stream_summary import (
        BalanceSummary,
        FeedForwardChange,
        StreamSummary,
    )
    from g1stream.session.summary import MessageStats, Summary, Termination, TrackingSummary

__all__ = [
    "most",
    "render",
    "session_facts",
    "stream_facts",
    "verdict",
]

_LABEL: Final = 14
_MOST_JOINTS: Final = 3
_MOST_PROBLEMS: Final = 10
#: A time scale this far from 1 is shown.
_SLOW: Final = 0.02
#: How it ended, where nobody told.
_UNTOLD: Final = "not recorded"


def render(summary: Summary) -> str:
    """The summary as plain text of `WIDTH` columns, with sections for what there is."""
    sections = [
        [_line(*fact) for fact in session_facts(summary)],
        _tracking(summary.tracking, summary.stream) if summary.tracking else [],
        [_line(*fact) for fact in stream_facts(summary.stream)]
        if summary.stream
        else _log(summary.feedforward_log),
        _messages(summary),
        _problems(summary.problems),
    ]
    return "\n\n".join("\n".join(lines) for lines in sections if lines)


def verdict(summary: Summary) -> str:
    """How it went, in one sentence."""
    tracking, ended = summary.tracking, _ended(summary.termination)
    parts = (
        [f"ended {ended}".replace(f"ended {_UNTOLD}", "its end was not recorded")] if ended else []
    )
    if tracking:
        name, worst = max(tracking.joints.items(), key=lambda one: one[1].max_abs_rad)
        parts.append(
            f"the joints followed with an RMSE of {math.degrees(tracking.rmse_rad):.2f} deg, at "
            f"worst {math.degrees(worst.max_abs_rad):.1f} deg ({name.removesuffix('_joint')} at "
            f"{worst.max_abs_at_s:.1f} s)"
        )
    elif summary.recorder or summary.stream or summary.first_ns is not None:
        parts.append("tracking error: not recorded")
    else:  # what `convert` makes of one
        parts.append("a motion that was not played")
    n = len(summary.problems)
    parts.append(counted(n, "problem") if n else "no problems found")
    text = "; ".join(parts)
    return f"{text[0].upper()}{text[1:]}."


def most(ticks: Mapping[str, int]) -> str:
    """The first joints with their ticks, and how many others there are."""
    named = ", ".join(f"{joint} {n}" for joint, n in list(ticks.items())[:_MOST_JOINTS])
    rest = len(ticks) - _MOST_JOINTS
    return f"{named} and {counted(rest, 'more joint')}" if rest > 0 else named


def session_facts(summary: Summary) -> list[tuple[str, str]]:
    """What ran, when, where and with which settings: labels and texts."""
    motion, recorder = summary.motion, summary.recorder
    lines = [("session", _files(summary))] if summary.files_bytes or recorder else []
    if summary.first_ns is not None:
        lines.append(("recorded", _recorded(summary)))
    if motion:
        parts = [motion.name or "unknown"]
        parts += [counted(motion.frames, "frame")] if motion.frames else []
        parts += [f"{motion.fps:g} fps"] if motion.fps else []
        parts += [f"{motion.duration_s:.2f} s"] if motion.duration_s is not None else []
        if motion.sha256 or motion.content_sha256:  # joined motions come from no one file
            of = "" if motion.sha256 else "of its frames "
            parts.append(f"sha256 {of}{(motion.sha256 or motion.content_sha256 or '')[:12]}")
        parts += motion.operations
        lines.append(("motion", ", ".join(parts)))
        if motion.parts:
            lines.append(("joined of", "; ".join(map(_part, motion.parts))))
    if summary.joints and (summary.absent or len(summary.joints) < N_JOINTS):
        lines.append(("joints", _joints(summary)))
    ramp = _ramp(summary.stream)
    if summary.phases:
        phases = [
            f"{one.phase.name} {one.duration_s:.2f} s" + ramp * (one.phase is Phase.RAMP)
            for one in summary.phases
        ]
        lines.append(("phases", ", ".join(phases)))
    elif ramp and summary.stream:
        lines.append(("phases", f"RAMP {summary.stream.ramp_s:.2f} s{ramp}"))
    if ended := _ended(summary.termination):
        lines.append(("ended", ended))
    if summary.settings is not None:
        settings = [f"{key} = {value}" for key, value in summary.settings.items()] or ["defaults"]
        gains = [f"{k} {low:g} to {high:g}" for k, (low, high) in (summary.gains or {}).items()]
        lines.append(("settings", "; ".join([*settings, *gains])))
    offsets = [
        f"{topic} {-delay.clock_offset_estimate_ns / 1e6:+.2f} ms ({', '.join(delay.hosts)})"
        for topic, delay in (recorder.delays if recorder else {}).items()
        if delay.clock_offset_estimate_ns is not None
    ]
    if offsets:
        lines.append(("clock offsets", ", ".join(offsets)))
    if recorder and recorder.absent:
        lines.append(("not published", ", ".join(recorder.absent)))
    if summary.attachments_bytes:
        files = [f"{name} ({_size(size)})" for name, size in summary.attachments_bytes.items()]
        lines.append(("attached", ", ".join(files)))
    return lines


def _part(motion: MotionInfo) -> str:
    """One of the motions that were joined."""
    about = [motion.name or "unknown"]
    about += [f"{motion.duration_s:.2f} s"] if motion.duration_s is not None else []
    about += [f"sha256 {motion.sha256[:12]}"] if motion.sha256 else []
    return ", ".join([*about, *motion.operations])


def _joints(summary: Summary) -> str:
    """Which joints played the motion: limbs that did as a whole by their name."""
    played, missing, named = {*(summary.joints or ())}, {*summary.absent}, []
    for limb, joints in JOINT_GROUPS.items():
        names = {JOINT_NAMES[i] for i in joints}
        short = sorted(name.removesuffix("_joint") for name in names & played)
        named += [limb.replace("_", " ")] if played & names >= names - missing else short
    settings = summary.settings or {}
    rest = "only damp" if settings.get("stream.others") == "free" else "hold their pose"
    if settings.get("stream.via") == "arm_sdk":
        rest = "are the robot's own controller's"
    if settings.get("stream.support") == "feet":
        rest = "stand still"
    total = N_JOINTS - len(missing)
    others = f"; the others {rest}" if len(played) < total else ""
    lacks = ", ".join(name.removesuffix("_joint") for name in summary.absent)
    has = f"; the robot lacks {lacks}" if lacks else ""
    return f"{len(played)} of {total} play: {', '.join(named)}{others}{has}"


def _files(summary: Summary) -> str:
    recorder = summary.recorder
    paths = [*summary.files_bytes] or (recorder.paths if recorder else []) or ["not saved"]
    more = f" to {Path(paths[-1]).name}, {len(paths)} files" if len(paths) > 1 else ""
    size = f", {_size(sum(summary.files_bytes.values()))}" if summary.files_bytes else ""
    removed = ", removed: nothing was received" if recorder and recorder.removed else ""
    return f"{paths[0]}{more}{size}{removed}"


def _recorded(summary: Summary) -> str:
    begin = datetime.fromtimestamp((summary.first_ns or 0) / 1e9, timezone.utc)
    when = "in simulated time" if summary.simulated else f"{begin:%Y-%m-%d %H:%M:%S} UTC"
    parts = [when, f"{summary.duration_s or 0.0:.2f} s"]
    parts += [f"on {summary.host}"] if summary.host else []
    parts += [f"domain {summary.domain} on {summary.interface}"] if summary.interface else []
    version = summary.versions.get("g1stream")
    return ", ".join(parts + ([f"by g1stream {version}"] if version else []))


def _ramp(stream: StreamSummary | None) -> str:
    if stream is None or stream.ramp_s is None or stream.ramp_speed_rad_s is None:
        return ""
    return f" (to {stream.ramp_speed_rad_s:.2f} rad/s)"


def _ended(termination: Termination) -> str:
    """How it ended and how much was played; empty where neither is known."""
    start, played, motion = termination.start_s, termination.played_s, termination.motion_s
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
    if whole:
        return f"{how}; played from {start:.1f} s to its end"
    if played > rest:
        return f"{how}; played {played:.1f} s of the motion of {motion:.1f} s, looped"
    return f"{how}; played {played:.1f} of {motion:.1f} s" + (
        f" from {start:.1f} s" if start else ""
    )


def _tracking(tracking: TrackingSummary, stream: StreamSummary | None) -> list[str]:
    rows = [("limb", "RMSE rad", "RMSE deg", "max deg", "at s", "worst joint by RMSE", "deg")]
    limbs = {**tracking.rmse_by_limb_rad, "all joints": tracking.rmse_rad}
    for limb, rmse in limbs.items():
        members = {JOINT_NAMES[i] for i in JOINT_GROUPS.get(limb, ())} or tracking.joints
        joints = {name: one for name, one in tracking.joints.items() if name in members}
        name, worst = max(joints.items(), key=lambda one: one[1].rmse_rad)
        largest = max(joints.values(), key=lambda one: one.max_abs_rad)
        rows.append(
            (
                limb.replace("_", " "),
                f"{rmse:.4f}",
                f"{math.degrees(rmse):.3f}",
                f"{math.degrees(largest.max_abs_rad):.2f}",
                f"{largest.max_abs_at_s:.2f}",
                name.removesuffix("_joint"),
                f"{math.degrees(worst.rmse_rad):.3f}",
            )
        )
    excluded = f"; {tracking.excluded_states} in gaps of the reference left out"
    return [
        *table(rows, left=(0, 5)),
        "",
        _line("delay", _delay(tracking, stream.preview_s if stream else None)),
        _line(
            "compared",
            f"{counted(tracking.compared_states, 'state')} over {tracking.compared_s:.2f} s of PLAY"
            + (excluded if tracking.excluded_states else ""),
        ),
    ]


def _delay(tracking: TrackingSummary, preview: float | None) -> str:
    if tracking.delay_s is None:
        return "not determined: too little moves, or no delay explains the error"
    side = "behind" if tracking.delay_s >= 0 else "ahead of"
    # Commands are ahead of the reference, so that the robot, which is behind them, is not.
    behind = (
        f", {(tracking.delay_s + preview) * 1e3:.1f} ms behind its commands, which are sent "
        f"{preview * 1e3:.1f} ms ahead (stream.preview)"
        if preview
        else ""
    )
    return (
        f"the robot is {abs(tracking.delay_s) * 1e3:.1f} ms {side} the reference{behind}; RMSE "
        f"without the delay {tracking.rmse_without_delay_rad:.4f} rad, and without each joint's "
        f"mean error {tracking.rmse_without_delay_and_mean_rad:.4f} rad"
    )


def _log(feedforward_log: Sequence[str]) -> list[str]:
    """All that a stream that was killed has left of its feed-forward."""
    return [_line("feed-forward", "; ".join(feedforward_log))] if feedforward_log else []


def stream_facts(stream: StreamSummary) -> list[tuple[str, str]]:
    """What the stream counted: labels and texts."""
    lines: list[tuple[str, str]] = []
    if stream.commands == 0:
        lines.append(("commands", "none sent"))
    elif stream.commands is not None:
        at = f" at {stream.rate_hz:.2f} Hz" if stream.rate_hz is not None else ""
        asked = f" (nominal {stream.nominal_rate_hz:g})" if stream.nominal_rate_hz else ""
        skipped = stream.skipped_ticks
        lines.append(
            (
                "commands",
                f"{stream.commands}{at}{asked}"
                + (f", {counted(skipped, 'tick')} skipped" if skipped is not None else ""),
            )
        )
    if stream.lateness_us:
        of = " (of the commands sent, without skipped ticks)" if stream.skipped_ticks else ""
        lines.append(("lateness", _percentiles(stream.lateness_us) + of))
    if stream.states_received is not None:
        lost = "" if stream.states_lost is None else f", {stream.states_lost} lost"
        lines.append(("states", f"{stream.states_received} received{lost}"))
    if stream.feedforward:
        lines.append(("feed-forward", _feedforward(stream)))
    if stream.balance:
        lines.append(("balance", _balance(stream.balance)))
    if stream.time_scale is not None and abs(stream.time_scale - 1.0) > _SLOW:
        lines.append(("time", f"the simulator ran at {stream.time_scale:.2f} of real time"))
    if stream.slowed not in (None, 1.0):
        lines.append(("slowed", f"{stream.slowed:g} times, to fit the joints' speeds"))
    if stream.delay_s:
        lines.append(("stalls", f"of the loop delayed the motion by {stream.delay_s:.3f} s"))
    for label, what, ticks in (
        ("clamped", "joint targets at their limits", stream.clamped_ticks),
        ("too fast", "joint targets held back to the joint's speed", stream.speed_limited_ticks),
        ("too strong", "joint targets eased to the motor's torque", stream.torque_limited_ticks),
        ("saturated", "feed-forward torques at their limits", stream.saturated_ticks),
    ):
        if ticks:
            lines.append((label, f"{what}, ticks: {most(ticks)}"))
    if stream.realtime:
        granted = [f"{g.what} {g.detail if g.granted else 'not granted'}" for g in stream.realtime]
        lines.append(("real time", ", ".join(granted)))
    return lines


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


def _messages(summary: Summary) -> list[str]:
    """A row for each topic of DDS; the number of the others and of their messages."""
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
    # A recorder writes the robot's description by itself.
    if others and not (summary.recorder and summary.first_ns is None):
        lines.append(
            _line("other topics", f"{len(others)}, with {counted(sum(others), 'message')}")
        )
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


def _problems(problems: Sequence[str]) -> list[str]:
    shown = list(problems[:_MOST_PROBLEMS]) or ["no problems found"]
    if rest := len(problems[_MOST_PROBLEMS:]):
        shown.append(f"and {rest} more; --json lists all")
    return [_line("" if i else "problems", text) for i, text in enumerate(shown)]


def _percentiles(us: Percentiles) -> str:
    return f"p50 {us.p50:.0f} us, p99 {us.p99:.0f}, p99.9 {us.p99_9:.0f}, max {us.max:.0f}"


def _size(n_bytes: int) -> str:
    return f"{n_bytes / 1e6:.1f} MB" if n_bytes >= 1e5 else f"{n_bytes / 1e3:.1f} kB"


def _line(label: str, text: str) -> str:
    return labelled(label.ljust(_LABEL), text)
