"""`g1stream library`: many motions at once."""

from __future__ import annotations

import sys
from collections import Counter
from dataclasses import dataclass
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, cast, get_args

from g1stream.cli.command import (
    EXIT_OK,
    EXIT_STOPPED,
    SettingsCommand,
    exit_code_of_signal,
    on_signals,
    print_lines,
    print_warning,
)
from g1stream.cli.flags import argument, flag
from g1stream.cli.progress import ProgressDisplay
from g1stream.errors import ConfigError
from g1stream.text import counted, labelled, table
from g1stream.types import StreamSupport, Support

if TYPE_CHECKING:
    from g1stream.cli.fail_if import FailIf
    from g1stream.extras.library.compute import LibraryCase
    from g1stream.extras.library.run import LibraryRun
    from g1stream.extras.library.table import MotionRow

#: Motions that are named where several failed.
_NAMED: Final = 5
#: Between two lines of progress where there is no terminal, s.
_IN_PIPE_S: Final = 30.0


@dataclass(frozen=True, kw_only=True)
class Library(SettingsCommand):
    """Checks or simulates all motion files in directories, copies of a file once.

    check: what `g1stream physics` says. simulate: plays each motion on a simulated robot,
    faster than real time, once for each support.

    The result is a directory with Parquet tables, a row for each motion and one for each of its
    joints, and index.html. A file that is broken, or takes too much time or memory, is a row with
    its reason. The same command continues where it was ended, and computes again what other
    settings or versions change. docs/library.md has the columns; a condition names one that is a
    number or a yes (1) or no (0), or `ok`, which is 1 for a row whose status is ok.

    Examples:
      g1stream library check motions -o library
      g1stream library simulate motions --support bolted,hanging
      g1stream library check motions --fail-if 'max_collision > 10'
      g1stream library check motions --cluster tcp://head:8786

    Exit codes:
      0        computed; that a motion failed is a result, too
      1        a condition of --fail-if holds, or cannot be told, for a row;
               or rows are missing
      2        bad input
      128 + n  ended by signal n; what was computed is kept
    """

    action: Literal["check", "simulate"] = argument(
        "check limits and physics of the motions, or simulate a robot that plays them. Flags that "
        "begin with an action go with that one only.",
        "ACTION",
    )
    places: tuple[str, ...] = argument("Directories, or motion files.", "PATH...")
    out: Path = flag(Path("library"), "Directory of the tables.", "DIR", aliases=("-o",))
    support: str | None = flag(
        None,
        f"simulate: how the pelvis is held: {', '.join(get_args(StreamSupport))}; several with "
        "commas.",
        "SUPPORT",
        shown="bolted",
    )
    sessions: bool = flag(False, "simulate: keep each session, and its report.")
    workers: int | None = flag(None, "Processes on this machine.", "N", shown="CPUs", gt=0)
    cluster: str | None = flag(
        None, "Use the workers of this Dask scheduler instead (extra `cluster`).", "ADDRESS"
    )
    time_limit: float = flag(600.0, "Time for a motion.", "S", gt=0)
    memory_limit: float = flag(4000.0, "Memory for a motion.", "MB", gt=0)
    fail_if: list[str] = flag(
        (),
        "Exit code 1 where this holds for a row: NAME OP NUMBER, OP one of < <= > >=. May be "
        "repeated.",
        "CONDITION",
        shown="none",
    )
    json: bool = flag(False, "Print a line of JSON for each row that is computed.")

    def run(self) -> int:
        """Compute, and return the exit code."""
        from g1stream.cli.fail_if import FailIf
        from g1stream.extras.library.processes import Limits
        from g1stream.extras.library.run import LibraryRun, run_library
        from g1stream.extras.library.table import CONDITION_NAMES, newest_motions

        self._check_flags()
        # Refused now, and not when all is computed.
        conditions = [FailIf.parse(text, CONDITION_NAMES) for text in self.fail_if]
        cases = self._cases()
        run, reasons = LibraryRun(), list[str]()

        def print_row(row: MotionRow) -> None:
            if self.json:
                print(row.model_dump_json(exclude={"picture"}), flush=True)

        with on_signals(reasons.append), ProgressDisplay(run.status, in_pipe=_IN_PIPE_S):
            run_library(
                self.places,
                cases,
                workers=self.workers,
                cluster=self.cluster,
                limits=Limits(self.time_limit, self.memory_limit),
                run=run,
                on_row=print_row,
                stop=lambda: bool(reasons),
                warn=print_warning,
            )
        found = newest_motions(self.out) if run.done or run.known else None
        rows = [] if found is None else found[found["key"].isin(run.keys)].to_dict("records")
        supports = {case.support: i for i, case in enumerate(cases)}
        rows.sort(key=lambda row: (supports.get(row["support"], -1), row["path"]))
        out = sys.stderr if self.json else None
        lines = [*_about(run, self.out), *_results(rows), *_problems(run, rows)]
        print_lines("\n".join(lines), out)
        verdicts = [_verdict(one, rows, complete=run.complete) for one in conditions]
        for _, line in verdicts:
            print_lines(line, out)
        failed = any(one_failed for one_failed, _ in verdicts)
        if reasons:
            return exit_code_of_signal(reasons[0]) or EXIT_STOPPED
        return EXIT_STOPPED if failed or not run.complete else EXIT_OK

    def _check_flags(self) -> None:
        for name, given in (("--support", self.support), ("--sessions", self.sessions)):
            if given and self.action != "simulate":
                raise ConfigError(
                    f"{name} has no effect on library {self.action}.", "Leave it out."
                )
        if self.workers and self.cluster:
            raise ConfigError("--workers and --cluster exclude each other.", "Give one of them.")

    def _cases(self) -> list[LibraryCase]:
        from g1stream.extras.library.compute import LibraryCase

        config, out = self.resolve(), self.out
        if self.action == "check":
            return [LibraryCase("check", out, config)]
        asked = dict.fromkeys((self.support or config.sim.support).split(","))
        if unknown := asked.keys() - set(get_args(StreamSupport)):
            raise ConfigError(
                f"There is no support {min(unknown)!r}.",
                f"Choose from {', '.join(get_args(StreamSupport))}.",
            )
        supports = cast("list[StreamSupport]", list(asked))
        return [
            LibraryCase("simulate", out, config, support, sessions=self.sessions)
            for support in supports
        ]


