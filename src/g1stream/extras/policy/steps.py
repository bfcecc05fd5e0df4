"""Analysis of a policy's steps in a session: delays, terms, and early signs of a fall.

A sign is a value that stays, from some time in the last two seconds before the fall, three times as
far from the middle of its range as ever before in the run. The statistics of the training are only
known if the network normalises its observation with them; they are never assumed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, Final, Literal, NamedTuple

import numpy as np

from g1stream.analysis.summarise import percentiles
from g1stream.errors import RobotError
from g1stream.extras.policy.contract import PolicyContract, recorded_contract
from g1stream.extras.policy.observation import REPEATED
from g1stream.extras.policy.source import TILTED
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.rotations import quat_rotate_inverse
from g1stream.robot.soles import SIDES, Soles
from g1stream.session.records import Percentiles, PolicyInfo, Record
from g1stream.text import short_name
from g1stream.types import Floats, Phase

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from g1stream.app.session import Session
    from g1stream.session.streams import PolicyStream, Stream

__all__ = ["Fall", "PolicySteps", "Sign", "TermFigures", "policy_steps"]

#: A fall: tilt of the pelvis against the reference above `TILTED`, or height below it, m.
_BELOW: Final = 0.25
#: The loop may detect a fall this much after the phase that it ends, s.
_AFTER: Final = 0.1
#: Time before a fall in which signs are searched, s; half of a shorter run.
_WINDOW: Final = 2.0
#: Fraction of its limit at which a motor is at its limit, and the least duration, s.
_SATURATED, _SHORTEST = 0.99, 0.01
#: A value this many times as far from the middle of its range as ever before has left the range.
_FARTHER: Final = 3.0
#: A value that returns to its range for this long is no sign, s.
_BACK: Final = 0.3
#: Least half range of sole heights, m.
_FLOORS: Final = {"contact": 0.02}
#: The training has little or no data beyond this many standard deviations from the mean.
_UNSEEN: Final = 5.0
#: An interval of this many steps is a gap.
_GAP: Final = 1.5
#: Terms that do not depend on the robot.
_ASKED: Final = (
    *("velocity_commands", "command_lin_vel", "command_ang_vel", "motion_command", "motion_phase"),
    *("motion_joint_pos", "motion_lin_vel_xy", "motion_height"),
    *("motion_roll_pitch", "motion_yaw_rate"),
)
#: Values of other terms, and the previous action, which is analysed separately.
_KNOWN: Final = (REPEATED, "last_action")
_UP: Final = np.array([0.0, 0.0, 1.0])

Kind = Literal["term", "action", "torque", "contact", "time"]


class TermFigures(Record, frozen=True):
    """Statistics of a term of the observation, over all steps before a fall.

    Attributes:
        mean, std: over its values, in the units of the observation.
        deviation: largest deviation of a value in the last second before the fall from its mean
            in the run before, in standard deviations of that run; None without a fall.
        of: name of that value.
        trained_deviation: largest deviation of a value from the mean of the training, in standard
            deviations of the training; None if the network does not contain them.
        beyond_training: fraction of the steps with a value beyond 5 of these deviations.
    """

    mean: float
    std: float
    deviation: float | None = None
    of: str | None = None
    trained_deviation: float | None = None
    beyond_training: float | None = None


class Sign(Record, frozen=True):
    """An early sign of a fall.

    Attributes:
        kind: kind of the sign.
        what: description of the sign.
        time_s: its start, on the motion's clock.
    """

    kind: Kind
    what: str
    time_s: float


class Fall(Record, frozen=True):
    """A fall, and the signs before it.

    Attributes:
        time_s: time on the motion's clock.
        why: how the fall was detected.
        signs: the first of each kind, the earliest first; None if the session is a part that begins
            after the fall. Then `time_s` is that of its first LowState.
    """

    time_s: float
    why: str
    signs: list[Sign] | None

    def __str__(self) -> str:
        if self.signs is None:
            return f"The robot had fallen before this part: {self.why}."
        text = f"The robot fell at {self.time_s:.2f} s: {self.why}."
        if not self.signs:
            return f"{text} No value left its range in the {_WINDOW:g} s before."
        first, *others = self.signs
        then = "; then ".join(f"{one.what}, {self._before(one)}" for one in others)
        return (
            f"{text} First, {self._before(first)}: {first.what}{f'; then {then}' if then else ''}."
        )

    def _before(self, sign: Sign) -> str:
        return f"{self.time_s - sign.time_s:.2f} s before"


class PolicySteps(Record, frozen=True):
    """Results from the steps of a policy in a run.

    Attributes:
        policy: path of its ONNX file.
        steps: number of steps.
        step_s: time between two steps, the available time for delays.
        repeated: steps whose action was not finite.
        late: intervals between steps of one and a half steps or more.
        delay_s: from the publish time of the LowState to that of the command.
        state_age_s: from the reception of the LowState to the observation.
        inference_s: time in the network; 0 in a rollout.
        saturated: joint -> fraction of the states while the policy ran in which its motor was at
            99 % of its limit or more, the highest first.
        terms: by name, in order.
        fall: None if the robot did not fall.
    """

    policy: str | None
    steps: int
    step_s: float
    repeated: int
    late: int
    delay_s: Percentiles | None
    state_age_s: Percentiles
    inference_s: Percentiles
    saturated: dict[str, float]
    terms: dict[str, TermFigures]
    fall: Fall | None


class _Trace(NamedTuple):
    """Values over time in which signs are searched: values (T, J) at times (T,), and J names."""

    kind: Kind
    names: list[str]
    time: Floats
    values: Floats


class _AtLimit(NamedTuple):
    """Times (T,) of the states, s, and whether motors (T, 29) are at their limits."""

    time: Floats
    full: NDArray[np.bool_]


def policy_steps(session: Session) -> PolicySteps | None:
    """Analyse the steps of a policy; None if a session has none.

    Raises:
        RecordingError: the file is damaged.
    """
    steps, info = session.policy, session.policy_info
    if steps is None or len(steps) < 2:
        return None
    contract, columns = recorded_contract(info), info.newest if info else {}
    step = 1.0 / contract.rate if contract else float(np.median(np.diff(steps.time)))
    terms = list(_terms(steps, columns, contract))
    begin, fall = float(steps.time[0]), _fall(session)
    full = _at_limit(session)
    told, window = None, 0.0
    if fall and fall[0] <= begin:  # a part of a session, from after the fall
        told, fall = Fall(time_s=fall[0], why=fall[1], signs=None), None
    if fall:
        window = min(_WINDOW, 0.5 * (fall[0] - begin))
        traces = [*terms, _actions(steps, columns, contract), *_contacts(session, steps)]
        signs = [*_left(traces, fall[0], window), *_times(session, steps, step, fall[0], window)]
        signs += _torques(full, begin, fall[0], window)
        told = Fall(time_s=fall[0], why=fall[1], signs=_first(signs))
    end = fall[0] if fall else float(steps.time[-1])
    known = steps.delay[np.isfinite(steps.delay)]
    return PolicySteps(
        policy=info.path if info else None,
        steps=len(steps),
        step_s=step,
        repeated=int((steps.repeated > 0).sum()),
        late=int((np.diff(steps.time) >= _GAP * step).sum()),
        delay_s=percentiles(known) if len(known) else None,
        state_age_s=percentiles(steps.state_age),
        inference_s=percentiles(steps.inference_time),
        saturated=_saturated(full, begin, end),
        terms={
            name: _figures(trace, steps, at, info, fall, window)
            for (name, at), trace in zip(columns.items(), terms, strict=True)
        },
        fall=told,
    )


def _reference(
    steps: PolicyStream, columns: Mapping[str, slice], contract: PolicyContract | None
) -> dict[str, Floats]:
    """Values (N, joints) that the terms of the joints have at the reference, if it is observed."""
    for term in reversed(contract.terms) if contract else ():  # the newest step comes last
        if contract and term.value in ("motion_command", "motion_joint_pos"):
            values = steps.observation[:, columns[term.name]] / np.mean(term.scale)
            n = len(contract.joint_names)
            pos = values[:, :n] - np.array(contract.default_pos)
            return {"joint_pos_rel": pos, "joint_vel_rel": values[:, n:]}
    return {}


def _terms(
    steps: PolicyStream, columns: Mapping[str, slice], contract: PolicyContract | None
) -> Iterator[_Trace]:
    """The terms of an observation; joints minus their reference if that is observed."""
    scales = {one.name: np.array(one.scale) for one in contract.terms} if contract else {}
    reference = _reference(steps, columns, contract)
    for name, at in columns.items():
        values = steps.observation[:, at].astype(np.float64)
        names = [f"{name}[{i}]" for i in range(values.shape[1])]
        if contract and len(names) == len(contract.joint_names):
            names = [f"{name} of {short_name(joint)}" for joint in contract.joint_names]
        if (wanted := reference.get(name)) is not None and wanted.shape == values.shape:
            values = values - wanted * scales[name]
            names = [f"{one} minus the reference's" for one in names]
        yield _Trace("term", names, steps.time, values)


def _actions(
    steps: PolicyStream, columns: Mapping[str, slice], contract: PolicyContract | None
) -> _Trace:
    """Actions minus the one that commands the reference, if that is observed."""
    names = [f"the action of {short_name(joint)}" for joint in JOINT_NAMES]
    values = steps.action.astype(np.float64)
    wanted = _reference(steps, columns, contract).get("joint_pos_rel")
    if contract and wanted is not None:
        offset = np.array(contract.action_offset or contract.default_pos) - contract.default_pos
        values[:, contract.order] -= (wanted - offset) / np.array(contract.action_scale)
    return _Trace("action", names, steps.time, values)


def _contacts(session: Session, steps: PolicyStream) -> Iterator[_Trace]:
    """Height of each sole above the reference's, if the base is published."""
    base, measured, reference = session.base, session.measured, session.reference
    if base is None:
        return
    try:
        soles = Soles(session.robot)
    except RobotError:
        return

    def at(stream: Stream) -> NDArray[np.intp]:
        return np.searchsorted(stream.time, steps.time).clip(0, len(stream) - 1)

    def heights(q: Floats, place: Floats, quat: Floats) -> Floats:
        corners = soles.path(q, place, quat)[..., 2]
        lowest: Floats = corners.reshape(len(corners), len(SIDES), -1).min(axis=2)
        return lowest

    own, its = at(measured), at(reference)
    above = heights(measured.q[own], base.position[at(base)], measured.imu_quat_wxyz[own])
    above -= heights(reference.q[its], reference.root_pos[its], reference.root_quat_wxyz[its])
    names = [f"the height of the {side} sole" for side in SIDES]
    yield _Trace("contact", names, steps.time, above)


