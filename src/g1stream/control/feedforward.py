"""Feed-forward: the velocity and torque of a command, from the model of the robot.

Pure: time and measurements come in as arguments. docs/tracking.md explains the method.
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Final, get_args

import numpy as np

from g1stream.control.state_checks import STALE, ImuReading, all_finite, is_unit
from g1stream.control.time_scale import TimeScale
from g1stream.control.torques import HeldTorques, Moment, Reading
from g1stream.errors import ConfigError
from g1stream.extras.feet.standing_torques import StandingTorques
from g1stream.motion.blend import minimum_jerk
from g1stream.robot.dynamics import InverseDynamics
from g1stream.robot.joints import N_JOINTS
from g1stream.robot.model import G1, REVISIONS
from g1stream.session.records import FeedForwardChange
from g1stream.types import FeedForwardKind, Floats, Ints, Phase, StreamSupport, Support

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from g1stream.config import StreamConfig
    from g1stream.control.targets import Target
    from g1stream.control.torques import TorqueSource
    from g1stream.session.records import BalanceSummary

__all__ = ["FeedForward"]

_LOGGER = logging.getLogger(__name__)

#: No G1 turns faster than this without having fallen, rad/s.
_MAX_GYROSCOPE: Final = 30.0
#: The torque fades out, and in again, in this time, s.
_FADE: Final = 0.1


class FeedForward:
    """Adds velocity and torque to targets.

    With `dynamics`, the torque is that of a source, such as the inverse dynamics of the reference.
    It fades in with RAMP. While the IMU is stale or implausible, and while the source has a fault,
    the torque is faded out and the velocity remains.

    Velocities are given in the robot's time, which in a simulator that is short of CPU is slower
    than the clock: the reference's velocity is divided by the time scale, its acceleration by the
    square of it.

    Args:
        kind: what commands carry beside q; None: `dynamics` where the bridge announces how it holds
            the robot, `velocity` elsewhere.
        support: how the robot is held; None: as the bridge announces.
        source: computes torques; needed for `dynamics`.
        limit: (29,) N·m, the largest torque in either direction; 0 for joints that get none.
        period: s between commands.
        ramp: s, length of RAMP; the torque fades in during its first half.
        preview: s by which the target of a command is ahead of its publish time, because it takes
            effect later; None: a period for a bridge that announces its support, otherwise 0.
        time_scale: simulated over real time; None: it is measured.
        onboard: the robot's own controller carries it, and only arms and waist are commanded. Their
            torque is that of a pelvis at rest in the attitude that the IMU measures, whatever the
            legs do.

    Attributes:
        kind, support: as given; after `begin`, as decided.
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
        source: TorqueSource | None = None,
        limit: Floats,
        period: float,
        ramp: float,
        preview: float | None = 0.0,
        time_scale: float | None = 1.0,
        onboard: bool = False,
    ) -> None:
        self.kind = kind
        self.support = support
        self.scale = TimeScale() if time_scale is None else None
        self.saturated: Ints = np.zeros(N_JOINTS, dtype=np.int64)
        self.changes: list[FeedForwardChange] = []
        self._onboard = onboard
        self._given_preview, self._given_scale = preview, time_scale or 1.0
        self._source = source
        self._limit = limit
        self._period = period
        self.ramp = ramp
        self._weight = 1.0  # of the torque, 0 while faded out
        self._fault = ""  # the reported one
        self._tau = np.zeros(N_JOINTS)
        self._announced = False
        self._phase = Phase.WAIT

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
        return self._source.name if self._source and self.kind == "dynamics" else None

    @property
    def balance(self) -> BalanceSummary | None:
        """How near a robot on its feet was to falling; None for one that is held."""
        return self._source.balance_summary if self._source else None

    @classmethod
    def from_config(
        cls,
        settings: StreamConfig,
        robot: G1,
        period: float,
        *,
        held: NDArray[np.bool_] | None = None,
    ) -> FeedForward:
        """The feed-forward of a config for commands that are `period` seconds apart.

        Joints that are not `held` (29,) get no torque.

        Raises:
            RobotError: the inverse dynamics of this robot cannot be computed.
        """
        kind = settings.feedforward
        limit = robot.torque_limit if held is None else robot.torque_limit * held
        other = G1.load(REVISIONS[1]) if robot is G1.default() else None
        source: TorqueSource | None = None
        if settings.support == "feet":
            if kind not in (None, "dynamics"):
                raise ConfigError(
                    "support feet needs torques that are computed at every tick.",
                    "Give --feedforward dynamics, or hold the robot otherwise.",
                )
            source = StandingTorques(robot, other, period)
        elif kind in (None, "dynamics"):
            source = HeldTorques(
                InverseDynamics(robot),
                InverseDynamics(other) if other else None,
                period=period,
                complete=bool(limit.all()),
            )
        return cls(
            kind,
            settings.support,
            source=source,
            limit=limit,
            period=period,
            ramp=settings.ramp,
            preview=settings.preview,
            time_scale=settings.time_scale,
            onboard=settings.via == "arm_sdk",
        )

    def ramp_to(self, first: Target) -> None:
        """RAMP begins, or begins anew, to the first target of PLAY."""
        if self._source:
            self._source.ramp_to(first)

    def awaited(self) -> str:
        """What RAMP waits for, or ""."""
        return self._source.awaited if self._source and self.kind == "dynamics" else ""

    @property
    def stands(self) -> bool:
        """Whether the robot is on its feet in RAMP already."""
        return bool(self._source and self.kind == "dynamics" and self._source.stands)

    def verdict(self) -> str:
        """Why the robot has to be damped, or ""."""
        source = self._source
        if self.kind != "dynamics" or source is None:
            return ""
        lost = f"the torque that keeps the robot on its feet has faded out: {self._fault}"
        return source.fall or (lost if source.needed and self._fault else "")

    def begin(self, announced: str | None, robot: str | None = None) -> None:
        """Decide on kind and support, and log the decision.

        Args:
            announced: the support that the bridge announces; None if it does not.
            robot: the name of the robot that it announces; None if it does not.
        """
        self._announced = announced is not None
        if self._onboard:
            self._begin_onboard(robot)
            return
        self.support = self.support or next(
            (known for known in get_args(Support) if known == announced), None
        )
        if self.kind is None:
            # Ground contact is in the model of a robot on its feet only.
            held = self.support not in (None, "free")
            self.kind = "dynamics" if held and self._source else "velocity"
        unknown = self.kind == "dynamics" and not (self._source and self.support)
        if unknown:
            self.kind = "velocity"
        text = f"dynamics, support {self.support}" if self.kind == "dynamics" else str(self.kind)
        if unknown:
            text += " only: the support is unknown; give --support"
        _LOGGER.log(logging.WARNING if unknown else logging.INFO, "feed-forward: %s", text)
        if self.kind == "dynamics" and self._source and self.support:
            self._source.begin(self.support, announced, robot)

    def _begin_onboard(self, robot: str | None) -> None:
        """As `begin`, where the robot's own controller carries it: nothing is to be checked."""
        if self.kind is None:
            self.kind = "dynamics" if self._announced and self._source else "velocity"
        if self.kind == "dynamics" and self._source:
            self._source.begin("bolted", "bolted", robot)
            _LOGGER.info("feed-forward: dynamics, at the measured attitude of the pelvis")
        else:
            _LOGGER.warning(
                "feed-forward: %s only: arms and waist sag under their weight; "
                "--feedforward dynamics carries it",
                self.kind,
            )

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
        phase = self._phase
        if self.scale and phase is not Phase.WAIT:
            self.scale.add(time, q, dq)
        if self._source:
            self._source.observe(phase, time, Reading(q, dq, tau, imu), self.time_scale)

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
        target = target.slowed(self.time_scale)
        if self.kind != "dynamics":
            return target
        # Within half the ramp: the rest of it corrects the sag under a partial torque.
        blend = minimum_jerk(2.0 * elapsed / self.ramp)[0] if phase is Phase.RAMP else 1.0
        if self._source is None:
            raise RuntimeError("there is no source of torques: call begin() first")
        fault = self._source.fault or _find_fault(imu, age)
        if not fault:
            ramped = min(1.0, elapsed / self.ramp) if phase is Phase.RAMP else 1.0
            target = self._source.command(Moment(phase, ramped, target, imu, age))
            self._tau = target.tau
        self._weight += (-1.0 if fault else 1.0) * self._period / _FADE
        self._weight = min(1.0, max(0.0, self._weight))
        self._log_change(fault, target.motion_time)
        return target.replace(tau=self._limited(blend * self._weight * self._tau))

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

    def _limited(self, tau: Floats) -> Floats:
        limited: Floats = np.minimum(np.maximum(tau, -self._limit), self._limit)
        held = (limited != tau) & (self._limit > 0.0)
        if np.count_nonzero(held):
            self.saturated += held
        return limited


def _find_fault(imu: ImuReading, age: float) -> str:
    """Why no torque can be computed from the newest reading; empty if it can."""
    if age > STALE:
        return f"LowState is older than {STALE:g} s"
    if not all(map(all_finite, imu)):
        return "the IMU reports NaN or infinity"
    if not is_unit(imu.quat_wxyz):
        return "the IMU quaternion is not of norm 1"
    if max(map(abs, imu.gyroscope.tolist())) > _MAX_GYROSCOPE:
        return f"the gyroscope reports more than {_MAX_GYROSCOPE:g} rad/s"
    return ""
