"""`g1stream repair`: adds the index to a session whose recorder was killed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from g1stream.cli.command import EXIT_OK, Command, print_lines
from g1stream.cli.flags import argument
from g1stream.text import counted


@dataclass(frozen=True, kw_only=True)
class Repair(Command):
    """Viewers such as Rerun show nothing from a file without an index. g1stream needs no index.

    The file is replaced when its copy with an index is complete. All whole messages stay unchanged,
    byte for byte. A file that has an index is not changed.

    Examples:
      g1stream repair session.mcap

    Exit codes:
      0  all files of the session have an index
      2  bad input: not a session, damaged, or still being recorded
    """

    session: Path = argument("The session file, or the directory of a split recording.", "SESSION")

    def run(self) -> int:
        """Write the index, and return the exit code."""
        from g1stream.session.repair import repair_session

        for path, messages, dropped in repair_session(self.session):
            done = "complete already" if dropped is None else "index written"
            if dropped:
                done += f", {counted(dropped, 'byte')} of an unfinished record dropped"
            print_lines(f"{path}: {done}; {counted(messages, 'message')}")
        return EXIT_OK
