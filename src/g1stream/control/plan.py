"""What is about to be played, on what, and how: all that settings decide, found once."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.config import SHIPPED, Config, load_config
from g1stream.control.command import HAND_BACK_TIME, MOVED, WEIGHT_TIME
from g1stream.control.gains import gains_in_play
from g1stream.control.sources import load_source
from g1stream.dds.domain import is_local_only
from g1stream.dds.messages import COMMANDS
from g1stream.errors import ConfigError
from g1stream.motion.fit import fit_to_robot
from g1stream.motion.motion import Motion
from g1stream.motion.readers import load_motion
from g1stream.robot.joints import select_joints
from g1stream.robot.model import G1
from g1stream.session.records import SessionInfo

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from g1stream.config import StreamConfig
    from g1stream.control.gains import Gains
    from g1stream.control.sources import Source
    from g1stream.dds.messages import Topic
    from g1stream.motion.limits import Interval
    from g1stream.motion.trajectory import Trajectory

__all__ = ["Plan", "for_wire", "plan", "with_robot_limits"]

_LOGGER = logging.getLogger(__name__)

#: Age of the last LowState that stops in simulation, s. There, two programs and the physics share
#: one machine, and silences above a robot's 0.1 s are common on two CPUs; nothing breaks meanwhile:
#: the torque of the feed-forward fades out after 20 ms, and the position servo holds. Half of the
#: 1 s after which Unitree's own programs stop.
_STATE_TIMEOUT_OF_SIMULATOR: Final = 0.5


@dataclass(frozen=True)
class Plan:
    """What is about to be played, on what, and how. It is for one run: its source has a state.

    Attributes:
        config: all settings in force.
        robot: the G1 whose limits and dynamics apply.
        trajectory: of the motion as it is played.
        interval: the part of it that is played.
        slowed: factor by which the motion was slowed; 1 where it was not.
        topic: of the commands.
        gains: of the servos.
        played: (29,) which joints play the motion.
        held: (29,) which joints have a position servo.
        source: of the torques or targets of commands.
        events: what is to be logged about the motion, with the level.
    """

    config: Config
    robot: G1
    trajectory: Trajectory
    interval: Interval
    slowed: float
    topic: Topic
    gains: Gains
    played: NDArray[np.bool_]
    held: NDArray[np.bool_]
    source: Source = field(repr=False)
    events: tuple[tuple[int, str], ...] = ()

    @property
    def motion(self) -> Motion:
        """As it is played."""
        return self.trajectory.motion

    def summary(self) -> dict[str, float]:
        """Fields of `StreamSummary` about what is played."""
        return {"start_s": self.interval.start, "slowed": self.slowed}

    def session_info(self) -> SessionInfo:
        """What a session file says of it before its first sample."""
        return SessionInfo.from_config(
            self.config, self.robot, self.motion, self.gains._asdict(), self.source.about()
        )

    def log_events(self) -> None:
        """Log what is to be known about the motion."""
        for level, text in self.events:
            _LOGGER.log(level, "%s", text)


def plan(motion: Motion | str | Path, config: Config, *, simulated: bool | None = None) -> Plan:
    """Find out what a motion and settings ask for; nothing is sent or written.

    Args:
        motion: a motion, a motion file, or the name of a bundled motion.
        config: all settings.
        simulated: nothing but a simulator is reached, and settings hold as they are given; None: as
            the interface says, which unset settings depend on, see `for_wire`.

    Raises:
        ConfigError: a setting does not fit the others or the motion, or an extra is not installed.
        MotionError: a file is no motion, or its joint angles cannot be radians.
        SafetyError: the motion is beyond the robot's limits.
        RobotError: there are no dynamics of this robot.
    """
    if simulated is None:
        config = for_wire(config)
        simulated = is_local_only(config.dds.interface)
    settings = config.stream
    robot = G1.load(config.robot, own_limits=config.safety.urdf_limits, params=config.params)
    played = robot.select(settings.played_joints)
    held = played if settings.others == "free" else robot.present
    if settings.via == "arm_sdk":
        held = MOVED & robot.present
    complete = bool((robot.torque_limit * held).all())
    source = load_source(config, robot, simulated=simulated, complete=complete)
    if not isinstance(motion, Motion):
        motion = load_motion(motion)
    motion, changed = source.change(motion)
    asked, commanded = config, not source.reference_only
    if not commanded:
        whole = settings.model_copy(update={"start": 0.0, "duration": None})
        asked = config.model_copy(update={"stream": whole})
    fit = fit_to_robot(motion, robot, asked, simulated=simulated, commanded=commanded)
    return Plan(
        config=config,
        robot=robot,
        trajectory=fit.trajectory,
        interval=fit.interval,
        slowed=fit.slowed,
        topic=COMMANDS[settings.via],
        gains=source.gains or gains_in_play(config, robot),
        played=played,
        held=held,
        source=source,
        events=(*([(logging.INFO, changed)] if changed else []), *fit.events),
    )


def with_robot_limits(config: Config) -> Config:
    """A config in which robot.toml's values stand wherever nothing is set; unchanged on loopback.

    Its domain and interface are not taken over.
    """
    if is_local_only(config.dds.interface):
        return config
    robot = load_config(SHIPPED / "robot.toml")
    tables = {}
    for name in robot.model_fields_set - {"dds"}:
        given, cautious = getattr(config, name), getattr(robot, name)
        unset = {
            key: getattr(cautious, key)
            for key in cautious.model_fields_set
            if key not in given.model_fields_set or getattr(given, key) is None
        }
        tables[name] = given.model_copy(update=unset)
    return config.model_copy(update=tables)


def for_wire(config: Config) -> Config:
    """A config whose unset values that depend on the wire are set.

    On loopback there is a simulator, which may be silent for longer than a robot. Anywhere else
    there may be a robot, for which robot.toml has the values. With `stream.via` = arm_sdk, its
    topic decides on others.

    Raises:
        ConfigError: the settings ask for what is not possible with `stream.via` = arm_sdk.
    """
    if is_local_only(config.dds.interface):
        timeout = config.safety.state_timeout or _STATE_TIMEOUT_OF_SIMULATOR
        safety = config.safety.model_copy(update={"state_timeout": timeout})
        config = config.model_copy(update={"safety": safety})
    else:
        config = with_robot_limits(config)
    if config.stream.via == "arm_sdk":
        config = config.model_copy(update={"stream": _for_arm_sdk(config.stream)})
    return config


def _for_arm_sdk(settings: StreamConfig) -> StreamConfig:
    """The settings of a stream with `via` = arm_sdk, with those that depend on it set.

    Raises:
        ConfigError: they ask for what the robot's own controller does not let others do.
    """
    if (select_joints(settings.played_joints) & ~MOVED).any():
        raise ConfigError(
            f"stream.joints = {settings.joints!r} selects joints of the legs, which stream.via = "
            "arm_sdk cannot move.",
            "Choose of arms and waist, or leave --via out.",
        )
    if settings.others == "free":
        raise ConfigError(
            "stream.others = free with stream.via = arm_sdk: nothing would carry these joints.",
            "Leave --others out: arms and waist that do not play then hold their pose.",
        )
    if settings.support:
        raise ConfigError(
            f"stream.support = {settings.support} with stream.via = arm_sdk: the robot's own "
            "controller carries it.",
            "Leave --support out.",
        )
    return settings.model_copy(
        update={
            "ramp": max(settings.ramp, WEIGHT_TIME),
            "damp": HAND_BACK_TIME,
            "soft_start": 0.0,
        }
    )
