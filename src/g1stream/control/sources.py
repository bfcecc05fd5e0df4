"""Sources of a command's torque or target: the interface, the table, and that of a held robot.

A source that is an extra has a row in `SOURCES`, and is imported only where a setting asks for it.
Pure but for that.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from g1stream.control.support import ForceObserver, RevisionFit, SupportCheck
from g1stream.optional import load_object
from g1stream.robot.dynamics import BaseMotion, InverseDynamics
from g1stream.robot.model import G1, REVISIONS
from g1stream.types import Phase, StreamSupport, Support

if TYPE_CHECKING:
    from g1stream.config import Config
    from g1stream.control.gains import Gains
    from g1stream.control.reading import Reading
    from g1stream.control.targets import Target, WayDown
    from g1stream.dds.messages import Topic
    from g1stream.motion.motion import Motion
    from g1stream.session.records import BalanceSummary, PolicyInfo

__all__ = ["SOURCES", "HeldTorques", "Moment", "Source", "load_source"]

_LOGGER = logging.getLogger(__name__)

SOURCES: Final = {
    "feet": "g1stream.extras.feet.source:StandingTorques",
    "policy": "g1stream.extras.policy.source:PolicyTargets",
}
"""By `stream.support`, and for a `stream.policy`: module and class of a source that is an extra. To
add one, add a row.

The class takes what `load_source` takes."""

#: The revision of the robot is decided on when this share of RAMP has passed.
_DECISION: Final = 0.8


class Moment(NamedTuple):
    """When a command is asked for, and for what.

    Attributes:
        phase: RAMP, PLAY or HOLD.
        ramped: share of the time of the way to the first frame that has passed; 1 after it.
        target: the desired state when the command takes effect.
        measured: the newest LowState.
        age: s since that was received.
        time: s of the motion's clock, which goes on in HOLD, and stands still while the motion
            waits.
        tick: number of the Reference that is published with it.
        clock: tells the time, ns, as of `measured.received`, to measure how long something takes.
    """

    phase: Phase
    ramped: float
    target: Target
    measured: Reading
    age: float
    time: float = 0.0
    tick: int = 0
    clock: Callable[[], int] = lambda: 0


class Source:
    """Adds torque to the target of each command, or replaces it; this one leaves it as it is.

    A source is made before anything is sent, for one run, and raises where it cannot do what the
    settings ask. `change` is called once, then `begin` once, then in each tick `observe` for the
    newest LowState and `command` for the command of the next tick. All of it runs in the loop's
    thread: `command` may compute anew at a rate of its own, and repeat itself in between. What it
    returns is kept within the limits, and the Reference shows the target that it was given.

    Attributes:
        gains: that the targets of this source need; None: those of the config.
        needed: the robot falls without this torque, so that the run ends where it has faded out.
        support: of the robot, where that is not asked for; None: as the bridge announces.
        lift: m by which the pelvis is higher when RAMP begins.
        in_steps: its targets are computed at a lower rate than commands, for their torque.
        way_down: with which HOLD ends; None: it only rests.
        own_time: the motion keeps to the robot's time, and waits where a simulator stalls.
        reference_only: the motion is followed and not commanded, so that its limits do not matter;
            `change` returns the part of it that the settings ask for.
        tells: topic of what it tells of its commands; None: nothing.
    """

    gains: Gains | None = None
    needed: bool = False
    support: StreamSupport | None = None
    lift: float = 0.0
    in_steps: bool = False
    way_down: WayDown | None = None
    own_time: bool = False
    reference_only: bool = False
    tells: Topic | None = None

    @property
    def name(self) -> str | None:
        """Of the robot's model; None without one."""
        return None

    @property
    def fault(self) -> str:
        """Why this torque is wrong, so that it has to fade out; "" while it is right."""
        return ""

    @property
    def fall(self) -> str:
        """Why the robot has to be damped at once; "" while it need not."""
        return ""

    @property
    def awaited(self) -> str:
        """What RAMP waits for; "" where it need not wait."""
        return ""

    @property
    def stands(self) -> bool:
        """Whether the robot is on its feet in RAMP already, so that it can go down from there."""
        return False

    @property
    def summary(self) -> BalanceSummary | None:
        """How near a robot on its feet was to falling; None for one that is held."""
        return None

    def change(self, motion: Motion) -> tuple[Motion, str]:
        """The motion as it can be played, before its limits are checked, and what was changed.

        Raises:
            ConfigError: the settings ask for a part that is not within the motion.
            MotionError: it cannot be played.
        """
        return motion, ""

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

    def observe(self, phase: Phase, measured: Reading, scale: float) -> None:
        """Take a LowState into account; `scale` is simulated over real time."""

    def command(self, moment: Moment) -> Target:
        """The target of a command, with its torque; that of the servos comes on top."""
        return moment.target

    def repeated(self, target: Target) -> Target:
        """The target of a command where nothing new can be computed, without torque."""
        return target

    def told(self) -> bytes:
        """A message on the topic that it `tells` of what was computed since the last call, or b"".

        It is published with the command that was computed of it.
        """
        return b""

    def about(self) -> PolicyInfo | None:
        """What a session says of the policy that its targets are of."""
        return None


def load_source(config: Config, robot: G1, *, simulated: bool, complete: bool) -> Source:
    """The source that a config asks for.

    Args:
        config: the settings in force.
        robot: the robot.
        simulated: nothing but a simulator is reached.
        complete: every joint gets its torque.

    Raises:
        ConfigError: it is not installed, or the settings do not go with it.
        SafetyError: it may not be used on a robot.
        RobotError: there are no dynamics of this robot.
    """
    settings = config.stream
    if place := SOURCES.get("policy" if settings.policy else settings.support or ""):
        made: Source = load_object(place)(config, robot, simulated=simulated, complete=complete)
        return made
    if settings.feedforward not in (None, "dynamics"):
        return Source()
    other = other_revision(robot)
    return HeldTorques(
        InverseDynamics(robot),
        InverseDynamics(other) if other else None,
        period=settings.period / 1e9,
        complete=complete,
    )


def other_revision(robot: G1) -> G1 | None:
    """The G1 of another revision, where a robot may be either; None where it is known."""
    return G1.load(REVISIONS[1]) if robot is G1.default() else None


class HeldTorques(Source):
    """The inverse dynamics of the reference for a robot that is held in a known way.

    Args:
        dynamics: the model.
        alternative: another model, of another revision of the robot. During RAMP the measured
            torques are compared with both, and the one that fits better is used from then on.
        period: s between commands.
        complete: every joint gets its torque; otherwise the revisions cannot be told apart.
    """

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

    def observe(self, phase: Phase, measured: Reading, scale: float) -> None:
        if self._fit and phase is Phase.RAMP:
            self._fit.add(measured, scale)
        elif self._check and phase is Phase.PLAY:
            self._check.add(measured, self._expected_rate, scale)

    def command(self, moment: Moment) -> Target:
        if self._fit and (moment.phase is not Phase.RAMP or moment.ramped > _DECISION):
            self._decide(self._fit.position)
            self._fit = None
        target, imu, dynamics = moment.target, moment.measured.imu, self._dynamics
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
        return target._replace(tau=solution.tau)

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
