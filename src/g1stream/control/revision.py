"""Which of two revisions of a robot is the one that moves; pure."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.robot.dynamics import BaseMotion, friction_torque
from g1stream.robot.joints import FRICTION
from g1stream.robot.rotations import quat_normalize, quat_rotate
from g1stream.types import Floats

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from g1stream.control.safety import ImuReading
    from g1stream.robot.dynamics import InverseDynamics
    from g1stream.types import Support

__all__ = ["RevisionFit"]


class RevisionFit:
    """Compares measured torques with the inverse dynamics of two models.

    Readings are averaged over windows, whose mean acceleration is the change of velocity; a hanging
    robot is carried by the force that its accelerometer shows. The torques that the models predict,
    t1 and t2, and the measured ones, t, give the position of t between the two, by least squares
    over all joints and windows:

        a = sum((t - t1) . (t2 - t1) / s²) / sum((t2 - t1)² / s²)

    It is 0 for the first model and 1 for the second. s is the deviation of a measured torque:
    that of the model, and for a joint that hardly moves its dry friction.

    Args:
        support: how the robot is held.
        models: the two.
    """

    WINDOW: Final = 0.1  # s
    _GAP: Final = 0.03  # s between readings, beyond which a window is not used
    _DEVIATION: Final = 0.15  # N·m
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

        Args:
            time: when it was received, s.
            q: (29,) measured, rad, motor order.
            dq: (29,) rad/s.
            tau: (29,) N·m.
            imu: in the pelvis.
            scale: simulated over real time.
        """
        next(self._work, None)
        if not 0.0 < time - self._last <= self._GAP:
            self._readings, self._start = [], time
        self._last = time
        self._readings.append(tuple(part.astype(np.float64) for part in (q, dq, tau, *imu)))
        passed = (time - self._start) * scale
        if time - self._start >= self.WINDOW:
            if len(self._readings) >= self._FEWEST:
                self._work = self._evaluate(self._readings, passed)
            self._readings, self._start = self._readings[-1:], time

    def _evaluate(self, readings: list[tuple[Floats, ...]], passed: float) -> Iterator[None]:
        """Compare a window, in steps of one solution each."""
        columns = [np.array(column) for column in zip(*readings, strict=True)]
        q, dq, tau, quat, rate, specific = (column.mean(axis=0) for column in columns)
        speeds = columns[1]
        ddq = (speeds[-1] - speeds[0]) / passed
        friction = np.mean([friction_torque(speed) for speed in speeds], axis=0)
        friction -= friction_torque(dq)
        if not all(np.isfinite(part).all() for part in (q, dq, tau, quat, rate, specific)):
            return
        base = BaseMotion(quat_normalize(quat), rate)
        predicted = []
        for model in self._models:
            force = np.array([0.0, 0.0, model.mass * model.gravity])
            for _ in range(3 if self._support == "hanging" else 1):
                solution = model.solve(self._support, q, dq, ddq, base, force=force)
                missing = specific - model.specific_force(solution, base)
                force = force + model.mass * quat_rotate(base.quat_wxyz, missing)
                yield
            predicted.append(solution.tau + friction)
        first, second = predicted
        stuck = FRICTION * (1.0 - np.tanh(np.abs(dq) / 0.05))
        weight = 1.0 / (self._DEVIATION**2 + stuck**2)
        apart = second - first
        self._products += float((weight * apart) @ (tau - first))
        self._information += float((weight * apart) @ apart)
