"""`g1stream compare`: compares sessions of the same motion."""

from __future__ import annotations

from dataclasses import MISSING, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from g1stream.cli.command import (
    EXIT_OK,
    EXIT_STOPPED,
    print_json,
    print_lines,
    print_verdict,
)
from g1stream.cli.flags import argument, flag
from g1stream.cli.progress import showing_progress
from g1stream.cli.session_flags import SessionFlags
from g1stream.errors import ConfigError

if TYPE_CHECKING:
    from g1stream.app.session import Session


@dataclass(frozen=True, kw_only=True)
class Compare(SessionFlags):
    """Compares sessions of the same motion, over the part that all of them played.

    With several sessions on a side it shows how much they differ among themselves. A condition
    names a metric of the table, `rmse.left_leg` or `rmse.left_knee_joint`. `base` is the base's
    mean of the same metric. `g1stream report` draws several sessions.

    A condition also fails if a session of either side ended early, is void, or played less than was
    asked. A condition on `completed`, `played` or `success` replaces this rule; these names have
    the lowest value of all sessions.

    Examples:
      g1stream compare before.mcap --with after.mcap
      g1stream compare a1.mcap a2.mcap a3.mcap --with b1.mcap b2.mcap b3.mcap
      g1stream compare good.mcap --with new.mcap --fail-if 'rmse > 1.1 * base'
      g1stream compare a.mcap --with b.mcap --fail-if 'played < 0.5'

    Exit codes:
      0  compared
      1  a condition of --fail-if holds, or the sessions lack its metric, or
         with --fail-if a session was not played as asked
      2  bad input: not sessions of the same motion, or an invalid condition
    """

    base: tuple[Path, ...] = argument("Session files to compare with.", "BASE...")
    other: tuple[Path, ...] = flag(
        MISSING, "Session files to compare with the base.", "OTHER...", aliases=("--with",)
    )
    fail_if: list[str] = flag(
        (),
        "Exit code 1 if this holds: NAME OP NUMBER, or NAME OP NUMBER * base, OP one of "
        "< <= > >=. May be repeated.",
        "CONDITION",
        shown="none",
    )
    json: bool = flag(False, "Print the comparison as JSON.")

    def run(self) -> int:
        """Compare, print, and return the exit code."""
        from g1stream.analysis.metrics import NAMED_METRICS
        from g1stream.extras.report.comparison import CONDITION_NAMES, compare
        from g1stream.extras.report.fail_if import FailIf

        if not self.base or not self.other:
            raise ConfigError(
                "Sessions on both sides are needed.",
                "Give both: g1stream compare BASE... --with OTHER...",
            )
        with_base = [name for name in CONDITION_NAMES if name.partition(".")[0] in NAMED_METRICS]
        # Checked before the sessions are read.
        conditions = FailIf.parse_all(self.fail_if, CONDITION_NAMES, with_base)
        with showing_progress() as progress:
            sides: list[list[Session | Path]] = [[*self.base], [*self.other]]
            if self.motion is not None:  # otherwise sessions are opened one at a time
                sides = [[self.open(path) for path in side] for side in (self.base, self.other)]
            comparison = compare(*sides, progress=progress)
        other, base = comparison.named()
        truths = [one.holds(other.get(one.name), base.get(one.name)) for one in conditions]
        failed = any(truth is not False for truth in truths)
        if self.json:
            print_json(comparison.model_dump(mode="json") | {"failed": failed})
        else:
            print_lines(str(comparison))
            for one, truth in zip(conditions, truths, strict=True):
                if one.default and not truth:
                    continue
                verdict = {
                    False: "passed: {0.text} does not hold",
                    True: "FAILED: {0.text} holds",
                    None: "FAILED: {0.text} is unknown, because not all sessions have {0.name}",
                }[truth]
                print_lines("")
                if one.default:
                    verdict += " (tested unless a condition is on one of these names)"
                print_verdict(verdict.format(one), failed=truth is not False)
        return EXIT_STOPPED if failed else EXIT_OK
