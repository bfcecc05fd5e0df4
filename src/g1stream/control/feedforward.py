"""What a command carries beside the position: velocity and torque, from the model of the robot.

Pure: time and measurements come in as arguments. docs/tracking.md explains the whole.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple, get_args

import numpy as np

from g1stream.control.measured import all_finite, is_unit
from g1stream.control.support import ForceObserver, SupportCheck
from g1stream.motion.blend import minimum_jerk
from g1stream.robot.dynamics import BaseMotion
from g1stream.robot.joints import N_JOINTS
from g1stream.types import INFO, WARNING, FeedForwardKind, Phase, Support

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from g1stream.control.measured import ImuReading
    from g1stream.control.target import Target
    from g1stream.robot.dynamics import InverseDynamics

__all__ = ["Change", "FeedForward"]

_SUPPORTS: Final[tuple[Support, ...]] = get_args(Support)

#: What no G1 turns at without being beyond rescue, rad/s.
_ABSURD_RATE: Final = 30.0
#: LowState older than this says nothing about now, s: ten states of 500 a second.
_STALE: Final = 0.02
#: The torque fades out, and in again, in this time, s.
_FADE: Final = 0.1


class Change(NamedTuple):
    """The torque went, or came back.

    Attributes:
        motion_time: when in the motion, s.
        kind: what commands carry from then on.
        reason: why; empty where the reason to do without has gone.
    """

    motion_time: float
    kind: FeedForwardKind
    reason: str

    def __str__(self) -> str:
        if self.reason:
            return f"feed-forward: {self.kind} only, because {self.reason}"
        return f"feed-forward: {self.kind} again"


class FeedForward:
    """Adds velocity and torque to targets.

    With `dynamics`, the torque is what the reference takes on the robot as it is held: the joints'
    part from the reference, the pelvis's attitude and rate from the IMU. It fades in with the ramp.
    Where the IMU is stale or absurd, or the pelvis does not move as the support lets it, the torque
    fades out and the velocity remains.

    Args:
        kind: what commands carry beside q; None: as much as is known, which is `dynamics` where
            the bridge says how it holds the robot, and `velocity` elsewhere.
        support: how the robot is held; None: as the bridge says.
        dynamics: the model; needed for `dynamics`.
        limit: (29,) N·m, the greatest torque either way.
        period: s between commands.
        ramp: s, how long RAMP lasts; the torque fades in during its first half.
        preview: s by which a command is ahead of what is due when it is published, because it
            takes effect later.

    Attributes:
        kind, support: as given; what was found out, after `begin`.
        preview: as given.
        saturated: (29,) int64, ticks at which each joint's torque was held at its limit.
    """

    def __init__(
        self,
        kind: FeedForwardKind | None,
        support: Support | None = None,
        *,
        dynamics: InverseDynamics | None = None,
        limit: NDArray[np.float64],
        period: float = 0.002,
        ramp: float = 1.0,
        preview: float = 0.0,
    ) -> None:
        self.kind = kind
        self.support = support
        self.preview = preview
        self.saturated: NDArray[np.int64] = np.zeros(N_JOINTS, dtype=np.int64)
        self._dynamics = dynamics
        self._limit = limit
        self._period = period
        self._ramp = ramp
        self._trust = 1.0
        self._told = ""
        self._tau = np.zeros(N_JOINTS)
        self._news: list[Change] = []
        self._observer: ForceObserver | None = None
        self._check: SupportCheck | None = None

    def begin(self, announced: str | None) -> Sequence[tuple[int, str]]:
        """Settle what is done, and say so: (level, text).

        Args:
            announced: how the bridge says that it holds the robot; None where it does not say.
        """
        told = self.support
        self.support = told or next((one for one in _SUPPORTS if one == announced), None)
        if self.kind is None:
            held = self.support not in (None, "free")  # what the ground does is not in the model
            self.kind = "dynamics" if held and self._dynamics else "velocity"
        if self.kind != "dynamics":
            return [(INFO, f"feed-forward: {self.kind}")]
        if self._dynamics is None or self.support is None:
            self.kind = "velocity"
            return [
                (
                    WARNING,
                    "feed-forward: velocity only, because nobody says how the robot is held; "
                    "give --support",
                )
            ]
        # What the bridge says of itself needs no check.
        self._check = SupportCheck(self._period) if self.support != announced else None
        if self.support == "hanging":
            self._observer = ForceObserver(self._dynamics, self._period)
        lines = [(INFO, f"feed-forward: dynamics of a robot that is held {self.support}")]
        if told and announced and told != announced:
            lines.append(
                (
                    WARNING,
                    f"the bridge says that it holds the robot {announced}, not {told}: "
                    "a wrong support follows worse than none",
                )
            )
        return lines

    def command(
        self, phase: Phase, elapsed: float, target: Target, imu: ImuReading, age: float
    ) -> Target:
        """The target with what its command carries: dq and tau.

        Args:
            phase: RAMP, PLAY or HOLD.
            elapsed: s since it began.
            target: what is asked for when the command takes effect.
            imu: the newest reading.
            age: s since that came.
        """
        if self.kind == "none":
            return target.but(dq=0.0)
        if self.kind != "dynamics":
            return target
        # In half the ramp, so that the rest of it can mend the sag of a torque that was not whole.
        blend = minimum_jerk(2.0 * elapsed / self._ramp)[0] if phase is Phase.RAMP else 1.0
        doubt = self._doubt(imu, age)
        if not doubt:
            self._tau = self._torque(target, imu)
        self._trust += (-1.0 if doubt else 1.0) * self._period / _FADE
        self._trust = min(1.0, max(0.0, self._trust))
        self._note(doubt, target.motion_time)
        return target.but(tau=self._limited(blend * self._trust * self._tau))

    def news(self) -> list[Change]:
        """What has changed since the last call."""
        news, self._news = self._news, []
        return news

    def _doubt(self, imu: ImuReading, age: float) -> str:
        """Why no torque is to be computed from what is known now; empty where all is well."""
        if self._check and self._check.wrong:
            return (
                f"the pelvis does not move as one that is held {self.support}: "
                "give the --support that it has"
            )
        return _fault(imu, age)

    def _note(self, doubt: str, motion_time: float) -> None:
        """Note when the torque is gone and when it is back, not a moment's doubt."""
        if doubt and not self._trust and doubt != self._told:
            self._news.append(Change(motion_time, "velocity", doubt))
            self._told = doubt
        elif self._told and self._trust == 1.0:
            self._news.append(Change(motion_time, "dynamics", ""))
            self._told = ""

    def _torque(self, target: Target, imu: ImuReading) -> NDArray[np.float64]:
        dynamics, support = self._dynamics, self.support
        if dynamics is None or support is None:
            raise RuntimeError("there is no model to compute torques with: call begin() first")
        base = _base(support, target, imu)
        force = self._observer.update(imu) if self._observer else None
        solution = dynamics.solve(support, target.q, target.dq, target.ddq, base, force=force)
        if self._observer:
            self._observer.expect(dynamics.felt(solution, base))
        if self._check:
            self._check.add(target.motion_time, imu.gyroscope, solution.ang_acc)
        return solution.tau

    def _limited(self, tau: NDArray[np.float64]) -> NDArray[np.float64]:
        limited: NDArray[np.float64] = np.minimum(np.maximum(tau, -self._limit), self._limit)
        held = limited != tau
        if np.count_nonzero(held):
            self.saturated += held
        return limited


def _fault(imu: ImuReading, age: float) -> str:
    """What is wrong with a reading; empty where nothing is."""
    if age > _STALE:
        return f"LowState is older than {_STALE:g} s"
    if not all(map(all_finite, imu)):
        return "the IMU says a number that is not finite"
    if not is_unit(imu.quat_wxyz):
        return "the IMU's quaternion is not of length 1"
    if max(map(abs, imu.gyroscope.tolist())) > _ABSURD_RATE:
        return f"the IMU turns faster than {_ABSURD_RATE:g} rad/s"
    return ""


def _base(support: Support, target: Target, imu: ImuReading) -> BaseMotion:
    if support == "follow":
        return BaseMotion(
            target.root_quat_wxyz, target.root_ang_vel, target.root_lin_acc, target.root_ang_acc
        )
    return BaseMotion(imu.quat_wxyz.astype(np.float64), imu.gyroscope.astype(np.float64))
