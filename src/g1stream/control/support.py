"""What the pelvis's inertial unit tells about how the robot is held; pure."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.robot.rotations import quat_rotate

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from g1stream.control.measured import ImuReading
    from g1stream.robot.dynamics import InverseDynamics

__all__ = ["ForceObserver", "SupportCheck"]


class ForceObserver:
    """Estimates the force that carries a hanging robot, from the pelvis's accelerometer.

    A band that stretches and swings does not carry the weight alone, straight up. What the model
    expects the accelerometer to say, and what it says, differ by the force's error over the mass:
    a share of that goes into the estimate at every tick (a disturbance observer, K. Ohnishi 1987).

    Args:
        dynamics: the model whose solutions are compared.
        period: s between updates.
    """

    #: Slower than the noise and the delay of a unit, faster than the swing of a band, s.
    _TIME: Final = 0.05
    #: The estimate stays within this many weights of the weight.
    _REACH: Final = 1.0

    def __init__(self, dynamics: InverseDynamics, period: float) -> None:
        self._gain = dynamics.mass * period / self._TIME
        self._weight = np.array([0.0, 0.0, dynamics.mass * dynamics.gravity])
        self._furthest = self._REACH * dynamics.mass * dynamics.gravity
        self._error = np.zeros(3)
        self._expected: list[NDArray[np.float64]] = []

    def update(self, imu: ImuReading) -> NDArray[np.float64]:
        """The force (3,), N, world, after another reading."""
        # A reading answers the command before the last, which it was prepared beside.
        if len(self._expected) == 2:
            wrong = imu.accelerometer - self._expected.pop(0)
            self._error += self._gain * quat_rotate(imu.quat_wxyz.astype(np.float64), wrong)
            length = float(np.sqrt(self._error @ self._error))
            self._error *= min(1.0, self._furthest / max(length, 1e-9))
        return self._weight + self._error

    def expect(self, felt: NDArray[np.float64]) -> None:
        """Remember what (3,) the accelerometer ought to say to the command of this tick, m/s²."""
        self._expected.append(felt)


class SupportCheck:
    """Notices that the pelvis does not turn as the assumed support lets it.

    The change of the gyroscope's reading over a short window is compared with what the model says.
    A support that leaves most of the change unexplained in most of 50 windows, a second's worth, is
    wrong, and so is one that predicts what does not happen. In simulation a right support fails in
    up to a sixth of the windows of a dance, a wrong one in most of them within seconds; `free` told
    of a robot that hangs is the hardest to notice.

    Args:
        period: s between ticks.

    Attributes:
        wrong: whether it was; for good.
    """

    _WINDOW: Final = 0.02
    _SPAN: Final = 50  # windows
    #: Over so many periods without a tick the last prediction still holds; a longer stall is left
    #: out.
    _GAP: Final = 3
    #: What nobody is blamed for: noise, and the play of a real mount, rad/s a window.
    _FLOOR: Final = 0.03
    #: The part of the change that a right model may leave unexplained.
    _UNEXPLAINED: Final = 0.7
    #: The part of the windows in which it may leave more than that.
    _MOST: Final = 0.5

    def __init__(self, period: float) -> None:
        self.wrong = False
        self._gap = (self._GAP + 0.5) * period
        self._window = max(self._WINDOW, period) - period / 2.0
        self._last, self._ang_acc = -np.inf, np.zeros(3)
        self._begun, self._rate, self._predicted = 0.0, np.zeros(3), np.zeros(3)
        self._windows = self._failed = 0

    def add(
        self, time: float, gyroscope: NDArray[np.floating], ang_acc: NDArray[np.float64]
    ) -> None:
        """Take another tick's reading and prediction.

        Args:
            time: of the tick, s.
            gyroscope: (3,) the measured rate, rad/s.
            ang_acc: (3,) the predicted change of it from then on, rad/s².
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

    def _judge(self, change: NDArray[np.float64]) -> None:
        unexplained = float(np.linalg.norm(change - self._predicted))
        allowed = np.hypot(self._FLOOR, self._UNEXPLAINED * float(np.linalg.norm(change)))
        self._failed += unexplained > allowed
        self._windows += 1
        if self._windows == self._SPAN:
            self.wrong |= self._failed > self._MOST * self._SPAN
            self._windows = self._failed = 0
