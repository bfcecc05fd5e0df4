"""Play a recorded session again."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from g1stream.config import Config
from g1stream.control.link import DdsLink
from g1stream.errors import ConfigError
from g1stream.programs.stream import stream
from g1stream.replay.commands import recorded_commands
from g1stream.replay.recorded_link import RecordedLink
from g1stream.robot.model import G1
from g1stream.session.session import Session, open_session
from g1stream.session.session_to_motion import commanded_motion
from g1stream.session.streams import Reference

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from g1stream.control.loop import StreamLoop
    from g1stream.dds.domain import Participant
    from g1stream.motion.motion import Motion
    from g1stream.programs.outcome import StreamOutcome

__all__ = ["replay"]


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
        SafetyError: a recorded command must not be sent to this robot, or it would leap at one.
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
    motion, make_link = _prepared(session, config, exact, speed)
    return stream(
        motion,
        config,
        record=record,
        force=force,
        on_loop=on_loop and (lambda loop: on_loop(loop, motion)),
        warn_limits=not exact,  # recorded commands beyond a limit are refused
        make_link=make_link,
    )


def _prepared(
    session: Session | str | Path, config: Config, exact: bool, speed: float
) -> tuple[Motion, Callable[[Participant], DdsLink]]:
    """The motion to play, and what makes the link; of the session, nothing else is kept."""
    if not isinstance(session, Session):
        session = open_session(session)
    make_link: Callable[[Participant], DdsLink] = DdsLink
    recorded = None
    if exact:
        robot = G1.load(config.robot)
        recorded = recorded_commands(session, robot, config.safety, speed)
        make_link = partial(
            RecordedLink,
            times=recorded.times / speed,
            commands=recorded.commands,
            velocity=robot.velocity,
        )
    if recorded and not session.topics.get(Reference.topic):
        motion = commanded_motion(recorded.times, recorded.q.astype(np.float64), session.path)
    else:
        motion = session.motion()
    return replace(motion, fps=motion.fps * speed), make_link
