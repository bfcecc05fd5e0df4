"""The gap between a robot and the simulator under the same commands.

The simulated robot gets the recorded commands at their times, in windows that begin with the
measured state. The remaining difference is compared with the noise of the session, and explained
by simple regressions.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from g1stream.analysis.signals import SIMULATED
from g1stream.app.session import Session, open_session
from g1stream.extras.fit.recorded import Recorded, noise_of, smoothed
from g1stream.extras.fit.simulation import (
    JITTER,
    Simulated,
    doubt,
    simulate_commands,
    world_support,
)
from g1stream.robot.dynamics import GRAVITY, STICTION_SPEED, BaseMotion, InverseDynamics
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS
from g1stream.robot.model import G1, REVISIONS, VARIANTS
from g1stream.session.records import ParametersInfo, Record, StreamSummary, read_record
from g1stream.session.source import ExtendedSource, MemorySource
from g1stream.text import counted, labelled, table
from g1stream.types import Floats
from g1stream.view.encoders import JointStatesTemplate

__all__ = [
    "FAR",
    "FAR_OFF",
    "Cause",
    "Gap",
    "JointGap",
    "Servo",
    "excess",
    "gap",
    "robot_of",
    "servo_law",
]

_FIELDS: Final = ("position", "velocity", "effort")
#: A joint differs if the RMS position difference without noise is above this, rad, and above twice
#: its noise.
_DIFFERS: Final = 5e-4
#: A larger gap, rad, has another cause than parameters, and a delay whose nearer limit is below
#: this, s, is none.
FAR: Final = 0.05
FAR_OFF: Final = "so much is mostly due to another support (--support) or robot (--robot)"
_ON_TIME: Final = 5e-4
#: A cause is reported above this fraction of the difference and number of standard errors.
_SHARE: Final = 0.1
_ERRORS: Final = 4.0
#: Accelerations and velocities are derivatives of positions smoothed with this cutoff, Hz.
_CUTOFF: Final = 15.0
#: A regression uses every n-th LowState, because those between add no information.
_EVERY: Final = 5
#: Slower joints (RMS) show neither viscous friction nor inertia, rad/s.
_MOVES: Final = 0.1
#: The delay is known with a smaller standard error, s. Longest cycle of a drive or physics step, s.
_KNOWN, _STEP = 5e-4, 1e-3
#: Largest change of the delay, s, in one of so many linearisations.
_LONGEST, _LINEARISED = 0.03, 4
#: Fewest blocks of a second for the errors of the servo law.
_FEWEST_BLOCKS: Final = 5
#: Windows of the servo law, s; the low-pass has not settled at their ends, s. A joint's least mean
#: square of torques in a second, times the samples, (N·m)².
_SECONDS, _MARGIN, _MOVED = 10.0, 0.1, 1e-2
#: Fraction of its limit at which a motor is saturated.
_SATURATED: Final = 0.99


class Cause(Record):
    """A cause that explains part of a joint's difference.

    Attributes:
        name: dry friction, viscous friction, inertia, weight, constant torque, backlash or
            saturation.
        amount: value of the robot minus that of the simulator.
        unit: unit of the amount.
        share: explained fraction of the difference's variance; None for saturation.
    """

    name: str
    amount: float
    unit: str
    share: float | None = None

    def __str__(self) -> str:
        share = "" if self.share is None else f" ({100.0 * self.share:.0f} %)"
        return f"{self.name} {self.amount:+.2g} {self.unit}{share}"


class JointGap(Record):
    """RMS of measured - simulated of a joint, and the noise of the measurement.

    Attributes:
        q_rad, dq_rad_s, tau_nm: RMS of the difference.
        q_noise_rad, dq_noise_rad_s, tau_noise_nm: standard deviation of the noise: that of the
            measurement, see `noise_of`, and that of the initial state of a window.
        differs: whether positions differ by more than noise, without the worst window.
        causes: causes of the difference, the largest first; empty without a difference.
    """

    q_rad: float
    q_noise_rad: float
    dq_rad_s: float
    dq_noise_rad_s: float
    tau_nm: float
    tau_noise_nm: float
    differs: bool = False
    causes: list[Cause] = []

    @property
    def excess_rad(self) -> float:
        """RMS of the position difference without the noise, rad."""
        return float(excess(np.array(self.q_rad), np.array(self.q_noise_rad)))


class Gap(Record):
    """The difference between a session and the simulation of its commands.

    Attributes:
        session: name of the session.
        robot: name of the simulated robot.
        params: its parameters; None for the default ones.
        support: how the simulated base was held.
        window_s: length of a window.
        simulated_s: length of all windows.
        delay_s: time by which the robot uses commands later than the simulator; None if unknown.
        delay_low_s, delay_high_s: its limits, because a command close to a LowState belongs to
            either, and whether LowState has the torque of an instant or of a period, and from
            which moment of its cycle a drive's torque counts, is unknown.
        doubt: why the robot cannot have been held so; empty if it can.
        q_rad: RMS position difference of all joints, without noise.
        joints: by name, the largest difference first.
    """

    session: str
    robot: str
    params: ParametersInfo | None = None
    support: str
    window_s: float
    simulated_s: float
    delay_s: float | None = None
    delay_low_s: float | None = None
    delay_high_s: float | None = None
    doubt: str = ""
    q_rad: float
    joints: dict[str, JointGap]

    def __str__(self) -> str:
        return _render(self)


def gap(
    session: Session | str | Path,
    *,
    out: str | Path | None = None,
    robot: G1 | None = None,
    support: str | None = None,
    window: float = 1.0,
    force: bool = False,
) -> Gap:
    """Simulate the commands of a session, and compare.

    Args:
        session: session with commands and LowStates.
        out: also write the session with the simulated joints on /simulated/joint_states.
        robot: robot to simulate, with its parameters; that of the session if None.
        support: how the robot was held; as recorded if None.
        window: time after which the simulation restarts from the measured state, s.
        force: replace an existing file.

    Raises:
        G1StreamError: the session, the robot or the file cannot be used.
    """
    if not isinstance(session, Session):
        session = open_session(session)
    robot = robot or robot_of(session)
    recorded = Recorded.of(session)
    held = world_support(recorded, support)
    simulated = simulate_commands(recorded, robot, support=held, window=window)
    found = compare(recorded, simulated, robot, window)
    if out is not None:
        _write(session, Path(out), recorded, simulated, found, force=force)
    return found


def robot_of(session: Session, name: Path | str | None = None, params: Path | None = None) -> G1:
    """The robot to simulate: by name, from the parameters, or that of the session.

    Raises:
        G1StreamError: the robot or the parameters cannot be used.
    """
    if name is not None or params is not None:
        robot = G1.load(name, params=params)
        if name is not None or robot.parameters.robot:
            return robot
    stream, _ = read_record(StreamSummary, session.metadata.get("stream"), "stream")
    if str(session.metadata.get("log_clock", "")).startswith("simulated"):
        # A rollout has the URDF of its robot, whichever model its feed-forward used.
        stream = None
    known = stream.robot if stream and stream.robot in (*REVISIONS, *VARIANTS) else None
    return G1.load(known, params=params) if known or params else session.robot


def excess(rms: Floats, noise: Floats) -> Floats:
    """Root mean square after subtraction of the noise's variance."""
    left: Floats = np.sqrt(np.maximum(np.square(rms) - np.square(noise), 0.0))
    return left


