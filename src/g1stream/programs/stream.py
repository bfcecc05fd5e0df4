"""Play a motion: the loop on the wire, and a recorder beside it if requested."""

from __future__ import annotations

import logging
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

from g1stream.analysis.summary import summarise_run
from g1stream.clock import SystemClock
from g1stream.config import Config
from g1stream.control.gains import resolve_gains
from g1stream.control.link import DdsLink
from g1stream.control.loop import StreamLoop, make_loop
from g1stream.dds.domain import Participant, is_local_only
from g1stream.dds.log_handler import dds_log_handler
from g1stream.dds.topics import LOWCMD
from g1stream.doctor.findings import explain_no_robot
from g1stream.doctor.wire import inspect_participant
from g1stream.errors import SafetyError, WireError
from g1stream.events import handled_by
from g1stream.exact_replay.recorded_link import RecordedLink
from g1stream.files import timestamped
from g1stream.motion.correction import Correction
from g1stream.motion.limits import Interval, measure_limits
from g1stream.motion.motion import Motion
from g1stream.motion.trajectory import Trajectory
from g1stream.programs.child_process import Child, ChildError
from g1stream.realtime import describe, on_time
from g1stream.robot.model import G1
from g1stream.session.motions import load_motion
from g1stream.session.parts import check_recording_path, remove_recording
from g1stream.session.session import open_session
from g1stream.session.summary import (
    MotionInfo,
    RecorderSummary,
    SessionInfo,
    StreamSummary,
    Summary,
    Termination,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from g1stream.config import RecordConfig
    from g1stream.control.loop import LoopReport
    from g1stream.doctor.facts import Finding
    from g1stream.exact_replay.commands import RecordedCommands
    from g1stream.realtime import Grant

__all__ = ["for_wire", "stream"]

_LOGGER = logging.getLogger(__name__)

#: Age of the last LowState that stops in simulation, s. There, two programs and the physics share
#: one machine, and silences above a robot's 0.1 s are common on two CPUs; nothing breaks meanwhile:
#: the torque of the feed-forward fades out after 20 ms, and the position servo holds. Half of the
#: 1 s after which Unitree's own programs stop.
_STATE_TIMEOUT_OF_SIMULATOR: Final = 0.5
#: How long other publishers are looked for before we become one ourselves, ns.
_DISCOVERY: Final = 300_000_000
#: How long the wire is listened to for a diagnosis when nothing answered, s.
_LISTEN: Final = 0.2
#: Topics of a file that have messages also where no sample was received.
_WITHOUT_SAMPLES: Final = frozenset({"/log", "/scene", "/robot_description"})


def stream(
    motion: Motion | str | Path,
    config: Config | None = None,
    *,
    record: str | Path | None = None,
    force: bool = False,
    on_loop: Callable[[StreamLoop], None] | None = None,
    recorded: RecordedCommands | None = None,
) -> Summary:
    """Play a motion on the robot that subscribes to LowCmd, and return how it went.

    The robot is damped before this returns or raises, whatever ends it. Events are logged below
    the logger `g1stream`, and published on rt/g1stream/log.

    Args:
        motion: a motion, a motion file, or the name of a bundled motion.
        config: all settings; by default domain 1 on loopback.
        record: also record the session into this file.
        force: replace an existing recording.
        on_loop: called with the loop before it runs, to display it or to stop it.
        recorded: commands to publish during PLAY, bit for bit, instead of new ones.

    Raises:
        G1StreamError: a file, a setting or the wire does not allow it.
    """
    config = config or Config()
    session = None if record is None else Path(record)
    if session:
        _check_recording_path(session, config.record, force)
    robot = G1.load(config.robot)
    if not isinstance(motion, Motion):
        motion = load_motion(motion)
    interval = Interval.from_config(config.stream, motion)
    correction = Correction.load(path) if (path := config.stream.correction) else None
    clock = SystemClock()
    with Participant(config.dds.domain, config.dds.interface) as participant:
        joined = clock.now()
        # Done now, because it takes as long as the discovery of other publishers.
        trajectory = Trajectory(motion, loop=config.stream.loop)
        exceeded: Sequence[tuple[int, str]] = ()
        if recorded is None:  # recorded commands beyond a limit were refused
            rate, margin = config.stream.rate, config.safety.position_margin
            limits = measure_limits(trajectory, robot, interval, rate=rate, position_margin=margin)
            exceeded = limits.events
        if not config.safety.allow_second_writer:
            clock.sleep_until(joined + _DISCOVERY)
            _refuse_if_commanded(participant)
        link = RecordedLink(participant, recorded) if recorded else DdsLink(participant)
        events = dds_log_handler(participant, "stream")
        loop = make_loop(
            for_wire(config),
            robot,
            trajectory,
            link,
            clock,
            recorded=recorded is not None,
            correction=correction,
        )
        if on_loop:
            on_loop(loop)
        recorder = None
        if session:
            info = SessionInfo.of(config, motion, resolve_gains(config.gains)._asdict(), correction)
            recorder = _RecorderChild(session, force, config, info)
        recording = None
        granted: list[Grant] = []
        findings: list[Finding] = []
        try:
            # All events have been published when the recorder is told to finish.
            with handled_by(events):
                for level, text in exceeded:
                    _LOGGER.log(level, "%s", text)
                with on_time(config.realtime.priority, config.realtime.cpu) as granted:
                    _LOGGER.info("real time: %s", describe(granted))
                    report = loop.run()
                findings = _diagnose(config, participant, link, report)
        finally:
            about = {"start_s": interval.start, "realtime": granted, "findings": findings}
            played = loop.report.summary().model_copy(update={**about, **link.counts()})
            alone = not (played.commands or played.states_used)
            if recorder:
                recording = recorder.finish(played, remove_if_empty=alone)
    if recording and not alone and not recording.stopped and recording.first_ns is not None:
        return open_session(recording.path).summary()
    return summarise_run(
        config,
        motion=MotionInfo.of(motion),
        termination=Termination(
            reason=report.reason,
            played_s=None if report.reason else interval.length,
            motion_s=motion.duration,
            start_s=interval.start,
        ),
        stream=played,
        recorder=recording,
    )


class _RecorderChild:
    """The recorder as a child process; it misses nothing that is published from now on.

    Raises:
        ChildError: it cannot record.
    """

    def __init__(self, path: Path, force: bool, config: Config, session: SessionInfo) -> None:
        self._path = path
        arguments = {"path": path, "config": config, "force": force, "session": session}
        self._child = Child("record", arguments)
        try:
            self._child.wait_until_ready()
        except BaseException:
            self._child.kill()
            raise

    def finish(self, stream: StreamSummary, *, remove_if_empty: bool) -> RecorderSummary:
        """End the recording, and return its summary; if the recorder failed, only why.

        Args:
            stream: for the file's metadata.
            remove_if_empty: remove a recording without any sample, so that the next one is not
                refused because of it.
        """
        summary: RecorderSummary
        try:
            summary = self._child.finish({"stream": stream.model_dump(mode="json")})
        except ChildError as error:
            path = str(self._path)
            return RecorderSummary(path=path, paths=[path], stopped=error.cause)
        if remove_if_empty and summary.counts.keys() <= _WITHOUT_SAMPLES:
            summary.removed = True
            if summary.paths:  # else its writer has removed it, and left an older one in place
                remove_recording(Path(summary.path))
        return summary


def _check_recording_path(path: Path, settings: RecordConfig, force: bool) -> None:
    """Refuse a path that cannot be recorded to before anything is started."""
    if settings.auto_name:
        path = timestamped(path, time.time_ns())
    split = settings.split_size is not None or settings.split_duration is not None
    check_recording_path(path, split=split, force=force)


def _refuse_if_commanded(participant: Participant) -> None:
    """Refuse before we publish LowCmd ourselves, which would stop another g1stream."""
    others = participant.writers(LOWCMD.name)
    if others:
        raise SafetyError(
            f"There is another publisher on {LOWCMD.name}: "
            f"{', '.join(map(participant.owner, others))}.",
            "Stop it, or pass --allow-second-writer to publish commands beside it.",
        )


def for_wire(config: Config) -> Config:
    """A config whose unset values that depend on the wire are set.

    On loopback there is a simulator, which may be silent for longer than a robot. Unless asked for,
    no torque from the model is sent to another machine, and its time is that of the clock.
    """
    settings, safety = config.stream, config.safety
    if is_local_only(config.dds.interface):
        timeout = safety.state_timeout or _STATE_TIMEOUT_OF_SIMULATOR
        safety = safety.model_copy(update={"state_timeout": timeout})
    else:
        update = {
            "feedforward": settings.feedforward or "velocity",
            "time_scale": settings.time_scale or 1.0,
        }
        settings = settings.model_copy(update=update)
    return config.model_copy(update={"stream": settings, "safety": safety})


def _diagnose(
    config: Config, participant: Participant, link: DdsLink, report: LoopReport
) -> list[Finding]:
    """Why there was no robot to play on; also logged, so that it is in the recording."""
    waited = "stream.wait" in report.reason
    if report.commands or not waited or (report.states and link.subscribers()):
        return []
    try:
        wire = inspect_participant(participant, _LISTEN)
    except WireError:  # the outcome is reported all the same
        return []
    # The loop has listened for longer. Subscribers are counted only now, so that one that has
    # appeared in the meantime counts as matched.
    state = replace(wire.state, received=wire.state.received or report.states)
    wire = replace(wire, state=state, commands_matched=link.subscribers())
    findings = explain_no_robot(config.dds.domain, config.dds.interface, wire)
    for finding in findings:
        _LOGGER.error("%s", finding.cause)
    return findings
