"""Comparison of two sets of sessions of the same motion, metric by metric."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path
from statistics import fmean
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import computed_field

from g1stream.analysis.metrics import NAMED_METRICS, Metrics, metrics
from g1stream.analysis.summarise import flat, played
from g1stream.analysis.summary import SuccessMetrics, Summary
from g1stream.analysis.tracking import interpolated
from g1stream.app.session import Session, open_session
from g1stream.config import Config
from g1stream.errors import RecordingError
from g1stream.extras.report.fail_if import AS_ASKED
from g1stream.robot.joints import JOINT_GROUPS, JOINT_NAMES
from g1stream.session.records import Record, SessionInfo, read_record
from g1stream.text import counted, labelled, printable, table
from g1stream.types import Floats

__all__ = [
    "CONDITION_NAMES",
    "Comparison",
    "Difference",
    "compare",
    "differences",
    "ranked",
    "verdict",
]

CONDITION_NAMES: Final = (
    *NAMED_METRICS,
    *AS_ASKED,
    *(f"rmse.{part}" for part in (*JOINT_GROUPS, *JOINT_NAMES)),
)
"""The names for conditions on a comparison; sessions may lack the data for some."""

#: Largest difference of two references of the same motion at the same motion time, rad.
_SAME_MOTION: Final = 0.01
#: Sessions whose start and end differ by less have played the same part, s: a few LowStates.
_SAME_INTERVAL: Final = 0.1
#: Shortest common part, s.
_SHORTEST: Final = 0.1
#: Rate of the motion times at which references are compared, Hz.
_RATE: Final = 20.0

_SIGNED: Final = {"delay"}
#: Metrics in which the movement of the pelvis counts.
_OF_PELVIS: Final = {"mpjpe_root", "mpjpe_world", "e_vel", "e_acc"}


class Comparison(Record):
    """Comparison of sessions of a motion with others.

    Attributes:
        motion: name of the motion.
        base, other: paths of the sessions.
        start_s, stop_s: the compared part of the motion, which all sessions played.
        metrics: over all joints that played in every session, by the name for --fail-if.
        limbs, joints: RMSE, rad, by name; the joints by size of the difference.
        terms: mean and standard deviation of each term that a learned policy observed, and of its
            actions, such as `std of joint_vel_rel`; empty if a session has no policy.
        terms_apart: RMS difference of these at the same motion time, means over the sessions of a
            side, by term; those that both sides have.
        differs: other differences between the sides, such as `gains.kp of waist` -> the value on
            each side.
        incomplete: path of each session that ended early, is void or played less than was asked ->
            the reason.
        as_asked: the lowest `completed` (0 for a void run), `played` (fraction of what was asked)
            and `success` of all sessions, 0 to 1; those that are known.
    """

    motion: str
    base: list[str]
    other: list[str]
    start_s: float
    stop_s: float
    metrics: dict[str, Difference]
    limbs: dict[str, Difference]
    joints: dict[str, Difference]
    terms: dict[str, Difference]
    terms_apart: dict[str, float]
    differs: dict[str, tuple[str, str]]
    incomplete: dict[str, str]
    as_asked: dict[str, float]

    def __str__(self) -> str:
        """The verdict, the compared part, other differences, and the table."""
        kinds: tuple[dict[str, Difference], ...] = (
            self.metrics,
            {f"RMSE {name.replace('_', ' ')}": one for name, one in self.limbs.items()},
            {
                name.removesuffix("_joint"): one
                for name, one in list(self.joints.items())[:_MOST_JOINTS]
            },
            self.terms,
        )
        rows: list[tuple[str, ...]] = [("", "base", "other", "unit", "change", "spread")]
        for kind in filter(None, kinds):
            rows += [_row(name, one) for name, one in kind.items()]
            rows.append(("",) * len(rows[0]))
        lines = [
            labelled("verdict   ", verdict(self)),
            labelled("motion    ", f"{self.motion}, {self.start_s:.2f} to {self.stop_s:.2f} s"),
            labelled("base      ", ", ".join(self.base)),
            labelled("other     ", ", ".join(self.other)),
        ]
        lines += [
            labelled("differs   ", f"{name}: {base}; {other}")
            for name, (base, other) in self.differs.items()
        ]
        if self.terms_apart:
            apart = (f"{name} {value:.3g}" for name, value in self.terms_apart.items())
            lines.append(
                labelled("apart     ", f"at the same motion time, RMS: {', '.join(apart)}")
            )
        below = (
            "change: other - base, in % of base or, from tenfold on, other / base; in the unit "
            "if a percentage has no meaning; spread: the largest difference between sessions of "
            "one side, which several on each side show; joints: the "
            f"{_MOST_JOINTS} whose RMSE differs most"
        )
        return "\n".join(
            [*lines, "", *map(printable, table(rows, left=(0, 3))), labelled("", below)]
        )

    def named(self) -> tuple[dict[str, float], dict[str, float]]:
        """The values that a condition can name, and the values of `base` for them.

        The first are those of the other side, such as `rmse` and `rmse.left_leg`, and `as_asked`.
        """
        parts = (self.limbs | self.joints).items()
        metrics = self.metrics | {f"rmse.{part}": one for part, one in parts}
        other = {name: one.other for name, one in metrics.items()}
        return other | self.as_asked, {name: one.base for name, one in metrics.items()}


def compare(
    base: Sequence[Session | str | Path] | Session | str | Path,
    other: Sequence[Session | str | Path] | Session | str | Path,
    *,
    progress: Callable[[str, float], None] = lambda what, fraction: None,
) -> Comparison:
    """Compare sessions of one motion with others, over the part that all of them played.

    Args:
        base: one or several sessions, or their files.
        other: one or several sessions, or their files, to compare with them.
        progress: called with a label and the fraction done, 0 to 1.

    Returns:
        The differences. Two or more sessions on each side show how much of them may be noise.

    Raises:
        RecordingError: a session has no tracking error or another motion, no joint played in
            all of them, or two on a side are the same.
    """
    several = [[side] if isinstance(side, (Session, str, Path)) else side for side in (base, other)]
    if not all(several):
        raise RecordingError("There is nothing to compare.", "Give sessions on both sides.")
    total, sides = sum(map(len, several)), list[list[_Run]]()
    for side in several:
        sides.append([])
        for one in side:
            progress("reading", sum(map(len, sides)) / total)
            sides[-1].append(_read(one))
    for runs in sides:
        _require_different(runs)
    runs = [*sides[0], *sides[1]]
    start, stop = max(run.start for run in runs), min(run.stop for run in runs)
    joints = tuple(sorted(set.intersection(*({*run.joints} for run in runs))))
    if not joints:
        raise RecordingError(
            "No joint plays the motion in all of these sessions.",
            "Compare sessions in which the same joints play.",
        )
    for run in runs[1:]:
        _require_same_motion(runs[0], run)
    if stop - start < _SHORTEST:
        raise _nothing_in_common(max(runs, key=lambda run: run.start), start, stop)
    found = [[run.metrics_of(start, stop, joints) for run in side] for side in sides]
    observed = _observed(sides, start, stop)
    return Comparison(
        motion=runs[0].motion,
        base=[run.path for run in sides[0]],
        other=[run.path for run in sides[1]],
        start_s=start,
        stop_s=stop,
        metrics=differences(
            [
                [run.named(one) for run, one in zip(*each, strict=True)]
                for each in zip(sides, found, strict=True)
            ],
            {name: unit for name, (unit, _) in NAMED_METRICS.items()},
            _SIGNED,
        ),
        limbs=differences([[_rmse(m, "limbs") for m in side] for side in found], {}),
        joints=ranked(differences([[_rmse(m, "joints") for m in side] for side in found], {})),
        terms=_terms(observed) if observed else {},
        terms_apart=_apart(observed) if observed else {},
        differs=_circumstances(*sides),
        incomplete={run.path: run.incomplete for run in runs if run.incomplete},
        as_asked=_lowest([run.as_asked for run in runs]),
    )


class _Run(NamedTuple):
    """The data that is kept of a session. Samples are not kept, to save memory."""

    source: Session | str | Path
    path: str
    motion: str
    start: float  # motion time at the start of the played part, s
    stop: float
    rows: NDArray[np.intp]  # (T,) motion times of `reference`, in steps of a common grid
    reference: Floats  # (T, 29) rad
    joints: tuple[int, ...]  # motor indices of the joints that played
    held: bool  # whether a support held the pelvis
    metrics: Metrics  # of the whole session
    measured: bytes  # hash of all joint positions and their times
    facts: dict[str, str]  # possible causes of a difference, beside the motion
    as_asked: dict[str, float | None]  # as in `Comparison`
    incomplete: str  # why it was not played as asked, or ""

    def metrics_of(self, start: float, stop: float, joints: tuple[int, ...]) -> Metrics:
        """Metrics of some joints in a part; of the whole session if it played little else."""
        whole = max(start - self.start, self.stop - stop) < _SAME_INTERVAL
        if whole and joints == self.joints:
            return self.metrics
        session = _opened(self.source)
        if whole:
            return metrics(session, joints)
        found = session.tracking()
        inside = (found.motion_time >= start) & (found.motion_time <= stop)
        if inside.any():
            first, last = found.time[inside][[0, -1]].tolist()
            part = metrics(session.sel(time=slice(first, last)), joints)
            if part.tracking:
                return part
        raise _nothing_in_common(self, start, stop)

    def named(self, found: Metrics) -> dict[str, float | None]:
        """The named metrics; of a held pelvis None for those in which its movement counts."""
        return {
            name: None if self.held and name in _OF_PELVIS else value
            for name, value in found.named().items()
        }


def _opened(source: Session | str | Path) -> Session:
    return source if isinstance(source, Session) else open_session(source)


def _read(source: Session | str | Path) -> _Run:
    session = _opened(source)
    if played(session.phases) > 1:
        raise RecordingError(
            f"Several motions were played in {session.path}.", "Give sessions with one motion."
        )
    of_all, found = session.metrics(), session.tracking()
    start, stop = found.motion_time[[0, -1]].tolist()
    rows = np.arange(math.ceil(start * _RATE), math.floor(stop * _RATE) + 1)
    summary = session.summary()
    return _Run(
        source=source,
        path=str(session.path),
        motion=(summary.motion and summary.motion.name) or "unknown",
        start=start,
        stop=stop,
        rows=rows,
        reference=interpolated(rows / _RATE, found.motion_time, found.reference),
        joints=found.joints,
        held=bool(summary.held),
        metrics=of_all,
        measured=hashlib.sha256(found.motion_time.tobytes() + found.measured.tobytes()).digest(),
        facts=dict(_facts(session, summary)),
        **_as_asked(summary, of_all.success),
    )


def _as_asked(summary: Summary, found: SuccessMetrics) -> dict[str, Any]:
    """How much of what was asked was played: the last two fields of `_Run`."""
    # A selected part is shorter because it was asked for; what others were asked is unknown.
    played = None if summary.selected or summary.attached else found.progress
    completed, void = found.completed, found.spoilt_by_ms
    incomplete = ""
    if void:
        incomplete = f"void: the robot's time stopped or jumped by {void:.0f} ms"
    elif completed is False:
        ended = summary.termination
        incomplete = f"ended early: {ended.reason or ended.guard}"
    elif played is not None and played < 1.0:
        incomplete = f"{played:.0%} of what was asked was recorded"
    values = (False if void else completed), played, found.success
    known = {
        name: None if value is None else float(value)
        for name, value in zip(AS_ASKED, values, strict=True)
    }
    return {"as_asked": known, "incomplete": incomplete}


def _lowest(runs: Sequence[Mapping[str, float | None]]) -> dict[str, float]:
    """The lowest value of each name; without those that are unknown, unless another is below 1."""
    found = {}
    for name in AS_ASKED:
        known = [value for one in runs if (value := one[name]) is not None]
        if known and (len(known) == len(runs) or min(known) < 1.0):
            found[name] = min(known)
    return found


def _nothing_in_common(run: _Run, start: float, stop: float) -> RecordingError:
    return RecordingError(
        f"{run.path} ({run.motion}) and the others have no part of a motion in common: the last "
        f"one began at {start:.2f} s of it, the first one ended at {stop:.2f} s.",
        "Compare sessions that played the same part of a motion.",
    )


def _require_different(side: Sequence[_Run]) -> None:
    """Refuse a run given twice: it would make the spread of its side too small."""
    first: dict[bytes, _Run] = {}
    for run in side:
        if (same := first.setdefault(run.measured, run)) is not run:
            raise RecordingError(
                f"{same.path} and {run.path} are the same run: their measurements are equal.",
                "Give each run once; rollouts only differ with another `noise`, such as "
                "SensorNoise(seed=1).",
            )


def _require_same_motion(first: _Run, other: _Run) -> None:
    """Compare the references at each motion time, whatever the names and files are."""
    _, rows, other_rows = np.intersect1d(first.rows, other.rows, return_indices=True)
    joints = sorted({*first.joints} & {*other.joints})
    difference = first.reference[rows] - other.reference[other_rows]
    apart = np.abs(difference[:, joints]).max(initial=0.0)
    if len(rows) and apart <= _SAME_MOTION:
        return
    reason = "they have no part of a motion in common"
    if len(rows):
        reason = f"their references differ by up to {apart:.2f} rad at the same motion time"
    raise RecordingError(
        f"{first.path} ({first.motion}) and {other.path} ({other.motion}) are not sessions of the "
        f"same motion: {reason}.",
        "Compare sessions of the same motion, played at the same speed.",
    )


def _rmse(found: Metrics, which: str) -> dict[str, float | None]:
    assert found.tracking
    return {name: one.rmse_rad for name, one in getattr(found.tracking, which).items()}


class _Observed(NamedTuple):
    """What a policy observed and did in N steps, by term: values (N, K) at motion times (N,), s."""

    motion_time: Floats
    values: dict[str, NDArray[Any]]


def _observed(sides: Sequence[Sequence[_Run]], start: float, stop: float) -> list[list[_Observed]]:
    """The steps of policies in a part of the motion; empty if a session has none there."""
    found: list[list[_Observed]] = []
    for side in sides:
        found.append([])
        for run in side:
            session = _opened(run.source)
            steps, info = session.policy, session.policy_info
            if steps is None or info is None:
                return []
            tracked = session.tracking()
            at = np.interp(steps.time, tracked.time, tracked.motion_time, -np.inf, np.inf)
            inside = (at >= start) & (at <= stop) & np.isfinite(steps.action).all(axis=1)
            if not inside.any():
                return []
            rows = np.flatnonzero(inside)
            values = {name: steps.observation[rows, of] for name, of in info.newest.items()}
            found[-1].append(_Observed(at[rows], values | {"action": steps.action[rows]}))
    return found


def _terms(sides: Sequence[Sequence[_Observed]]) -> dict[str, Difference]:
    """Differences of a policy's observations, by statistic and term."""
    statistics: dict[str, Callable[[Floats], Any]] = {"mean": np.mean, "std": np.std}
    figures = [
        [
            {
                f"{what} of {name}": float(of(values.astype(np.float64)))
                for name, values in one.values.items()
                for what, of in statistics.items()
            }
            for one in side
        ]
        for side in sides
    ]
    names = {*figures[0][0]}
    return differences(
        figures, dict.fromkeys(names, ""), {name for name in names if name.startswith("mean")}
    )


