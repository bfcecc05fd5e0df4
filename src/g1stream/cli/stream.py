"""`g1stream stream`: plays a motion, or the reference of a recorded session."""

from __future__ import annotations

import os
import sys
import textwrap
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Any, ClassVar, Final

from g1stream.cli.command import (
    EXIT_SIGNAL,
    LiveCommand,
    announce_wire,
    confirmed,
    exit_code,
    on_signals,
    print_lines,
    print_summary,
    print_warning,
    yes_flag,
)
from g1stream.cli.doctor import render as render_findings
from g1stream.cli.flags import flag
from g1stream.cli.motion_flags import MOTIONS, MotionFlags
from g1stream.cli.progress import ProgressDisplay, loop_status
from g1stream.control.stop import Stop
from g1stream.errors import ConfigError
from g1stream.events import ConsoleHandler, handled_by

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from g1stream.app.arming import ArmingReport
    from g1stream.control.loop import StreamLoop
    from g1stream.motion.motion import Motion

#: Text width of the arming report, in characters.
_WIDTH: Final = 98


def may_arm(report: ArmingReport, *, yes: str | None) -> bool:
    """Print the report, and ask whether to command the robot, unless `yes` names the interface."""
    print_lines(render_arming(report), sys.stderr)
    return confirmed(report.interface, yes)


def render_arming(report: ArmingReport) -> str:
    """The arming report as text."""
    worst = report.furthest
    limits = ", ".join(f"{name} = {value}" for name, value in report.limits.items())
    lines = [
        f"ARMING: domain {report.domain} on {report.interface}",
        f"pose: pelvis tilted by {report.tilt:.2f} rad",
        "to the first frame:",
    ]
    for limb in report.limbs:
        kp, kd = (f"{low:g} to {high:g}" for low, high in (limb.kp, limb.kd))
        lines.append(f"  {limb.limb:<10} {limb.distance:+.2f} rad  {limb.joint}, kp {kp}, kd {kd}")
    service = report.motion_service
    said = f"{service.about}: {service.cause}"
    if service.remedy:  # directly above the question
        said = textwrap.fill(f"WARNING: {service.cause} {service.remedy}", _WIDTH)
    lines += [
        f"  furthest   {worst.distance:+.2f} rad  {worst.joint}",
        f"ramp: {report.ramp:.1f} s, at up to {report.peak_speed:.2f} rad/s",
        textwrap.fill(f"limits: {limits}", _WIDTH, subsequent_indent="  "),
    ]
    if report.wider:
        lines += ["WARNING: these settings are not those of the profile robot:"]
        lines += [f"  {value}" for value in report.wider]
    lines += [render_findings(report.findings), said]
    return "\n".join(lines)


@contextmanager
def playing() -> Iterator[Callable[[StreamLoop, Motion], None]]:
    """Print events, and yield a function that prepares a loop. Call it before the loop runs.

    It lets signals stop the loop and displays its progress. A signal that comes before there is a
    loop stops the loop in WAIT, and a second one ends the process, because nothing has been sent
    yet. The signal handlers stay until the recording is complete.
    """
    loops: list[StreamLoop] = []
    early: list[int] = []

    def stop(number: int) -> None:
        if early and not loops:  # a policy's rehearsal takes seconds
            raise SystemExit(EXIT_SIGNAL + number)
        early.append(number)
        for loop in loops:
            loop.request_stop(Stop.by_signal(number))

    with ExitStack() as stack:
        stack.enter_context(on_signals(stop))
        stack.enter_context(handled_by(ConsoleHandler()))

        def prepare(loop: StreamLoop, motion: Motion) -> None:
            if loop.wait_for == "enter":
                _require_keys()
                Thread(target=_go_on_by_key, args=(loop,), daemon=True).start()
            loops.append(loop)
            if early:
                loop.request_stop(Stop.by_signal(early[0]))
            stack.enter_context(ProgressDisplay(lambda: loop_status(loop, motion)))

        yield prepare


def _require_keys() -> None:
    """Refuse to wait for a key that cannot be read."""
    try:
        ours = not os.isatty(0) or os.tcgetpgrp(0) == os.getpgrp()
        ours &= not os.path.samestat(os.fstat(0), Path(os.devnull).stat())
    except OSError:
        ours = False
    if sys.stdin is None or not ours:
        raise ConfigError(
            "Nobody can press Enter: standard input is closed or empty, or this is a background "
            "process.",
            "Run it in the foreground, or give a button of the remote to --wait-for.",
        )


