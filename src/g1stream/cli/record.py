"""`g1stream record`."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import tyro

from g1stream.cli.common import (
    EXIT_BAD_INPUT,
    EXIT_OK,
    EXIT_STOPPED,
    Flag,
    WireCommand,
    announce_wire,
    on_signals,
    print_json,
    value,
)
from g1stream.errors import G1StreamError
from g1stream.realtime import stand_back
from g1stream.types import WARNING

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
    """Go on in a new file (name_001.mcap, name_002.mcap) after so much."""
    split_duration: Annotated[float | None, value("S", "one file")] = None
    """Go on in a new file after so long."""
    json: Flag = False
    """Print the summary as JSON on standard output."""
    attached: Flag = False
    """For programs: speak JSON lines, and end when standard input does."""

    def run(self) -> int:
        """Record, and return the exit code."""
        from g1stream.programs.record import record

        stand_back()
        stopped: list[str] = []
        on_signals(stopped.append)
        if self.attached:
            return self._run_attached(stopped)
        config = self.resolve()

        def begun() -> None:
            announce_wire(config, commands=False)
            print(f"Recording {self.file}. Ctrl-C ends it.", file=sys.stderr)

        report = record(
            self.file,
            config,
            force=self.force,
            should_stop=lambda: bool(stopped),
            on_ready=begun,
            on_event=_print_event,
        )
        if self.json:
            print_json(report.as_dict())
        else:
            print(_summary(report))
        return EXIT_OK if report.whole and report.first else EXIT_STOPPED

    def _run_attached(self, stopped: list[str]) -> int:
        from g1stream.config import load_config
        from g1stream.programs.child_process import ParentLine
        from g1stream.programs.record import record

        parent = ParentLine()
        try:
            session = parent.greeting()
            report = record(
                self.file,
                load_config(over=session["config"]),
                force=self.force,
                session=session,
                should_stop=lambda: bool(stopped) or parent.gone.is_set(),
                on_ready=lambda: parent.say("ready"),
                on_event=_print_event,
                last_words=lambda: _merged(parent.received()),
            )
        except G1StreamError as error:
            parent.say("error", cause=error.cause, remedy=error.remedy)
            return EXIT_BAD_INPUT
        parent.say("done", path=" ".join(report.paths), **report.as_dict())
        return EXIT_OK


def _merged(lines: list[dict[str, Any]]) -> dict[str, Any]:
    return {key: value for line in lines for key, value in line.items()}


def _print_event(level: int, text: str) -> None:
    """Show a warning; what else the recorder tells is for the file."""
    if level >= WARNING:
        print(f"record: {text}", file=sys.stderr)


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
