"""`g1stream record`."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

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
from g1stream.errors import ConfigError, G1StreamError

if TYPE_CHECKING:
    from g1stream.recording.recorder import RecorderReport

__all__ = ["Record"]


@dataclass(frozen=True, kw_only=True)
class Record(WireCommand):
    """Record what is on the wire into a session file, whoever publishes it.

    Never disturbs what it watches. Ctrl-C ends the recording and closes the file.
    """

    file: Annotated[Path, tyro.conf.Positional, value("MCAP")]
    """The session file."""
    force: Flag = False
    """Replace a file that is there already."""
    json: Flag = False
    """Print the summary as JSON on standard output."""
    attached: Flag = False
    """For programs: speak JSON lines, and end when standard input does."""

    def run(self) -> int:
        """Record, and return the exit code."""
        from g1stream.programs.record import record

        stopped: list[str] = []
        on_signals(stopped.append)
        if self.attached:
            return self._run_attached(stopped)
        config = self.resolve()
        announce_wire(config)
        print(f"Recording {self.file}. Ctrl-C ends it.", file=sys.stderr)
        report = record(self.file, config, force=self.force, should_stop=lambda: bool(stopped))
        if self.json:
            print_json(report.as_dict())
        else:
            print(_summary(self.file, report))
        return EXIT_OK if report.counts else EXIT_STOPPED

    def _run_attached(self, stopped: list[str]) -> int:
        from g1stream.config import Config
        from g1stream.programs.children import ParentLine
        from g1stream.programs.record import record

        parent = ParentLine()
        try:
            session = parent.next(timeout=10.0)
            if session is None:
                raise ConfigError(
                    "No session was described on standard input.",
                    "Leave out --attached; it is for programs that start a recorder.",
                )
            report = record(
                self.file,
                Config.model_validate(session["config"]),
                force=self.force,
                session=session,
                should_stop=lambda: bool(stopped) or parent.gone.is_set(),
                on_ready=lambda: parent.say("ready"),
                last_words=lambda: _merged(parent.received()),
            )
        except G1StreamError as error:
            parent.say("error", cause=error.cause, remedy=error.remedy)
            return EXIT_BAD_INPUT
        parent.say("done", path=str(self.file), **report.as_dict())
        return EXIT_OK


def _merged(lines: list[dict[str, Any]]) -> dict[str, Any]:
    return {key: value for line in lines for key, value in line.items()}


def _summary(path: Path, report: RecorderReport) -> str:
    if not report.counts:
        return f"{path}: nothing was published."
    width = max(map(len, report.counts))
    lines = [f"{path}: {report.as_dict()['duration_s']:.1f} s"]
    lines += [f"  {topic:<{width}}  {n:>8}" for topic, n in sorted(report.counts.items())]
    lines += [f"  missing from {topic}: {n}" for topic, n in report.missing.items() if n]
    return "\n".join(lines)
