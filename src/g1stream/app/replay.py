"""Play a recorded session again."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from g1stream.analysis.summary import Summary
from g1stream.app.arming import ArmingReport, require_arming
from g1stream.app.session import Session, open_session
from g1stream.app.stream import stream
from g1stream.config import Config
from g1stream.control.loop import StreamLoop
from g1stream.errors import ConfigError
from g1stream.motion.motion import Motion

__all__ = ["replay"]


def replay(
    session: Session | str | Path,
    config: Config | None = None,
    *,
    speed: float = 1.0,
    record: str | Path | None = None,
    force: bool = False,
    arm: Callable[[ArmingReport], bool] | None = None,
    on_loop: Callable[[StreamLoop, Motion], None] | None = None,
) -> Summary:
    """Play a recorded session on the robot that subscribes to LowCmd, and return its summary.

    The recorded reference is played like any motion, with a ramp, limits, and the gains and
    feed-forward of `config`.

    Args:
        session: a session or its file.
        config: all settings; by default domain 1 on loopback.
        speed: factor relative to the recording.
        record: also record the new session into this file.
        force: replace an existing recording.
        arm: called before anything is sent, as in `stream`; required on anything but loopback.
        on_loop: called with the loop and the motion before the loop runs.

    Raises:
        SafetyError: the robot is not armed, or the motion is beyond its limits.
        G1StreamError: a file, a setting or the wire is not valid.
    """
    config = config or Config()
    require_arming(config.dds.interface, armed=arm is not None)
    if not isinstance(session, Session):
        session = open_session(session)
    if config.stream.policy and session.policy_info:
        raise ConfigError(
            "The motion of this session begins and ends with the policy's standing phases.",
            "Give the motion itself to `g1stream stream --policy`.",
        )
    motion = session.motion()
    if speed != 1.0:
        motion = motion.at_speed(speed)
    return stream(
        motion,
        config,
        record=record,
        force=force,
        arm=arm,
        on_loop=on_loop and (lambda loop: on_loop(loop, motion)),
    )