def compare(recorded: Recorded, simulated: Simulated, robot: G1, window: float) -> Gap:
    """Compare measured and simulated signals, joint by joint."""
    known = ~np.isnan(simulated.tau[:, 0])
    known[0] = False  # the simulation starts there
    pairs = ("q", "dq", "tau")
    differences = {name: getattr(recorded, name) - getattr(simulated, name) for name in pairs}
    rms = {name: np.sqrt(np.mean(values[known] ** 2, 0)) for name, values in differences.items()}
    noise = {
        name: np.hypot(noise_of(getattr(recorded, name)), simulated.spread[i])
        for i, name in enumerate(pairs)
    }
    left = excess(rms["q"], noise["q"])
    # Without the worst window, because a jerk at its start may hide the state in noise.
    squares = np.where(known[:, np.newaxis], differences["q"] ** 2, 0.0)
    by_window = np.array([squares[part].sum(axis=0) for part in simulated.windows])
    rest = squares.sum(axis=0) - (by_window.max(axis=0) if len(by_window) > 1 else 0.0)
    usual = excess(np.sqrt(rest / known.sum()), noise["q"])
    differs = (usual > np.maximum(_DIFFERS, 2.0 * noise["q"])) & robot.present
    servo, period = servo_law([recorded], robot), recorded.period
    ticks = int(robot.parameters.command_delay / period + 1e-6)
    delays: list[float | None] = [None] * 3
    if servo.delay_error < _KNOWN:
        own, unsure = servo.delay - ticks * period, 0.5 * (period + _STEP)
        delays = [own + n * unsure - recorded.wait(n * JITTER) for n in (0, -1, 1)]
    causes = _causes(recorded, robot, differences, known, differs, servo.delay)
    present = np.flatnonzero(robot.present)
    joints = {
        JOINT_NAMES[j]: JointGap(
            q_rad=rms["q"][j],
            q_noise_rad=noise["q"][j],
            dq_rad_s=rms["dq"][j],
            dq_noise_rad_s=noise["dq"][j],
            tau_nm=rms["tau"][j],
            tau_noise_nm=noise["tau"][j],
            differs=bool(differs[j]),
            causes=causes.get(j, []),
        )
        for j in sorted(present.tolist(), key=lambda j: -left[j])
    }
    lengths = [
        recorded.time[part.stop - 1] - recorded.time[part.start] for part in simulated.windows
    ]
    return Gap(
        session=recorded.name,
        robot=robot.name,
        params=ParametersInfo.from_robot(robot),
        support=simulated.support,
        window_s=window,
        simulated_s=float(sum(lengths)),
        delay_s=delays[0],
        delay_low_s=delays[1],
        delay_high_s=delays[2],
        doubt=doubt(recorded, simulated.support),
        q_rad=float(np.sqrt(np.mean(left[present] ** 2))),
        joints=joints,
    )


