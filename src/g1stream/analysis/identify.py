"""What a session shows of the robot: its revision, mass and mass centre of its torso."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, get_args

import numpy as np
from pydantic import BaseModel

from g1stream.control.revision import RevisionFit, Window
from g1stream.control.state_checks import ImuReading
from g1stream.control.time_scale import TimeScale
from g1stream.errors import RecordingError
from g1stream.input_limits import NUMBER
from g1stream.robot.dynamics import InverseDynamics
from g1stream.robot.joints import JOINT_GROUPS
from g1stream.robot.model import G1, REVISIONS
from g1stream.text import counted
from g1stream.types import Support

if TYPE_CHECKING:
    from collections.abc import Iterator

    from g1stream.session.session import Session
    from g1stream.session.summary import Summary
    from g1stream.types import Floats

__all__ = ["Identification", "identify"]

#: More windows than these are thinned out.
_MOST_WINDOWS: Final = 300
_WAIST: Final = list(JOINT_GROUPS["waist"])


class Identification(BaseModel):
    """What the torques of a session show of the robot.

    Attributes:
        support: how it was held.
        robot: the revision that fits better.
        compared: the two revisions.
        position: of the measured torques, 0 at the first revision and 1 at the second.
        torso_mass_kg: of the torso with what is fixed to it; None for a robot that hangs: the band
            carries it, and the waist does not.
        torso_mass_deviation_kg: standard deviation.
        torso_centre_m: its mass centre, x, y, z in the frame of `torso_link`.
        torso_centre_deviation_m: standard deviations.
        time_scale: median of simulated over real time.
        windows: of 0.1 s, that were used.
    """

    support: Support
    robot: str
    compared: tuple[str, str]
    position: float
    torso_mass_kg: float | None
    torso_mass_deviation_kg: float | None
    torso_centre_m: tuple[float, float, float]
    torso_centre_deviation_m: tuple[float, float, float]
    time_scale: float
    windows: int


def identify(session: Session, support: Support | None = None) -> Identification:
    """Compare the measured torques of a session with models of the robot.

    The revision is told as in `stream`. Mass and mass centre of the torso then are those with which
    the model's torques at the waist fit the measured ones best (least squares).

    Args:
        session: of a robot that is bolted or hangs.
        support: how it was held; as the session says if None.

    Raises:
        RecordingError: the support is not known, the robot lacks joints, or too little was
            recorded.
    """
    summary = session.summary()
    support = support or _support(summary)
    if support not in ("bolted", "hanging"):
        raise RecordingError(
            f"The robot cannot be identified: its support is {support or 'unknown'}.",
            "Give --support bolted or --support hanging, as it was held.",
        )
    if summary.absent:
        raise RecordingError(
            "The robot cannot be identified: it lacks "
            f"{counted(len(summary.absent), 'joint')}, which the models have.",
            "Give a session of a G1 with all 29 joints.",
        )
    models = tuple(InverseDynamics(G1.load(name)) for name in REVISIONS)
    fit, scale = RevisionFit(support, (models[0], models[1])), TimeScale()
    windows = list(_windows(session, fit, scale))
    if fit.position is None or len(windows) < 10:
        raise RecordingError(
            "The robot cannot be identified: too little of its torques was recorded.",
            "Give a session with LowState of a robot that moves, at 100 Hz or more.",
        )
    model = models[fit.position > 0.5]
    windows = windows[:: -(-len(windows) // _MOST_WINDOWS)]
    values, deviation = _torso(model, support, windows)
    bolted = support == "bolted"
    centre, around = values[:3].tolist(), deviation[:3].tolist()
    return Identification(
        support=support,
        robot=model.name,
        compared=REVISIONS,
        position=fit.position,
        torso_mass_kg=float(values[3]) if bolted else None,
        torso_mass_deviation_kg=float(deviation[3]) if bolted else None,
        torso_centre_m=centre,
        torso_centre_deviation_m=around,
        time_scale=float(scale.median or 1.0),
        windows=len(windows),
    )


def _support(summary: Summary) -> Support | None:
    """How the robot was held, also by what a stream that was killed has left; None if unknown."""
    if summary.stream:
        known = {str(summary.stream.support)}
    else:
        known = {text.partition(", support ")[2] for text in summary.feedforward_log}
        known.add((summary.settings or {}).get("stream.support", ""))
    return next((support for support in get_args(Support) if support in known), None)


def _windows(session: Session, fit: RevisionFit, scale: TimeScale) -> Iterator[Window]:
    """The windows of RAMP and PLAY; all readings go to the estimators too."""
    states = session.measured
    time = states.time
    phases = [interval for interval in session.phases if interval.phase.name in ("RAMP", "PLAY")]
    moving = np.zeros(len(time), bool)
    for interval in phases:
        moving |= (time >= interval.start_s) & (time <= interval.end_s)
    for name in ("q", "dq", "tau", "imu_quat_wxyz", "gyroscope", "accelerometer"):
        moving &= (np.abs(getattr(states, name)) < NUMBER).all(axis=1)
    moving &= np.abs(states.imu_quat_wxyz).max(axis=1) > 0.1  # a bridge may leave it zero
    readings: list[tuple[Floats, ...]] = []
    start, last = -np.inf, -np.inf
    for k in np.flatnonzero(moving):
        imu = ImuReading(states.imu_quat_wxyz[k], states.gyroscope[k], states.accelerometer[k])
        q, dq, tau, now = states.q[k], states.dq[k], states.tau[k], float(time[k])
        scale.add(now, q, dq)
        fit.add(now, q, dq, tau, imu, scale.value)
        if now - last > fit.GAP:
            readings, start = [], now
        last = now
        readings.append(tuple(part.astype(np.float64) for part in (q, dq, tau, *imu)))
        if now - start >= fit.WINDOW:
            window = Window.of(readings, (now - start) * scale.value)
            if window and len(readings) >= fit.FEWEST:
                yield window
            readings, start = readings[-1:], now


def _torso(
    model: InverseDynamics, support: Support, windows: list[Window]
) -> tuple[Floats, Floats]:
    """Mass centre (3,) m and, of a bolted robot, mass, kg; and their standard deviations."""
    from scipy.optimize import least_squares

    mass, centre = model.carrier

    def misfit(values: Floats) -> Floats:
        model.carrier = float(values[3]) if values.size > 3 else mass, values[:3]
        parts = []
        for window in windows:
            *_, tau = window.solve(model, support)
            parts.append(((tau - window.tau) / window.deviation)[_WAIST])
        return np.concatenate(parts)

    first = np.array([*centre, mass][: 4 if support == "bolted" else 3])
    lowest, highest = np.array([[-0.2, -0.2, -0.1, 1.0], [0.2, 0.2, 0.5, 30.0]])[:, : first.size]
    found = least_squares(misfit, first, bounds=(lowest, highest), loss="soft_l1")
    variance = 2.0 * found.cost / max(1, found.fun.size - first.size)
    deviation = np.sqrt(np.diag(np.linalg.pinv(found.jac.T @ found.jac)) * variance)
    return found.x, deviation
