"""`g1stream record`."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import tyro

from g1stream.cli.common import (
    EXIT_OK,
    EXIT_STOPPED,
    Flag,
    WireCommand,
    announce_wire,
    on_signals,
    print_json,
    value,
)
from g1stream.events import console_handler, handled_by
from g1stream.realtime import lower_priority

if TYPE_CHECKING:
    from g1stream.recorder.recorder_report import RecorderReport

__all__ = ["Record"]


@dataclass(frozen=True, kw_only=True)
class Record(WireCommand):
    """Record what is on the wire into a session file, whoever publishes it.

    Never disturbs what it watches. Ctrl-C ends the recording and closes the file.
    """

    settings: ClassVar[dict[str, str]] = {
        **WireCommand.settings,
        "split_size": "record.split_size",
        "split_duration": "record.split_duration",
        "auto_name": "record.auto_name",
    }

    file: Annotated[Path, tyro.conf.Positional, value("MCAP")]
    """The session file."""
    force: Flag = False
    """Replace a file that is there already."""
    auto_name: Flag = False
    """Put the time, UTC, into the file's name."""
    split_size: Annotated[float | None, value("MB", "one file")] = None
    """Split into parts of this size: name/name_0.mcap, name/name_1.mcap and so on."""
    split_duration: Annotated[float | None, value("S", "one file")] = None
    """Split into parts of this duration."""
    json: Flag = False
    """Print the summary as JSON on standard output."""

    def run(self) -> int:
        """Record, and return the exit code."""
        from g1stream.programs.record import record

        lower_priority()
        stopped: list[str] = []
        on_signals(stopped.append)
        config = self.resolve()

        def begun() -> None:
            announce_wire(config, commands=False)
            print(f"Recording {self.file}. Ctrl-C ends it.", file=sys.stderr)

        with handled_by(console_handler("record")):
            report = record(
                self.file,
                config,
                force=self.force,
                should_stop=lambda: bool(stopped),
                on_ready=begun,
            )
        if self.json:
            print_json(report.as_dict())
        else:
            print(_summary(report))
        return EXIT_OK if report.whole and report.first else EXIT_STOPPED


def _summary(report: RecorderReport) -> str:
    name = " ".join(report.paths)
    if not report.first:
        return f"{name}: nothing was received."
    width = max(map(len, report.counts))
    lines = [f"{name}: {report.as_dict()['duration_s']:.1f} s"]
    lines += [f"  {topic:<{width}}  {n:>8}" for topic, n in sorted(report.counts.items())]
    lines += [f"  missing from {topic}: {n}" for topic, n in report.missing.items() if n]
    lines += [f"  not of the type of {topic}: {n}" for topic, n in report.malformed.items()]
    lines += [f"  datagrams dropped by the kernel: {report.dropped}"] if report.dropped else []
    lines += [f"  absent: {', '.join(report.absent)}"] if report.absent else []
    lines += [
        f"  {topic} comes from {', '.join(delay['hosts'])}, whose clock is "
        f"{-delay['clock_offset_estimate_ns'] / 1e6:+.2f} ms from this one's, transit included"
        for topic, delay in report.delays.items()
        if "clock_offset_estimate_ns" in delay
    ]
    return "\n".join(lines)