def _apart(sides: Sequence[Sequence[_Observed]]) -> dict[str, float]:
    """RMS difference of the sides' mean values at the same motion time, by term."""
    every = [one for side in sides for one in side]
    first, last = (
        choose(one.motion_time[end] for one in every) for choose, end in ((max, 0), (min, -1))
    )
    at = sides[0][0].motion_time
    at = at[(at >= first) & (at <= last)]
    widths = [{(name, values.shape[1]) for name, values in one.values.items()} for one in every]
    shared = {name for name, _ in set.intersection(*widths)} if len(at) else set[str]()
    found = {}
    for name in (name for name in every[0].values if name in shared):
        base, other = (
            np.mean([interpolated(at, one.motion_time, one.values[name]) for one in side], axis=0)
            for side in sides
        )
        found[name] = float(np.sqrt(np.mean(np.square(other - base))))
    return found


def _circumstances(base: Sequence[_Run], other: Sequence[_Run]) -> dict[str, tuple[str, str]]:
    """Differences between the two sides in settings and versions, by name."""
    sides = [[run.facts for run in side] for side in (base, other)]
    every = [one for side in sides for one in side]
    # Recordings without settings do not show whether these were different.
    shown = {
        name: tuple(", ".join(dict.fromkeys(one[name] for one in side)) for side in sides)
        for name in every[0]
        if all(name in one for one in every)
    }
    return {name: (a, b) for name, (a, b) in shown.items() if a != b}


