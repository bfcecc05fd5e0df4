"""`g1stream plot`: plots joints of a session."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from g1stream.cli.command import EXIT_OK, print_result
from g1stream.cli.flags import argument, flag
from g1stream.cli.session_flags import SessionFlags


@dataclass(frozen=True, kw_only=True)
class Plot(SessionFlags):
    """By default it plots the joints that move most, the error over time and the RMSE of each
    joint. With --joints or --what it plots a row for each joint and a column for each quantity.

    Examples:
      g1stream plot session.mcap
      g1stream plot session.mcap --joints 'left_*' --what q,error,tau -o left.pdf

    Exit codes:
      0  written
      2  bad input: not a session file, nothing to plot, unknown joint
    """  # noqa: D205

    session: Path = argument("The session file.", "SESSION")
    joints: str | None = flag(
        None, "Joints, limbs or patterns, such as arms,waist_yaw,'left_*'.", "LIST", shown="all"
    )
    what: str | None = flag(None, "Quantities, separated by commas: q, dq, tau, error.", "LIST")
    out: Path = flag(Path("plot.png"), "The file to write: .png, .svg or .pdf.", "OUT")
    force: bool = flag(False, "Replace an existing file.")
    json: bool = flag(False, "Print the path as JSON.")

    def run(self) -> int:
        """Write the figure, and return the exit code."""
        from g1stream.analysis.plots import draw

        what = None if self.what is None else self.what.split(",")
        draw(self.open(self.session), self.out, self.joints, what, force=self.force)
        print_result({"path": str(self.out)}, str(self.out), as_json=self.json)
        return EXIT_OK
