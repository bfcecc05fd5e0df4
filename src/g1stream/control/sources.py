"""Sources of a command's torque or target: the interface, the table, and that of a held robot.

A source that is an extra has a row in `SOURCES`, and is imported only if a setting selects it. The
rest is pure.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from g1stream.control.support import ForceObserver, SupportCheck
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
"""Sources that are extras, as `module:class`, by `stream.support`, and `policy` for
`stream.policy`.

To add one, add a row. The class takes the same arguments as `load_source`."""


class Moment(NamedTuple):
    """Inputs for a command: phase, target and measurements.

    Attributes:
        phase: RAMP, PLAY or HOLD.
        ramped: progress of the ramp as a share of its time; 1 after it.
        target: the desired state when the command takes effect.
        measured: the newest LowState.
        age: time since the reception of `measured`, s.
        time: time of the motion's clock, s, which continues in HOLD and stops while the motion
            waits.
        tick: number of the Reference that is published with the command.
        clock: returns the time, ns of the clock of `measured.received`, to measure durations.
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
    """Adds torque to the target of each command, or replaces it; the base class changes nothing.

    A source is made for one run before anything is sent. It raises an error if it cannot fulfil the
    settings. `change` is called once, then `begin` once, then in each tick `observe` for the newest
    LowState and `command` for the command of the next tick. All calls are in the loop's thread.
    `command` may compute at a lower rate, and return the same target in between. Its result is kept
    within the limits. The target passed to `command` is ahead by the preview; the Reference has
    that of its own tick.

    Attributes:
        gains: gains for the targets of this source; None: those of the config.
        needed: the robot falls without this torque, so the run ends when it has faded out.
        support: default support of the robot; None: as the bridge announces.
        lift: height of the pelvis above its target when RAMP begins, m.
        in_steps: targets are computed at a lower rate than commands, for their torque.
        way_down: motion with which HOLD ends; None: no motion.
        own_time: the motion follows the robot's time, and waits while a simulator stalls.
        reference_only: the motion is not commanded directly, so its limits are not checked;
            `change` returns the part of it that the settings select.
        tells: topic of the source's messages about its commands; None without messages.
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
        """Name of the robot's model; None without a model."""
        return None

    @property
    def fault(self) -> str:
        """Why this torque is wrong and has to fade out, or ""."""
        return ""

    @property
    def fall(self) -> str:
        """Why the robot has to be damped immediately, or ""."""
        return ""

    @property
    def awaited(self) -> str:
        """The event that RAMP waits for; "" if it need not wait."""
        return ""

    @property
    def stands(self) -> bool:
        """Whether the robot is already on its feet in RAMP, so that it can go down from there."""
        return False

    @property
    def summary(self) -> BalanceSummary | None:
        """Balance margins of a robot on its feet; None for a robot that is held."""
        return None

    def change(self, motion: Motion) -> tuple[Motion, str]:
        """Adapt the motion for this source, before its limits are checked.

        Returns:
            The motion as it can be played, and a sentence about the changes.

        Raises:
            ConfigError: the settings select a part that is not within the motion.
            MotionError: the motion cannot be played.
        """
        return motion, ""

    def begin(self, support: StreamSupport, announced: str | None, robot: str | None) -> None:
        """Prepare for the support of the robot when RAMP begins.

        Args:
            support: how the robot is held.
            announced: the support that the bridge announces; None if it does not.
            robot: the name of the robot that the bridge announces; None if it does not.

        Raises:
            ConfigError: there is no torque for this support.
        """

    def ramp_to(self, first: Target) -> None:
        """Prepare for a RAMP, or a restarted RAMP, to the first target of PLAY."""

    def observe(self, phase: Phase, measured: Reading, scale: float) -> None:
        """Process a LowState; `scale` is the ratio of simulated to real time."""

    def command(self, moment: Moment) -> Target:
        """The target of a command, with feed-forward torque, which is added to the servos'."""
        return moment.target

    def repeated(self, target: Target) -> Target:
        """The target of a command, without torque, if nothing new can be computed."""
        return target

    def told(self) -> bytes:
        """A message on the topic `tells` about the computation since the last call, or b"".

        It is published with the command that resulted from the computation.
        """
        return b""

    def about(self) -> PolicyInfo | None:
        """Metadata of the policy that computes the targets; None without a policy."""
        return None


