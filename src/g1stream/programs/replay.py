"""Play a recorded session again."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from g1stream.config import MAX_KD, MAX_KP, Config
from g1stream.control.link import DdsLink
from g1stream.control.recorded import RecordedLink
from g1stream.dds.messages import LowCmd
from g1stream.errors import ConfigError, RecordingError, SafetyError
from g1stream.programs.stream import stream
from g1stream.recording.played import PLAY, commanded_motion
from g1stream.recording.session import Session, open_session
from g1stream.recording.streams import Command, Reference
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.model import G1
from g1stream.robot.motors import TORQUE_LIMIT

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray

    from g1stream.control.loop import StreamLoop
    from g1stream.motion.motion import Motion
    from g1stream.programs.outcome import StreamOutcome

__all__ = ["replay"]

#: Commands are float32: a target at a limit may be beyond it by its rounding, rad.
_ROUNDING = 1e-6


def replay(
    session: Session | str | Path,
    config: Config | None = None,
    *,
    exact: bool = False,
    speed: float = 1.0,
    record: str | Path | None = None,
    force: bool = False,
    on_loop: Callable[[StreamLoop, Motion], None] | None = None,
) -> StreamOutcome:
    """Play a recorded session on whatever robot listens, and return how it went.

    What was played is a motion like any other: it is ramped to, kept within the envelope, held and
    damped, with the gains and feed-forward of `config`.

    Args:
        session: a session or its file.
        config: all settings; the defaults if left out: domain 1 on loopback.
        exact: while the motion plays, publish the recorded LowCmds, bit for bit, instead of
            computing new ones; their gains and torques go with them. Without a reference in the
            session, all commands that held the robot are the motion.
        speed: how many times as fast as it was recorded.
        record: also record the new session into this file.
        force: replace a recording that is there already.
        on_loop: is given the loop and the motion before it runs.

    Raises:
        SafetyError: a recorded command must not be sent to this robot.
        G1StreamError: a file, a setting or the wire does not allow it.
    """
    config = config or Config()
    if not (np.isfinite(speed) and speed > 0):
        raise ConfigError(f"The speed {speed} is not above 0.", "Give a --speed such as 0.5.")
    if exact and config.stream.loop:
        raise ConfigError(
            "Recorded commands cannot be looped: the last does not lead to the first.",
            "Leave out --loop or --exact.",
        )
    if not isinstance(session, Session):
        session = open_session(session)
    make_link: Callable[..., DdsLink] = DdsLink
    if exact:
        times, chosen = _played_commands(session)
        _check(session, chosen, G1.load(config.robot))
        commands = _bytes_of(session, chosen)
        make_link = partial(RecordedLink, times=times / speed, commands=commands)
    if exact and not session.topics.get(Reference.topic):
        motion = commanded_motion(times, session.command.q[chosen], session.path)
    else:
        motion = session.motion()
    motion = replace(motion, fps=motion.fps * speed)
    return stream(
        motion,
        config,
        record=record,
        force=force,
        on_loop=on_loop and (lambda loop: on_loop(loop, motion)),
        make_link=make_link,
    )


def _played_commands(session: Session) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """When in the motion each command was due (N,), s, and which of /lowcmd these are (N,)."""
    command = session.command
    if session.topics.get(Reference.topic):
        # A command and its reference have the very same stamp.
        reference = session.reference
        playing = np.flatnonzero(reference.phase == PLAY)
        _, chosen, paired = np.intersect1d(
            command.publish_time, reference.publish_time[playing], return_indices=True
        )
        times = reference.motion_time[playing]
        times = times[paired] - times[:1]
    else:
        chosen = np.flatnonzero(command.kp.any(axis=1))
        times = (command.publish_time[chosen] - command.publish_time[chosen[:1]]) / 1e9
    if len(chosen) < 2:
        raise RecordingError(
            f"{session.path} has no commands that played a motion.",
            "Give a session in which somebody held the robot with kp above 0.",
        )
    return times, chosen


def _check(session: Session, chosen: NDArray[np.intp], robot: G1) -> None:
    """Refuse commands that would not have passed the envelope: nothing may alter them later."""
    command = session.command
    for name in ("q", "dq", "tau", "kp", "kd"):
        values = getattr(command, name)[chosen]
        if not np.isfinite(values).all():
            joint = JOINT_NAMES[int(np.argwhere(~np.isfinite(values))[0, 1])]
            raise _unsafe(session, f"has a {name} of {joint} that is not finite")
    torque = np.minimum(TORQUE_LIMIT, robot.effort)
    nothing = np.zeros(len(JOINT_NAMES))
    for name, unit, lower, upper in (
        ("q", "rad", robot.lower, robot.upper),
        ("dq", "rad/s", -robot.velocity, robot.velocity),
        ("tau", "Nm", -torque, torque),
        ("kp", "Nm/rad", nothing, nothing + MAX_KP),
        ("kd", "Nm s/rad", nothing, nothing + MAX_KD),
    ):
        values = getattr(command, name)[chosen]
        # What lies at a limit was rounded to float32 on the wire.
        slack = _ROUNDING * np.maximum(1.0, np.maximum(np.abs(lower), np.abs(upper)))
        beyond = (values < lower - slack) | (values > upper + slack)
        if beyond.any():
            row, joint = np.argwhere(beyond)[0]
            raise _unsafe(
                session,
                f"asks {JOINT_NAMES[joint]} for a {name} of {values[row, joint]:.3f} {unit}, "
                f"beyond its limits {lower[joint]:.3f} and {upper[joint]:.3f}",
            )


def _bytes_of(session: Session, chosen: NDArray[np.intp]) -> list[bytes]:
    """The chosen commands as they were on the wire."""
    recorded = list(session.replay_bytes(Command.topic))
    commands = [recorded[i] for i in chosen.tolist()]
    seen = LowCmd()
    for data in commands:
        seen.load(data)
        if not seen.crc_matches():
            raise _unsafe(session, "has a checksum that does not fit")
        if seen.mode_pr:
            raise _unsafe(session, f"has mode_pr {seen.mode_pr}, not 0")
    return commands


def _unsafe(session: Session, what: str) -> SafetyError:
    return SafetyError(
        f"A recorded command of {session.path} {what}.",
        "Replay the reference instead, which stays within the envelope: leave out --exact.",
    )
