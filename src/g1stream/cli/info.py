"""`g1stream info`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from g1stream.cli.common import EXIT_OK, Flag, value
from g1stream.cli.summary import print_summary

__all__ = ["Info"]


@dataclass(frozen=True, kw_only=True)
class Info:
    """Show what is in a session, how well it went, and its problems.

    Reads files of killed recorders too.
    """

    file: Annotated[Path, tyro.conf.Positional, value("MCAP")]
    """The session file, or one of its parts."""
    json: Flag = False
    """Print the summary as JSON."""

    def run(self) -> int:
        """Print the summary, and return the exit code."""
        from g1stream.session.session import open_session

        print_summary(open_session(self.file).summary(), as_json=self.json)
        return EXIT_OK
