"""`g1stream stream`."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import tyro

from g1stream.cli.common import (
    EXIT_OK,
    EXIT_STOPPED,
    Flag,
    WireCommand,
    announce_wire,
    exit_code_of_signal,
    on_signals,
    print_json,
    value,
)
from g1stream.cli.watch import watching
from g1stream.realtime import told

if TYPE_CHECKING:
    from g1stream.control.loop import StreamLoop
    from g1stream.programs.outcome import StreamOutcome

__all__ = ["PlayCommand", "Stream", "exit_code", "summary"]


@dataclass(frozen=True, kw_only=True)
class PlayCommand(WireCommand):
    """Flags of the subcommands that play something on a robot."""

    settings: ClassVar[dict[str, str]] = {
        **WireCommand.settings,
        "rate": "stream.rate",
        "start": "stream.start",
        "duration": "stream.duration",
        "loop": "stream.loop",
        "ramp": "stream.ramp",
        "feedforward": "stream.feedforward",
        "support": "stream.support",
        "allow_second_writer": "safety.allow_second_writer",
        "auto_name": "record.auto_name",
        "split_size": "record.split_size",
        "split_duration": "record.split_duration",
    }

    record: Annotated[Path | None, value("MCAP")] = None
    """Record the session into this file."""
    force: Flag = False
    """Replace a recording that is there already."""
    auto_name: Flag = False
    """Put the time, UTC, into the recording's name."""
    split_size: Annotated[float | None, value("MB", "one file")] = None
    """Record on in a new file (name_001.mcap, name_002.mcap) after so much."""
    split_duration: Annotated[float | None, value("S", "one file")] = None
    """Record on in a new file after so long."""
    rate: Annotated[float | None, value("HZ", "500")] = None
    """LowCmd per second."""
    start: Annotated[float | None, value("S", "0")] = None
    """Where in the motion to start."""
    duration: Annotated[float | None, value("S", "to its end")] = None
    """How much of the motion to play."""
    loop: Flag = False
    """Play again and again until stopped."""
    ramp: Annotated[float | None, value("S", "3")] = None
    """Time from the measured pose to the first frame."""
    feedforward: Annotated[
        Literal["none", "velocity", "dynamics"] | None,
        value(
            "{none,velocity,dynamics}",
            "dynamics where a simulator here says how it holds, velocity elsewhere",
        ),
    ] = None
    """What commands carry beside the position: nothing, velocity, or velocity and torque."""
    support: Annotated[
        Literal["bolted", "hanging", "follow", "free"] | None,
        value("{bolted,hanging,follow,free}", "as the simulator says"),
    ] = None
    """How the robot is held, for the torque; a wrong answer follows worse than none."""
    gains: Annotated[Path | None, value("TOML", "those of Unitree's example")] = None
    """File with tables [kp] and [kd]: joint name or pattern = gain. Goes over the config's."""
    allow_second_writer: Flag = False
    """Play although somebody else commands the robot. Dangerous."""
    json: Flag = False
    """Print the summary as JSON on standard output."""

    def overrides(self) -> dict[str, Any]:
        """The flags that were given, and the gains file's tables."""
        from g1stream.config import read_toml

        over = super().overrides()
        if self.gains:
            over |= {f"gains.{name}": table for name, table in read_toml(self.gains).items()}
        return over

    def report(self, outcome: StreamOutcome) -> int:
        """Print how it went, and return the exit code."""
        if self.json:
            print_json(outcome.as_dict())
        else:
            print(summary(outcome))
        return exit_code(outcome)


@dataclass(frozen=True, kw_only=True)
class Stream(PlayCommand):
    """Play a motion on whatever robot listens: publish it as LowCmd, watch LowState.

    Waits for a LowState, moves to the first frame, plays, holds, damps. Ctrl-C damps and ends.
    """

    motion: Annotated[str, tyro.conf.Positional, value("MOTION")]
    """Motion file (CSV), session file, or the name of a bundled motion: demo."""
    fps: Annotated[float | None, value("N", "30")] = None
    """Frames per second of the motion file."""

    def run(self) -> int:
        """Play, and return the exit code."""
        from g1stream.programs.stream import stream
        from g1stream.recording.motions import load_motion
        from g1stream.robot.model import G1

        config = self.resolve()
        motion = load_motion(self.motion, G1.load(config.robot), fps=self.fps)
        for warning in motion.warnings:
            print(f"warning: {warning}", file=sys.stderr)
        announce_wire(config)

        with watching() as watch:

            def prepare(loop: StreamLoop) -> None:
                on_signals(loop.request_stop)
                watch(loop, motion)

            outcome = stream(motion, config, record=self.record, force=self.force, on_loop=prepare)
        return self.report(outcome)


def exit_code(outcome: StreamOutcome) -> int:
    """0 for a motion played to its end, 128 + n for signal n, 1 for what else stopped it.

    1 as well where it was to be recorded and something of it is not in the file.
    """
    reason = outcome.report.reason
    recording = outcome.recording
    if not reason:
        lost = recording and (
            recording["stopped"]
            or recording["dropped_datagrams"]
            or any(recording["missing"].values())
            or any(recording["malformed"].values())
        )
        return EXIT_STOPPED if lost else EXIT_OK
    return exit_code_of_signal(reason) or EXIT_STOPPED


def summary(outcome: StreamOutcome) -> str:
    """How it went, for people."""
    report = outcome.report
    lateness = report.lateness
    ended = f"stopped: {report.reason}" if report.reason else "played to its end"
    if not report.commands:
        lines = [f"{outcome.motion}: no command was sent; {report.reason}."]
        lines += [f"  {finding.cause}\n  {finding.remedy}" for finding in outcome.findings]
        return "\n".join(lines)
    lines = [
        f"{outcome.motion}: {ended}",
        f"  commands   {report.commands} at {report.rate:.2f} Hz "
        f"({1e9 / report.period:g} asked for), {report.skipped} ticks skipped",
        "  lateness   "
        + ", ".join(f"p{p:g} {lateness.percentile_us(p):.0f} us" for p in (50, 99, 99.9))
        + f", max {lateness.maximum_ns / 1000:.0f} us",
        f"  states     {_states(outcome.wire)}",
        f"  real time  {told(outcome.granted)}",
    ]
    if clamped := int(report.clamped.sum()):
        lines.append(f"  limits     {clamped} joint targets were held at their limit")
    if saturated := int(report.saturated.sum()):
        lines.append(f"  torque     {saturated} feed-forward torques were held at their limit")
    if outcome.recording:
        lines += _recording(outcome.recording)
    return "\n".join(lines)


def _states(wire: dict[str, int | None]) -> str:
    missed = wire["states_missed"]
    lost = (
        "how many were lost is unknown: they carry no tick" if missed is None else f"{missed} lost"
    )
    return f"{wire['states_received']} received, {lost}"


def _recording(recording: dict[str, Any]) -> list[str]:
    lines = [f"  recording  {recording['path']}"]
    lines += [f"             missing from {t}: {n}" for t, n in recording["missing"].items() if n]
    if recording["stopped"]:
        lines.append(f"             it ended early: {recording['stopped']}")
    return lines
