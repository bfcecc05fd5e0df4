"""`g1stream library`: checks, simulates or converts many motions."""

from __future__ import annotations

import sys
from collections import Counter
from dataclasses import dataclass
from itertools import product
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, cast, get_args

from g1stream.cli.command import (
    EXIT_OK,
    EXIT_SIGNAL,
    EXIT_STOPPED,
    SettingsCommand,
    on_signals,
    print_lines,
    print_verdict,
    print_warning,
)
from g1stream.cli.flags import argument, flag
from g1stream.cli.progress import ProgressDisplay
from g1stream.config import load_config, settings
from g1stream.control.gains import resolve_gains
from g1stream.errors import ConfigError
from g1stream.extras.policy.published import policy_path
from g1stream.robot.joints import JOINT_NAMES
from g1stream.text import counted, labelled, table
from g1stream.types import MotionFormat, StreamSupport, Support

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from g1stream.config import Config
    from g1stream.extras.library.compute import LibraryCase
    from g1stream.extras.library.run import LibraryRun
    from g1stream.extras.library.table import MotionRow
    from g1stream.extras.report.fail_if import FailIf

__all__ = ["Library", "swept"]

#: What some flags need.
_SIMULATE: Final = ("action=simulate",)
#: Number of failed motions that are listed.
_NAMED: Final = 5
#: Time between progress lines without a terminal, s.
_IN_PIPE_S: Final = 30.0


