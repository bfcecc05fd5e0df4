"""`g1stream info`: prints the contents of a session file."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from g1stream.cli.command import EXIT_OK, print_summary, print_warning
from g1stream.cli.flags import argument, flag
from g1stream.cli.session_flags import SessionFlags
from g1stream.errors import RecordingError
from g1stream.events import is_quiet


@dataclass(frozen=True, kw_only=True)
class Info(SessionFlags):
    """Also reads files of recorders that were killed.

    Examples:
      g1stream info session.mcap
      g1stream info session.mcap --all
      g1stream info session.mcap --json | jq .

    Exit codes:
      0  printed
      2  bad input: not a session file
    """

    file: Path = argument("The session file.", "SESSION")
    all: bool = flag(False, "Print all that is known, such as settings, phases and each topic.")
    json: bool = flag(False, "Print the summary as JSON, which has all of it.")

    def run(self) -> int:
        """Print the summary, and return the exit code."""
        session = self.open(self.file)
        summary = session.summary()
        if summary.moves:  # without a moving base the links add nothing to the joints
            with suppress(RecordingError):  # the summary lists the file's problems
                metrics = session.metrics()
                summary.success = metrics.success
                summary.terminations = metrics.body.terminations if metrics.body else None
        if is_quiet():
            print_warning(*summary.problems)
        print_summary(summary, as_json=self.json, details=self.all)
        return EXIT_OK
