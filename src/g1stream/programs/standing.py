"""A motion for a robot that stands on its own feet, if the settings ask for that."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

from g1stream.dds.domain import is_local_only
from g1stream.errors import ConfigError, MotionError, SafetyError
from g1stream.motion.limits import Interval
from g1stream.physics.footing import CannotStandError
from g1stream.physics.parts import longest_part, stand_part
from g1stream.robot.standing import LEGS

if TYPE_CHECKING:
    from g1stream.config import Config
    from g1stream.motion.motion import Motion
    from g1stream.physics.ground import Flags
    from g1stream.robot.model import G1
    from g1stream.settings import StreamConfig

__all__ = ["refuse_feet_on_robot", "stand_if_asked"]

#: The joints that almost any motion can be played with, on legs that stand.
_UPPER_BODY: Final = "arms,waist"


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
    _require_standing(config.stream, robot)
    played = robot.select(config.stream.played_joints)
    asked = Interval.from_config(config.stream, motion).frames(motion)
    try:
        standing = stand_part(motion, robot, asked, played)
    except CannotStandError as error:
        ways = ["play it slower (--speed)"] if error.slower else []
        remedy = "; or ".join([*ways, *_other_ways(motion, robot, asked, error.frames, played)])
        raise MotionError(error.cause, f"{remedy[0].upper()}{remedy[1:]}.") from None
    how = str(standing)
    if not how:
        return standing.motion, ""
    changed = replace(standing.motion, operations=(*motion.operations, how))
    return changed, f"{motion.name} is played {how}"


def _require_standing(settings: StreamConfig, robot: G1) -> None:
    """Refuse settings with which a robot cannot be kept on its feet."""
    whole = bool(robot.present.all()) and settings.via == "lowcmd" and settings.others == "hold"
    if settings.loop or not whole:
        raise ConfigError(
            "support feet needs all 29 joints, on rt/lowcmd, and a motion that does not repeat.",
            "Leave out --via, --others and --loop, or hold the robot otherwise.",
        )


def _other_ways(
    motion: Motion, robot: G1, asked: range, forbidden: Flags, played: Flags
) -> list[str]:
    """What can be played instead of some frames, of which some (T,) forbid that.

    That these stand has been tried.
    """
    ways = []
    if part := longest_part(motion, robot, asked, forbidden, played):
        ways.append(f"give {part}, the longest part found that stands")
    if played[:LEGS].any():
        flag, upper = f"--joints {_UPPER_BODY}", robot.select(_UPPER_BODY)
        try:
            stand_part(motion, robot, asked, upper)
            ways.append(f"give {flag}")
        except CannotStandError as error:
            if part := longest_part(motion, robot, asked, error.frames, upper):
                ways.append(f"give {flag} {part}")
    return [*ways, "hold the robot and give --support hanging"]


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