def _facts(session: Session, summary: Summary) -> Iterator[tuple[str, str]]:
    """Possible causes of a difference, beside the motion; unknown ones are omitted."""
    info = read_record(SessionInfo, dict(session.metadata))[0] or SessionInfo()
    if stream := summary.stream:
        known = {
            "feed-forward": stream.feedforward,
            "support": stream.support,
            "robot": stream.robot,
            "rate": stream.nominal_rate_hz and f"{stream.nominal_rate_hz:g} Hz",
        }
        yield from ((name, str(value)) for name, value in known.items() if value is not None)
        yield "slowed", f"{stream.slowed or 1.0:g}"
    for name, gains in (info.gains or {}).items():
        for limb, joints in JOINT_GROUPS.items():
            values = (f"{gains[joint]:g}" for joint in joints if joint < len(gains))
            yield f"gains.{name} of {limb}", ", ".join(dict.fromkeys(values))
    if info.policy and info.policy.sha256:
        yield "SHA-256 of the policy", info.policy.sha256[:12]
    yield from ((f"version of {name}", v) for name, v in summary.versions.items())
    if summary.host:
        yield "host", summary.host
    if info.config is None:
        return
    for name, value in (flat(Config().model_dump(mode="json")) | flat(info.config)).items():
        if not name.startswith(("stream.feedforward", "stream.rate", "gains.", "record.")):
            yield name, "not set" if value is None else str(value)


