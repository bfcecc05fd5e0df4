"""`g1stream record`."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import tyro

from g1stream.cli.common import (
    Flag,
    WireCommand,
    announce_wire,
    on_signals,
    value,
)
from g1stream.cli.summary import exit_code, print_summary
from g1stream.events import console_handler, handled_by
from g1stream.realtime import lower_priority

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
            summary = record(
                self.file,
                config,
                force=self.force,
                should_stop=lambda: bool(stopped),
                on_ready=begun,
            )
        print_summary(summary, as_json=self.json)
        return exit_code(summary)
