"""A motion as a robot on its own feet can play it, or why not and what instead."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from g1stream.errors import ConfigError, MotionError
from g1stream.extras.physics.footing import CannotStandError
from g1stream.extras.physics.instead import find_instead
from g1stream.extras.physics.stance import stand_part
from g1stream.motion.motion import Motion
from g1stream.motion.readers import load_motion
from g1stream.robot.model import G1

if TYPE_CHECKING:
    from pathlib import Path

    from g1stream.extras.physics.ground import Flags
    from g1stream.extras.physics.stance import Standing

__all__ = ["stand", "stand_or_explain"]


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