class Difference(Record):
    """A metric on both sides.

    Attributes:
        unit: unit of the values.
        base, other: mean over the sessions of a side.
        base_values, other_values: value of each session.
        change: (other - base) / base; None if base is 0, or if the metric can have either sign, so
            that a percentage has no meaning.
    """

    unit: str
    base: float
    other: float
    base_values: list[float]
    other_values: list[float]
    change: float | None = None

    @computed_field  # type: ignore[prop-decorator]
    @property
    def difference(self) -> float:
        """Other - base."""
        return self.other - self.base

    @computed_field  # type: ignore[prop-decorator]
    @property
    def spread(self) -> float | None:
        """Largest difference between sessions of one side; None with one session on each."""
        sides = self.base_values, self.other_values
        if max(map(len, sides)) < 2:
            return None
        return max(max(values) - min(values) for values in sides)


def differences(
    sides: Sequence[Sequence[Mapping[str, float | None]]],
    units: Mapping[str, str],
    signed: Collection[str] = (),
) -> dict[str, Difference]:
    """Differences of the metrics that all sessions have, by name.

    The default unit is rad; `signed` metrics can have either sign.
    """
    found: dict[str, Difference] = {}
    for name in sides[0][0]:
        values = [[v for one in side if (v := one.get(name)) is not None] for side in sides]
        if [len(side) for side in values] != [len(side) for side in sides]:
            continue
        base, other = map(fmean, values)
        found[name] = Difference(
            unit=units.get(name, "rad"),
            base=base,
            other=other,
            base_values=values[0],
            other_values=values[1],
            change=(other - base) / base if base and name not in signed else None,
        )
    return found


