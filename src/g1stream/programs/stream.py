"""Play a motion: the loop on the wire, with a recorder beside it if asked for."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from g1stream.clock import SystemClock
from g1stream.config import Config
from g1stream.control.feedforward import FeedForward
from g1stream.control.gains import Gains, resolve_gains
from g1stream.control.link import DdsLink
from g1stream.control.loop import StreamLoop
from g1stream.control.phases import Timing
from g1stream.control.safety import Envelope
from g1stream.control.targets import Targets
from g1stream.dds.domain import Participant, is_local_only
from g1stream.dds.topics import LOWCMD
from g1stream.doctor.matching import explain_no_robot
from g1stream.doctor.wire import inspect_participant
from g1stream.errors import ConfigError, SafetyError, WireError
from g1stream.motion.limits import Interval, measure_limits
from g1stream.motion.motion import Motion
from g1stream.motion.trajectory import Trajectory
from g1stream.programs.outcome import StreamOutcome, loop_summary
from g1stream.programs.recorder_child import RecorderChild, refuse_path
from g1stream.realtime import on_time, told
from g1stream.robot.dynamics import InverseDynamics
from g1stream.robot.joints import TORQUE_LIMIT
from g1stream.robot.model import G1
from g1stream.session.motions import load_motion
from g1stream.types import ERROR, INFO, WARNING

if TYPE_CHECKING:
    from collections.abc import Callable

    from g1stream.clock import Clock
    from g1stream.control.loop import LoopReport
    from g1stream.doctor.facts import Finding
    from g1stream.realtime import Grant

__all__ = ["StreamOutcome", "make_loop", "played_interval", "stream"]

#: For how long others are looked for before we show ourselves as a writer of LowCmd, ns.
_DISCOVERY = 300_000_000
#: For how long then, in case that somebody else started at the same moment, ns.
_SETTLE = 100_000_000
#: For how long a wire is listened to on which nobody answered, s.
_LISTEN = 0.2


def stream(
    motion: Motion | str | Path,
    config: Config | None = None,
    *,
    record: str | Path | None = None,
    force: bool = False,
    on_loop: Callable[[StreamLoop], None] | None = None,
    on_warning: Callable[[str], None] | None = lambda text: None,
    make_link: Callable[[Participant], DdsLink] = DdsLink,
) -> StreamOutcome:
    """Play a motion on whatever robot listens, and return how it went.

    The robot is damped before this returns or raises, however it ends.

    Args:
        motion: a motion, a motion file, or the name of a bundled motion.
        config: all settings; the defaults if left out: domain 1 on loopback.
        record: also record the session into this file.
        force: replace a recording that is there already.
        on_loop: is given the loop before it runs, to watch it or to ask it to stop.
        on_warning: is told, before the first command, what of the motion is beyond the limits;
            None: it is not looked at.
        make_link: makes what stands between the loop and the wire.

    Raises:
        G1StreamError: a file, a setting or the wire does not allow it.
    """
    config = config or Config()
    session = None if record is None else Path(record)
    if session:
        refuse_path(session, config.record, force)
    robot = G1.load(config.robot)
    if not isinstance(motion, Motion):
        motion = load_motion(motion, robot)
    interval = played_interval(motion, config)
    gains = resolve_gains(config.gains)
    clock = SystemClock()
    with Participant(config.dds.domain, config.dds.interface) as participant:
        joined = clock.now()
        # Only now, because it takes as long as others need to be discovered.
        settings = config.stream
        trajectory = Trajectory(motion, loop=settings.loop)
        targets = Targets(
            trajectory, start=interval.start, play=interval.length, ramp=settings.ramp
        )
        warnings: tuple[str, ...] = ()
        if on_warning:
            warnings = measure_limits(
                trajectory,
                robot,
                interval,
                rate=settings.rate,
                position_margin=config.safety.position_margin,
            ).warnings
        if not config.safety.allow_second_writer:
            clock.sleep_until(joined + _DISCOVERY)
            _refuse_if_commanded(participant)
        link = make_link(participant)
        loop = make_loop(config, robot, link, targets, interval.length, gains, clock)
        if on_loop:
            on_loop(loop)
        if on_warning:
            for warning in warnings:
                on_warning(warning)
        recorder = RecorderChild(session, force, config, motion, gains) if session else None
        recording = None
        granted: list[Grant] = []
        try:
            with on_time(config.realtime.priority, config.realtime.cpu) as granted:
                link.tell(INFO, told(granted))
                for warning in warnings:
                    link.tell(WARNING, warning)
                report = loop.run()
            findings = _unanswered(config, participant, link, report)
        finally:
            wire = link.counts()
            if recorder:
                heard = bool(loop.report.commands or loop.report.states)
                recording = recorder.finish(_final_metadata(loop, wire, granted), heard=heard)
    return StreamOutcome(motion.name, report, recording, wire, granted, interval, findings)


def _final_metadata(
    loop: StreamLoop, wire: dict[str, int | None], granted: list[Grant]
) -> dict[str, Any]:
    """What the recorder notes of how the loop went."""
    grants = [asdict(grant) for grant in granted]
    return {"stream": {**loop_summary(loop.report), "wire": wire, "realtime": grants}}


def _unanswered(
    config: Config, participant: Participant, link: DdsLink, report: LoopReport
) -> list[Finding]:
    """Why nobody was there to play to, in the doctor's words; they go into the recording too."""
    if report.commands or (report.states and link.listeners()):
        return []
    try:
        wire = inspect_participant(participant, _LISTEN)
    except WireError:  # how the run went is told all the same
        return []
    # The loop has listened for longer. Readers are counted only now: whoever came meanwhile is
    # among them, and is matched.
    state = replace(wire.state, received=wire.state.received or report.states)
    wire = replace(wire, state=state, commands_matched=link.listeners())
    findings = explain_no_robot(config.dds.domain, config.dds.interface, wire)
    for finding in findings:
        link.tell(ERROR, finding.cause)
    return findings


