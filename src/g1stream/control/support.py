"""What the IMU in the pelvis shows about how the robot is held; pure."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.robot.rotations import quat_rotate
from g1stream.types import Floats

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from g1stream.control.safety import ImuReading
    from g1stream.robot.dynamics import InverseDynamics

__all__ = ["ForceObserver", "SupportCheck"]


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
    """Detects that the pelvis does not rotate as the assumed support predicts.

    The change of the gyroscope's reading over a short window is compared with the model's
    prediction. A support is wrong if the prediction misses most of the change in most of 50
    windows, one second. In simulation the correct support fails in up to a sixth of the windows of
    a dance, a wrong one in most of them within seconds; `free` for a hanging robot is the hardest
    to detect.

    Args:
        period: s between ticks.

    Attributes:
        wrong: whether the support was found to be wrong; stays True.
    """

    _WINDOW: Final = 0.02
    _SPAN: Final = 50  # windows
    #: The last prediction is used for up to this many periods without a tick; a longer stall is
    #: not evaluated.
    _GAP: Final = 3
    #: Allowed difference for noise and the play of a real mount, rad/s per window.
    _FLOOR: Final = 0.03
    #: Fraction of the change that a correct model may miss.
    _UNEXPLAINED: Final = 0.7
    #: Fraction of the windows in which it may miss more than that.
    _MOST: Final = 0.5

    def __init__(self, period: float) -> None:
        self.wrong = False
        self._gap = (self._GAP + 0.5) * period
        self._window = max(self._WINDOW, period) - period / 2.0
        self._last, self._ang_acc = -np.inf, np.zeros(3)
        self._begun, self._rate, self._predicted = 0.0, np.zeros(3), np.zeros(3)
        self._windows = self._failed = 0

    def add(self, time: float, gyroscope: NDArray[np.floating], ang_acc: Floats) -> None:
        """Add the reading and the prediction of another tick.

        Args:
            time: of the tick, s.
            gyroscope: (3,) the measured rate, rad/s.
            ang_acc: (3,) its predicted rate of change from then on, rad/s².
        """
        passed = time - self._last
        self._last = time
        if 0.0 < passed <= self._gap:
            self._predicted += passed * self._ang_acc
            if time - self._begun >= self._window:
                self._judge(gyroscope - self._rate)
                self._begin(time, gyroscope)
        else:
            self._begin(time, gyroscope)
        self._ang_acc = ang_acc

    def _begin(self, time: float, gyroscope: NDArray[np.floating]) -> None:
        self._begun, self._rate = time, gyroscope.astype(np.float64)
        self._predicted = np.zeros(3)

    def _judge(self, change: Floats) -> None:
        unexplained = float(np.linalg.norm(change - self._predicted))
        allowed = np.hypot(self._FLOOR, self._UNEXPLAINED * float(np.linalg.norm(change)))
        self._failed += unexplained > allowed
        self._windows += 1
        if self._windows == self._SPAN:
            self.wrong |= self._failed > self._MOST * self._SPAN
            self._windows = self._failed = 0
