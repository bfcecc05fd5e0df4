"""Sources of a command's torque or target: the interface, the table, and that of a held robot.

A source that is an extra has a row in `SOURCES`, and is imported only if a setting selects it. The
rest is pure.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, NamedTuple, get_args

import numpy as np

from g1stream.control.support import ForceObserver, SupportCheck
from g1stream.motion.limits import Interval
from g1stream.optional import load_object
from g1stream.robot.dynamics import BaseMotion, InverseDynamics
from g1stream.robot.model import G1, REVISIONS
from g1stream.types import FeedForwardKind, Phase, StreamSupport, Support

if TYPE_CHECKING:
    from g1stream.config import Config
    from g1stream.control.gains import Gains
    from g1stream.control.reading import Reading
    from g1stream.control.targets import Setpoint, WayDown
    from g1stream.dds.messages import Topic
    from g1stream.motion.motion import Motion
    from g1stream.session.records import PolicyInfo

__all__ = [
    "SOURCES",
    "Changed",
    "HeldTorques",
    "Mode",
    "Moment",
    "Source",
    "Status",
    "Traits",
    "join_with_rests",
    "load_source",
]

_LOGGER = logging.getLogger(__name__)

SOURCES: Final = {
    "feet": "g1stream.extras.feet.source:StandingTorques",
    "policy": "g1stream.extras.policy.source:PolicyTargets",
}
"""Sources that are extras, as `module:class`, by `stream.support`, and `policy` for
`stream.policy`.

