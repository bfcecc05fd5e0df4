"""`g1stream compare`: sessions of a motion beside others."""

from __future__ import annotations

from dataclasses import MISSING, dataclass
from pathlib import Path

from g1stream.cli.command import EXIT_OK, EXIT_STOPPED, Command, print_json, print_lines
from g1stream.cli.flags import argument, flag
from g1stream.cli.progress import showing_progress
from g1stream.errors import ConfigError

__all__ = ["Compare"]


@dataclass(frozen=True, kw_only=True)
class Compare(Command):
    """Compares sessions of one motion, over the part of it that all of them played.

    With two or more sessions on each side it tells which differences are more than the noise from
    run to run (Welch's t-test, adjusted by Holm's method). A condition names metrics of the table,
    `rmse.left_leg` or `rmse.left_knee_joint`; `base` is the base's mean of the same metric, and
    `p.rmse`, `p.left_leg` or `p.left_knee_joint` the p-value of a difference.

    Examples:
      g1stream compare before.mcap --with after.mcap
      g1stream compare a1.mcap a2.mcap a3.mcap --with b1.mcap b2.mcap b3.mcap
      g1stream compare good.mcap --with new.mcap -o compare.html
      g1stream compare good.mcap --with new.mcap --fail-if 'rmse > 1.1 * base'
      g1stream compare good?.mcap --with new?.mcap --fail-if 'p.rmse < 0.05'

    Exit codes:
      0  compared
      1  the condition of --fail-if holds, or cannot be told as it divides by 0
      2  bad input: not sessions of one motion, a condition that cannot be used,
         a page that cannot be written
    """

    base: tuple[Path, ...] = argument("Session files to compare with.", "BASE...")
    other: tuple[Path, ...] = flag(
        MISSING, "Session files that are compared with them.", "OTHER...", aliases=("--with",)
    )
    out: Path | None = flag(
        None, "A page that shows both sides over each other.", "HTML", aliases=("-o",)
    )
    force: bool = flag(False, "Replace a page that is there.")
    fail_if: str | None = flag(None, "Exit code 1 where this holds.", "CONDITION")
    json: bool = flag(False, "Print the comparison as JSON.")

    def run(self) -> int:
        """Compare, print, and return the exit code."""
        from g1stream.analysis.condition import Condition
        from g1stream.extras.report.compare import CONDITION_NAMES, compare

        if not self.base or not self.other:
            raise ConfigError(
                "Sessions on two sides are needed.",
                "Give both: g1stream compare BASE... --with OTHER...",
            )
        condition = None if self.fail_if is None else Condition(self.fail_if)
        if condition:  # refused now, and not when all sessions are read
            condition.require(CONDITION_NAMES)
            tested = [name for name in condition.metrics if name.startswith("p.")]
            if tested and min(len(self.base), len(self.other)) < 2:
                raise ConfigError(
                    f"{tested[0]} tells noise from change, and needs several sessions.",
                    "Give two or more on each side.",
                )
        with showing_progress() as progress:
            comparison = compare(
                self.base, self.other, page=self.out, force=self.force, progress=progress
            )
        truth = condition.holds(*comparison.named()) if condition else False
        failed = truth is not False
        if self.json:
            print_json(comparison.model_dump(mode="json") | {"failed": failed})
        else:
            print_lines(str(comparison))
            if condition:
                verdict = {
                    False: ("passed", "does not hold"),
                    True: ("FAILED", "holds"),
                    None: ("FAILED", "cannot be told: it divides by 0"),
                }[truth]
                print_lines("\n{0}: {text} {1}".format(*verdict, text=condition.text))
        return EXIT_STOPPED if failed else EXIT_OK
