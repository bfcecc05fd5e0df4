"""A motion for a robot that stands on its own feet, if the settings ask for that."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from g1stream.dds.domain import is_local_only
from g1stream.errors import ConfigError, MotionError, SafetyError
from g1stream.extras.physics.footing import CannotStandError
from g1stream.extras.physics.instead import find_instead
from g1stream.extras.physics.stance import stand_part
from g1stream.motion.limits import Interval
from g1stream.motion.motion import Motion
from g1stream.motion.readers import load_motion
from g1stream.robot.model import G1

if TYPE_CHECKING:
    from pathlib import Path

    from g1stream.config import Config, StreamConfig
    from g1stream.extras.physics.ground import Flags
    from g1stream.extras.physics.stance import Standing

__all__ = ["refuse_feet_on_robot", "stand", "stand_if_asked", "stand_or_explain"]


def stand_if_asked(motion: Motion, robot: G1, config: Config) -> tuple[Motion, str]:
    """The motion with its feet planted, and what was changed; with other supports as it is, and "".

    The part that is not played need not be able to stand: it becomes a pause.

    Raises:
        ConfigError: the part to play is not within the motion, or the settings do not go with feet.
        MotionError: it cannot be played on its feet; its remedy names what can.
        RobotError: the soles of this robot are not known.
    """
    if config.stream.support != "feet":
        return motion, ""
    _require_standing(config.stream)
    played = robot.select(config.stream.played_joints)
    asked = Interval.from_config(config.stream, motion).frames(motion)
    standing = stand_or_explain(motion, robot, asked, played)
    how = str(standing)
    if not how:
        return standing.motion, ""
    changed = replace(standing.motion, operations=(*motion.operations, how))
    return changed, f"{motion.name} is played {how}"


def stand_or_explain(motion: Motion, robot: G1, frames: range, played: Flags) -> Standing:
    """Some frames of a motion, as a robot on its feet can play them.

    Raises:
        ConfigError: the robot lacks joints, or some of the legs are `played` (29,), and others are
            not.
        MotionError: it cannot; its remedy names what it can play.
        RobotError: the soles of this robot are not known.
    """
    if not robot.present.all():
        raise ConfigError(
            f"A robot on its feet needs all 29 joints, and {robot.name} has "
            f"{np.count_nonzero(robot.present)}.",
            "Give another robot, or hold it otherwise.",
        )
    try:
        return stand_part(motion, robot, frames, played)
    except CannotStandError as error:
        instead = find_instead(motion, robot, frames, error, played)
        hanging = "hold the robot and give --support hanging"
        remedy = "; or ".join(filter(None, (str(instead), hanging)))
        raise MotionError(error.cause, f"{remedy[0].upper()}{remedy[1:]}.") from None


def stand(
    motion: Motion | str | Path, joints: str | None = None, robot: G1 | None = None
) -> Standing:
    """A motion as a robot on its feet can play it: its feet stand, or step one at a time.

    `stream` and `rollout` do so with support feet. docs/feet.md says what is changed.

    Args:
        motion: a motion, a motion file, or the name of a bundled motion.
        joints: those that play it, such as "arms,waist", on legs that stand; all if None.
        robot: the G1; the default one if None.

    Raises:
        ConfigError: there are no such joints, some of the legs are given, and others are not, or
            the robot lacks joints.
        MotionError: it cannot be played on the feet; the remedy names what can.
        RobotError: the soles of this robot are not known.
    """
    robot = robot or G1.default()
    if not isinstance(motion, Motion):
        motion = load_motion(motion)
    return stand_or_explain(motion, robot, range(motion.n_frames), robot.select(joints))


def _require_standing(settings: StreamConfig) -> None:
    """Refuse settings with which a robot cannot be kept on its feet."""
    if settings.loop or settings.via != "lowcmd" or settings.others != "hold":
        raise ConfigError(
            "support feet needs all 29 joints, on rt/lowcmd, and a motion that does not repeat.",
            "Leave out --via, --others and --loop, or hold the robot otherwise.",
        )


def refuse_feet_on_robot(config: Config) -> None:
    """Refuse to keep a robot on its feet where that was not asked for explicitly.

    Raises:
        SafetyError: the interface is not the loopback, and stream.experimental_feet is not set.
    """
    local = is_local_only(config.dds.interface)
    if config.stream.support == "feet" and not (local or config.stream.experimental_feet):
        raise SafetyError(
            f"--support feet on {config.dds.interface}: it has been tried in simulators only, and "
            "a robot that it lets fall breaks.",
            "Use --support hanging, or the loopback interface; --experimental-feet allows it.",
        )
