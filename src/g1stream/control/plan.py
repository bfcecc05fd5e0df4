"""The plan of a stream: motion, robot, gains and source, resolved from the settings."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from g1stream.config import Config
from g1stream.control.combinations import require_combination
from g1stream.control.gains import Gains, resolve_gains
from g1stream.control.receiver import load_receiver
from g1stream.control.sources import load_source
from g1stream.dds.remote import Operator
from g1stream.errors import ConfigError
from g1stream.motion.fit import fit_to_robot
from g1stream.motion.motion import Motion
from g1stream.motion.readers import load_motion
from g1stream.robot.model import G1
from g1stream.session.records import SessionInfo

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from g1stream.control.receiver import Receiver
    from g1stream.control.sources import Source
    from g1stream.motion.limits import Interval
    from g1stream.motion.trajectory import Trajectory

__all__ = ["Plan", "plan"]

_LOGGER = logging.getLogger(__name__)


@dataclass(frozen=True)
class Plan:
    """The motion, robot and settings of one run; its source has state, so it is used only once.

    Attributes:
        config: all settings in force.
        robot: the G1 whose limits and dynamics apply.
        trajectory: trajectory of the motion as it is played.
        interval: the part of the trajectory that is played.
        slowed: factor by which the motion was slowed down; 1 if it was not.
        receiver: the receiver of the commands.
        gains: gains of the servos; 0 for motors that have none.
        played: (29,) joints that play the motion.
        held: (29,) joints with a position servo, which follow a target.
        commanded: (29,) motors that get commands; the slots of the others are 0.
        source: source of the torques or targets of commands.
        rests: motion times, s, at which it rests and waits for `stream.wait_for`.
        events: log messages about the motion, with their levels.
    """

    config: Config
    robot: G1
    trajectory: Trajectory
    interval: Interval
    slowed: float
    receiver: Receiver
    gains: Gains
    played: NDArray[np.bool_]
    held: NDArray[np.bool_]
    commanded: NDArray[np.bool_]
    source: Source = field(repr=False)
    rests: tuple[float, ...] = ()
    events: tuple[tuple[int, str], ...] = ()

    @property
    def motion(self) -> Motion:
        """The motion as it is played."""
        return self.trajectory.motion

    @property
    def moved(self) -> NDArray[np.bool_]:
        """(29,) joints that move: those that play, and of a robot on its own feet all."""
        return self.robot.present if self.source.traits.way_down else self.played

    def summary(self) -> dict[str, float]:
        """Fields of `StreamSummary` about the played motion."""
        return {"start_s": self.interval.start, "slowed": self.slowed}

    def session_info(self) -> SessionInfo:
        """The metadata of a session file before its first sample."""
        return SessionInfo.from_config(
            self.config,
            self.robot,
            self.motion,
            self.gains._asdict(),
            self.played,
            self.source.traits.about,
        )

    def log_events(self) -> None:
        """Log the events about the motion."""
        for level, text in self.events:
            _LOGGER.log(level, "%s", text)


def plan(motion: Motion | str | Path, config: Config, *, simulated: bool) -> Plan:
    """Resolve a motion and settings into a plan; nothing is sent or written.

    Args:
        motion: a motion, a motion file, or the name of a bundled motion.
        config: all settings; for DDS those of `for_wire`.
        simulated: only a simulator can be reached.

    Raises:
        ConfigError: a setting conflicts with others or the motion, or an extra is not installed.
        MotionError: a file is not a motion, or its joint angles cannot be radians.
        SafetyError: the motion is beyond the robot's limits.
        RobotError: there is no dynamics model of this robot.
    """
    settings = config.stream
    robot = G1.of_config(config)
    played = robot.select(settings.played_joints)
    require_combination(config, robot, simulated=simulated)
    receiver = load_receiver(settings.via, settings.period, settings.damp)
    commanded = robot.present & receiver.joints
    held = played if settings.others == "free" else commanded
    source = load_source(config, robot, receiver.source, simulated=simulated)
    if not isinstance(motion, Motion):
        motion = load_motion(motion)
    Operator(config.safety.stop_buttons, config.safety.deadman, settings.wait_for)  # are valid
    motion, how, rests = source.prepare(motion)
    if settings.wait_for and (settings.loop or not rests):
        raise ConfigError(
            f"Nothing waits for {settings.wait_for}: the motion, or the part that is played, is "
            "one motion, or stream.loop is true.",
            "Give several motions, or remove --wait-for.",
        )
    asked, limited = config, not source.traits.makes_targets
    if settings.wait_for or not limited:  # it is cut already
        whole = settings.model_copy(update={"start": 0.0, "duration": None})
        asked = config.model_copy(update={"stream": whole})
    fit = fit_to_robot(motion, robot, asked, played, simulated=simulated, limited=limited)
    gains = source.traits.gains or resolve_gains(config.gains)
    return Plan(
        config=config,
        robot=robot,
        trajectory=fit.trajectory,
        interval=fit.interval,
        slowed=fit.slowed,
        receiver=receiver,
        gains=Gains(np.where(held, gains.kp, 0.0), np.where(commanded, gains.kd, 0.0)),
        played=played,
        held=held,
        commanded=commanded,
        source=source,
        rests=tuple(fit.slowed * rest for rest in rests),
        events=(*([(logging.INFO, how)] if how else []), *fit.events),
    )
