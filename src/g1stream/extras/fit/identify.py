"""Identifies a robot's parameters from sessions, with confidence intervals and a validation.

Least squares on the inverse dynamics (`regression`) are biased by sensor noise in velocities and
accelerations, by the low-pass filter, and by the times of sampling. The same estimate is therefore
made from a simulation of the same commands with the session's noise and known parameters. The
result is the parameters with which the simulation gives the same estimate as the robot (indirect
inference: C. Gourieroux, A. Monfort and E. Renault 1993).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.stats import f as fisher
from scipy.stats import t as student

from g1stream.app.session import Session, open_session
from g1stream.errors import RecordingError
from g1stream.extras.fit.recorded import Recorded, noise_of
from g1stream.extras.fit.regression import (
    AXES,
    LINKS,
    OF_JOINTS,
    Estimate,
    Movement,
    Regression,
    names_of,
)
from g1stream.extras.fit.simulated_session import (
    FAR,
    FAR_OFF,
    Servo,
    compare,
    robot_of,
    servo_law,
)
from g1stream.extras.fit.simulation import Simulated, doubt, simulate_commands, world_support
from g1stream.files import complete_file
from g1stream.robot.dynamics import GRAVITY, compiled_dynamics
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS
from g1stream.robot.model import G1
from g1stream.robot.parameters import NOMINAL, Parameters
from g1stream.session.records import Record
from g1stream.text import labelled, table
from g1stream.types import Floats, Support

__all__ = ["Fit", "FittedValue", "fit_parameters"]

Kind = Literal[
    "damping",
    "friction",
    "armature",
    "torque_scale",
    "mass",
    "com_x",
    "com_y",
    "com_z",
    "command_delay",
]
Untold = Literal["", "wide", "impossible", "unlike"]

#: Length of a window of the regression, and of one of the validation, s.
_WINDOW, _JUDGED = 2.0, 1.0
#: Most seconds of windows in long sessions that are fitted, and validated.
_MOST, _MOST_JUDGED = 60.0, 30.0
#: Iterations of simulation and fit, more of them with shifted centres of mass, and draws of noise
#: for the last one.
_ROUNDS, _MORE_ROUNDS, _DRAWS = 3, 2, 4
#: Fraction of a single session that is used for validation.
_HELD_OUT: Final = 0.2
#: A session determines a value if half its 95 % interval is at most this: as a fraction of the
#: value, or of the default if that is larger; of masses, kg; shifts, m; scales; the delay, s.
_OF_VALUE: Final = 0.5
_TOLD: Final = {
    "mass": 0.5,
    **dict.fromkeys(AXES, 0.02),
    "torque_scale": 0.05,
    "command_delay": 2e-3,
}
#: If a larger fraction of joints does not fit, none does.
_MANY: Final = 0.2
#: A centre of mass is fitted if its effect is not chance at this probability and its shift is above
#: this, m. Otherwise a mass explains the same.
_CHANCE, _SHIFTED = 0.999, 0.004
#: What is added to half an interval: to that of a scale, because filters of reported torques are
#: unknown; of the delay, s, because the cycle of a drive, or the physics step of a simulator, is:
#: a force counts from the middle of a step of up to 1 ms, or from its beginning.
_FINEST: Final = {"torque_scale": 0.005, "command_delay": 5e-4}
_UNITS: Final = {
    "damping": "N·m·s/rad",
    "friction": "N·m",
    "armature": "kg·m²",
    "torque_scale": "",
    "mass": "kg",
    "com": "m",
    "command_delay": "s",
}
#: Least values that a simulation accepts.
_LEAST: Final = {"damping": 0.0, "friction": 0.0, "armature": 5e-4}
#: Largest changes of a mass, kg, and a centre of mass, m, in a simulation; a link keeps a half.
_MOST_MASS, _MOST_SHIFT, _KEPT = 5.0, 0.2, 0.5


class FittedValue(Record):
    """An identified parameter.

    Attributes:
        kind: name of its table in a parameters file; com_x, com_y and com_z are the parts of com.
        name: name of the joint or the link; empty for the command delay.
        value, low, high: the value, and the ends of its 95 % interval; None if it has none.
        default: value without a parameters file.
        told: whether the sessions determine it; others are not written.
        why: why not: the interval is wide, the value impossible, or the joint moves unlike a joint
            with these parameters, so that an interval would not hold the true value.
        differs: whether the value is another one than the default, at 95 % for all values of the
            fit together (Bonferroni).
    """

    kind: str
    name: str
    value: float
    low: float | None
    high: float | None
    default: float
    told: bool
    why: Untold = ""
    differs: bool = False

    @property
    def written(self) -> bool:
        """Whether a parameters file has it: it is determined, and masses and scales differ."""
        return self.told and (self.differs or self.kind in ("command_delay", *_LEAST))

    @property
    def half(self) -> str:
        """Half the interval as text."""
        digits = 4 if self.kind in ("armature", *AXES) else 3
        return "-" if self.high is None else f"{self.high - self.value:.{digits}f}"

    def __str__(self) -> str:
        digits = 4 if self.kind in ("armature", *AXES) else 3
        return f"{self.value:.{digits}f}{'*' if self.differs else ''}" if self.told else "?"


class Fit(Record):
    """The identified parameters of a robot, and their validation.

    Attributes:
        sessions: names of the sessions.
        held_out: name of the validation session; "the last 20 %" without another session.
        robot: robot model to whose masses they are relative.
        support: how it was held.
        fitted_s: length of the fitted windows.
        values: all parameters.
        gap_before_rad, gap_after_rad: gap of the held-out session, RMS of all joints without noise,
            with the default parameters and with these.
        refusal: why these cannot be the parameters of the robot, which are then not written; empty
            if they can.
    """

    sessions: list[str]
    held_out: str
    robot: str
    support: str
    fitted_s: float
    values: list[FittedValue]
    gap_before_rad: float
    gap_after_rad: float
    refusal: str = ""

    @property
    def reduction(self) -> float:
        """Relative reduction of the held-out session's gap."""
        return 1.0 - self.gap_after_rad / max(self.gap_before_rad, 1e-12)

    def find(self, kind: Kind, name: str = "") -> FittedValue:
        """Find a value by its kind and the joint or link."""
        return next(one for one in self.values if (one.kind, one.name) == (kind, name))

    def save(self, path: str | Path, *, force: bool = False) -> Path:
        """Write the determined parameters as a file for `--params`.

        Raises:
            RecordingError: the file cannot be written, or the parameters are refused.
        """
        if self.refusal:
            raise RecordingError(
                f"These parameters are not written: {self.refusal}.",
                "Check --support, --robot, and the sessions with `g1stream simulate`.",
            )
        path = Path(path)
        with complete_file(path, force=force) as temporary:
            temporary.write_text(_toml(self), encoding="utf-8")
        return path

    def __str__(self) -> str:
        return _render(self)


