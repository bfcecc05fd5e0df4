"""Feed-forward: the velocity and torque of a command, from the model of the robot.

Pure: time and measurements come in as arguments. docs/tracking.md explains the method.
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Final, get_args

import numpy as np

from g1stream.control.balance import Balance, Reading
from g1stream.control.revision import RevisionFit
from g1stream.control.state_checks import STALE, ImuReading, all_finite, is_unit
from g1stream.control.support import ForceObserver, SupportCheck
from g1stream.control.targets import LOWERED
from g1stream.control.time_scale import TimeScale
from g1stream.errors import ConfigError
from g1stream.motion.blend import minimum_jerk
from g1stream.robot.dynamics import BaseMotion, InverseDynamics
from g1stream.robot.joints import N_JOINTS
from g1stream.robot.model import G1, REVISIONS
from g1stream.session.summary import FeedForwardChange
from g1stream.types import FeedForwardKind, Floats, Ints, Phase, StreamSupport, Support

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from g1stream.control.targets import Target
    from g1stream.settings import StreamConfig

__all__ = ["FeedForward"]

_LOGGER = logging.getLogger(__name__)

#: No G1 turns faster than this without having fallen, rad/s.
_MAX_GYROSCOPE: Final = 30.0
#: The torque fades out, and in again, in this time, s.
_FADE: Final = 0.1
#: The revision of the robot is decided on when this share of RAMP has passed.
_DECISION: Final = 0.8


class FeedForward:
    """Adds velocity and torque to targets.

    With `dynamics`, the torque is that of the inverse dynamics of the reference for the given
    support: joint motion from the reference, attitude and rate of the pelvis from the IMU. It fades
    in with RAMP. While the IMU is stale or implausible, and once the robot does not move as the
    support lets it, the torque is faded out and the velocity remains.

    Velocities are given in the robot's time, which in a simulator that is short of CPU is slower
    than the clock: the reference's velocity is divided by the time scale, its acceleration by the
    square of it.

    Args:
        kind: what commands carry beside q; None: `dynamics` where the bridge announces how it holds
            the robot, `velocity` elsewhere.
        support: how the robot is held; None: as the bridge announces.
        dynamics: the model; needed for `dynamics`.
        alternative: another model, of another revision of the robot. During RAMP the measured
            torques are compared with both, and the one that fits better is used from then on.
        limit: (29,) N·m, the largest torque in either direction; 0 for joints that get none.
        period: s between commands.
        ramp: s, length of RAMP; the torque fades in during its first half.
        preview: s by which the target of a command is ahead of its publish time, because it takes
            effect later; None: a period for a bridge that announces its support, otherwise 0.
        time_scale: simulated over real time; None: it is measured.
        recorded: the commands of PLAY are recorded ones, so that this applies to RAMP and HOLD.
        balance: keeps a robot with support `feet` on them.

    Attributes:
        kind, support: as given; after `begin`, as decided.
        recorded: as given.
        scale: the measured time scale; None where it is given.
        ramp: as given; it may be set until RAMP begins.
        saturated: (29,) int64, ticks at which each joint's torque was held at its limit.
        changes: when the torque was switched off and on again, in order.
    """

    def __init__(
        self,
        kind: FeedForwardKind | None,
        support: StreamSupport | None = None,
        *,
        dynamics: InverseDynamics | None = None,
        alternative: InverseDynamics | None = None,
        limit: Floats,
        period: float,
        ramp: float,
        preview: float | None = 0.0,
        time_scale: float | None = 1.0,
        recorded: bool = False,
        balance: Balance | None = None,
    ) -> None:
        self.kind = kind
        self.support = support
        self.recorded = recorded
        self.scale = TimeScale() if time_scale is None else None
        self.saturated: Ints = np.zeros(N_JOINTS, dtype=np.int64)
        self.changes: list[FeedForwardChange] = []
        self._given_preview, self._given_scale = preview, time_scale or 1.0
        self._dynamics = dynamics
        self._alternative = alternative
        self._limit = limit
        self._period = period
        self.ramp = ramp
        self._weight = 1.0  # of the torque, 0 while faded out
        self._fault = ""  # the reported one
        self._tau = np.zeros(N_JOINTS)
        self._balance = balance
        self._reading: Reading | None = None
        self._observer: ForceObserver | None = None
        self._check: SupportCheck | None = None
        self._fit: RevisionFit | None = None
        self._announced = self._trusted = False
        self._phase = Phase.WAIT
        self._expected_rate = np.zeros(3)

    @property
    def preview(self) -> float:
        """How far commands are ahead of the motion, s."""
        if self._given_preview is not None:
            return self._given_preview
        # Our bridge's servo runs at the rate of commands: it reads one half a period after it
        # arrived on average, and holds it for a whole one. unitree_mujoco's bridges run at another
        # rate or on the arrival of a command, with measurements that are older by a step.
        return self._period if self._announced else 0.0

    @property
    def median_time_scale(self) -> float | None:
        """Of simulated over real time, where it is measured."""
        return self.scale.median if self.scale else None

    @property
    def robot(self) -> str | None:
        """The name of the model that torques are computed with; None without torques."""
        return self._dynamics.name if self._dynamics and self.kind == "dynamics" else None

    @classmethod
    def from_config(
        cls,
        settings: StreamConfig,
        robot: G1,
        period: float,
        *,
        recorded: bool = False,
        held: NDArray[np.bool_] | None = None,
    ) -> FeedForward:
        """The feed-forward of a config for commands that are `period` seconds apart.

        Joints that are not `held` (29,) get no torque.

        Raises:
            RobotError: the inverse dynamics of this robot cannot be computed.
        """
        kind = settings.feedforward
        torque = kind in (None, "dynamics")
        balance = None
        if settings.support == "feet":
            if recorded or not torque:
                raise ConfigError(
                    "support feet needs torques that are computed at every tick.",
                    "Leave out --exact, or hold the robot otherwise."
                    if recorded
                    else "Give --feedforward dynamics, or hold the robot otherwise.",
                )
            balance = Balance(robot, period)
        other = G1.load(REVISIONS[1]) if torque and robot is G1.default() else None
        return cls(
            kind,
            settings.support,
            dynamics=InverseDynamics(robot) if torque else None,
            alternative=InverseDynamics(other) if other else None,
            limit=robot.torque_limit if held is None else robot.torque_limit * held,
            period=period,
            ramp=settings.ramp,
            preview=settings.preview,
            time_scale=settings.time_scale,
            recorded=recorded,
            balance=balance,
        )

    def stand_on(self, first: Target) -> None:
        """RAMP begins to this target, on whose feet the robot is to stand, if it is to."""
        if self._balance:
            self._balance.begin(first)

    def verdict(self) -> str:
        """Why a robot on its feet has to be damped, or ""."""
        if self._balance is None:
            return ""
        lost = f"the torque that keeps the robot on its feet has faded out: {self._fault}"
        return self._balance.fault or (lost if self._fault else "")

    def begin(self, announced: str | None, robot: str | None = None) -> None:
        """Decide on kind and support, and log the decision.

        Args:
            announced: the support that the bridge announces; None if it does not.
            robot: the name of the robot that it announces; None if it does not.
        """
        given = self.support
        self._announced = announced is not None
        self._trusted = given in (None, announced)
        self.support = given or next((s for s in get_args(Support) if s == announced), None)
        if self.kind is None:
            # Ground contact is in the model of a robot on its feet only.
            held = self.support not in (None, "free")
            self.kind = "dynamics" if held and self._dynamics else "velocity"
        unknown = self.kind == "dynamics" and not (self._dynamics and self.support)
        if unknown:
            self.kind = "velocity"
        text = f"dynamics, support {self.support}" if self.kind == "dynamics" else str(self.kind)
        if unknown:
            text += " only: the support is unknown; give --support"
        if self.recorded:
            text = f"recorded; in RAMP and HOLD {text}"
        _LOGGER.log(logging.WARNING if unknown else logging.INFO, "feed-forward: %s", text)
        if self.kind != "dynamics":
            return
        if given == "feet":
            if announced not in (None, "free"):
                raise ConfigError(
                    f"The simulator holds the robot ({announced}); it does not stand on its feet.",
                    "Start it with --support free, or stream without --support feet.",
                )
            return
        if given and announced and given != announced:
            _LOGGER.warning(
                "the bridge announces support %s, not %s: tracking with a wrong support is worse "
                "than without feed-forward",
                announced,
                given,
            )
        support = self.support
        if self._dynamics is None or support is None or support == "feet" or self.recorded:
            return  # observer and check need every tick
        if self._alternative and robot == self._alternative.name:
            self._dynamics = self._alternative
        elif self._alternative and robot is None and self._limit.all():  # no joint is free
            self._fit = RevisionFit(support, (self._dynamics, self._alternative))
        self._use(self._dynamics)

    def _use(self, dynamics: InverseDynamics) -> None:
        """Compute torques with this model, and check the support by it."""
        self._dynamics = dynamics
        # What the bridge announces about itself needs no check.
        support = self.support
        if support is None or support == "feet":
            return
        self._check = None if self._trusted else SupportCheck(dynamics, support)
        if support == "hanging":
            self._observer = ForceObserver(dynamics, self._period)

    def observe(
        self,
        time: float,
        q: NDArray[np.floating],
        dq: NDArray[np.floating],
        tau: NDArray[np.floating],
        imu: ImuReading,
    ) -> None:
        """Take a new LowState into account.

        Args:
            time: when it was received, s.
            q: (29,) measured, rad, motor order.
            dq: (29,) rad/s.
            tau: (29,) N·m.
            imu: of the pelvis.
        """
        self._reading = Reading(q, dq, tau, imu)
        phase = self._phase
        if phase is Phase.WAIT or (self.recorded and phase is Phase.PLAY):
            return
        if self.scale:
            self.scale.add(time, q, dq)
        if self._fit and phase is Phase.RAMP:
            self._fit.add(time, q, dq, tau, imu, self.time_scale)
        elif self._check and phase is Phase.PLAY:
            self._check.add(time, q, dq, imu, self._expected_rate, self.time_scale)

    @property
    def time_scale(self) -> float:
        """Simulated over real time, as given or measured."""
        return self.scale.value if self.scale else self._given_scale

    def command(
        self, phase: Phase, elapsed: float, target: Target, imu: ImuReading, age: float
    ) -> Target:
        """The target with the dq and tau that its command carries.

        Args:
            phase: RAMP, PLAY or HOLD.
            elapsed: s since it began.
            target: the desired state at the time when the command takes effect.
            imu: the newest reading.
            age: s since it was received.
        """
        self._phase = phase
        if self.kind == "none":
            return target.replace(dq=0.0)
        if self.recorded and phase is Phase.PLAY:
            return target
        target = target.slowed(self.time_scale)
        if self.kind != "dynamics":
            return target
        if self._fit and (phase is not Phase.RAMP or elapsed > _DECISION * self.ramp):
            self._decide(self._fit.position)
            self._fit = None
        self._expected_rate = target.root_ang_vel
        # Within half the ramp: the rest of it corrects the sag under a partial torque.
        blend = minimum_jerk(2.0 * elapsed / self.ramp)[0] if phase is Phase.RAMP else 1.0
        fault = self._find_fault(imu, age)
        if not fault:
            self._tau = (
                self._balanced(phase, elapsed / self.ramp, target, age)
                if self._balance
                else self._torque(target, imu)
            )
        self._weight += (-1.0 if fault else 1.0) * self._period / _FADE
        self._weight = min(1.0, max(0.0, self._weight))
        self._log_change(fault, target.motion_time)
        return target.replace(tau=self._limited(blend * self._weight * self._tau))

    def _decide(self, position: float | None) -> None:
        """Continue with the model that the measured torques are nearer to."""
        first, second = self._dynamics, self._alternative
        if first is None or second is None:
            return
        if position is not None and position > 0.5:
            self._use(second)
        why = (
            "too little is known of its torques to tell"
            if position is None
            else f"measured torques at {position:.2f}, {first.name} at 0, {second.name} at 1"
        )
        _LOGGER.info("feed-forward: robot %s: %s", self.robot, why)

    def _find_fault(self, imu: ImuReading, age: float) -> str:
        """Why no torque can be computed from the newest reading; empty if it can."""
        if self._check and self._check.wrong:
            return f"the robot does not move as with support {self.support}; correct --support"
        if age > STALE:
            return f"LowState is older than {STALE:g} s"
        if not all(map(all_finite, imu)):
            return "the IMU reports NaN or infinity"
        if not is_unit(imu.quat_wxyz):
            return "the IMU quaternion is not of norm 1"
        if max(map(abs, imu.gyroscope.tolist())) > _MAX_GYROSCOPE:
            return f"the gyroscope reports more than {_MAX_GYROSCOPE:g} rad/s"
        return ""

    def _log_change(self, fault: str, motion_time: float) -> None:
        """Report a torque that has faded out or in completely, not a short fault."""
        if fault and not self._weight and fault != self._fault:
            self._fault = fault
            _LOGGER.warning("feed-forward: velocity only: %s", fault)
        elif self._fault and self._weight == 1.0:
            self._fault = ""
            _LOGGER.warning("feed-forward: dynamics again")
        else:
            return
        kind: FeedForwardKind = "velocity" if self._fault else "dynamics"
        change = FeedForwardChange(motion_time_s=motion_time, kind=kind, reason=self._fault)
        self.changes.append(change)

    def _balanced(self, phase: Phase, ramped: float, target: Target, age: float) -> Floats:
        """The torque of a robot on its feet."""
        if self._balance is None or self._reading is None:
            raise RuntimeError("nothing was measured, or there is no balance")
        if phase is not Phase.RAMP:
            return self._balance.torque(target, self._reading, age)
        share = minimum_jerk((ramped - LOWERED) / (1.0 - LOWERED))[0] if self._announced else None
        return self._balance.torque(target, self._reading, age, share=share, planted=False)

    def _torque(self, target: Target, imu: ImuReading) -> Floats:
        dynamics, support = self._dynamics, self.support
        if dynamics is None or support is None or support == "feet":
            raise RuntimeError("there is no model to compute torques with: call begin() first")
        base = _base(support, target, imu)
        force = self._observer.update(imu) if self._observer else None
        solution = dynamics.solve(support, target.q, target.dq, target.ddq, base, force=force)
        if self._observer:
            self._observer.expect(dynamics.specific_force(solution, base))
        return solution.tau

    def _limited(self, tau: Floats) -> Floats:
        limited: Floats = np.minimum(np.maximum(tau, -self._limit), self._limit)
        held = (limited != tau) & (self._limit > 0.0)
        if np.count_nonzero(held):
            self.saturated += held
        return limited


def _base(support: Support, target: Target, imu: ImuReading) -> BaseMotion:
    if support == "follow":
        return BaseMotion(
            target.root_quat_wxyz, target.root_ang_vel, target.root_lin_acc, target.root_ang_acc
        )
    return BaseMotion(imu.quat_wxyz.astype(np.float64), imu.gyroscope.astype(np.float64))
