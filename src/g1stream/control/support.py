"""Detect a wrong support from measurements, and the force that carries a robot. Pure."""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.robot.dynamics import BaseMotion, Momentum
from g1stream.robot.rotations import quat_rotate
from g1stream.types import Floats

if TYPE_CHECKING:
    from g1stream.control.reading import ImuReading, Reading
    from g1stream.robot.dynamics import InverseDynamics
    from g1stream.types import Support

__all__ = ["ForceObserver", "SupportCheck"]


class ForceObserver:
    """Estimates the force that carries a hanging robot, from the pelvis's accelerometer.

    The force of a band that stretches and swings differs from the weight in size and direction. The
    measured acceleration differs from the model's prediction by the force error divided by the
    mass. A fraction of this difference corrects the estimate at every tick (a disturbance observer,
    K. Ohnishi 1987).

    Args:
        dynamics: the model that predicts the acceleration.
        period: time between updates, s.
    """

    #: Time constant, s; above the noise and delay of an IMU, and below the swing of a band.
    _TIME: Final = 0.05
    #: Maximum difference of the estimate from the weight, in multiples of the weight.
    _REACH: Final = 1.0

    def __init__(self, dynamics: InverseDynamics, period: float) -> None:
        self._gain = dynamics.mass * period / self._TIME
        self._weight = np.array([0.0, 0.0, dynamics.mass * dynamics.gravity])
        self._furthest = self._REACH * dynamics.mass * dynamics.gravity
        self._error = np.zeros(3)
        self._expected: list[Floats] = []

    def update(self, imu: ImuReading) -> Floats:
        """Update the estimate with a reading; return the force (3,), N, world."""
        # A reading shows the effect of the last command but one.
        if len(self._expected) == 2:
            wrong = imu.accelerometer - self._expected.pop(0)
            self._error += self._gain * quat_rotate(imu.quat_wxyz.astype(np.float64), wrong)
            length = float(np.sqrt(self._error @ self._error))
            self._error *= min(1.0, self._furthest / max(length, 1e-9))
        return self._weight + self._error

    def expect(self, specific_force: Floats) -> None:
        """Store the predicted accelerometer reading (3,) for the command of this tick, m/s²."""
        self._expected.append(specific_force)