def _left(traces: list[_Trace], fall: float, window: float) -> Iterator[Sign]:
    """Values that stay further from the middle of their range before the fall than ever before."""
    for kind, names, time, values in traces:
        before, late = time < fall - window, (time >= fall - window) & (time <= fall)
        if before.sum() < 2 or not late.any() or names[0].startswith((*_ASKED, *_KNOWN)):
            continue
        least, most = values[before].min(axis=0), values[before].max(axis=0)
        half = np.maximum(0.5 * (most - least), _FLOORS.get(kind, 1e-9))
        far = np.abs(values[late] - 0.5 * (most + least)) > _FARTHER * half
        # Short excursions in a motion return to the range; those that lead to a fall do not.
        first = {of: _since(time[late], far[:, of], fall) for of in np.flatnonzero(far.any(axis=0))}
        known = {of: at for of, at in first.items() if at is not None}
        if known:
            of = min(known, key=lambda one: (known[one], -np.abs(values[late][-1, one])))
            value = values[time == known[of]][0, of]
            usual = f"{least[of]:.3g} to {most[of]:.3g}"
            what = f"{names[of]} was {value:.3g}, before that always {usual}"
            yield Sign(kind=kind, what=what, time_s=float(known[of]))


def _since(time: Floats, far: NDArray[np.bool_], fall: float) -> float | None:
    """Start of the time that is `far` until the fall, except short moments; None if it returned."""
    rows = np.flatnonzero(far)
    back = np.flatnonzero(np.diff(np.append(time[rows], fall)) > _BACK)
    first = int(back[-1]) + 1 if len(back) else 0
    return float(time[rows[first]]) if first < len(rows) else None