def load_source(config: Config, robot: G1, *, simulated: bool) -> Source:
    """Load the source that a config selects.

    Args:
        config: the settings in force.
        robot: the robot.
        simulated: only a simulator can be reached.

    Raises:
        ConfigError: the source is not installed, or conflicts with other settings.
        SafetyError: the source may not be used on a robot.
        RobotError: there is no dynamics model of this robot.
    """
    settings = config.stream
    if place := SOURCES.get("policy" if settings.policy else settings.support or ""):
        made: Source = load_object(place)(config, robot, simulated=simulated)
        return made
    if settings.feedforward not in (None, "dynamics"):
        return Source()
    models = [InverseDynamics(one) for one in possible_revisions(robot, simulated=simulated)]
    return HeldTorques(*models, period=settings.period / 1e9)


def possible_revisions(robot: G1, *, simulated: bool) -> list[G1]:
    """The robot that is assumed if none is announced, then the other one that may be announced.

    Without a setting the revision is not known. A simulator that announces nothing is
    unitree_mujoco, which has g1_29dof.
    """
    if robot is not G1.default():
        return [robot]
    revisions = [robot, G1.load(REVISIONS[1])]
    return revisions[::-1] if simulated else revisions


class HeldTorques(Source):
    """Torques from inverse dynamics of the reference, for a robot with a known support.

    Args:
        dynamics: the model of the robot, unless the bridge announces the alternative.
        alternative: the model of another revision of the robot; None: the robot is known.
        period: time between commands, s.
    """

    def __init__(
        self,
        dynamics: InverseDynamics,
        alternative: InverseDynamics | None = None,
        *,
        period: float,
    ) -> None:
        self._dynamics, self._alternative = dynamics, alternative
        self._period = period
        self._support: Support = "bolted"
        self._trusted = False
        self._observer: ForceObserver | None = None
        self._check: SupportCheck | None = None
        self._expected_rate = np.zeros(3)

    @property
    def name(self) -> str:
        return self._dynamics.name

    @property
    def fault(self) -> str:
        """Why the robot cannot be held as assumed, or ""."""
        wrong = self._check and self._check.wrong
        support = self._support
        return (
            f"the robot does not move as with support {support}; correct --support" if wrong else ""
        )

    def begin(self, support: StreamSupport, announced: str | None, robot: str | None) -> None:
        if support == "feet":
            raise ValueError("support feet needs the source of the extra `feet`")
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
        elif self._alternative and robot is None:
            _LOGGER.info("feed-forward: robot %s, assumed; --robot names another", self.name)
        # A support that the bridge announces needs no check.
        self._check = None if self._trusted else SupportCheck(self._dynamics, support)
        if support == "hanging":
            self._observer = ForceObserver(self._dynamics, self._period)

    def observe(self, phase: Phase, measured: Reading, scale: float) -> None:
        if self._check and phase is Phase.PLAY:
            self._check.add(measured, self._expected_rate, scale)

    def command(self, moment: Moment) -> Target:
        target, measured, dynamics = moment.target, moment.measured, self._dynamics
        imu = measured.imu
        self._expected_rate = target.root_ang_vel
        if self._support == "follow":
            base = BaseMotion(
                target.root_quat_wxyz, target.root_ang_vel, target.root_lin_acc, target.root_ang_acc
            )
        else:
            rate = measured.steady_rate.astype(np.float64)
            base = BaseMotion(imu.quat_wxyz.astype(np.float64), rate)
        force = self._observer.update(imu) if self._observer else None
        solution = dynamics.solve(self._support, target.q, target.dq, target.ddq, base, force=force)
        if self._observer:
            self._observer.expect(dynamics.specific_force(solution, base))
        return target._replace(tau=solution.tau)
