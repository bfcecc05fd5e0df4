"""Which of two revisions of a robot is the one that moves; pure."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from g1stream.robot.dynamics import BaseMotion, friction_torque
from g1stream.robot.joints import FRICTION
from g1stream.robot.rotations import quat_rotate
from g1stream.types import Floats

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from g1stream.control.state_checks import ImuReading
    from g1stream.robot.dynamics import InverseDynamics
    from g1stream.types import Support

__all__ = ["RevisionFit"]


#: Of a measured torque from that of the true model, N·m.
_DEVIATION: Final = 0.15
#: Below about this speed dry friction may take any value up to its full one, rad/s.
_STICTION_SPEED: Final = 0.05


class _Window(NamedTuple):
    """The means of some readings.

    Attributes:
        q, dq, ddq, tau: (29,) rad, rad/s, rad/s², N·m, motor order.
        quat_wxyz: (4,) pelvis to world.
        rate: (3,) rad/s, of the gyroscope.
        specific: (3,) m/s², of the accelerometer.
        friction: (29,) N·m, by which the mean friction differs from that at the mean speed.
    """

    q: Floats
    dq: Floats
    ddq: Floats
    tau: Floats
    quat_wxyz: Floats
    rate: Floats
    specific: Floats
    friction: Floats

    @classmethod
    def of(cls, readings: Sequence[tuple[Floats, ...]], passed: float) -> _Window | None:
        """Of tuples of q, dq, tau and an `ImuReading`, over `passed` s of the robot's time.

        The acceleration is the change of velocity. None if a value is not finite.
        """
        columns = [np.array(column) for column in zip(*readings, strict=True)]
        q, dq, tau, quat, rate, specific = (column.mean(axis=0) for column in columns)
        norm = float(np.linalg.norm(quat))
        if not np.isfinite(np.concatenate((q, dq, tau, rate, specific, [norm]))).all() or not norm:
            return None
        speeds = columns[1]
        friction = np.mean([friction_torque(speed) for speed in speeds], axis=0)
        return cls(
            q,
            dq,
            (speeds[-1] - speeds[0]) / passed,
            tau,
            quat / norm,
            rate,
            specific,
            friction - friction_torque(dq),
        )

    @property
    def deviation(self) -> Floats:
        """(29,) N·m, that of a measured torque: for a joint that hardly moves, its dry friction."""
        stuck = FRICTION * (1.0 - np.tanh(np.abs(self.dq) / _STICTION_SPEED))
        return np.hypot(_DEVIATION, stuck)

    def solve(self, model: InverseDynamics, support: Support) -> Iterator[Floats]:
        """Predicted torques (29,), N·m, better with each iteration; the last one counts.

        The force that carries a hanging robot becomes that which the accelerometer shows.
        """
        base = BaseMotion(self.quat_wxyz, self.rate)
        force = np.array([0.0, 0.0, model.mass * model.gravity])
        for _ in range(3 if support == "hanging" else 1):
            solution = model.solve(support, self.q, self.dq, self.ddq, base, force=force)
            missing = self.specific - model.specific_force(solution, base)
            force = force + model.mass * quat_rotate(base.quat_wxyz, missing)
            yield solution.tau + self.friction


class RevisionFit:
    """Compares measured torques with the inverse dynamics of two models.

    Readings are averaged over windows, whose mean acceleration is the change of velocity; a hanging
    robot is carried by the force that its accelerometer shows. The torques that the models predict,
    t1 and t2, and the measured ones, t, give the position of t between the two, by least squares
    over all joints and windows:

        a = sum((t - t1) . (t2 - t1) / s²) / sum((t2 - t1)² / s²)

    It is 0 for the first model and 1 for the second. s is the deviation of a measured torque.

    Args:
        support: how the robot is held.
        models: the two.
    """

    _WINDOW: Final = 0.1  # s
    _GAP: Final = 0.03  # s between readings, beyond which a window is not used
    _FEWEST: Final = 8  # readings in a window
    #: The least information that decides, 1 / variance of a.
    _ENOUGH: Final = 10.0

    def __init__(self, support: Support, models: tuple[InverseDynamics, InverseDynamics]) -> None:
        self._support = support
        self._models = models
        self._products = self._information = 0.0
        self._readings: list[tuple[Floats, ...]] = []
        self._start = self._last = -np.inf
        self._work: Iterator[None] = iter(())

    @property
    def position(self) -> float | None:
        """Where the measured torques are, 0 at the first model and 1 at the second; if known."""
        known = self._information > self._ENOUGH
        return self._products / self._information if known else None

    def add(
        self,
        time: float,
        q: NDArray[np.floating],
        dq: NDArray[np.floating],
        tau: NDArray[np.floating],
        imu: ImuReading,
        scale: float = 1.0,
    ) -> None:
        """Add a reading; at most one model is solved for in a call.

        `FeedForward.observe` describes the reading; `scale` is simulated over real time.
        """
        next(self._work, None)
        if not 0.0 < time - self._last <= self._GAP:
            self._readings, self._start = [], time
        self._last = time
        self._readings.append(tuple(part.astype(np.float64) for part in (q, dq, tau, *imu)))
        passed = (time - self._start) * scale
        if time - self._start >= self._WINDOW:
            if len(self._readings) >= self._FEWEST:
                self._work = self._evaluate(self._readings, passed)
            self._readings, self._start = self._readings[-1:], time

    def _evaluate(self, readings: list[tuple[Floats, ...]], passed: float) -> Iterator[None]:
        """Compare a window, in steps of one solution each."""
        window = _Window.of(readings, passed)
        if window is None:
            return
        predicted = []
        for model in self._models:
            for tau in window.solve(model, self._support):
                latest = tau
                yield
            predicted.append(latest)
        first, second = predicted
        apart, weight = second - first, 1.0 / window.deviation**2
        self._products += float((weight * apart) @ (window.tau - first))
        self._information += float((weight * apart) @ apart)
