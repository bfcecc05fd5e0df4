"""What measurements show about the robot: how it is held, and which revision it is; pure."""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from g1stream.robot.dynamics import STICTION_SPEED, BaseMotion, Momentum, friction_torque
from g1stream.robot.joints import FRICTION
from g1stream.robot.rotations import quat_rotate
from g1stream.types import Floats

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from g1stream.control.reading import ImuReading, Reading
    from g1stream.robot.dynamics import InverseDynamics
    from g1stream.types import Support

__all__ = ["ForceObserver", "RevisionFit", "SupportCheck"]

#: Of a measured torque from that of the true model, N·m.
_DEVIATION: Final = 0.15


class ForceObserver:
    """Estimates the force that carries a hanging robot, from the pelvis's accelerometer.

    A band that stretches and swings exerts more than the weight, and not only upward. The measured
    acceleration differs from the model's prediction by the error of the force divided by the mass;
    a fraction of that is added to the estimate at every tick (a disturbance observer, K. Ohnishi
    1987).

    Args:
        dynamics: the model whose solutions are compared.
        period: s between updates.
    """

    #: Time constant, s: above the noise and delay of an IMU, below the swing of a band.
    _TIME: Final = 0.05
    #: The estimate differs from the weight by at most this many times the weight.
    _REACH: Final = 1.0

    def __init__(self, dynamics: InverseDynamics, period: float) -> None:
        self._gain = dynamics.mass * period / self._TIME
        self._weight = np.array([0.0, 0.0, dynamics.mass * dynamics.gravity])
        self._furthest = self._REACH * dynamics.mass * dynamics.gravity
        self._error = np.zeros(3)
        self._expected: list[Floats] = []

    def update(self, imu: ImuReading) -> Floats:
        """The estimated force (3,), N, world, after another reading."""
        # A reading shows the effect of the command before the last one.
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
    """Detects that the robot does not move as the assumed support lets it.

    A change that is measured over windows of 60 ms is compared with its prediction:

    - hanging: the angular momentum about the centre of mass, from joints and IMU, with the moment
      of a force at the torso's centre of mass. The force is that of the whole robot's linear
      momentum, from joints and accelerometer, averaged. Forces between links, self-contact for
      one, change neither momentum.
    - free: the angular momentum, with that of no force.
    - bolted: the angular velocity of the pelvis, with that of rest.
    - follow: the angular velocity of the pelvis, with that of the reference.

    A support is wrong if the prediction misses most of the change for two seconds on end, where
    anything moves. In simulation, unitree_mujoco's included, the correct support misses less than a
    quarter of it, and a wrong one most of it, or more.

    Args:
        dynamics: the model.
        support: as assumed.

    Attributes:
        wrong: whether the support was found to be wrong; stays True.
    """

    _STEP: Final = 0.0095  # s between evaluations
    _WINDOW: Final = 0.06  # s
    _SPAN: Final = 16  # windows that are judged together
    _SPANS: Final = 2  # of them in a row that must fail
    #: A window with a longer gap between readings is not used, s.
    _GAP: Final = 0.03
    #: Change that is not judged, per window: N·m·s of the momentum, rad/s of the pelvis.
    _FLOOR: Final = MappingProxyType({"hanging": 0.1, "free": 0.1, "bolted": 0.03, "follow": 0.03})
    #: The force that carries a hanging robot is averaged over about these times, s, and the one
    #: that explains more counts: an accelerometer misses much of an impact when LowState is late or
    #: repeated, and a force that swings fast is lost in a long average.
    _AVERAGES: Final = np.array([[0.03], [0.15]])
    #: The part of a window by which a simulator's time may differ from what it should be.
    _STALL: Final = 0.5
    #: Fraction of the change that a correct model may miss.
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
        simulated over real time.
        """
        time, imu = measured.received / 1e9, measured.imu
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
        """The quantity that is compared, and its predicted change since the last evaluation."""
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
        # A simulator that stalls, or catches up, has not taken the time that has passed.
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
    def from_readings(cls, readings: Sequence[Reading], passed: float) -> _Window | None:
        """The means of readings over `passed` s of the robot's time.

        The acceleration is the change of velocity. None if a value is not finite.
        """
        rows = [(one.q, one.dq, one.tau, *one.imu) for one in readings]
        columns = [np.array(column, np.float64) for column in zip(*rows, strict=True)]
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
        stuck = FRICTION * (1.0 - np.tanh(np.abs(self.dq) / STICTION_SPEED))
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
        self._readings: list[Reading] = []
        self._start = self._last = -np.inf
        self._work: Iterator[None] = iter(())

    @property
    def position(self) -> float | None:
        """Where the measured torques are, 0 at the first model and 1 at the second; if known."""
        known = self._information > self._ENOUGH
        return self._products / self._information if known else None

    def add(self, measured: Reading, scale: float = 1.0) -> None:
        """Add a reading; at most one model is solved for in a call.

        `scale` is simulated over real time.
        """
        next(self._work, None)
        time = measured.received / 1e9
        if not 0.0 < time - self._last <= self._GAP:
            self._readings, self._start = [], time
        self._last = time
        self._readings.append(measured)
        passed = (time - self._start) * scale
        if time - self._start >= self._WINDOW:
            if len(self._readings) >= self._FEWEST:
                self._work = self._evaluate(self._readings, passed)
            self._readings, self._start = self._readings[-1:], time

    def _evaluate(self, readings: list[Reading], passed: float) -> Iterator[None]:
        """Compare a window, in steps of one solution each."""
        window = _Window.from_readings(readings, passed)
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