def _times(
    session: Session, steps: PolicyStream, step: float, fall: float, window: float
) -> Iterator[Sign]:
    """Gaps of LowState or of steps, delays of a whole step, and actions that are not finite."""
    states = np.sort(session.measured.time)
    for time, apart, what in (
        (states[1:], np.diff(states), "LowState came {:.0f} ms after the one before"),
        (steps.time[1:], np.diff(steps.time) / _GAP, "a step came {:.0f} ms after the one before"),
        (steps.time, steps.delay, "a command followed {:.0f} ms after its LowState"),
    ):
        late = (time >= fall - window) & (time <= fall)
        usual = np.nanmax(apart[time < fall - window], initial=0.0)
        found = np.flatnonzero(late & (apart > max(step, usual)))
        if len(found):
            at = int(found[0])
            length = apart[at] * (_GAP if what.startswith("a step") else 1.0)
            yield Sign(kind="time", what=what.format(1e3 * length), time_s=float(time[at]))
    late = (steps.time >= fall - window) & (steps.time <= fall)
    found = np.flatnonzero(late & (steps.repeated > 0))
    if len(found):
        what = "an action was not finite"
        yield Sign(kind="action", what=what, time_s=float(steps.time[found[0]]))


def _torques(of: _AtLimit, begin: float, fall: float, window: float) -> Iterator[Sign]:
    """Motors at their limits for longer than ever before."""
    time, full = of
    for joint in np.flatnonzero(full.any(axis=0)):
        runs = list(_runs(full[:, joint]))
        spans = [(float(time[a]), float(time[b] - time[a])) for a, b in runs]
        usual = max((n for at, n in spans if begin <= at < fall - window), default=0.0)
        for at, length in spans:
            if fall - window <= at <= fall and length > max(usual, _SHORTEST):
                what = f"{short_name(JOINT_NAMES[joint])} was at its torque limit"
                yield Sign(kind="torque", what=what, time_s=at)
                break


