"""`g1stream identify`: which robot a session was recorded on."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from g1stream.cli.command import EXIT_OK, Command, print_json, print_lines
from g1stream.cli.flags import argument, flag
from g1stream.text import counted
from g1stream.types import Support

if TYPE_CHECKING:
    from g1stream.analysis.identify import Identification

__all__ = ["Identify"]


@dataclass(frozen=True, kw_only=True)
class Identify(Command):
    """Compares measured torques with the models of both revisions of the G1.

    The robot must have been bolted, or have hung from its torso.

    Examples:
      g1stream identify session.mcap
      g1stream identify session.mcap --support hanging

    Exit codes:
      0  identified
      2  bad input: not a session file, an unknown support, too little motion
    """

    file: Path = argument("The session file, or the directory of a split recording.", "SESSION")
    support: Support | None = flag(None, "How the robot was held; as the session says if unset.")
    json: bool = flag(False, "Print it as JSON.")

    def run(self) -> int:
        """Print what was found, and return the exit code."""
        from g1stream.analysis.identify import identify
        from g1stream.session.session import open_session

        found = identify(open_session(self.file), self.support)
        if self.json:
            print_json(found.model_dump(mode="json"))
        else:
            print_lines(_text(found))
        return EXIT_OK


def _text(found: Identification) -> str:
    centre = zip(found.torso_centre_m, found.torso_centre_deviation_m, strict=True)
    mass = "not known: the band carries the torso"
    if found.torso_mass_kg is not None:
        mass = f"{found.torso_mass_kg:.2f} +- {found.torso_mass_deviation_kg or 0.0:.2f} kg"
    return "\n".join(
        (
            f"robot          {found.robot}",
            f"torques        at {found.position:.2f}: {', '.join(found.compared)} are 0 and 1",
            f"torso mass     {mass}",
            f"torso centre   {', '.join(f'{1e3 * x:.1f} +- {1e3 * d:.1f}' for x, d in centre)} mm",
            f"time           {found.time_scale:.3f} of real time",
            f"from           {counted(found.windows, 'window')} of 0.1 s, support {found.support}",
        )
    )
