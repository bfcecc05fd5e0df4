"""The loop that a config describes."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

from g1stream.control.arm_sdk import MOVED, ArmSdkComposer, settings_for_arm_sdk
from g1stream.control.command_delay import CommandDelay
from g1stream.control.commands import CommandLimits, Composer
from g1stream.control.feedforward import FeedForward
from g1stream.control.gains import gains_in_play
from g1stream.control.loop import StreamLoop
from g1stream.control.next_command import NextCommand
from g1stream.control.overruns import Overruns
from g1stream.control.phases import Timing
from g1stream.control.safety import Safety
from g1stream.control.schedule import Schedule
from g1stream.control.targets import Targets
from g1stream.dds.domain import SETTLE
from g1stream.dds.messages import ARM_SDK, LOWCMD
from g1stream.extras.feet.squat import SQUAT_TIME, Squat
from g1stream.motion.blend import COAST
from g1stream.motion.limits import Interval

if TYPE_CHECKING:
    from g1stream.clock import Clock
    from g1stream.config import Config
    from g1stream.control.link import Link
    from g1stream.motion.trajectory import Trajectory
    from g1stream.robot.model import G1

__all__ = ["make_loop"]

#: More than a leg is shorter in the lowest squat than stretched, m.
_LIFT: Final = 0.4


def make_loop(
    config: Config,
    robot: G1,
    trajectory: Trajectory,
    link: Link,
    clock: Clock,
    *,
    settle: int = round(SETTLE * 1e9),
) -> StreamLoop:
    """The loop that plays a trajectory as configured, not yet running.

    Args:
        config: all settings.
        robot: the robot whose limits and dynamics apply.
        trajectory: the motion.
        link: the wire.
        clock: now, stamp and sleep_until.
        settle: how long other publishers are waited for before the first command, ns.

    Raises:
        ConfigError: the interval to play, the joints, the gains or the margin to the limits are
            invalid.
        RobotError: the inverse dynamics of this robot cannot be computed.
    """
    settings = config.stream
    if settings.via == "arm_sdk":
        settings = settings_for_arm_sdk(settings)
    interval = Interval.from_config(settings, trajectory.motion)
    period = round(1e9 / settings.rate)  # whole, because deadlines are
    gains = gains_in_play(config, robot)
    played = robot.select(settings.played_joints)
    held = played if settings.others == "free" else robot.present
    limits = CommandLimits(robot, config.safety, settings.beyond_limits)
    composer = Composer(limits, gains, settings.damp_kd, played, robot.present)
    topic = LOWCMD
    if settings.via == "arm_sdk":
        held, topic = MOVED & robot.present, ARM_SDK
        composer = ArmSdkComposer(limits, gains, played, held, period)
    squat, timing = None, Timing.from_config(settings, interval.length, settle=settle + period)
    if settings.support == "feet":
        squat = Squat(robot)
        hold = round(1e9 * max(settings.hold, COAST))
        timing = replace(timing, hold=hold, squat=round(1e9 * SQUAT_TIME))
    targets = Targets(
        trajectory,
        start=interval.start,
        play=interval.length,
        ramp=settings.ramp,
        ramp_speed=settings.ramp_speed,
        played=None if squat else played,  # the others stand as the motion was changed to
        lift=_LIFT if squat else 0.0,
        squat=squat,
        hold=settings.hold,
    )
    schedule = Schedule(targets, timing, period)
    commands = NextCommand(
        schedule,
        composer,
        period=period,
        feedforward=FeedForward.from_config(settings, robot, period / 1e9, held=held),
        soft_start=round(settings.soft_start * 1e9),
    )
    return StreamLoop(
        link,
        clock,
        schedule,
        commands,
        Safety(robot, config.safety, period, held),
        Overruns(period, config.safety),
        period=period,
        allow_second_writer=config.safety.allow_second_writer,
        topic=topic,
        command_delay=None if topic is ARM_SDK else CommandDelay(balanced=bool(squat)),
    )
