"""`g1stream info`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from g1stream.cli.common import EXIT_OK, Flag, print_json, value

__all__ = ["Info"]


@dataclass(frozen=True, kw_only=True)
class Info:
    """Look into a session file: what is in it, how well it went, and what is amiss.

    Reads files of killed recorders too.
    """

    file: Annotated[Path, tyro.conf.Positional, value("MCAP")]
    """The session file, or one of its parts."""
    json: Flag = False
    """Print the findings as JSON."""

    def run(self) -> int:
        """Look, and return the exit code."""
        from g1stream.analysis.info import describe
        from g1stream.analysis.info_text import render_info
        from g1stream.session.session import open_session

        info = describe(open_session(self.file))
        if self.json:
            print_json(info.as_dict())
        else:
            print(render_info(info))
        return EXIT_OK
