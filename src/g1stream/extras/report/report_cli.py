"""`g1stream report`: reports on sessions as an HTML page, JSON or CSV."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

from g1stream.cli.command import EXIT_OK, print_json
from g1stream.cli.flags import argument, flag
from g1stream.cli.progress import showing_progress
from g1stream.cli.session_flags import SessionFlags

#: The default page.
_PAGE: Final = Path("report.html")


@dataclass(frozen=True, kw_only=True)
class Report(SessionFlags):
    """The page needs no network. It shows the run, the tracking error by joint and limb, body-space
    metrics, torque, the physics of the motion, timing, events, and figures of every joint. It
    includes a video or picture beside a session with the same name.

    Examples:
      g1stream report session.mcap
      g1stream report monday.mcap tuesday.mcap -o both.html
      g1stream report session.mcap --json | jq '.sessions[0].metrics.tracking'

    Exit codes:
      0  written or printed
      2  bad input: not a session file, a file that cannot be written
    """  # noqa: D205

    sessions: tuple[Path, ...] = argument("Session files.", "SESSION...")
    out: Path | None = flag(None, "The page to write.", "HTML", shown=str(_PAGE))
    force: bool = flag(False, "Replace an existing file.")
    json: bool = flag(
        False, "Print summary, metrics, physics as JSON; no page.", excludes=("csv", "out")
    )
    csv: bool = flag(False, "Print the metrics as CSV; no page.", excludes=("out",))

    def run(self) -> int:
        """Write the page or print the numbers, and return the exit code."""
        from g1stream.extras.report.page import numbers, report, to_csv

        sessions = map(self.open, self.sessions)  # one at a time, because each may be large
        if self.csv:
            print(to_csv(sessions), end="")
            return EXIT_OK
        with showing_progress() as progress:
            if self.json:
                found = numbers(sessions, progress)
            else:
                page = report(sessions, self.out or _PAGE, force=self.force, progress=progress)
        if self.json:
            print_json(found)
        else:
            print(page)
        return EXIT_OK
