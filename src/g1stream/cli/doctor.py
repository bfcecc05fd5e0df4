"""`g1stream doctor`: checks DDS, robot and machine; the worst finding sets the exit code."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING

from g1stream.cli.command import SettingsCommand, print_json, print_lines
from g1stream.cli.flags import flag
from g1stream.events import is_quiet
from g1stream.text import labelled

if TYPE_CHECKING:
    from collections.abc import Iterable

    from g1stream.doctor.facts import Finding


@dataclass(frozen=True, kw_only=True)
class Doctor(SettingsCommand):
    """Checks the interface, the DDS domain, the robot or simulator, and wake-up latency.

    It only subscribes; it publishes nothing. DDS announces a subscriber on the chosen interface and
    on loopback. If no LowState is found there, the other interfaces to look on are named.

    Examples:
      g1stream doctor
      g1stream doctor --config robot --interface eth0 --seconds 5

    Exit codes:
      0  no problems found
      1  warnings
      2  problems, or bad input
    """

    seconds: float = flag(1.0, "Time to listen.", "SECONDS", gt=0)
    json: bool = flag(False, "Print the findings as JSON on standard output.")

    def run(self) -> int:
        """Diagnose, and return the exit code."""
        from g1stream.doctor.inspection import diagnose

        findings = diagnose(self.resolve(), self.seconds)
        if self.json:
            print_json([one.model_dump(mode="json") for one in findings])
        elif not is_quiet():
            print_lines(render(findings))
        elif serious := [one for one in findings if one.level]:
            print_lines(render(serious), sys.stderr)
        return max(one.level for one in findings)


def render(findings: Iterable[Finding]) -> str:
    """The findings as text: a line each for cause and remedy."""
    lines = []
    for finding in findings:
        label = f"{finding.level.name.lower():<8} {finding.about:<13} "
        lines.append(labelled(label, finding.cause))
        if finding.remedy:
            lines.append(labelled(" " * len(label), finding.remedy))
    return "\n".join(lines)