def _go_on_by_key(loop: StreamLoop) -> None:
    """Let a resting motion go on at each line of standard input, until that ends."""
    with suppress(OSError):  # the terminal is gone
        # Unbuffered, because a thread with the lock of a buffer would not let Python exit.
        while text := os.read(0, 1024):
            if b"\n" in text:
                loop.go_on()
    loop.end_at_rest("standard input has ended, so nobody can press Enter")


@dataclass(frozen=True, kw_only=True)
class Stream(LiveCommand, MotionFlags):
    """Waits for a LowState, moves to the first frame, plays, holds the last frame, and damps.

    Ctrl-C damps the robot and ends. With --support feet the robot squats first, and with --policy
    it stands first; a second Ctrl-C damps at once. docs/feet.md and docs/policy.md say how to put
    it on its feet in each simulator.

    Examples:
      g1stream stream demo
      g1stream stream dance.csv --record dance.mcap --support hanging
      g1stream stream dance.csv --support feet --joints arms,waist
      g1stream stream dance.csv --policy policy.onnx --record dance.mcap
      g1stream stream wave.csv dance.npz --blend 1 --start 2 --mirror
      g1stream stream dance.csv --config robot --interface eth0 --arm --duration 5

    Exit codes:
      0        played as asked
      1        something stopped it, or the recording is incomplete
      2        bad input
      128 + n  ended by signal n: 130 after Ctrl-C
    """

    defaults: ClassVar = {"profile": "by the interface"}

    motions: tuple[str, ...] = flag(
        (), MOTIONS, "MOTION...", positional=True, shown="the policy's own"
    )
    record: Path | None = flag(None, "Record the session into this file.", "MCAP", aliases=("-o",))
    force: bool = flag(False, "Replace an existing recording.", needs=("record",))
    gains: Path | None = flag(
        None,
        "File with tables [kp] and [kd]: joint name or pattern = gain. Overrides the config.",
        "TOML",
        shown="those of Unitree's example",
        advanced=True,
    )
    arm: bool = flag(
        False,
        "Show what will be sent to which robot, and ask first. Required on anything but loopback.",
    )
    yes: str | None = yes_flag("arm", advanced=True)
    scale_time: bool = flag(
        False,
        "Slow down the whole motion until all joints keep their speed limits.",
        advanced=True,
        excludes=("clamp", "anyway"),
    )
    clamp: bool = flag(
        False,
        "Play a motion that exceeds joint limits, with targets clamped to positions and speeds.",
        advanced=True,
        excludes=("anyway",),
    )
    anyway: bool = flag(
        False,
        "Play a motion that exceeds joint limits at its own speeds, or a policy that falls in its "
        "rehearsal (loopback interface only).",
        advanced=True,
    )
    json: bool = flag(False, "Print the summary as JSON on standard output.")

    def overrides(self) -> dict[str, Any]:
        """The flags that were given, and the tables of the gains file."""
        over = super().overrides()
        if self.gains:
            from g1stream.control.gains import read_gains

            over |= {f"gains.{name}": table for name, table in read_gains(self.gains).items()}
        for name in ("scale_time", "clamp", "anyway"):
            if getattr(self, name):
                over["stream.beyond_limits"] = name.replace("_", "-")
        return over

    def run(self) -> int:
        """Play, and return the exit code."""
        from g1stream.app.stream import stream
        from g1stream.motion.readers import default_motion
        from g1stream.robot.model import G1

        config = self.resolve()
        motion = self.load(self.motions or [default_motion(config)], G1.of_config(config))
        print_warning(*motion.warnings)
        if not config.stream.policy and (nets := [m for m in self.motions if m.endswith(".onnx")]):
            print_warning(
                f"{nets[0]} moves the robot without its network: on its own feet the robot "
                f"falls. `--policy {nets[0]}` plays it with the network."
            )
        announce_wire(config)
        with self.serving(config), playing() as prepare:
            summary = stream(
                motion,
                config,
                record=self.record,
                force=self.force,
                arm=partial(may_arm, yes=self.yes) if self.arm else None,
                on_loop=lambda loop: prepare(loop, motion),
            )
        print_summary(summary, as_json=self.json)
        return exit_code(summary)