@dataclass(frozen=True, kw_only=True)
class Library(SettingsCommand):
    """Checks, simulates or converts all motion files in directories; copies of a file once.

    `check` computes the results of `g1stream physics`. `simulate` plays each motion on a simulated
    robot, faster than real time, once for each support and each value of a sweep. `convert` writes
    motion files, including training files for other programs, or MCAP files for viewers.

    The result is a directory with Parquet tables, a row for each motion and one for each of its
    joints. A file that is broken, or needs too much time or memory, has a row with the reason. If
    the command is interrupted, run it again to continue. It recomputes rows after changes of
    settings or versions. docs/library.md lists the columns. A condition names a column with numbers
    or with yes (1) and no (0), or `ok`, which is 1 for a row whose status is ok. It also fails if a
    simulated motion was not played to its end, unless a condition is on `completed`, `played` or
    `success`.

    Examples:
      g1stream library check motions -o library
      g1stream library simulate motions --support bolted,hanging
      g1stream library simulate motions --sweep gains.kp=0.5,1,2
      g1stream library simulate motions --policy a.onnx --sweep sim.push=0,0.5
      g1stream library check motions --fail-if 'max_collision > 10'
      g1stream library check motions --cluster tls://head:8786

    Exit codes:
      0        computed, even if motions failed
      1        a condition of --fail-if holds, or is unknown, for a row;
               or rows are missing
      2        bad input
      128 + n  ended by signal n; results so far are kept
    """

    action: Literal["check", "simulate", "convert"] = argument(
        "check limits and physics of the motions, simulate a robot that plays them, or convert "
        "their files.",
        "ACTION",
    )
    places: tuple[str, ...] = argument("Directories, and motion files.", "PATH...")
    out: Path = flag(Path("library"), "Directory of the tables.", "DIR")
    support: str | None = flag(
        None,
        f"How the pelvis is held: {', '.join(get_args(StreamSupport))}; several with commas.",
        "SUPPORT",
        shown="bolted",
        needs=_SIMULATE,
    )
    sweep: list[str] = flag(
        (),
        "Run with each value of a setting, such as stream.rate=250,500. Values of "
        "gains.kp and gains.kd are factors of the gains. May be repeated, for all combinations.",
        "NAME=A,B",
        shown="none",
        needs=_SIMULATE,
    )
    policy: list[str] = flag(
        (),
        "ONNX file of a learned policy that plays on free feet, or the name of a published one "
        "(extra `policy`). May be repeated, to run with each.",
        "POLICY",
        shown="none",
        needs=_SIMULATE,
    )
    sessions: bool = flag(False, "Keep each session and its report.", needs=_SIMULATE)
    to: Literal["npz", "csv", "mcap", MotionFormat] = flag(
        "npz",
        "Format of the files; beyondmimic and others are for other programs.",
        needs=("action=convert",),
    )
    workers: int | None = flag(
        None, "Processes on this machine.", "N", shown="CPUs", gt=0, advanced=True
    )
    cluster: str | None = flag(
        None,
        "Use the workers of this Dask scheduler instead.",
        "ADDRESS",
        advanced=True,
        excludes=("workers",),
    )
    cluster_insecure: bool = flag(
        False,
        "Use a scheduler on another machine without TLS: whoever can answer in its place runs "
        "code here and on the workers.",
        advanced=True,
        needs=("cluster",),
    )
    time_limit: float = flag(600.0, "Time for a motion.", "SECONDS", gt=0, advanced=True)
    memory_limit: float = flag(4000.0, "Memory for a motion.", "MB", gt=0, advanced=True)
    fail_if: list[str] = flag(
        (),
        "Exit code 1 if this holds for a row: NAME OP NUMBER, OP one of < <= > >=. May be "
        "repeated.",
        "CONDITION",
        shown="none",
    )
    json: bool = flag(False, "Print a line of JSON for each computed row.")

    def run(self) -> int:
        """Compute, and return the exit code."""
        from g1stream.extras.library.run import LibraryRun, run_library
        from g1stream.extras.library.table import CONDITION_NAMES, newest_motions
        from g1stream.extras.library.workers import Limits
        from g1stream.extras.report.fail_if import FailIf

        # Checked before the long computation.
        conditions = FailIf.parse_all(self.fail_if, CONDITION_NAMES)
        cases = self._cases()
        run, signals = LibraryRun(), list[int]()
        with on_signals(signals.append), ProgressDisplay(run.status, in_pipe=_IN_PIPE_S):
            run_library(
                self.places,
                cases,
                workers=self.workers,
                cluster=self.cluster,
                insecure=self.cluster_insecure,
                limits=Limits(self.time_limit, self.memory_limit),
                run=run,
                on_row=_print_row if self.json else lambda row: None,
                stop=lambda: bool(signals),
                warn=print_warning,
            )
        found = newest_motions(self.out) if run.done or run.known else None
        rows = [] if found is None else found[found["key"].isin(run.keys)].to_dict("records")
        variants = {case.variant: i for i, case in enumerate(cases)}
        rows.sort(key=lambda row: (variants.get(row["variant"], -1), row["path"]))
        out = sys.stderr if self.json else None
        lines = [*_about(run, self.out), *_results(rows), *_problems(run, rows)]
        print_lines("\n".join(lines), out)
        verdicts = [_verdict(one, rows, complete=run.complete) for one in conditions]
        for one, (one_failed, line) in zip(conditions, verdicts, strict=True):
            if one_failed or not one.default:
                print_verdict(line, failed=one_failed, file=out)
        failed = any(one_failed for one_failed, _ in verdicts)
        if signals:
            return EXIT_SIGNAL + signals[0]
        return EXIT_STOPPED if failed or not run.complete else EXIT_OK

    def _cases(self) -> list[LibraryCase]:
        from g1stream.extras.library.compute import LibraryCase

        config, out = self.resolve(), self.out
        if self.action == "check":
            return [LibraryCase("check", out, config)]
        if self.action == "convert":
            return [LibraryCase("convert", out, config, format=self.to)]
        if any(text.startswith("stream.policy=") for text in self.sweep):
            raise ConfigError("--sweep cannot have policies.", "Give --policy for each of them.")
        policies = self.policy or filter(None, [config.stream.policy])
        files = list(dict.fromkeys(str(policy_path(one).absolute()) for one in policies))
        if files and self.support not in (None, "free"):
            raise ConfigError(
                f"--support {self.support} does not fit a policy, which needs free feet.",
                "Remove --support.",
            )
        asked = dict.fromkeys(
            (self.support or ("free" if files else config.sim.support)).split(",")
        )
        if unknown := asked.keys() - set(get_args(StreamSupport)):
            raise ConfigError(
                f"There is no support {min(unknown)!r}.",
                f"Choose from {', '.join(get_args(StreamSupport))}.",
            )
        supports = cast("list[StreamSupport]", list(asked))
        played = [_with_policy(config, file) for file in files] or [config]
        cases = [
            LibraryCase("simulate", out, settings, support, values, sessions=self.sessions)
            for support in supports
            for one in played
            for values, settings in swept(one, self.sweep)
        ]
        # Unreadable policies are reported here, before the computation.
        return list({case.variant: case for case in cases}.values())


