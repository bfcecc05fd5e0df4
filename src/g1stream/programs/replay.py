"""Play a recorded session again."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from g1stream.config import Config
from g1stream.errors import ConfigError, RecordingError
from g1stream.exact_replay.commands import recorded_commands
from g1stream.programs.arming import require_arming
from g1stream.programs.stream import stream, with_robot_limits
from g1stream.robot.model import G1
from g1stream.session.motions import commanded_motion
from g1stream.session.session import Session, open_session
from g1stream.session.streams import Command, Reference

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from g1stream.control.loop import StreamLoop
    from g1stream.exact_replay.commands import RecordedCommands
    from g1stream.motion.motion import Motion
    from g1stream.programs.arming import ArmingReport
    from g1stream.session.summary import Summary

__all__ = ["replay"]


def replay(
    session: Session | str | Path,
    config: Config | None = None,
    *,
    exact: bool = False,
    speed: float = 1.0,
    record: str | Path | None = None,
    force: bool = False,
    arm: Callable[[ArmingReport], bool] | None = None,
    on_loop: Callable[[StreamLoop, Motion], None] | None = None,
) -> Summary:
    """Play a recorded session on the robot that subscribes to LowCmd, and return how it went.

    The recorded reference is played like any motion: with a ramp, within the limits, with the gains
    and feed-forward of `config`.

    Args:
        session: a session or its file.
        config: all settings; by default domain 1 on loopback.
        exact: during PLAY, publish the recorded LowCmds, bit for bit, with their gains and torques,
            instead of new ones. In a session without a reference, the motion is that of all
            commands with kp above 0.
        speed: factor relative to the recording.
        record: also record the new session into this file.
        force: replace an existing recording.
        arm: called before anything is sent, as by `stream`; needed on anything but loopback.
        on_loop: called with the loop and the motion before the loop runs.

    Raises:
        SafetyError: a recorded command must not be sent to this robot, or it is not armed.
        G1StreamError: a file, a setting or the wire does not allow it.
    """
    config = config or Config()
    require_arming(config.dds.interface, armed=arm is not None)
    config = with_robot_limits(config)
    if not (np.isfinite(speed) and speed > 0):
        raise ConfigError(f"The speed {speed} is not above 0.", "Give a --speed such as 0.5.")
    if exact and config.stream.loop:
        raise ConfigError(
            "Recorded commands cannot be looped: the last one does not lead to the first.",
            "Leave out --loop or --exact.",
        )
    if not isinstance(session, Session):
        session = open_session(session)
    recorded = None
    if exact:
        recorded = recorded_commands(
            session,
            G1.load(config.robot, own_limits=config.safety.urdf_limits),
            config.safety,
            speed,
        )
    motion = _motion(session, recorded, speed)
    return stream(
        motion,
        config,
        record=record,
        force=force,
        arm=arm,
        on_loop=on_loop and (lambda loop: on_loop(loop, motion)),
        recorded=recorded,
    )


def _motion(session: Session, recorded: RecordedCommands | None, speed: float) -> Motion:
    """The motion of the reference; without one, that of the recorded commands."""
    if session.topics.get(Reference.topic):
        motion = session.motion()
        return replace(motion, fps=motion.fps * speed)
    if recorded:
        return commanded_motion(recorded.times, recorded.q.astype(np.float64), session.path)
    raise RecordingError(
        f"{session.path} has no messages on {Reference.topic}, so no reference to replay.",
        "Replay its recorded commands: add --exact."
        if session.topics.get(Command.topic)
        else "Give a session in which a motion was played.",
    )
