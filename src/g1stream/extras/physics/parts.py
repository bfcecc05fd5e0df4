"""What a robot on its feet can play of a motion: a part, more slowly, or with fewer joints."""

from __future__ import annotations

from dataclasses import replace
from heapq import heappop, heappush
from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.extras.physics.footing import CannotStandError
from g1stream.extras.physics.ground import stretches
from g1stream.extras.physics.instead import UPPER_BODY, Instead, Part
from g1stream.extras.physics.stance import stand
from g1stream.motion.limits import Interval
from g1stream.robot.joints import LEGS

if TYPE_CHECKING:
    from g1stream.extras.physics.ground import Flags
    from g1stream.extras.physics.stance import Standing
    from g1stream.motion.motion import Motion
    from g1stream.motion.trajectory import Trajectory
    from g1stream.robot.model import G1

__all__ = ["find_instead", "longest_part", "stand_part"]

#: Before and after a part the robot stands still for so long, s: what shall not be played does not
#: say where the feet stand.
_STILL: Final = 0.5
#: A part of which nothing is said is shorter, s; frames this near to what forbids one are not in
#: it, s.
_LEAST: Final = 1.0
_NEAR: Final = 0.1
#: Parts that are tried at most, because each takes a check; of a dance of two minutes, 43 are.
_TRIES: Final = 200
#: A part in which no joint moves by more is not worth playing, rad.
_MOVES: Final = 0.05
#: Speeds that are tried where a motion is too fast.
_SPEEDS: Final = (0.7, 0.5, 0.25)


def stand_part(
    motion: Motion,
    robot: G1,
    frames: range,
    played: Flags | None = None,
    trajectory: Trajectory | None = None,
) -> Standing:
    """Some frames of a motion as `stand` has them; before and after them the robot stands still.

    The changed motion is as long as it was.

    Args:
        motion: of which some frames are played.
        robot: the G1.
        frames: two or more.
        played: (29,) the joints that play it; all if None.
        trajectory: through all frames; made if it is needed and None.

    Raises:
        CannotStandError: they cannot be played on the feet; it has their numbers in the motion.
        ConfigError: some joints of the legs play it, and others do not.
        RobotError: the soles of this robot are not known.
    """
    if len(frames) == motion.n_frames:
        return stand(motion, robot, played, trajectory)
    still, everywhere = max(1, round(_STILL * motion.fps)), np.arange(motion.n_frames)
    around = everywhere[max(0, frames.start - still) : frames.stop + still]
    shown = around.clip(frames[0], frames[-1])
    try:
        standing = stand(motion.at_frames(shown), robot, played)
    except CannotStandError as error:
        forbidden = np.zeros(motion.n_frames, np.bool_)
        forbidden[shown[error.frames]] = True
        raise CannotStandError(motion, error.what, forbidden, slower=error.slower) from None
    rows = everywhere.clip(around[0], around[-1]) - around[0]
    changed, before = (one.at_frames(rows) for one in (standing.motion, standing.before))
    return replace(standing, motion=changed, before=before, frames=frames)


def longest_part(
    motion: Motion, robot: G1, frames: range, forbidden: Flags, played: Flags | None = None
) -> Part | None:
    """The longest part that is found of those that can be played on the feet.

    Frames that forbid it are left out, until nothing forbids the longest part that remains. Where a
    foot stands is an average over a part, so that a longer one may exist.

    Args:
        motion: of which to play a part.
        robot: the G1.
        frames: where to look for it.
        forbidden: (T,) the frames of the motion that forbid to play all of these.
        played: (29,) the joints that play it; all if None.

    Returns:
        The part; None if none of a second in which a joint moves was found in 200 attempts.

    Raises:
        ConfigError: some joints of the legs play it, and others do not.
        RobotError: the soles of this robot are not known.
    """
    from scipy.ndimage import binary_dilation

    near = max(1, round(_NEAR * motion.fps))
    playing = motion.joint_pos if played is None else motion.joint_pos[:, played]
    parts: list[tuple[int, int]] = []  # length, negative, and first frame

    def add_what_remains(of: range, forbidden: Flags) -> None:
        free = ~binary_dilation(forbidden[of.start : of.stop], iterations=near)
        for first, stop in stretches(free).tolist():
            moved = np.ptp(playing[of.start + first : of.start + stop], axis=0).max()
            if stop - first > _LEAST * motion.fps and moved > _MOVES:
                heappush(parts, (first - stop, of.start + first))

    add_what_remains(frames, forbidden)
    for _ in range(_TRIES):
        if not parts:
            break
        negative, first = heappop(parts)
        part = Part.of_frames(range(first, first - negative), motion.fps)
        tried = Interval(part.start_s, part.duration_s, motion.duration).frames(motion)
        try:
            stand_part(motion, robot, tried, played)
        except CannotStandError as error:
            add_what_remains(tried, error.frames)
        else:
            return part
    return None


def find_instead(
    motion: Motion,
    robot: G1,
    frames: range,
    refused: CannotStandError,
    played: Flags | None = None,
) -> Instead:
    """Find what can be played on the feet instead of some frames of a motion.

    Args:
        motion: whose frames cannot.
        robot: the G1.
        frames: that cannot.
        refused: why.
        played: (29,) the joints that play it; all if None.

    Raises:
        RobotError: the soles of this robot are not known.
    """

    def refusal(one: Motion, played: Flags | None) -> CannotStandError | None:
        try:
            stand_part(one, robot, frames, played)
        except CannotStandError as error:
            return error
        return None

    # Of a part, the seconds would be others, too.
    speeds = _SPEEDS if refused.slower and len(frames) == motion.n_frames else ()
    asked = Part.of_frames(frames, motion.fps)
    upper_body = None
    if played is None or played[:LEGS].any():
        upper = robot.select(UPPER_BODY)
        error = refusal(motion, upper)
        upper_body = longest_part(motion, robot, frames, error.frames, upper) if error else asked
    return Instead(
        asked=asked,
        speed=next((one for one in speeds if not refusal(motion.at_speed(one), played)), None),
        part=longest_part(motion, robot, frames, refused.frames, played),
        upper_body=upper_body,
    )