class Servo(NamedTuple):
    """How the reported torques follow from commands and states.

    Attributes:
        delay, delay_error: time from the publish time of a command until it acts, and its standard
            error, s.
        scale, scale_error: (29,) torque over that of the servo law, and standard errors; 1 and
            infinite without torque.
    """

    delay: float
    delay_error: float
    scale: Floats
    scale_error: Floats


def servo_law(records: Sequence[Recorded], robot: G1, delay: float = 0.0) -> Servo:
    """Least squares of the reported torques on those of the servo law.

        tau_est = scale (tau - lag dtau/dt - delay dfeed/dt)

    of low-passed signals, see `Recorded.servo`, joint by joint. Whether a robot reports the torque
    of an instant or the mean of a period, and after which filter, is a lag. The delay is the mean
    of all joints by their precision. Errors are those of blocks of a second (H. White 1980).

    Args:
        records: sessions of a robot.
        robot: robot with the torque limits; a saturated motor does not follow the law.
        delay: initial value of the delay, s.
    """
    scale, error, delay_error = np.ones(N_JOINTS), np.full(N_JOINTS, np.inf), np.inf
    for _ in range(_LINEARISED):
        found_blocks = [block for one in records for block in _blocks(one, robot, delay)]
        if len(found_blocks) < _FEWEST_BLOCKS:  # their scatter says nothing of the errors
            break
        products = np.stack(found_blocks)
        total = products.sum(axis=0)
        told = (total[:, 0, 0] > _MOVED * len(products)) & (total[:, 3, 3] > 0.0) & robot.present
        if not told.any():
            break
        normal = total[told, :3, :3]
        normal = normal + 1e-9 * normal[:, :1, :1] * np.eye(3)
        found = np.linalg.solve(normal, total[told, :3, 3:])
        scores = products[:, told, :3, 3:] - products[:, told, :3, :3] @ found
        inverse = np.linalg.inv(normal)
        few = len(products) / max(1, len(products) - 3)
        spread = few * (scores @ scores.transpose(0, 1, 3, 2)).sum(axis=0)
        variance = np.diagonal(inverse @ spread @ inverse, axis1=1, axis2=2)
        scale[told], error[told] = found[:, 0, 0], np.sqrt(variance[:, 0])
        late, weight = found[:, 1, 0] / found[:, 0, 0], 1.0 / np.maximum(variance[:, 1], 1e-12)
        delay += float(np.clip((weight * late).sum() / weight.sum(), -_LONGEST, _LONGEST))
        delay_error = float(1.0 / np.sqrt(weight.sum()))
    return Servo(delay, delay_error, scale, error)