def _at_limit(session: Session) -> _AtLimit:
    measured, limit = session.measured, session.robot.torque_limit
    full = (np.abs(measured.tau) >= _SATURATED * limit) & (limit > 0.0)
    return _AtLimit(measured.time, full)


def _saturated(of: _AtLimit, begin: float, end: float) -> dict[str, float]:
    time, full = of
    inside = (time >= begin) & (time <= end)
    shares = full[inside].mean(axis=0) if inside.any() else np.zeros(len(JOINT_NAMES))
    order = np.argsort(-shares, kind="stable")
    return {JOINT_NAMES[joint]: float(shares[joint]) for joint in order if shares[joint] > 0.0}


def _runs(flags: NDArray[np.bool_]) -> Iterator[tuple[int, int]]:
    """First and last index of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(np.int8), [0]])))
    for first, after in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        yield first, after - 1


def _first(signs: list[Sign]) -> list[Sign]:
    """The first sign of each kind, in order of time."""
    found: dict[str, Sign] = {}
    for one in sorted(signs, key=lambda sign: sign.time_s):
        found.setdefault(one.kind, one)
    return list(found.values())


def _fall(session: Session) -> tuple[float, str] | None:
    """Time of a fall in PLAY or HOLD, and how it was detected."""
    if not session.topics.get("/reference") or not session.topics.get("/lowstate"):
        return None
    measured, reference = session.measured, session.reference
    time = measured.time
    played = np.zeros(len(time), bool)
    for one in session.phases:
        if one.phase in (Phase.PLAY, Phase.HOLD):
            played |= (time >= one.start_s) & (time <= one.end_s + _AFTER)
    if not played.any():
        return None
    at = np.searchsorted(reference.time, time[played]).clip(0, len(reference) - 1)
    ups = [
        quat_rotate_inverse(quat, _UP)
        for quat in (measured.imu_quat_wxyz[played], reference.root_quat_wxyz[at])
    ]
    tilt = np.arccos(np.clip(np.sum(ups[0] * ups[1], axis=1), -1.0, 1.0))
    below = np.zeros(len(tilt))
    if base := session.base:
        height = np.interp(time[played], base.time, base.position[:, 2])
        below = reference.root_pos[at, 2] - height
    fallen = np.flatnonzero((tilt > TILTED) | (below > _BELOW))
    if not len(fallen):
        return None
    first = int(fallen[0])
    why = f"the pelvis was {below[first]:.2f} m below the reference"
    if tilt[first] > TILTED:
        why = f"the pelvis was tilted by {tilt[first]:.2f} rad against the reference"
    return float(time[played][first]), why


def _figures(
    trace: _Trace,
    steps: PolicyStream,
    at: slice,
    info: PolicyInfo | None,
    fall: tuple[float, str] | None,
    window: float,
) -> TermFigures:
    time = trace.time
    before = time <= fall[0] if fall else np.ones(len(time), bool)
    values = steps.observation[before, at].astype(np.float64)
    figures: dict[str, Any] = {"mean": float(values.mean()), "std": float(values.std())}
    info = info or PolicyInfo()
    mean, std = np.array(info.trained_mean), np.array(info.trained_std)
    if len(mean) == len(std) == steps.observation.shape[1] and (std > 0.0).all():
        apart = (np.abs(values - mean[at]) / std[at]).max(axis=1)
        figures["trained_deviation"] = float(apart.max())
        figures["beyond_training"] = float((apart > _UNSEEN).mean())
    if fall:
        run = trace.values[time < fall[0] - window]
        last = trace.values[(time >= fall[0] - min(1.0, window)) & (time <= fall[0])]
        if len(run) > 1 and len(last):
            std = np.maximum(run.std(axis=0), 1e-9)
            apart = (np.abs(last - run.mean(axis=0)) / std).max(axis=0)
            of = int(apart.argmax())
            figures |= {"deviation": float(apart[of]), "of": trace.names[of]}
    return TermFigures(**figures)
