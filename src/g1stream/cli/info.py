"""`g1stream info`: what is in a session file."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from g1stream.cli.command import EXIT_OK, print_summary
from g1stream.cli.flags import argument, flag
from g1stream.cli.session_flags import SessionFlags
from g1stream.errors import RecordingError


@dataclass(frozen=True, kw_only=True)
class Info(SessionFlags):
    """Reads files of killed recorders too.

    Examples:
      g1stream info session.mcap
      g1stream info session.mcap --json | jq .

    Exit codes:
      0  printed
      2  bad input: not a session file
    """

    file: Path = argument("The session file, or the directory of a split recording.", "SESSION")
    json: bool = flag(False, "Print the summary as JSON.")

    def run(self) -> int:
        """Print the summary, and return the exit code."""
        session = self.open(self.file)
        summary = session.summary()
        if summary.moves:  # elsewhere the links tell nothing that the joints do not
            with suppress(RecordingError):  # the problems say what is wrong with the file
                metrics = session.metrics()
                summary.success = metrics.success
                summary.terminations = metrics.body.terminations if metrics.body else None
        print_summary(summary, as_json=self.json)
        return EXIT_OK
