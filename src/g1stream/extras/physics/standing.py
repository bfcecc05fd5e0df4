"""Check whether a motion can be played on the feet, and find alternatives."""

from __future__ import annotations

from math import ceil, floor
from pathlib import Path
from typing import Final

import numpy as np
from scipy.ndimage import binary_dilation

from g1stream.errors import ConfigError, MotionError
from g1stream.extras.physics.footing import CannotStandError
from g1stream.extras.physics.ground import Flags, stretches
from g1stream.extras.physics.stance import Standing, stand_part
from g1stream.motion.limits import Interval
from g1stream.motion.motion import Motion
from g1stream.motion.readers import load_motion
from g1stream.robot.joints import LEGS
from g1stream.robot.model import G1

__all__ = ["find_instead", "stand", "stand_or_explain"]

#: Joints with which almost any motion can be played on standing legs.
_UPPER_BODY: Final = "arms,waist"
#: Shortest part, s, and distance of a part from frames that forbid it, s.
_LEAST, _NEAR = 1.0, 0.1
#: Most checks in a search; a dance of two minutes needs 43.
_TRIES: Final = 60
#: Least movement of a joint in a part, rad.
_MOVES: Final = 0.05
#: Speeds that are tried if a motion is too fast.
_SPEEDS: Final = (0.7, 0.5, 0.25)


def stand(
    motion: Motion | str | Path, joints: str | None = None, robot: G1 | None = None
) -> Standing:
    """Change a motion so that a robot can play it on its feet, which stand or step.

    `stream` and `rollout` do this with support feet. docs/feet.md describes the changes.

    Args:
        motion: a motion, a motion file, or the name of a bundled motion.
        joints: joints that play it, such as "arms,waist", on standing legs; all if None.
        robot: the G1; the default one if None.

    Raises:
        ConfigError: there are no such joints, only some joints of the legs are given, or the
            robot lacks joints.
        MotionError: it cannot be played on the feet; the remedy gives alternatives.
        RobotError: the robot's soles are unknown.
    """
    robot = robot or G1.default()
    if not isinstance(motion, Motion):
        motion = load_motion(motion)
    return stand_or_explain(motion, robot, range(motion.n_frames), robot.select(joints))


def stand_or_explain(motion: Motion, robot: G1, frames: range, played: Flags) -> Standing:
    """Change some frames of a motion with `played` joints (29,); errors are those of `stand`."""
    if not robot.present.all():
        raise ConfigError(
            f"A robot on its feet needs all 29 joints, but {robot.name} has "
            f"{np.count_nonzero(robot.present)}.",
            "Give another robot, or hold it otherwise.",
        )
    try:
        return stand_part(motion, robot, frames, played)
    except CannotStandError as error:
        instead = find_instead(motion, robot, frames, error, played)
        hanging = "hold the robot and give --support hanging"
        remedy = "; or ".join(filter(None, (instead, hanging)))
        raise MotionError(error.cause, f"{remedy[0].upper()}{remedy[1:]}.") from None


def find_instead(
    motion: Motion, robot: G1, frames: range, refused: CannotStandError, played: Flags | None = None
) -> str:
    """Alternatives that can be played on the feet: slower, a part, or arms and waist.

    They have been checked, and are given as flags of `stream`; empty without an alternative.
    """
    ways = []
    whole = len(frames) == motion.n_frames  # a slower part would have other times
    for speed in _SPEEDS if refused.slower and whole else ():
        if not _refusal(motion.at_speed(speed), robot, frames, played):
            ways.append(f"play it at {speed:g} times this speed (--speed)")
            break
    if part := _longest_part(motion, robot, frames, refused.frames, played):
        ways.append(f"give {part}, the longest part found")
    if played is None or played[:LEGS].any():
        upper = robot.select(_UPPER_BODY)
        error = _refusal(motion, robot, frames, upper)
        part = _longest_part(motion, robot, frames, error.frames, upper) if error else ""
        if part or not error:
            ways.append(f"give --joints {_UPPER_BODY} {part}".rstrip())
    return "; or ".join(ways)


def _refusal(
    motion: Motion, robot: G1, frames: range, played: Flags | None
) -> CannotStandError | None:
    try:
        stand_part(motion, robot, frames, played)
    except CannotStandError as error:
        return error
    return None


def _longest_part(
    motion: Motion, robot: G1, frames: range, forbidden: Flags, played: Flags | None
) -> str:
    """Flags of the longest part found, in hundredths of a second; empty without one.

    The place of a foot is an average over a part, so a longer part may exist.
    """
    near = max(1, round(_NEAR * motion.fps))
    playing = motion.joint_pos if played is None else motion.joint_pos[:, played]
    forbidden = forbidden.copy()
    for _ in range(_TRIES):
        free = ~binary_dilation(forbidden, iterations=near)
        free[: frames.start] = free[frames.stop :] = False
        spans = [
            (stop - first, -first)
            for first, stop in stretches(free).tolist()
            if stop - first > _LEAST * motion.fps
            and np.ptp(playing[first:stop], axis=0).max() > _MOVES
        ]
        if not spans:
            break
        length, first = max(spans)
        start = ceil(100.0 * -first / motion.fps)
        hundredths = floor(100.0 * (length - 1 - first) / motion.fps) - start
        tried = Interval(start / 100.0, hundredths / 100.0).frames(motion)
        error = _refusal(motion, robot, tried, played)
        if not error:
            return f"--start {start / 100.0:g} --duration {hundredths / 100.0:g}"
        forbidden |= error.frames
    return ""