def _with_policy(config: Config, file: str) -> Config:
    return load_config(over=config.model_dump() | {"stream.policy": file})


def _verdict(condition: FailIf, rows: list[dict[str, Any]], *, complete: bool) -> tuple[bool, str]:
    """Whether a condition fails the run, and the verdict in words."""
    from g1stream.extras.library.table import condition_value

    truths = [condition.holds(condition_value(row, condition.name)) for row in rows]
    held = {
        text: [row for row, truth in zip(rows, truths, strict=True) if truth is one]
        for text, one in (("holds", True), ("is unknown", None))
    }
    failed = any(held.values())
    verdict = ", and ".join(
        f"{text} for {counted(len(of), 'row')}, such as {of[0]['name']}"
        for text, of in held.items()
        if of
    )
    label = "FAILED: " if failed else "passed: " if complete else "not decided: "
    there = "" if complete else f" of the {counted(len(rows), 'row')} so far"
    verdict = verdict or f"holds for no row{there}"
    return failed, labelled(label, f"{condition.text} {verdict}")


def _print_row(row: MotionRow) -> None:
    print(row.model_dump_json(), flush=True)


def _about(run: LibraryRun, out: Path) -> list[str]:
    """A summary of the run."""
    motions = counted(run.files - run.copies, "motion")
    copies = f", {run.copies} duplicates" if run.copies else ""
    known = f", {run.known} known before" if run.known else ""
    there = run.known + run.done
    more = ""
    if not run.computing or there < run.total:
        why = f"{run.total - there} missing" if run.computing else "it ended before all were read"
        more = f", {why} (run the same command again)"
    return [
        f"{out}: {there} of {counted(run.total, 'row')}, {motions}{copies}",
        f"  {run.done} computed in {run.elapsed:.1f} s{known}{more}",
    ]