def _blocks(recorded: Recorded, robot: G1, delay: float) -> Iterator[Floats]:
    """(29, 4, 4) products of the columns of `servo_law`, and the torque, in each second."""
    torque, feed = recorded.servo(delay)
    rate, limit = 1.0 / recorded.period, _SATURATED * robot.torque_limit
    margin, n = round(_MARGIN * rate), max(1, round(rate))
    for part in recorded.windows(_SECONDS):
        tau, fed, reported = (
            smoothed(one[part], rate, _CUTOFF) for one in (torque, feed, recorded.tau)
        )
        if len(tau) < 4 * margin or not np.isfinite(reported).all():
            continue
        lag, late = (-np.gradient(one, recorded.period, axis=0) for one in (tau, fed))
        columns = np.stack([tau, late, lag, reported], axis=-1)
        columns[np.abs(torque[part]) > limit] = 0.0
        for start in range(margin, len(tau) - margin, n):
            some = columns[start : min(start + n, len(tau) - margin) : _EVERY].transpose(1, 2, 0)
            yield some @ some.transpose(0, 2, 1)


def _causes(
    recorded: Recorded,
    robot: G1,
    differences: Mapping[str, Floats],
    known: NDArray[np.bool_],
    differs: NDArray[np.bool_],
    delay: float | None,
) -> dict[int, list[Cause]]:
    """The causes of the differences, by motor index, for the joints that differ."""
    rows = np.flatnonzero(known)[::_EVERY]
    rate = 1.0 / recorded.period
    q = smoothed(recorded.q, rate, _CUTOFF)
    dq = np.gradient(q, recorded.period, axis=0)
    ddq = np.gradient(dq, recorded.period, axis=0)[rows]
    dq, tau = dq[rows], recorded.tau[rows]
    weight = _gravity_torque(recorded, robot, q, rows) if differs.any() else tau
    asked, _ = recorded.servo(delay or 0.0)
    saturated = (np.abs(asked) >= robot.torque_limit).mean(axis=0)
    found: dict[int, list[Cause]] = {}
    for j in np.flatnonzero(differs).tolist():
        columns = {
            ("dry friction", "N·m"): np.tanh(dq[:, j] / STICTION_SPEED),
            ("weight", "times its torque"): weight[:, j],
            ("constant torque", "N·m"): np.ones(len(rows)),
        }
        if np.sqrt(np.mean(dq[:, j] ** 2)) > _MOVES:
            columns |= {
                ("viscous friction", "N·m·s/rad"): dq[:, j],
                ("inertia", "kg·m²"): ddq[:, j],
            }
        causes = _explained(columns, differences["tau"][rows, j])
        play = {("backlash", "rad"): np.tanh(tau[:, j] / 0.2), ("", ""): np.ones(len(rows))}
        play |= {("", "friction"): np.tanh(dq[:, j] / STICTION_SPEED), ("", "tau"): tau[:, j]}
        causes += [
            one
            for one in _explained(play, differences["q"][rows, j])
            if one.name == "backlash" and one.amount > 0.0
        ]
        causes.sort(key=lambda one: -(one.share or 0.0))
        if saturated[j] > 0.01:
            causes.append(Cause(name="saturation", amount=100 * saturated[j], unit="% of the time"))
        found[j] = causes
    return found


def _explained(columns: Mapping[tuple[str, str], Floats], values: Floats) -> list[Cause]:
    """Least squares of values (R,) on columns (R,), and the fraction that each column explains.

    The fraction is the column's coefficient times its covariance with the values, over their
    variance (J. Pratt 1987). The fractions add up to that of all columns.
    """
    x = np.stack(list(columns.values()), axis=1)
    scale = np.maximum(np.sqrt((x**2).mean(axis=0)), 1e-12)
    x = x / scale
    total = float((values**2).sum())
    if len(values) < 20 or not total:
        return []
    normal = x.T @ x + 1e-9 * len(x) * np.eye(x.shape[1])
    coefficient = np.linalg.solve(normal, x.T @ values)
    left = values - x @ coefficient
    # Neighbouring samples are correlated: some tenths of a second count as one.
    errors = np.sqrt(np.diag(np.linalg.inv(normal)) * left.var() * 20.0)
    shares = coefficient * (x * values[:, np.newaxis]).sum(axis=0) / total
    return [
        Cause(name=name, amount=float(one), unit=unit, share=float(share))
        for (name, unit), one, share, error in zip(
            columns, coefficient / scale, shares, errors / scale, strict=True
        )
        if share >= _SHARE and abs(one) > _ERRORS * error
    ]