class SupportCheck:
    """Detects that the robot does not move as the assumed support allows.

    It compares a change, measured over windows of 60 ms, with its prediction:

    - hanging: the angular momentum about the centre of mass, from joints and IMU, is compared with
      the moment of a force at the torso's centre of mass. The force comes from the linear momentum
      of the whole robot, from joints and accelerometer, averaged. Forces between links, such as
      self-contact, change neither momentum.
    - free: the angular momentum is compared with the one without a force.
    - bolted: the angular velocity of the pelvis is compared with zero.
    - follow: the angular velocity of the pelvis is compared with that of the reference.

    A support is wrong if the prediction misses most of the change for two seconds in a row while
    anything moves. In simulation, including unitree_mujoco, the correct support misses less than a
    quarter of the change, and a wrong one most of it or more.

    Args:
        dynamics: the model of the robot.
        support: the assumed support.

    Attributes:
        wrong: whether the support was found to be wrong; stays True.
    """

    _STEP: Final = 0.0095  # s between evaluations
    _WINDOW: Final = 0.06  # s
    _SPAN: Final = 16  # windows that are evaluated together
    _SPANS: Final = 2  # spans in a row that must fail
    #: Gap between readings above which a window is not used, s.
    _GAP: Final = 0.03
    #: Change per window that is ignored: N·m·s of the momentum, rad/s of the pelvis.
    _FLOOR: Final = MappingProxyType({"hanging": 0.1, "free": 0.1, "bolted": 0.03, "follow": 0.03})
    #: Time constants of two averages of the force that carries a hanging robot, s. The average that
    #: explains more of the change is used. A short one misses much of an impact when LowState is
    #: late or repeated, and a long one misses a force that swings fast.
    _AVERAGES: Final = np.array([[0.03], [0.15]])
    #: Maximum deviation of a simulator's time from the clock, as a share of a window.
    _STALL: Final = 0.5
    #: Share of the change that a correct model may miss.
    _UNEXPLAINED: Final = 0.5

    def __init__(self, dynamics: InverseDynamics, support: Support) -> None:
        self.wrong = False
        self._dynamics = dynamics
        self._support = support
        self._floor = self._FLOOR[support]
        self._start = self._last = self._received = -np.inf
        self._specific, self._readings = np.zeros(3), 0
        self._expected = self._from = self._predicted = np.zeros(3)
        self._momentum = Momentum(np.zeros(3), np.zeros(3), np.zeros(3))
        self._force = np.tile([0.0, 0.0, dynamics.gravity], (2, 1))  # per kg
        self._carried = np.zeros((2, 3))
        self._missed, self._changed = np.zeros(2), 0.0
        self._windows = self._failed = 0

    def add(self, measured: Reading, expected: Floats, scale: float = 1.0) -> None:
        """Add a reading.

        `expected` is the angular velocity (3,) of the pelvis in the reference, rad/s; `scale` is
        the ratio of simulated to real time.
        """
        time, imu = measured.arrived / 1e9, measured.imu
        if not 0.0 <= time - self._received <= self._GAP:
            self._start = -np.inf
        self._received = time
        self._specific = self._specific + imu.accelerometer
        self._readings += 1
        passed = time - self._last
        if 0.0 <= passed < self._STEP and np.isfinite(self._start):
            return
        value, impulse = self._evaluate(measured, expected, passed * scale)
        self._last = time
        self._specific, self._readings = np.zeros(3), 0
        if not np.isfinite(self._start):
            self._begin(time, value)
            return
        self._predicted = self._predicted + impulse
        if time - self._start >= self._WINDOW:
            self._judge(value - self._from)
            self._begin(time, value)

    def _evaluate(
        self, measured: Reading, expected: Floats, passed: float
    ) -> tuple[Floats, Floats]:
        """The compared quantity, and its predicted change since the last evaluation."""
        imu = measured.imu
        rate = imu.gyroscope.astype(np.float64)
        if self._support in ("bolted", "follow"):
            turned, self._expected = expected - self._expected, expected
            return rate, turned if self._support == "follow" else np.zeros(3)
        quat = imu.quat_wxyz.astype(np.float64)
        momentum = self._dynamics.momentum(
            measured.q.astype(np.float64), measured.dq.astype(np.float64), BaseMotion(quat, rate)
        )
        before, self._momentum = self._momentum, momentum
        if self._support == "free" or not np.isfinite(self._start):
            return momentum.angular, np.zeros(3)
        specific = quat_rotate(quat, self._specific / self._readings)
        force = specific + (momentum.velocity - before.velocity) / passed
        self._force = self._force + (force - self._force) * np.minimum(1.0, passed / self._AVERAGES)
        lever = 0.5 * self._dynamics.mass * (before.lever + momentum.lever)
        self._carried = self._carried + np.cross(lever, self._force) * passed
        return momentum.angular, np.zeros(3)

    def _begin(self, time: float, value: Floats) -> None:
        self._start, self._from = time, value
        self._predicted, self._carried = np.zeros(3), np.zeros((2, 3))

    def _judge(self, change: Floats) -> None:
        # In a simulator that stalls or catches up, another time has passed than on the clock.
        left = change - self._predicted
        square = np.maximum((self._carried**2).sum(axis=1), 1e-12)
        taken = np.clip(self._carried @ left / square, 1.0 - self._STALL, 1.0 + self._STALL)
        self._missed += np.linalg.norm(left - taken[:, np.newaxis] * self._carried, axis=1)
        self._changed += float(np.linalg.norm(change))
        self._windows += 1
        if self._windows == self._SPAN:
            allowed = self._UNEXPLAINED * self._changed + self._floor * self._SPAN
            self._failed = self._failed + 1 if self._missed.min() > allowed else 0
            self.wrong |= self._failed >= self._SPANS
            self._missed, self._changed = np.zeros(2), 0.0
            self._windows = 0
