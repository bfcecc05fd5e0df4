"""A motion for a robot that stands on its own feet, if the settings ask for that."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from g1stream.dds.domain import is_local_only
from g1stream.errors import SafetyError
from g1stream.motion.limits import Interval
from g1stream.physics.stance import on_standing_legs, stand
from g1stream.robot.standing import LEGS

if TYPE_CHECKING:
    from g1stream.config import Config
    from g1stream.motion.motion import Motion
    from g1stream.robot.model import G1

__all__ = ["refuse_feet_on_robot", "stand_if_asked"]


def stand_if_asked(motion: Motion, robot: G1, config: Config) -> tuple[Motion, str]:
    """The motion with its feet planted, and what was changed; with other supports as it is, and "".

    The part that is not played need not be able to stand: it becomes a pause. Where the legs do not
    play the motion, they stand, as `on_standing_legs` has it; where only they do, waist and arms
    keep the pose of its beginning.

    Raises:
        ConfigError: the part to play is not within the motion.
        MotionError: it cannot be played on its feet.
        RobotError: the soles of this robot are not known.
    """
    if config.stream.support != "feet":
        return motion, ""
    interval = Interval.from_config(config.stream, motion)
    length = motion.duration if interval.length is None else interval.length
    first, last = (np.array([0.0, length]) + interval.start) * motion.fps
    rows = np.clip(np.arange(motion.n_frames), int(first), int(np.ceil(last)))
    rows = np.minimum(rows, motion.n_frames - 1)
    part = replace(
        motion,
        joint_pos=motion.joint_pos[rows],
        root_pos=motion.root_pos[rows],
        root_quat_wxyz=motion.root_quat_wxyz[rows],
    )
    played = robot.select(config.stream.played_joints)
    changes = []
    if not played[:LEGS].any():
        part = on_standing_legs(part, robot, played)
        changes.append("on legs that stand")
    elif not played.all():
        part = replace(part, joint_pos=np.where(played, part.joint_pos, part.joint_pos[0]))
    standing = stand(part, robot)
    if standing.changes:
        changes.append(str(standing))
    changed = replace(standing.motion, operations=(*motion.operations, *changes))
    return changed, f"{motion.name} is played {', '.join(changes)}" if changes else ""


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