def _gravity_torque(recorded: Recorded, robot: G1, q: Floats, rows: NDArray[np.intp]) -> Floats:
    """(R, 29) N·m against gravity for pose and attitude in some rows."""
    dynamics, still = InverseDynamics(robot, gravity=GRAVITY), np.zeros(N_JOINTS)
    torques = [
        dynamics.solve("bolted", q[k], still, still, BaseMotion(recorded.quat_wxyz[k], np.zeros(3)))
        for k in rows
    ]
    return np.stack([one.tau for one in torques])


def _write(
    session: Session,
    out: Path,
    recorded: Recorded,
    simulated: Simulated,
    found: Gap,
    *,
    force: bool,
) -> None:
    """Write the session with the simulated joints."""
    added = MemorySource()
    added.add_metadata({"gap": found.model_dump(mode="json")})
    there = ~np.isnan(simulated.tau[:, 0])
    columns = (simulated.q[there], simulated.dq[there], simulated.tau[there])
    times = recorded.published[there]
    messages = JointStatesTemplate(JOINT_NAMES, _FIELDS).encode(times, *columns)
    added.write_batch(SIMULATED, messages, times, times)
    Session(ExtendedSource(session.source, added)).save(out, force=force)


def _render(found: Gap) -> str:
    """The gap as text."""
    rows: list[Sequence[str]] = [
        ("joint", "q mrad", "noise", "dq rad/s", "noise", "tau N·m", "noise")
    ]
    shown = {name: one for name, one in found.joints.items() if one.differs}
    for name, one in shown.items():
        figures = (
            (1e3 * one.q_rad, 2),
            (1e3 * one.q_noise_rad, 2),
            (one.dq_rad_s, 3),
            (one.dq_noise_rad_s, 3),
            (one.tau_nm, 2),
            (one.tau_noise_nm, 3),
        )
        cells = [f"{value:.{digits}f}" for value, digits in figures]
        rows.append((name.removesuffix("_joint"), *cells))
    lines = table(rows, left=(0,)) if shown else []
    delay, notes = found.delay_s or 0.0, list[str]()
    low, high = found.delay_low_s or 0.0, found.delay_high_s or 0.0
    if max(low, -high) > _ON_TIME:
        when = f"{1e3 * abs(delay):.1f} ms {'later' if delay > 0.0 else 'earlier'}"
        when += f" ({1e3 * min(abs(low), abs(high)):.1f} to {1e3 * max(abs(low), abs(high)):.1f})"
        notes.append(f"  delay  commands act {when} than in the simulator, at all joints")
    if found.doubt:
        notes.append(labelled("         ", found.doubt))
    elif found.q_rad > FAR:
        notes.append(labelled("         ", FAR_OFF))
    meaning = (
        "+: the robot has more than the simulator. In brackets the share of the difference that "
        "this explains. These are hints; `g1stream fit` measures."
    )
    alike = len(found.joints) - len(shown)
    unexplained = sum(not one.causes for one in shown.values())
    params = str(found.params) if found.params else "default parameters"
    return "\n".join(
        [
            f"{found.session}: {found.simulated_s:.1f} s simulated in windows of "
            f"{found.window_s:g} s, base {found.support}",
            labelled("  robot  ", f"{found.robot}, {params}"),
            f"  gap    {1e3 * found.q_rad:.2f} mrad RMS of all joints, without noise",
            f"         {len(shown)} joints differ by more than {1e3 * _DIFFERS:g} mrad and twice "
            f"the noise, {alike} do not",
            *notes,
            "",
            *lines,
            *([""] if shown else []),
            *(
                labelled(f"{name.removesuffix('_joint'):<22}", "; ".join(map(str, one.causes)))
                for name, one in shown.items()
                if one.causes
            ),
            *([f"no simple cause       {counted(unexplained, 'joint')}"] if unexplained else []),
            *(["", labelled("", meaning)] if len(shown) > unexplained else []),
        ]
    )
