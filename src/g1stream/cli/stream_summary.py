"""How a motion was played, for people and as an exit code."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from g1stream.analysis.formatting import carried, counted, most, played
from g1stream.cli.common import EXIT_OK, EXIT_STOPPED, exit_code_of_signal
from g1stream.realtime import describe

if TYPE_CHECKING:
    from collections.abc import Mapping

    from g1stream.control.report import LoopReport
    from g1stream.motion.limits import Interval
    from g1stream.programs.outcome import StreamOutcome

__all__ = ["exit_code", "summary"]


def exit_code(outcome: StreamOutcome) -> int:
    """0 for a motion played as asked, 128 + n for signal n, 1 for what else stopped it.

    1 as well where it was to be recorded and something of it is not in the file.
    """
    reason = outcome.report.reason
    recording = outcome.recording
    if not reason:
        return EXIT_STOPPED if recording and _lacks(recording) else EXIT_OK
    return exit_code_of_signal(reason) or EXIT_STOPPED


def summary(outcome: StreamOutcome) -> str:
    """How it went, for people."""
    report = outcome.report
    if not report.commands:
        lines = [f"{outcome.motion}: no command was sent; {report.reason}."]
        lines += [f"  {finding.cause}\n  {finding.remedy}" for finding in outcome.findings]
        return "\n".join(lines + _recording(outcome.recording))
    ended = f"stopped: {report.reason}" if report.reason else _played(outcome.interval)
    lateness = report.lateness
    lines = [
        f"{outcome.motion}: {ended}",
        _line(
            "commands",
            f"{report.commands} at {report.rate:.2f} Hz ({1e9 / report.period:g} asked for), "
            f"{counted(report.skipped, 'tick')} skipped",
        ),
        _line(
            "lateness",
            ", ".join(f"p{p:g} {lateness.percentile_us(p):.0f} us" for p in (50, 99, 99.9))
            + f", max {lateness.maximum_ns / 1000:.0f} us",
        ),
        _line("states", _states(outcome.wire)),
        _line("feed-forward", _carried(report)),
        _line("real time", describe(outcome.granted)),
        *_held(outcome),
        *_recording(outcome.recording),
    ]
    return "\n".join(lines)


def _line(label: str, text: str) -> str:
    return f"  {label:<12}  {text}"


def _played(interval: Interval) -> str:
    """What was played of a motion that nothing stopped."""
    if interval.loop:
        return f"played for {interval.length:.1f} s, again and again its {interval.motion:.1f} s"
    length = interval.motion - interval.start if interval.length is None else interval.length
    return played(interval.start, length, interval.motion)


def _states(wire: Mapping[str, int | None]) -> str:
    missed = wire["states_missed"]
    lost = (
        "how many were lost is unknown: they carry no tick" if missed is None else f"{missed} lost"
    )
    return f"{wire['states_received']} received, {lost}"


def _carried(report: LoopReport) -> str:
    changes = [change._asdict() for change in report.feedforward_changes]
    return carried(report.feedforward, report.support, changes)


def _held(outcome: StreamOutcome) -> list[str]:
    from g1stream.robot.joints import by_joint

    report = outcome.report
    return [
        _line(label, f"{counted(total, what)} held at the joint's limit: {most(joints)}")
        for label, what, joints in (
            ("limits", "joint target", by_joint(report.clamped.tolist())),
            ("torque", "feed-forward torque", by_joint(report.saturated.tolist())),
        )
        if (total := sum(joints.values()))
    ]


def _recording(recording: Mapping[str, Any] | None) -> list[str]:
    if recording is None:
        return []
    if recording.get("removed"):
        return [_line("recording", f"{recording['path']} removed: nothing was received")]
    return [
        _line("recording", recording["path"]),
        *(_line("", lack) for lack in _lacks(recording)),
    ]


def _lacks(recording: Mapping[str, Any]) -> list[str]:
    """What a recording has not in it that it ought to have."""
    lacks = [f"missing from {topic}: {n}" for topic, n in recording["missing"].items() if n]
    lacks += [f"malformed on {topic}: {n}" for topic, n in recording["malformed"].items() if n]
    if dropped := recording["dropped_datagrams"]:
        lacks.append(f"{counted(dropped, 'datagram')} came that the kernel had no room for")
    if recording["stopped"]:
        lacks.append(f"it ended early: {recording['stopped']}")
    return lacks
