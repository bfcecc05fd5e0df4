"""Check that a motion fits the robot's limits, and slow it down until it does if requested."""

from __future__ import annotations

import logging
from dataclasses import replace
from math import ceil
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from g1stream.errors import ConfigError, MotionError, SafetyError
from g1stream.motion.check import MotionReport, check_motion, dropped_joints
from g1stream.motion.limits import Interval
from g1stream.motion.trajectory import Trajectory
from g1stream.text import listed, told_apart

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from g1stream.config import Config
    from g1stream.motion.motion import Motion
    from g1stream.robot.model import G1

__all__ = ["Fit", "fit_to_robot", "require_si_units"]

#: A slowed motion is sampled at other times, so it may need to be slowed once more.
_ATTEMPTS: Final = 5


class Fit(NamedTuple):
    """A motion that may be played.

    Attributes:
        trajectory: spline of the motion, maybe slowed.
        interval: the part to play.
        slowed: factor by which it was slowed, or 1.
        events: log messages about it, with their levels.
    """

    trajectory: Trajectory
    interval: Interval
    slowed: float = 1.0
    events: tuple[tuple[int, str], ...] = ()


def fit_to_robot(
    motion: Motion,
    robot: G1,
    config: Config,
    played: NDArray[np.bool_],
    *,
    simulated: bool,
    limited: bool = True,
) -> Fit:
    """The motion in the form in which it may be played with these settings.

    With `stream.beyond_limits` = `scale-time`, a motion that is too fast is slowed evenly as a
    whole until every joint keeps its velocity limit. `stream.start` and `stream.duration` then
    refer to the slowed motion.

    Args:
        motion: motion to be played.
        robot: robot with the limits.
        config: the part to play, the rate, the margin and `stream.beyond_limits`.
        played: (29,) joints that play the motion; the others keep their limits.
        simulated: only a simulator can be reached, so `anyway` is allowed.
        limited: the motion's targets are sent, so they must keep the limits.

    Raises:
        ConfigError: `anyway` is not allowed here, or the interval is not within the motion.
        MotionError: the angles cannot be radians, or the positions cannot be metres.
        SafetyError: a frame is beyond a position limit, or a joint speed is above its limit.
    """
    beyond = config.stream.beyond_limits
    if beyond == "anyway" and not simulated:
        raise ConfigError(
            f"stream.beyond_limits = anyway is not allowed on {config.dds.interface}: "
            "there may be a robot.",
            "Use --scale-time or --clamp, or the loopback interface lo.",
        )
    fit, report = _check(motion, robot, config, played, limited=limited)
    require_si_units(report)
    for _ in range(_ATTEMPTS * (beyond == "scale-time")):
        if report.frames_beyond or report.within_limits:
            break
        # The whole motion decides, so that each part of it is slowed equally.
        whole = _of_played(fit.trajectory.motion, robot, played)
        whole_report = check_motion(whole, robot, rate=config.stream.rate)
        fastest = max(
            (report.streamed.speeds[0], whole_report.streamed.speeds[0]),
            key=lambda s: s.value / s.limit,
        )
        factor = ceil(1000.0 * fit.slowed * fastest.value / fastest.limit) / 1000.0
        fit, report = _check(motion, robot, config, played, factor, limited=limited)
    if limited and beyond not in ("clamp", "anyway") and not report.within_limits:
        raise _refused(report, slowing=beyond == "scale-time")
    return fit


def require_si_units(report: MotionReport) -> None:
    """Refuse a motion whose units its check rejects.

    Raises:
        MotionError: the angles cannot be radians, or the positions cannot be metres.
    """
    if not report.in_si_units:
        raise MotionError(
            f"{report.name} is not in radians and metres: it looks as if {report.suspicion}.",
            "Convert the joint angles to radians and the positions to metres.",
        )


def _check(
    motion: Motion,
    robot: G1,
    config: Config,
    played: NDArray[np.bool_],
    slowed: float = 1.0,
    *,
    limited: bool,
) -> tuple[Fit, MotionReport]:
    events: list[tuple[int, str]] = []
    if robot.warning:
        events.append((logging.WARNING, robot.warning))
    if dropped := dropped_joints(motion, robot):
        level = logging.WARNING if dropped.moved else logging.INFO
        events.append((level, f"{motion.name}: {dropped}"))
    if slowed != 1.0:
        motion = replace(motion, fps=motion.fps / slowed)
        text = f"{motion.name} is played {slowed:g} times slower to keep the joints' speed limits"
        events.append((logging.WARNING, text))
    interval = Interval.from_config(config.stream, motion)
    trajectory = Trajectory(motion, loop=config.stream.loop)
    checked = _of_played(motion, robot, played)
    report = check_motion(
        checked,
        robot,
        rate=config.stream.rate,
        position_margin=config.safety.position_margin,
        trajectory=trajectory if checked is motion else Trajectory(checked, loop=trajectory.loop),
        interval=interval,
    )
    if limited:
        events += report.streamed.events
    return Fit(trajectory, interval, slowed, tuple(events)), report


def _of_played(motion: Motion, robot: G1, played: NDArray[np.bool_]) -> Motion:
    """The motion for the limit check: joints that do not play stay within their limits."""
    if played.all():
        return motion
    middle = (robot.lower + robot.upper) / 2.0
    return replace(motion, joint_pos=np.where(played, motion.joint_pos, middle))


def _refused(report: MotionReport, *, slowing: bool) -> SafetyError:
    if report.frames_beyond:
        worst, others = report.frames_beyond[0], report.frames_beyond[1:]
        value, limit = told_apart(worst.value, worst.limit)
        cause = (
            f"{report.name} has {worst.joint} at {value} rad in frame "
            f"{worst.time * report.fps:.0f}, limit {limit}"
        )
    else:
        worst, others = report.streamed.too_fast[0], report.streamed.too_fast[1:]
        cause = (
            f"{report.name} moves {worst.joint} at {worst.value:.1f} rad/s at {worst.time:.2f} s, "
            f"frame {worst.time * report.fps:.0f}, limit {worst.limit:g}"
        )
    if others:
        cause += f"; also {listed([joint.joint for joint in others], 3)}"
    if report.suspicion:
        cause += f". It looks as if {report.suspicion}"
    slower = "" if report.frames_beyond or slowing else "--scale-time to play it slower, "
    return SafetyError(
        f"{cause}.",
        f"See `g1stream motion` and correct it, or give {slower}--clamp to limit its targets, "
        "or --anyway on the loopback interface.",
    )