def _results(rows: list[dict[str, Any]]) -> list[str]:
    """What can be played with each support, or the tracking error of each variant."""
    from g1stream.extras.physics.result import Playable

    ok = [row for row in rows if row["status"] == "ok"]
    if not ok or ok[0]["command"] == "convert":
        return []
    if ok[0]["command"] == "check":
        answers = get_args(Playable)
        counts = {one: Counter(row[one] for row in ok) for one in (*get_args(Support), "feet")}
        cells = [(name, *(str(n[answer]) for answer in answers)) for name, n in counts.items()]
        return ["", *table([("can be played", *answers), *cells], left=(0,))]
    played = [row for row in ok if not isnan(row["rmse"])]
    if any(_is_known(row["policy"]) for row in played):
        return ["", *table(_policy_lines(played), left=(0,))]
    lines = [("simulated", "rows", "success", "median RMSE rad", "worst", "motion")]
    for variant in dict.fromkeys(row["variant"] for row in played):
        of = sorted((r for r in played if r["variant"] == variant), key=lambda row: row["rmse"])
        successes = sum(row["success"] is True for row in of)
        median, worst = of[len(of) // 2], of[-1]
        figures = f"{median['rmse']:.4f}", f"{worst['rmse']:.4f}", worst["name"]
        lines.append((variant, str(len(of)), str(successes), *figures))
    return ["", *table(lines, left=(0, 5))]


#: Metrics of policies in papers: heading, column, scale, digits.
_OF_POLICIES: Final = (
    ("s survived", "survived", 1.0, 1),
    ("RMSE rad", "rmse", 1.0, 4),
    ("MPJPE rad", "mae", 1.0, 4),
    ("E_mpjpe mm", "mpjpe_root", 1.0, 1),
    ("E_g-mpjpe mm", "mpjpe_world", 1.0, 1),
    ("E_vel", "e_vel", 1.0, 2),
    ("E_acc", "e_acc", 1.0, 2),
    ("delay p99 ms", "delay_p99", 1e3, 2),
)


def _is_known(value: Any) -> bool:
    return value is not None and not (isinstance(value, float) and isnan(value))


def _policy_lines(rows: list[dict[str, Any]]) -> list[tuple[str, ...]]:
    """Number of successful rows by policy and setting, and means over the rows."""
    from g1stream.extras.library.table import MotionRow

    files = {(row["policy"], row["policy_sha256"]) for row in rows}
    several = {name for name, n in Counter(name for name, _ in files).items() if n > 1}
    swept = [name for name in rows[0] if name not in MotionRow.model_fields]
    swept = [name for name in swept if any(_is_known(row[name]) for row in rows)]
    heads = (head for head, *_ in _OF_POLICIES)
    lines = [("policy", *swept, "rows", "SONIC", "0.5 m", *heads)]
    for variant in dict.fromkeys(row["variant"] for row in rows):
        of = [row for row in rows if row["variant"] == variant]
        name, sha = of[0]["policy"], of[0]["policy_sha256"]
        label = f"{name}:{sha[:8]}" if name in several else name
        settings = (
            f"{of[0][one]:g}" if isinstance(of[0][one], float) else of[0][one] for one in swept
        )
        successes = (sum(row[one] is True for row in of) for one in ("success_sonic", "success"))
        means = []
        for _, column, scale, digits in _OF_POLICIES:
            known = [row[column] for row in of if not isnan(row[column])]
            means.append(f"{scale * sum(known) / len(known):.{digits}f}" if known else "")
        lines.append((label, *settings, str(len(of)), *map(str, successes), *means))
    return lines


def _problems(run: LibraryRun, rows: list[dict[str, Any]]) -> list[str]:
    """Failures with reasons, some of each kind, and notes on written files."""
    from g1stream.motion.motion import DEFAULT_FPS

    failed = [row for row in rows if row["status"] != "ok"]
    kinds = ", ".join(f"{n} {kind}" for kind, n in Counter(r["status"] for r in failed).items())
    lines = ["", f"failed: {kinds}"] if failed else []
    for row in failed[:_NAMED]:
        of = f" ({row['variant']})" if row["variant"] else ""
        lines.append(labelled("  ", f"{row['path']}{of}: {row['reason']}"))
    if len(failed) > _NAMED:
        lines.append(f"  and {len(failed) - _NAMED} more: column `reason` of the table")
    csv = [row for row in rows if row["variant"] == "csv" and row["status"] == "ok"]
    if rated := [row for row in csv if row["fps"] != DEFAULT_FPS]:
        lines.append(
            f"CSV files have no frame rate: read {counted(len(rated), 'file')} of these with "
            f"--fps, such as {rated[0]['output']} with --fps {rated[0]['fps']:g}; column `fps` "
            "has the rates of the others"
        )
    lost = list(run.lost.items())[:_NAMED]
    return lines + [labelled("  ", f"{path}: not computed: {why}") for path, why in lost]


#: Settings whose values in a sweep are factors.
_GAINS: Final = ("gains.kp", "gains.kd")


def swept(config: Config, sweeps: Sequence[str]) -> Iterator[tuple[dict[str, float | str], Config]]:
    """All combinations of swept values, and the settings with them.

    Args:
        config: the other settings.
        sweeps: such as `stream.rate=250,500`; values of `gains.kp` and `gains.kd` are factors of
            the gains.

    Raises:
        ConfigError: a name is not a setting or is swept twice, or a value does not fit.
    """
    values: dict[str, list[float | str]] = {}
    for text in sweeps:
        name, _, given = text.partition("=")
        if name not in settings() or name in values:
            reason = "is swept twice" if name in values else "is not a setting"
            raise ConfigError(
                f"{name} in --sweep {text} {reason}.",
                "Give each setting of configs/sim.toml once: --sweep stream.rate=250,500.",
            )
        values[name] = list(dict.fromkeys(_value(one.strip()) for one in given.split(",")))
        if "" in values[name]:
            raise ConfigError(
                f"--sweep {text} lacks a value.", f"Give values: --sweep {name}=0.5,1,2."
            )
    for combination in product(*values.values()):
        chosen = dict(zip(values, combination, strict=True))
        over = {name: _setting(config, name, value) for name, value in chosen.items()}
        yield chosen, load_config(over=config.model_dump() | over)


def _value(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


def _setting(config: Config, name: str, value: float | str) -> Any:
    if name not in _GAINS:
        return int(value) if isinstance(value, float) and value.is_integer() else value
    if isinstance(value, str):
        raise ConfigError(f"{name} cannot be {value} times the gains.", "Give a number.")
    kp, kd = resolve_gains(config.gains)
    gains = value * (kp if name == "gains.kp" else kd)
    return dict(zip(JOINT_NAMES, gains.tolist(), strict=True))
