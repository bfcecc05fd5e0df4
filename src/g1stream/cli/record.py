"""`g1stream record`: records the DDS topics into a session file."""

from __future__ import annotations

import logging
from contextlib import ExitStack
from dataclasses import MISSING, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from g1stream.cli.command import (
    LiveCommand,
    announce_wire,
    exit_code,
    on_signals,
    print_note,
    print_summary,
)
from g1stream.cli.flags import flag
from g1stream.cli.progress import ProgressDisplay, RecorderStatus
from g1stream.events import ConsoleHandler, handled_by
from g1stream.realtime import lower_priority

if TYPE_CHECKING:
    from g1stream.recorder.recorder import Recorder


@dataclass(frozen=True, kw_only=True)
class Record(LiveCommand):
    """Records the topics of the robot, the simulator and the streamer, whichever program publishes.

    It only subscribes, so it cannot disturb them. --ros-tf also publishes the robot for ROS 2.
    Ctrl-C ends the recording and closes the file.

    Examples:
      g1stream record -o session.mcap
      g1stream record -o robot.mcap --config robot --interface eth0

    Exit codes:
      0  recorded
      1  nothing was received, or samples are missing from the file
      2  bad input
    """

    out: Path = flag(MISSING, "The session file.", "MCAP")
    force: bool = flag(False, "Replace an existing file.")
    json: bool = flag(False, "Print the summary as JSON on standard output.")

    def run(self) -> int:
        """Record, and return the exit code."""
        from g1stream.app.record import record

        stopped: list[int] = []
        config = self.resolve()

        def on_ready() -> None:
            announce_wire(config, commands=False)
            print_note(f"Recording {self.out}. Ctrl-C ends it.")

        log = handled_by(ConsoleHandler(logging.WARNING))
        # Ctrl-C ends a server that does not start.
        with self.serving(config), on_signals(stopped.append), log, ExitStack() as stack:

            def on_recorder(recorder: Recorder) -> None:
                lower_priority()  # not that of the receiver, which is already running
                stack.enter_context(ProgressDisplay(RecorderStatus(recorder)))

            summary = record(
                self.out,
                config,
                force=self.force,
                should_stop=lambda: bool(stopped),
                on_ready=on_ready,
                on_recorder=on_recorder,
            )
        print_summary(summary, as_json=self.json)
        return exit_code(summary)