def ranked(found: Mapping[str, Difference]) -> dict[str, Difference]:
    """Sort by the size of the difference.

    A sort by percentage would put joints with a base of 1e-7 rad first.
    """
    return dict(sorted(found.items(), key=lambda one: -abs(one[1].difference)))


#: Number of sessions that were not played as asked that the verdict names.
_MOST_SHORT: Final = 3
#: Number of joints in the table.
_MOST_JOINTS: Final = 8
#: From this fraction of the base on a change is printed as a factor.
_MANY_TIMES: Final = 9.0
#: Significant digits of an RMSE, and the most digits to distinguish two of them.
_FEWEST_DIGITS, _MOST_DIGITS = 4, 7


def _share(change: float) -> str:
    return f"{change:+.1%}" if change < _MANY_TIMES else f"x{1.0 + change:.3g}"


def _row(name: str, one: Difference) -> tuple[str, ...]:
    change = f"{one.difference:+.3g}" if one.change is None else _share(one.change)
    spread = "" if one.spread is None else f"{one.spread:.2g}"
    return name, f"{one.base:.4g}", f"{one.other:.4g}", one.unit, change, spread


def verdict(comparison: Comparison) -> str:
    """The change of the tracking error, in one sentence; before it, the runs that do not count."""
    short = [f"{Path(path).name} {why}" for path, why in comparison.incomplete.items()]
    if short:
        of = counted(len(comparison.base) + len(comparison.other), "session")
        more = f", and {len(short) - _MOST_SHORT} more" * (len(short) > _MOST_SHORT)
        text = f"{len(short)} of {of} not played as asked ({'; '.join(short[:_MOST_SHORT])}{more})"
        return f"{text}. {verdict(comparison.model_copy(update={'incomplete': {}}))}"
    rmse = comparison.metrics["rmse"]
    noise = "with one session on each side it is unknown whether this is noise"
    if rmse.spread is not None:
        noise = f"sessions of one side differ by up to {rmse.spread:.2g} rad"
    for digits in range(_FEWEST_DIGITS, _MOST_DIGITS + 1):
        base, other = (f"{value:.{digits}g}" for value in (rmse.base, rmse.other))
        if base != other:
            change = "" if rmse.change is None else f" ({_share(rmse.change)})"
            text = f"an RMSE of {other} rad instead of {base}{change}; {noise}"
            break
    else:
        text = f"the same RMSE on both sides, {rmse.base:.{_FEWEST_DIGITS}g} rad"
    return f"The joints followed with {text}."
