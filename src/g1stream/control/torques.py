"""Where the torque of a command comes from: the interface, and the torques of a robot that is held.

Pure. The torques of a robot on its feet are in `g1stream.extras.feet.standing_torques`.
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, ClassVar, Final, NamedTuple, Protocol

import numpy as np

from g1stream.control.revision import RevisionFit
from g1stream.control.support import ForceObserver, SupportCheck
from g1stream.robot.dynamics import BaseMotion, InverseDynamics
from g1stream.types import Phase, StreamSupport, Support

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from g1stream.control.state_checks import ImuReading
    from g1stream.control.targets import Target
    from g1stream.session.records import BalanceSummary

__all__ = ["HeldTorques", "Moment", "Reading", "TorqueSource"]

_LOGGER = logging.getLogger(__name__)

#: The revision of the robot is decided on when this share of RAMP has passed.
_DECISION: Final = 0.8


class Reading(NamedTuple):
    """What a LowState has of the joints, (29,) in motor order, and of the pelvis."""

    q: NDArray[np.floating]  # rad
    dq: NDArray[np.floating]  # rad/s
    tau: NDArray[np.floating]  # N·m
    imu: ImuReading


class Moment(NamedTuple):
    """When a torque is asked for, and for what.

    Attributes:
        phase: RAMP, PLAY or HOLD.
        ramped: time since RAMP began over its length; 1 after it.
        target: the desired state when the command takes effect.
        imu: the newest reading of it.
        age: s since that was received.
    """

    phase: Phase
    ramped: float
    target: Target
    imu: ImuReading
    age: float


class TorqueSource(Protocol):
    """Computes the torque of each command.

    Attributes:
        name: of the robot's model.
        needed: the robot falls without this torque, so that the run ends where it has faded out.
        fault: why this torque is wrong, so that it has to fade out; "" while it is right.
        fall: why the robot has to be damped at once; "" while it need not.
        awaited: what RAMP waits for; "" where it need not wait.
        stands: the robot is on its feet in RAMP already, so that it can squat down.
        balance_summary: how near a robot on its feet was to falling; None for one that is held.
    """

    needed: ClassVar[bool]

    @property
    def name(self) -> str: ...

    @property
    def fault(self) -> str: ...

    @property
    def fall(self) -> str: ...

    @property
    def awaited(self) -> str: ...

    @property
    def stands(self) -> bool: ...

    @property
    def balance_summary(self) -> BalanceSummary | None: ...

    def begin(self, support: StreamSupport, announced: str | None, robot: str | None) -> None:
        """RAMP begins.

        Args:
            support: how the robot is held.
            announced: the support that the bridge announces; None if it does not.
            robot: the name of the robot that it announces; None if it does not.

        Raises:
            ConfigError: there is no torque for how the bridge holds the robot.
        """

    def ramp_to(self, first: Target) -> None:
        """RAMP begins, or begins anew, to the first target of PLAY."""

    def observe(self, phase: Phase, time: float, reading: Reading, scale: float) -> None:
        """Take a LowState into account that was received at `time`, s.

        `scale` is simulated over real time.
        """

    def command(self, moment: Moment) -> Target:
        """The target with the torque of its command; that of the servos comes on top."""


class HeldTorques:
    """The inverse dynamics of the reference for a robot that is held in a known way.

    Args:
        dynamics: the model.
        alternative: another model, of another revision of the robot. During RAMP the measured
            torques are compared with both, and the one that fits better is used from then on.
        period: s between commands.
        complete: every joint gets its torque; otherwise the revisions cannot be told apart.
    """

    needed: ClassVar = False
    fall: Final = ""
    awaited: Final = ""
    stands: Final = False
    balance_summary: Final = None

    def __init__(
        self,
        dynamics: InverseDynamics,
        alternative: InverseDynamics | None = None,
        *,
        period: float,
        complete: bool = True,
    ) -> None:
        self._dynamics, self._alternative = dynamics, alternative
        self._period = period
        self._complete = complete
        self._support: Support = "bolted"
        self._trusted = False
        self._observer: ForceObserver | None = None
        self._check: SupportCheck | None = None
        self._fit: RevisionFit | None = None
        self._expected_rate = np.zeros(3)

    @property
    def name(self) -> str:
        """Of the robot's model."""
        return self._dynamics.name

    @property
    def fault(self) -> str:
        """That the robot is not held as assumed, or ""."""
        wrong = self._check and self._check.wrong
        support = self._support
        return (
            f"the robot does not move as with support {support}; correct --support" if wrong else ""
        )

    def begin(self, support: StreamSupport, announced: str | None, robot: str | None) -> None:
        """RAMP begins; `TorqueSource` has the arguments."""
        if support == "feet":
            raise ValueError("nothing holds a robot on its feet")
        self._support, self._trusted = support, support == announced
        if announced and not self._trusted:
            _LOGGER.warning(
                "the bridge announces support %s, not %s: tracking with a wrong support is worse "
                "than without feed-forward",
                announced,
                support,
            )
        if self._alternative and robot == self._alternative.name:
            self._dynamics = self._alternative
        elif self._alternative and robot is None and self._complete:
            self._fit = RevisionFit(support, (self._dynamics, self._alternative))
        self._use(self._dynamics)

    def _use(self, dynamics: InverseDynamics) -> None:
        """Compute torques with this model, and check the support by it."""
        self._dynamics = dynamics
        # What the bridge announces about itself needs no check.
        self._check = None if self._trusted else SupportCheck(dynamics, self._support)
        if self._support == "hanging":
            self._observer = ForceObserver(dynamics, self._period)

    def ramp_to(self, first: Target) -> None:
        """The torque does not depend on where RAMP leads."""

    def observe(self, phase: Phase, time: float, reading: Reading, scale: float) -> None:
        """Take a LowState into account; `TorqueSource` has the arguments."""
        q, dq, tau, imu = reading
        if self._fit and phase is Phase.RAMP:
            self._fit.add(time, q, dq, tau, imu, scale)
        elif self._check and phase is Phase.PLAY:
            self._check.add(time, q, dq, imu, self._expected_rate, scale)

    def command(self, moment: Moment) -> Target:
        """The target with the torque of its command; that of the servos comes on top."""
        if self._fit and (moment.phase is not Phase.RAMP or moment.ramped > _DECISION):
            self._decide(self._fit.position)
            self._fit = None
        target, imu, dynamics = moment.target, moment.imu, self._dynamics
        self._expected_rate = target.root_ang_vel
        if self._support == "follow":
            base = BaseMotion(
                target.root_quat_wxyz, target.root_ang_vel, target.root_lin_acc, target.root_ang_acc
            )
        else:
            base = BaseMotion(imu.quat_wxyz.astype(np.float64), imu.gyroscope.astype(np.float64))
        force = self._observer.update(imu) if self._observer else None
        solution = dynamics.solve(self._support, target.q, target.dq, target.ddq, base, force=force)
        if self._observer:
            self._observer.expect(dynamics.specific_force(solution, base))
        return target.replace(tau=solution.tau)

    def _decide(self, position: float | None) -> None:
        """Continue with the model that the measured torques are nearer to."""
        first, second = self._dynamics, self._alternative
        if second is None:
            return
        if position is not None and position > 0.5:
            self._use(second)
        why = (
            "too little is known of its torques to tell"
            if position is None
            else f"measured torques at {position:.2f}, {first.name} at 0, {second.name} at 1"
        )
        _LOGGER.info("feed-forward: robot %s: %s", self.name, why)