def fit_parameters(
    sessions: Sequence[Session | str | Path],
    *,
    hold_out: Session | str | Path | None = None,
    robot: G1 | None = None,
    support: str | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> Fit:
    """Identify the parameters of a robot.

    Args:
        sessions: sessions of the robot, bolted or hanging.
        hold_out: another session for validation; the last fifth of each session if None.
        robot: robot without parameters; that of the first session if None.
        support: how it was held; as recorded if None.
        progress: called with the fraction done.

    Raises:
        G1StreamError: a session cannot be used.
    """
    opened = [one if isinstance(one, Session) else open_session(one) for one in sessions]
    robot = replace(robot or robot_of(opened[0]), parameters=NOMINAL)
    records = [Recorded.of(one) for one in opened]
    held = [_held(one, support) for one in records]
    if hold_out is None:
        splits = [_split(one) for one in records]
        fitted, judged = [first for first, _ in splits], [last for _, last in splits]
    else:
        other = hold_out if isinstance(hold_out, Session) else open_session(hold_out)
        fitted, judged = records, [Recorded.of(other)]
    fitted = [one.excerpt(_MOST / len(fitted)) for one in fitted]
    judged = [one.excerpt(_MOST_JUDGED / len(judged)) for one in judged]
    # The band's exact point of attack on a hanging robot's torso is unknown, and so is its mass.
    links = [link for link in LINKS if "hanging" not in held or link != "torso_link"]
    masses = [("mass", link) for link in links]
    regression = Regression(robot, masses)
    data = list(zip(fitted, held, strict=False))
    if not any(_has_torque(one) for one in fitted):
        raise RecordingError(
            f"{fitted[0].name} has no torques: tau_est is 0 in every LowState.",
            "Record a robot, or a simulator, that reports the torques of its motors.",
        )
    servo = servo_law(fitted, robot)
    measured = [_measured(one, how, servo.delay) for one, how in data]
    aim = regression.estimate(measured, _scales(servo))
    values, rounds, number = aim.values, _ROUNDS, 0
    while number < rounds:
        names = names_of(regression.added)
        changed = replace(robot, parameters=_parameters(robot, names, values, servo.delay))
        simulation = _Simulation(data, changed, servo)
        draws = _DRAWS if number == rounds - 1 else 1
        found = simulation.estimate(regression, draws)
        values = values + aim.values - found.values
        if number == 0 and (moved := _moved_links(robot, links, measured, simulation, servo)):
            shifts = [(axis, link) for link in moved for axis in AXES]
            regression = Regression(robot, [*masses, *shifts])
            aim = regression.estimate(measured, _scales(servo))
            values = np.insert(values, len(values) - 1, np.zeros(len(shifts)))
            rounds += _MORE_ROUNDS
        number += 1
        progress(number / (rounds + 1))
    fit = _fit(
        robot,
        aim._replace(values=values),
        found,
        names_of(regression.added),
        servo,
        fitted,
        held[0],
    )
    fit.sessions = [one.name for one in records]
    fit.held_out = judged[0].name if hold_out is not None else "the last 20 %"
    fit.gap_before_rad = _gap(judged, support, robot)
    fit.gap_after_rad = _gap(judged, support, replace(robot, parameters=_written(fit)))
    fit.refusal = _refusal(fit, servo, records, held)
    progress(1.0)
    return fit


def _held(recorded: Recorded, support: str | None) -> Support:
    held = world_support(recorded, support, ("bolted", "hanging"))
    if held == "free":
        raise RecordingError(
            f"{recorded.name} is of a robot on its feet, with unknown contact forces.",
            "Record a bolted or hanging robot, for example with `g1stream fit --motion-out`.",
        )
    return held


def _split(recorded: Recorded) -> tuple[Recorded, Recorded]:
    n = round((1.0 - _HELD_OUT) * len(recorded.time))
    return recorded.part(slice(0, n)), recorded.part(slice(n, len(recorded.time)))


def _has_torque(recorded: Recorded) -> bool:
    return bool(recorded.tau.any())


def _windows(recorded: Recorded) -> list[slice]:
    # The first state of a window is the last one of the previous window.
    return [slice(part.start + 1, part.stop) for part in recorded.windows(_WINDOW)]


def _scales(servo: Servo) -> Floats:
    return np.stack([servo.scale, np.clip(servo.scale_error, 1e-4, 1.0)])


def _measured(recorded: Recorded, support: Support, delay: float) -> Movement:
    windows, base = _windows(recorded), _base(recorded)
    return Movement(recorded.q, *recorded.servo(delay), base, recorded.period, windows, support)


def _base(recorded: Recorded) -> Floats:
    """(N, 10) measurements of the pelvis's IMU."""
    return np.concatenate([recorded.quat_wxyz, recorded.gyroscope, recorded.accelerometer], axis=1)


class _Simulation:
    """Simulations of the sessions with some parameters, estimated like the measurements."""

    def __init__(self, data: Sequence[tuple[Recorded, Support]], robot: G1, servo: Servo) -> None:
        self._data, self._robot, self._servo = data, robot, servo
        self._runs = [
            simulate_commands(one, robot, support=held, window=_WINDOW, repeats=False, exact=True)
            for one, held in data
        ]

    def estimate(self, regression: Regression, draws: int) -> Estimate:
        """The estimate, the mean over draws of the sensor noise."""
        rng, servo, found = np.random.default_rng(draws), self._servo, []
        for _ in range(draws):
            noisy = [
                _sensed(one, run, rng) for (one, _), run in zip(self._data, self._runs, strict=True)
            ]
            scale = servo_law(noisy, self._robot, servo.delay).scale
            movements = [
                _measured(one, held, servo.delay)
                for one, (_, held) in zip(noisy, self._data, strict=True)
            ]
            found.append(regression.estimate(movements, _scales(servo._replace(scale=scale))))
        return Estimate(*(np.mean(one, axis=0) for one in zip(*found, strict=True)))


def _sensed(recorded: Recorded, run: Simulated, rng: np.random.Generator) -> Recorded:
    """The recording with the states of a simulation, and the noise of its own."""
    known = ~np.isnan(run.tau[:, :1])
    sensed = recorded.q, recorded.dq, recorded.tau, _base(recorded)
    q, dq, tau, base = (
        np.where(known, clean, alike) + noise_of(alike) * rng.standard_normal(clean.shape)
        for clean, alike in zip((run.q, run.dq, run.tau, run.base), sensed, strict=True)
    )
    quat, gyroscope, accelerometer = base[:, :4], base[:, 4:7], base[:, 7:]
    return replace(
        recorded,
        q=q,
        dq=dq,
        tau=tau,
        quat_wxyz=quat,
        gyroscope=gyroscope,
        accelerometer=accelerometer,
    )


def _moved_links(
    robot: G1,
    links: Sequence[str],
    measured: Sequence[Movement],
    simulation: _Simulation,
    servo: Servo,
) -> list[str]:
    """The links with a shifted centre of mass, for which an added mass does not explain all."""
    added = [("mass", link) for link in links]
    regression = Regression(robot, [*added, *((axis, link) for link in links for axis in AXES)])
    aim = regression.estimate(measured, _scales(servo))
    found = simulation.estimate(regression, 1)
    names, moved = names_of(regression.added), []
    least = 3.0 * float(fisher.ppf(_CHANCE, 3, max(2, aim.blocks - 4)))
    for link in links:
        at = [names.index((axis, link)) for axis in AXES]
        shift = (aim.values - found.values)[at]
        # The simulation has its own noise.
        covariance = 2.0 * aim.covariance[np.ix_(at, at)]
        distance = float(shift @ np.linalg.solve(covariance, shift))
        if distance > least and np.abs(shift).max() > _SHIFTED:
            moved.append(link)
    return moved


def _parameters(
    robot: G1, names: Sequence[tuple[str, str]], values: Floats, delay: float
) -> Parameters:
    """The parameters for a simulation."""
    damping, friction, armature, scale = (
        np.maximum(part, _LEAST.get(kind, 0.2))
        for kind, part in zip(
            OF_JOINTS, values[: len(OF_JOINTS) * N_JOINTS].reshape(-1, N_JOINTS), strict=True
        )
    )
    model, masses = compiled_dynamics(robot, GRAVITY), dict[str, float]()
    centres: dict[str, Floats] = {}
    for (kind, link), value in zip(names, values.tolist(), strict=True):
        if kind == "mass":
            own = float(model.body(link).mass[0])
            masses[link] = min(max(value, -_KEPT * own), _MOST_MASS)
        elif kind in AXES:
            at = centres.setdefault(link, np.zeros(3))
            at[AXES.index(kind)] = min(max(value, -_MOST_SHIFT), _MOST_SHIFT)
    return Parameters(
        damping=damping,
        friction=friction,
        armature=armature,
        torque_scale=np.minimum(scale, 2.0),
        command_delay=delay + float(values[-1]),
        mass=masses,
        com=centres,
    )


def _fit(
    robot: G1,
    aim: Estimate,
    simulated: Estimate,
    names: Sequence[tuple[str, str]],
    servo: Servo,
    fitted: Sequence[Recorded],
    support: Support,
) -> Fit:
    """The values with their intervals."""
    freedom = max(2, aim.blocks - 4)
    unlike = ((aim.pulled - simulated.pulled) ** 2).sum(axis=0)
    errors = np.sqrt((np.diag(aim.covariance) + unlike) * (1.0 + 1.0 / _DRAWS))
    reach, all_reach = student.ppf([0.975, 1.0 - 0.025 / len(names)], freedom)
    misfit = _misfit(aim, simulated)
    found = []
    start = np.where([kind == "command_delay" for kind, _ in names], servo.delay, 0.0)
    for (kind, name), value, error in zip(
        names, (aim.values + start).tolist(), errors.tolist(), strict=True
    ):
        joint = JOINT_NAMES.index(name) if kind in OF_JOINTS else None
        if joint is not None and not robot.present[joint]:
            continue
        default = 0.0 if joint is None else float(getattr(NOMINAL, kind)[joint])
        least, to = _FINEST.get(kind, 0.0), float(reach * error)
        why: Untold = "wide" if to > _TOLD.get(kind, _OF_VALUE * max(abs(value), default)) else ""
        of_equations = kind in _LEAST and joint is not None and misfit[joint]
        if of_equations or (kind in ("mass", *AXES) and misfit.all()):
            why = "unlike"
        elif kind == "mass":  # a mass that leaves the link almost none has another cause
            own = float(compiled_dynamics(robot, GRAVITY).body(name).mass[0])
            why = why if value > -_KEPT * own else "impossible"
        elif kind in _LEAST and value + to < 0.0:  # friction and inertia cannot be negative
            why = "impossible"
        one = FittedValue(
            kind=kind,
            name=name,
            value=value,
            low=None if why == "unlike" else value - to - least,
            high=None if why == "unlike" else value + to + least,
            default=default,
            told=not why,
            why=why,
            differs=not why and bool(abs(value - default) > all_reach * error + least),
        )
        found.append(one)
    return Fit(
        sessions=[],
        held_out="",
        robot=robot.name,
        support=support,
        fitted_s=sum(one.seconds for one in fitted),
        values=found,
        gap_before_rad=0.0,
        gap_after_rad=0.0,
    )


def _misfit(aim: Estimate, simulated: Estimate) -> NDArray[np.bool_]:
    """(29,) whether the equations' residuals differ from those of a robot with the parameters.

    It is the F test of two variances, so that of the joints it finds 5 % do fit (Y. Benjamini and
    Y. Hochberg 1995). With play between rotor and link, for example, the equations do not hold at
    each reversal of the torque. If many joints do not fit, the others only pass the test by chance.
    """
    n, ratio = np.maximum(2.0, aim.independent), aim.residual / simulated.residual
    tails = [one(ratio, n, _DRAWS * n) for one in (fisher.sf, fisher.cdf)]
    chance = 2.0 * np.minimum(*tails)
    ranked = np.sort(chance)
    found = ranked[ranked <= 0.05 * np.arange(1, N_JOINTS + 1) / N_JOINTS]
    misfit: NDArray[np.bool_] = chance <= found.max(initial=0.0)
    return np.ones_like(misfit) if misfit.mean() > _MANY else misfit


def _refusal(fit: Fit, servo: Servo, records: Sequence[Recorded], held: Sequence[Support]) -> str:
    """Why the parameters cannot be those of the robot; empty if they can."""
    if any(reasons := [doubt(one, how) for one, how in zip(records, held, strict=True)]):
        return next(filter(None, reasons))
    if fit.gap_after_rad > FAR:
        return f"the gap is {1e3 * fit.gap_after_rad:.0f} mrad; {FAR_OFF}"
    delay = fit.find("command_delay")
    if delay.told and delay.high is not None:
        half = delay.high - delay.value
        if delay.high < 0.0:
            return f"commands would act {-1e3 * delay.value:.1f} ms before they were published"
        if abs(delay.value - servo.delay) > half + records[0].period:
            return (
                f"commands act after {1e3 * delay.value:.1f} ms according to the motion, but after "
                f"{1e3 * servo.delay:.1f} ms according to the reported torques"
            )
    if fit.reduction <= 0.0:
        return f"the gap of {fit.held_out} does not shrink with these parameters"
    return ""


def _written(fit: Fit) -> Parameters:
    """The parameters in the file of a fit."""
    arrays: dict[str, Any] = {
        kind: getattr(NOMINAL, kind).copy()
        for kind in ("damping", "friction", "armature", "torque_scale")
    }
    masses, delay = {}, 0.0
    centres: dict[str, Floats] = {}
    for one in fit.values:
        if not one.written:
            continue
        if one.kind == "mass":
            masses[one.name] = one.value
        elif one.kind in AXES:
            centres.setdefault(one.name, np.zeros(3))[AXES.index(one.kind)] = one.value
        elif one.kind == "command_delay":
            delay = one.value
        else:
            arrays[one.kind][JOINT_NAMES.index(one.name)] = max(
                one.value, _LEAST.get(one.kind, 0.2)
            )
    return Parameters(**arrays, mass=masses, com=centres, command_delay=delay)


def _gap(records: Sequence[Recorded], support: str | None, robot: G1) -> float:
    """RMS over all joints and sessions, without noise."""
    squares = []
    for one in records:
        held = world_support(one, support)
        simulated = simulate_commands(one, robot, support=held, window=_JUDGED)
        squares.append(compare(one, simulated, robot, _JUDGED).q_rad ** 2)
    return float(np.sqrt(np.mean(squares)))


def _toml(fit: Fit) -> str:
    """The parameters as a file, with their intervals as comments."""
    lines = [
        f"# Parameters of a G1, fitted by g1stream to {', '.join(fit.sessions)}.",
        f"# Gap of {fit.held_out}: {1e3 * fit.gap_before_rad:.2f} mrad without, "
        f"{1e3 * fit.gap_after_rad:.2f} mrad with them. Comments are 95 % intervals.",
        f'robot = "{fit.robot}"',
    ]
    for kind, unit in sorted(_UNITS.items(), key=lambda one: one[0] != "command_delay"):
        told = [one for one in fit.values if one.kind == kind and one.written]
        if kind == "command_delay":
            lines += [f"command_delay = {one.value:.4f}  {_interval(one, unit)}" for one in told]
            continue
        if kind == "com" and (centres := _written(fit).com):
            lines += ["", "[com]"]
            lines += [f"{link} = {np.round(at, 4).tolist()}" for link, at in centres.items()]
        untold = [
            (one.name, _WHY[one.why]) for one in fit.values if one.kind == kind and not one.told
        ]
        if told or untold:
            lines += ["", f"[{kind}]"]
        for one in told:
            value = max(one.value, _LEAST.get(kind, one.value))
            lines.append(f"{one.name} = {value:.5f}  {_interval(one, unit)}")
        lines += [f"# {name}: not determined, {why}" for name, why in untold]
    return "\n".join(lines) + "\n"


_WHY: Final = {
    "wide": "the interval is too wide",
    "impossible": "the value is impossible",
    "unlike": "joints move unlike ones with such parameters, for example with play; no interval",
}


def _interval(one: FittedValue, unit: str) -> str:
    differs = "" if one.differs else ", may be the default"
    return f"# {one.low:.4g} to {one.high:.4g} {unit}".rstrip() + differs


def _render(fit: Fit) -> str:
    """The fit as text."""
    heads = ("joint", "damping", "+-", "friction", "+-", "armature", "+-", "scale", "+-")
    rows: list[Sequence[str]] = [heads]
    kinds: tuple[Kind, ...] = ("damping", "friction", "armature", "torque_scale")
    of_joints = {one.name for one in fit.values if one.kind == "friction"}
    for name in (name for name in JOINT_NAMES if name in of_joints):
        cells = [name.removesuffix("_joint")]
        for kind in kinds:
            cells += [str(fit.find(kind, name)), fit.find(kind, name).half]
        rows.append(cells)
    added = [("link", "kg added", "+-")]
    for one in fit.values:
        if one.kind in ("mass", *AXES):
            shift = f" {one.kind.replace('_', ' ')}, m" if one.kind in AXES else ""
            added.append((f"{one.name.removesuffix('_link')}{shift}", str(one), one.half))
    delay = fit.find("command_delay")
    told = f"{1e3 * delay.value:.2f} ms{'*' if delay.differs else ''}"
    told += f", +- {1e3 * ((delay.high or 0.0) - delay.value):.2f}"
    reasons = {one.why: _WHY[one.why] for one in fit.values if one.why}
    differ = sum(one.differs for one in fit.values)
    less = f"{100 * fit.reduction:.0f} % less" if fit.reduction > 0.0 else "not less"
    return "\n".join(
        [
            labelled(
                "fit     ",
                f"{', '.join(fit.sessions)}: {fit.fitted_s:.1f} s, {fit.robot}, {fit.support}",
            ),
            f"delay   {told if delay.told else 'not determined by the sessions'}",
            f"gap     {1e3 * fit.gap_before_rad:.2f} mrad before, {1e3 * fit.gap_after_rad:.2f} "
            f"after, {less}, of {fit.held_out}",
            labelled("*       ", f"differs from the default: {differ} of {len(fit.values)} values"),
            *(labelled("?       ", f"not determined: {why}") for why in reasons.values()),
            *([labelled("refused ", f"{fit.refusal}; no file is written")] if fit.refusal else []),
            "units   damping N·m·s/rad, friction N·m, armature kg·m²; +-: half the 95 % interval",
            "",
            *table(rows, left=(0,)),
            "",
            *table(added, left=(0,)),
        ]
    )
