"""`g1stream convert`: a motion file into a session file, or a check of it."""

from __future__ import annotations

import re
import signal
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from g1stream.analysis.render import counted
from g1stream.cli.command import (
    EXIT_OK,
    EXIT_STOPPED,
    Command,
    exit_code_of_signal,
    print_json,
    print_warning,
)
from g1stream.cli.flags import MOTION, argument, flag, fps_flag
from g1stream.cli.motion import joint_lines, result_lines
from g1stream.cli.progress import ProgressDisplay
from g1stream.errors import ConfigError

if TYPE_CHECKING:
    from g1stream.motion.check import FileReport
    from g1stream.programs.convert import ConvertReport
    from g1stream.robot.model import G1

__all__ = ["Convert", "render_check"]


class _StoppedError(BaseException):
    """A signal was received; its name is the argument."""


@dataclass(frozen=True, kw_only=True)
class Convert(Command):
    """Needs no robot, no simulator and no DDS. A failure leaves no file behind.

    Log and publish time of every message are the base time + frame / fps, to the nearest
    nanosecond. With the default base time the same input always gives the same bytes.

    With --check nothing is written: it prints what is in the file. Warnings do not change the exit
    code.

    Examples:
      g1stream convert dance.csv dance.mcap
      g1stream convert dance.csv part.mcap --frames 100:200 --resample 500
      g1stream convert dance.csv --check

    Exit codes:
      0        converted, or --check found no problems
      1        --check found a problem
      2        bad input, such as a file of another kind
      128 + n  ended by signal n, nothing was written: 130 after Ctrl-C
    """

    motion: str = argument(MOTION, "MOTION")
    out: Path | None = flag(
        None, "The file to write; not needed with --check.", "MCAP", positional=True
    )
    check: bool = flag(False, "Only check the motion file, and print what is in it.")
    fps: float | None = fps_flag()
    base_time: str = flag(
        "0",
        "Time of frame 0: ns since 1970, or ISO 8601 with a zone (2026-03-01T12:00:00Z).",
        "TIME",
    )
    frames: str = flag(
        ":",
        "Only frames A to B - 1; either may be left out. Each keeps its time.",
        "A:B",
        shown="all",
    )
    resample: float | None = flag(
        None,
        "Sample the spline through the frames, with velocities and accelerations, at this rate.",
        "HZ",
        shown="the frames as they are",
        gt=0,
    )
    no_floating_root: bool = flag(False, "Pin the root link at the world's origin.")
    root_link: str | None = flag(
        None, "The link whose pose is in the motion file.", "LINK", shown="the URDF's root"
    )
    world_frame: str = flag("world", "Name of the world's frame.", "NAME")
    flat: bool = flag(False, "Put every link straight under the world instead of under its parent.")
    urdf: Path | None = flag(None, "URDF of the robot.", "FILE", shown="the built-in 29-joint G1")
    topic: str = flag("/tf", "Topic of the transforms.", "TOPIC")
    compression: Literal["zstd", "lz4", "none"] = flag("zstd", "Compression of the file.")
    force: bool = flag(False, "Replace a file that exists already.")
    json: bool = flag(False, "Print the summary as JSON on standard output.")

    def run(self) -> int:
        """Convert or check, and return the exit code."""
        from g1stream.robot.model import G1

        robot = G1.load(self.urdf)
        if self.check:
            return self._check(robot)
        if self.out is None:
            raise ConfigError(
                "The output file is missing.",
                "Give it after the motion, such as motion.mcap, or add --check to only check.",
            )
        # Checked between chunks: an exception in a signal handler could come between creating the
        # temporary file and the code that removes it.
        stopped_by: list[str] = []
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, lambda got, _: stopped_by.append(signal.Signals(got).name))
        try:
            report = self._convert(robot, self.out, stopped_by)
        except _StoppedError as stopped:
            print(f"\nStopped by {stopped}; nothing was written.", file=sys.stderr)
            return exit_code_of_signal(str(stopped)) or EXIT_STOPPED
        for warning in report.warnings:
            print_warning(warning)
        if self.json:
            print_json(report.as_dict())
        else:
            print(_summary(report))
        return EXIT_OK

    def _convert(self, robot: G1, out: Path, stopped_by: list[str]) -> ConvertReport:
        from g1stream.programs.convert import Conversion, convert
        from g1stream.session.timestamps import parse_time

        options = Conversion(
            base_time_ns=parse_time(self.base_time),
            frames=_frames(self.frames),
            resample=self.resample,
            floating_root=not self.no_floating_root,
            root_link=self.root_link,
            world_frame=self.world_frame,
            flat=self.flat,
            topic=self.topic,
            compression=self.compression,
            force=self.force,
        )
        done = 0.0

        def on_progress(fraction: float) -> None:
            nonlocal done
            if stopped_by:
                raise _StoppedError(stopped_by[0])
            done = fraction

        with ProgressDisplay(lambda: (done, f"{100 * done:3.0f} %")):
            return convert(
                self.motion, out, options, robot=robot, fps=self.fps, on_progress=on_progress
            )

    def _check(self, robot: G1) -> int:
        from g1stream.session.motions import check_motion_file

        report = check_motion_file(self.motion, robot, fps=self.fps)
        if self.json:
            print_json({**asdict(report), "path": str(report.path), "passed": report.passed})
        else:
            print(render_check(report))
        return EXIT_OK if report.passed else EXIT_STOPPED


def _frames(text: str) -> tuple[int | None, int | None]:
    match = re.fullmatch(r"([0-9]*):([0-9]*)", text)
    if not match:
        raise ConfigError(
            f"{text!r} is not a range of frames.", "Give A:B, such as 100:200, 100: or :200."
        )
    first, behind = (int(number) if number else None for number in match.groups())
    return first, behind


def _summary(report: ConvertReport) -> str:
    return (
        f"{report.path}: {report.frames} frames at {report.rate:g} Hz, "
        f"{(report.end_ns - report.start_ns) / 1e9:.2f} s, {report.size / 1e6:.1f} MB"
    )


def render_check(report: FileReport) -> str:
    """The report of --check as text."""
    lines, motion = [f"{report.path}", *_content(report)], report.motion
    if motion:
        lines.append(
            f"  duration        {motion.duration:.3f} s: {motion.n_frames} frames at "
            f"{motion.fps:g} fps"
        )
        lines += joint_lines(motion)
    fault = (report.fault, report.remedy) if report.fault else ()
    return "\n".join([*lines, *result_lines(motion, fault)])


def _content(report: FileReport) -> list[str]:
    """The lines about the columns of the file."""
    if report.kind == "session":
        return ["  file            a session; its motion is the recorded reference"]
    header = "named by a header" if report.has_header else "no header"
    if report.mapped and not report.has_header:
        header += ", columns as in LAFAN1"
    lines = [
        f"  file            {counted(report.n_rows, 'row')}, "
        f"{counted(report.n_columns, 'column')}, {header}",
        f"  mapped columns  {len(report.mapped)}",
    ]
    mapped = [f"    {column:3d} {joint}" for joint, column in report.mapped.items()]
    lines += mapped if len(mapped) <= 10 else [*mapped[:5], "      ...", *mapped[-5:]]
    lines += [f"  not in the URDF {name}" for name in report.not_in_robot]
    lines += [f"  not in the file {name}" for name in report.not_in_file]
    if report.quat_norms:
        lowest, highest = report.quat_norms
        lines.append(f"  quaternion norm {lowest:.6f} to {highest:.6f}")
    return lines