def _refuse_if_commanded(participant: Participant) -> None:
    """Refuse before there is a writer of ours, the sight of which would stop whoever plays."""
    others = participant.writers(LOWCMD.name)
    if others:
        raise SafetyError(
            f"Somebody else writes {LOWCMD.name}: {', '.join(map(str, others))}.",
            "End it, or pass --allow-second-writer if you mean to command beside it.",
        )


def make_loop(
    config: Config,
    robot: G1,
    link: Any,
    targets: Targets,
    play: float | None,
    gains: Gains,
    clock: Clock,
    *,
    settle: int = _SETTLE,
) -> StreamLoop:
    """The loop of a config, not yet running; `play` is how much of the motion is played, s."""
    settings, safety = config.stream, config.safety
    timing = Timing(
        wait=_ns(settings.wait),
        ramp=_ns(settings.ramp),
        play=None if play is None else _ns(play),
        hold=_ns(settings.hold),
        damp=_ns(settings.damp),
    )
    return StreamLoop(
        link,
        clock,
        targets,
        Envelope(robot, safety),
        timing,
        gains,
        period=_period(config),
        damp_kd=settings.damp_kd,
        settle=settle,
        allow_rivals=safety.allow_second_writer,
        feedforward=make_feedforward(config, robot),
    )


def make_feedforward(config: Config, robot: G1) -> FeedForward:
    """What commands carry beside q. By itself it takes no model to another machine.

    Raises:
        RobotError: the torques of this robot cannot be computed.
    """
    settings, period = config.stream, _period(config) / 1e9
    kind = settings.feedforward
    if kind is None and not is_local_only(config.dds.interface):
        kind = "velocity"
    dynamics = InverseDynamics(robot) if kind in (None, "dynamics") else None
    return FeedForward(
        kind,
        settings.support,
        dynamics=dynamics,
        limit=np.minimum(TORQUE_LIMIT, robot.effort),
        period=period,
        ramp=settings.ramp,
        # On average a servo of the same rate looks at a command half a period after it came, and
        # obeys it for a whole one.
        preview=period if settings.preview is None else settings.preview,
    )


def played_interval(motion: Motion, config: Config) -> Interval:
    """What of the motion is to be played."""
    start, duration = config.stream.start, config.stream.duration
    if start >= motion.duration:
        raise ConfigError(
            f"The start, {start:g} s, is not within {motion.name}, which lasts "
            f"{motion.duration:.2f} s.",
            "Choose an earlier --start.",
        )
    if config.stream.loop:
        return Interval(start, duration, motion.duration, loop=True)
    rest = motion.duration - start
    return Interval(start, rest if duration is None else min(duration, rest), motion.duration)


def _period(config: Config) -> int:
    """Between two commands, ns; whole, because the deadlines are."""
    return round(1e9 / config.stream.rate)


def _ns(seconds: float) -> int:
    return round(seconds * 1e9)