def _verdict(condition: FailIf, rows: list[dict[str, Any]], *, complete: bool) -> tuple[bool, str]:
    """Whether a condition fails the run, and that in words."""
    from g1stream.extras.library.table import condition_value

    truths = [condition.holds(condition_value(row, condition.name)) for row in rows]
    held = {
        text: [row for row, truth in zip(rows, truths, strict=True) if truth is one]
        for text, one in (("holds", True), ("cannot be told", None))
    }
    failed = any(held.values())
    verdict = ", and ".join(
        f"{text} for {counted(len(of), 'row')}, such as {of[0]['name']}"
        for text, of in held.items()
        if of
    )
    label = "FAILED: " if failed else "passed: " if complete else "not decided: "
    there = "" if complete else f" of the {counted(len(rows), 'row')} that are there"
    verdict = verdict or f"holds for no row{there}"
    return failed, labelled(label, f"{condition.text} {verdict}")


def _about(run: LibraryRun, out: Path) -> list[str]:
    """What was found, and what became of it."""
    from g1stream.extras.library.page import PAGE

    motions = counted(run.files - run.copies, "motion")
    copies = f", {run.copies} the same as another" if run.copies else ""
    known = f", {run.known} known before" if run.known else ""
    missing = run.total - run.known - run.done
    more = f", {missing} missing: the same command computes them" if missing else ""
    return [
        f"{out}: {counted(run.total, 'row')} of {motions}{copies}",
        f"  {run.done} computed in {run.elapsed:.1f} s{known}{more}",
        *([f"  {out / PAGE}"] if run.known or run.done else []),
    ]


def _results(rows: list[dict[str, Any]]) -> list[str]:
    """What can be played with each support, or how closely they were followed with each."""
    from g1stream.extras.physics.result import Playable

    ok = [row for row in rows if row["status"] == "ok"]
    if not ok:
        return []
    if ok[0]["command"] == "check":
        answers = get_args(Playable)
        counts = {one: Counter(row[one] for row in ok) for one in (*get_args(Support), "feet")}
        cells = [(name, *(str(n[answer]) for answer in answers)) for name, n in counts.items()]
        return ["", *table([("can be played", *answers), *cells], left=(0,))]
    lines = [("simulated", "rows", "success", "median RMSE rad", "worst", "motion")]
    played = [row for row in ok if not isnan(row["rmse"])]
    for support in dict.fromkeys(row["support"] for row in played):
        of = sorted((r for r in played if r["support"] == support), key=lambda row: row["rmse"])
        successes = sum(row["success"] is True for row in of)
        median, worst = of[len(of) // 2], of[-1]
        figures = f"{median['rmse']:.4f}", f"{worst['rmse']:.4f}", worst["name"]
        lines.append((support, str(len(of)), str(successes), *figures))
    return ["", *table(lines, left=(0, 5))]


def _problems(run: LibraryRun, rows: list[dict[str, Any]]) -> list[str]:
    """What failed, and why; some of each kind."""
    failed = [row for row in rows if row["status"] != "ok"]
    kinds = ", ".join(f"{n} {kind}" for kind, n in Counter(r["status"] for r in failed).items())
    lines = ["", f"failed: {kinds}"] if failed else []
    for row in failed[:_NAMED]:
        of = f" ({row['support']})" if row["support"] else ""
        lines.append(labelled("  ", f"{row['path']}{of}: {row['reason']}"))
    if len(failed) > _NAMED:
        lines.append(f"  and {len(failed) - _NAMED} more: column `reason` of the table")
    lost = list(run.lost.items())[:_NAMED]
    return lines + [labelled("  ", f"{path}: not computed: {why}") for path, why in lost]
