"""`g1stream doctor`."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from g1stream.cli.common import Flag, WireCommand, print_json, value
from g1stream.errors import ConfigError

if TYPE_CHECKING:
    from g1stream.doctor.facts import Finding

__all__ = ["Doctor"]


@dataclass(frozen=True, kw_only=True)
class Doctor(WireCommand):
    """Find out what keeps g1stream and a robot or simulator apart, or the loop from being on time.

    Only listens. Exit code 0: all well, 1: warnings, 2: problems.
    """

    seconds: Annotated[float, value("S", "1")] = 1.0
    """How long to listen."""
    json: Flag = False
    """Print the findings as JSON on standard output."""

    def run(self) -> int:
        """Look, and return the exit code."""
        from g1stream.programs.doctor import diagnose

        if not 0.0 < self.seconds < math.inf:
            raise ConfigError(
                f"The doctor cannot listen for {self.seconds} s.", "Give --seconds above 0."
            )
        findings = diagnose(self.resolve(), self.seconds)
        if self.json:
            print_json([one.model_dump(mode="json") for one in findings])
        else:
            print("\n".join(map(_text, findings)))
        return max(one.level for one in findings)


def _text(finding: Finding) -> str:
    line = f"{finding.level.name.lower():<8} {finding.about:<13} {finding.cause}"
    return f"{line}\n{'':<22} {finding.remedy}" if finding.remedy else line