To add one, add a row."""


#: Length of a rest between two motions, time from the moment at which it waits to the end of the
#: rest, and time of the blends before and after it, s.
_REST, _LEFT, _TO_REST = 0.5, 0.1, 1.0


class Moment(NamedTuple):
    """Inputs for a command: phase, target and measurements.

    Attributes:
        phase: RAMP, PLAY or HOLD.
        ramped: share of the time of the ramp that has passed; 1 after it.
        target: the desired state when the command takes effect.
        measured: the newest LowState.
        age: time since the reception of `measured`, s.
        time: time of the motion's clock, s, which continues in HOLD and in a rest, and stops while
            the robot's time does.
        tick: number of the Reference that is published with the command.
        clock: returns the time, ns of the clock of `measured.arrived`, to measure durations.
        scale: ratio of simulated to real time.
        robot_time: the robot's time, s, from any zero.
        fault: why nothing can be computed from `measured`, or "".
    """

    phase: Phase
    ramped: float
    target: Setpoint
    measured: Reading
    age: float
    time: float = 0.0
    tick: int = 0
    clock: Callable[[], int] = lambda: 0
    scale: float = 1.0
    robot_time: float = 0.0
    fault: str = ""


@dataclass(frozen=True)
class Traits:
    """What does not change during a run.

    Attributes:
        gains: gains for the targets; None: those of the config.
        way_down: motion with which HOLD ends, of a robot on its own feet. It falls without the
            source, so the run ends when the torque has faded out. None: the robot is held.
        makes_targets: the source makes its own targets, at a lower rate and for their torque, and
            only observes the motion. `prepare` returns the part that the settings select, and its
            limits are not checked. It follows the robot's time, and waits while a simulator stalls.
        about: metadata of the policy that computes the targets; None without a policy.
    """

    gains: Gains | None = None
    way_down: WayDown | None = None
    makes_targets: bool = False
    about: PolicyInfo | None = None


class Mode(NamedTuple):
    """How commands are made, as decided when RAMP begins.

    Attributes:
        kind: what commands have beside positions; None for a source that makes its own targets.
        support: how the robot is held; None: unknown.
        robot: name of the robot's model; None without a model.
    """

    kind: FeedForwardKind | None = None
    support: StreamSupport | None = None
    robot: str | None = None


class Status(NamedTuple):
    """What a source knows of the robot after its newest command.

    Attributes:
        fall: why the robot has to be damped immediately, or "".
        fault: why the torque is wrong and has to fade out, or "".
        awaited: the event that RAMP waits for; "" if it need not wait.
        stands: the robot is already on its feet in RAMP, so that it can go down from there.
        step: the newest step of a policy, as it is published with the command; b"" without a step.
        margins: fields of `BalanceSummary`; empty for a robot that is held.
    """

    fall: str = ""
    fault: str = ""
    awaited: str = ""
    stands: bool = False
    step: bytes = b""
    margins: Mapping[str, float] = MappingProxyType({})


class Changed(NamedTuple):
    """A motion as a source can play it.

    Attributes:
        motion: the motion.
        how: a sentence about the changes, or "".
        rests: times, s, at which it has been at rest for a moment, and may wait.
    """

    motion: Motion
    how: str = ""
    rests: tuple[float, ...] = ()


def join_with_rests(
    motion: Motion, following: Iterable[tuple[Motion, Motion]]
) -> tuple[Motion, tuple[float, ...]]:
    """Join pairs of a still pose and a motion to a motion.

    Returns:
        The motion, and the times, s, at which it rests in these poses.
    """
    rests = []
    for still, then in following:
        motion = motion.then(still, _TO_REST)
        rests.append(motion.duration - _LEFT)
        motion = motion.then(then, _TO_REST)
    return motion, tuple(rests)


class Source:
    """Adds torque to the target of each command, or replaces it; the base class changes nothing.

    A source is made for one run before anything is sent. It raises an error if it cannot fulfil the
    settings. `prepare` is called once, then `begin` once, then `command` in each tick, in the
    loop's thread.

    Args:
        config, robot, simulated: as of `load_source`.
    """

    traits: Traits = Traits()

    def __init__(self, config: Config, robot: G1, *, simulated: bool) -> None:
        self._kind, self._support = config.stream.feedforward, config.stream.support
        self._settings = config.stream

    def prepare(self, motion: Motion) -> Changed:
        """Adapt the motion for this source, before its limits are checked.

        With `stream.wait_for`, it rests at the end of each of the joined motions but the last.

        Raises:
            ConfigError: the settings select a part that is not within the motion.
            MotionError: the motion cannot be played.
        """
        if not self._settings.wait_for:
            return Changed(motion)
        parts = Interval.from_config(self._settings, motion).cut(motion).split()
        ends = (one.at_frames(np.full(round(_REST * one.fps) + 2, -1)) for one in parts[:-1])
        stills = (replace(one, name="rest", operations=()) for one in ends)
        joined, rests = join_with_rests(parts[0], zip(stills, parts[1:], strict=True))
        return Changed(joined, rests=rests)

    def listen(self, subscribe: Callable[[Topic], Callable[[], bytes | None]]) -> None:
        """Subscribe to more than LowState, over DDS only.

        `subscribe` returns a function that gives the newest sample since its last call, or None.
        """

    def begin(self, first: Setpoint, announced: str | None, robot: str | None) -> Mode:
        """Choose how commands are made when RAMP begins, and log the choice.

        Args:
            first: the first target of PLAY.
            announced: the support that the bridge announces; None if it does not.
            robot: the name of the robot that the bridge announces; None if it does not.

        Raises:
            ConfigError: there is no torque for this support.
        """
        known = (one for one in get_args(Support) if one == announced)
        support = self._support or next(known, None)
        # Only the model of the extra `feet` includes ground contact.
        kind = self._kind or ("velocity" if support in (None, "free") else "dynamics")
        if kind != "dynamics":
            _LOGGER.info("feed-forward: %s", kind)
        elif support:
            _LOGGER.info("feed-forward: dynamics, support %s", support)
        else:
            kind = "velocity"
            _LOGGER.warning("feed-forward: velocity only: the support is unknown; give --support")
        return Mode(kind, support)

    def command(self, moment: Moment) -> Setpoint:
        """The target of a command, with feed-forward torque, which is added to the servos'.

        It may compute at a lower rate, and return the same target in between. The result is kept
        within the limits. The given target is ahead by the preview; the Reference has that of its
        own tick. While there is a fault, the torque of the last command without one fades out.
        """
        return moment.target

    @property
    def status(self) -> Status:
        """What is known after the newest command, or after `begin`."""
        return Status()


def load_source(
    config: Config, robot: G1, for_motion: str | None = None, *, simulated: bool
) -> Source:
    """Load the source that a config selects.

    Args:
        config: the settings in force.
        robot: the robot.
        for_motion: the receiver's source for a motion, as in `SOURCES`; None: that of a held robot.
        simulated: only a simulator can be reached.

    Raises:
        ConfigError: the source is not installed, or conflicts with other settings.
        SafetyError: the source may not be used on a robot.
        RobotError: there is no dynamics model of this robot.
    """
    settings = config.stream
    place = SOURCES.get("policy" if settings.policy else settings.support or "", for_motion)
    torques = settings.feedforward in (None, "dynamics")
    kind: type[Source] = HeldTorques if torques else Source
    return (load_object(place) if place else kind)(config, robot, simulated=simulated)


class HeldTorques(Source):
    """Torques from inverse dynamics of the reference, for a robot with a known support.

    Attributes:
        robots: the robot that is assumed if none is announced, then the other one that may be
            announced. Without a setting the revision is not known. A simulator that announces
            nothing is unitree_mujoco, which has g1_29dof.
    """

    def __init__(self, config: Config, robot: G1, *, simulated: bool) -> None:
        super().__init__(config, robot, simulated=simulated)
        self.robots = [robot]
        if robot is G1.default():
            self.robots = [robot, G1.load(REVISIONS[1])][:: -1 if simulated else 1]
        wanted = self._kind in (None, "dynamics")  # a URDF may have no inertia
        self._models = [InverseDynamics(one) for one in self.robots if wanted]
        self._period = config.stream.period / 1e9
        self._dynamics: InverseDynamics
        self._held: Support = "bolted"
        self._observer: ForceObserver | None = None
        self._check: SupportCheck | None = None
        self._last: Moment | None = None

    @property
    def status(self) -> Status:
        fault = ""
        if self._check and self._check.wrong:
            fault = f"the robot does not move as with support {self._held}; correct --support"
        return Status(fault=fault)

    def begin(self, first: Setpoint, announced: str | None, robot: str | None) -> Mode:
        mode = super().begin(first, announced, robot)
        support = mode.support
        if mode.kind != "dynamics" or support is None or support == "feet":
            return mode
        if announced not in (None, support):
            _LOGGER.warning(
                "the bridge announces support %s, not %s: tracking with a wrong support is worse "
                "than without feed-forward",
                announced,
                support,
            )
        name = self.hold(support, robot)
        if support != announced:  # one that the bridge announces needs no check
            self._check = SupportCheck(self._dynamics, support)
        return mode._replace(robot=name)

    def hold(self, support: Support, robot: str | None) -> str:
        """Choose the model for a support and the robot that the bridge announces; its name."""
        self._held, self._dynamics = support, self._models[0]
        for model in self._models[1:]:
            if robot == model.name:
                self._dynamics = model
            elif robot is None:
                name = self._dynamics.name
                _LOGGER.info("feed-forward: robot %s, assumed; --robot names another", name)
        if support == "hanging":
            self._observer = ForceObserver(self._dynamics, self._period)
        return self._dynamics.name

    def command(self, moment: Moment) -> Setpoint:
        target, measured, dynamics = moment.target, moment.measured, self._dynamics
        last, self._last = self._last, moment
        if self._check and last and last.phase is Phase.PLAY and measured is not last.measured:
            self._check.add(measured, last.target.root_ang_vel, moment.scale)
        if moment.fault:
            return target
        imu = measured.imu
        if self._held == "follow":
            base = BaseMotion(
                target.root_quat_wxyz, target.root_ang_vel, target.root_lin_acc, target.root_ang_acc
            )
        else:
            rate = measured.steady_rate.astype(np.float64)
            base = BaseMotion(imu.quat_wxyz.astype(np.float64), rate)
        force = self._observer.update(imu) if self._observer else None
        solution = dynamics.solve(self._held, target.q, target.dq, target.ddq, base, force=force)
        if self._observer:
            self._observer.expect(dynamics.specific_force(solution, base))
        return target._replace(tau=solution.tau)
