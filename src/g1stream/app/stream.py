"""Play a motion: the loop on the wire, and a recorder beside it if requested."""

from __future__ import annotations

import logging
import time
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

from g1stream.analysis.summarise import summarise_run
from g1stream.analysis.summary import Summary, Termination
from g1stream.app.arming import inspect_for_arming, motion_service, require_arming
from g1stream.app.child_process import Child, ChildError, publishing_for_ros2
from g1stream.app.guard import Guard
from g1stream.app.session import open_session
from g1stream.clock import SystemClock
from g1stream.config import SHIPPED, Config, load_config
from g1stream.control.arm_sdk import settings_for_arm_sdk
from g1stream.control.gains import gains_in_play
from g1stream.control.link import DdsLink
from g1stream.control.loop import StreamLoop
from g1stream.control.make_loop import make_loop
from g1stream.dds.domain import DISCOVERY, Participant, is_local_only
from g1stream.dds.log_handler import dds_log_handler
from g1stream.dds.messages import COMMANDS, LOWCMD
from g1stream.doctor.findings import explain_no_robot
from g1stream.doctor.inspection import inspect_participant
from g1stream.errors import G1StreamError, SafetyError, WireError
from g1stream.events import handled_by
from g1stream.extras.feet.stand import refuse_feet_on_robot, stand_if_asked
from g1stream.files import timestamped
from g1stream.motion.fit import fit_to_robot
from g1stream.motion.motion import Motion
from g1stream.motion.readers import load_motion
from g1stream.realtime import describe, on_time
from g1stream.robot.model import G1
from g1stream.session.parts import check_recording_path
from g1stream.session.records import MotionInfo, RecorderSummary, SessionInfo, StreamSummary

if TYPE_CHECKING:
    from collections.abc import Callable

    from g1stream.app.arming import ArmingReport
    from g1stream.config import RecordConfig
    from g1stream.control.loop import LoopReport
    from g1stream.doctor.facts import Finding
    from g1stream.motion.fit import Playable
    from g1stream.motion.limits import Interval
    from g1stream.motion.trajectory import Trajectory
    from g1stream.realtime import Grant

__all__ = ["for_wire", "stream", "with_robot_limits"]

_LOGGER = logging.getLogger(__name__)

#: Age of the last LowState that stops in simulation, s. There, two programs and the physics share
#: one machine, and silences above a robot's 0.1 s are common on two CPUs; nothing breaks meanwhile:
#: the torque of the feed-forward fades out after 20 ms, and the position servo holds. Half of the
#: 1 s after which Unitree's own programs stop.
_STATE_TIMEOUT_OF_SIMULATOR: Final = 0.5
#: How long the wire is listened to for a diagnosis when nothing answered, s.
_LISTEN: Final = 0.2


def stream(
    motion: Motion | str | Path,
    config: Config | None = None,
    *,
    record: str | Path | None = None,
    force: bool = False,
    arm: Callable[[ArmingReport], bool] | None = None,
    on_loop: Callable[[StreamLoop], None] | None = None,
) -> Summary:
    """Play a motion on the robot that subscribes to LowCmd, and return how it went.

    The robot is damped before this returns or raises, whatever ends it; a guard process damps it
    where this one cannot. After the first command, what ends it is the reason in the summary.
    Events are logged below the logger `g1stream`, and published on rt/g1stream/log.

    Args:
        motion: a motion, a motion file, or the name of a bundled motion.
        config: all settings; by default domain 1 on loopback.
        record: also record the session into this file.
        force: replace an existing recording.
        arm: called before anything is sent with what is about to happen; nothing is sent unless it
            returns True. Needed on anything but the loopback interface.
        on_loop: called with the loop before it runs, to display it or to stop it.

    Raises:
        SafetyError: it is not armed, the motion is beyond the robot's limits, or there is another
            publisher of LowCmd.
        G1StreamError: a file, a setting or the wire does not allow it.
    """
    config = config or Config()
    require_arming(config.dds.interface, armed=arm is not None)
    refuse_feet_on_robot(config)
    config = with_robot_limits(config)
    on_wire = for_wire(config)
    session = None if record is None else _recording_path(Path(record), config.record, force)
    robot = G1.load(config.robot, own_limits=config.safety.urdf_limits)
    if not isinstance(motion, Motion):
        motion = load_motion(motion)
    clock = SystemClock()
    with (
        Guard(on_wire) as guard,
        Participant(config.dds.domain, config.dds.interface) as participant,
        ExitStack() as stack,
    ):
        joined = clock.now()
        # Done now, because it takes as long as the discovery of other publishers.
        playable = _fit(motion, robot, config)
        trajectory, interval = playable.trajectory, playable.interval
        motion = trajectory.motion
        _arm(participant, on_wire, trajectory, interval, arm)
        stack.enter_context(publishing_for_ros2(config))  # nothing is published before arming
        if not config.safety.allow_second_writer:
            clock.sleep_until(joined + round(DISCOVERY * 1e9))
            _refuse_if_commanded(participant, config)
        link = DdsLink(participant, guard.wait_until_ready(), COMMANDS[config.stream.via])
        events = dds_log_handler(participant, "stream")
        loop = make_loop(on_wire, robot, trajectory, link, clock)
        if on_loop:
            on_loop(loop)
        recorder = None
        if session:
            gains = gains_in_play(config, robot)._asdict()
            info = SessionInfo.from_config(config, robot, motion, gains)
            recorder = _RecorderChild(session, force, on_wire, info, loop)
        recording = None
        granted: list[Grant] = []
        findings: list[Finding] = []
        try:
            # All events have been published when the recorder is told to finish.
            with handled_by(events):
                for level, text in playable.events:
                    _LOGGER.log(level, "%s", text)
                with on_time(config.realtime.priority, config.realtime.cpu) as granted:
                    _LOGGER.info("real time: %s", describe(granted))
                    report = _run(loop, guard)
                findings = _diagnose(config, participant, link, report)
        finally:
            about = {
                "start_s": interval.start,
                "slowed": playable.slowed,
                "realtime": granted,
                "findings": findings,
            }
            played = loop.report.summary().model_copy(update={**about, **link.counts()})
            if recorder:
                recording = recorder.finish(played)
    met = played.commands or played.states_used  # else the file says nothing about a motion
    if met and recording and not recording.stopped and not recording.removed:
        return open_session(recording.path).summary()
    return summarise_run(
        config,
        motion=MotionInfo.from_motion(motion),
        termination=Termination(
            reason=report.reason,
            played_s=report.played / 1e9,
            motion_s=motion.duration,
            start_s=interval.start,
        ),
        stream=played,
        recorder=recording,
    )


def _run(loop: StreamLoop, guard: Guard) -> LoopReport:
    """Run the loop; an error after the first command has become its reason to end."""
    try:
        with guard.protecting(loop):
            return loop.run()
    except G1StreamError:
        if not loop.report.commands:
            raise
        return loop.report


class _RecorderChild:
    """The recorder as a child process; it misses nothing that is published from now on.

    If it fails while the motion is played, that is logged at once, and ends the motion if
    `safety.require_record` is set.

    Raises:
        ChildError: it cannot record.
    """

    def __init__(
        self, path: Path, force: bool, config: Config, session: SessionInfo, loop: StreamLoop
    ) -> None:
        self._path, self._loop = path, loop
        self._required = config.safety.require_record
        self._failure = ""
        arguments = {"path": path, "config": config, "force": force, "session": session}
        self._child = Child("record", arguments, on_failure=self._fail)
        try:
            self._child.wait_until_ready(abandoned=lambda: loop.stop_requests > 0)
        except BaseException:
            self._child.kill()
            raise

    def _fail(self, cause: str) -> None:
        self._failure = cause
        _LOGGER.error("the recording failed: %s", cause)
        if self._required:
            self._loop.request_stop(f"the recording failed: {cause.rstrip('.')}")

    def finish(self, stream: StreamSummary) -> RecorderSummary:
        """End the recording, and return its summary; if the recorder failed, only why.

        A signal that comes meanwhile ends the recorder at once.

        Args:
            stream: for the file's metadata.
        """
        summary: RecorderSummary
        final = {"stream": stream.model_dump(mode="json"), "stopped": self._failure}
        requests = self._loop.stop_requests
        self._child.resume()  # if it is stopped, it can still close its file
        try:
            summary = self._child.finish(
                final, abandoned=lambda: self._loop.stop_requests > requests
            )
        except ChildError as error:
            path = str(self._path)
            return RecorderSummary(path=path, paths=[path], stopped=self._failure or error.cause)
        gone = [path for path in summary.paths if not Path(path).exists()]
        if gone and not summary.removed:
            summary.stopped = summary.stopped or f"{gone[0]} is not there any more."
        return summary


def _recording_path(path: Path, settings: RecordConfig, force: bool) -> Path:
    """Where to record to; refused, before anything is started, where that is not possible."""
    if settings.auto_name:
        path = timestamped(path, time.time_ns())
    split = settings.split_size is not None or settings.split_duration is not None
    check_recording_path(path, split=split, force=force)
    return path


def _refuse_if_commanded(participant: Participant, config: Config) -> None:
    """Refuse before we publish commands ourselves, which would stop another g1stream."""
    topic = COMMANDS[config.stream.via]
    others = participant.commanders(topic.name)
    if others:
        raise SafetyError(
            f"There is another publisher on {topic.name}: "
            f"{', '.join(map(participant.owner, others))}.",
            "Stop it; `g1stream robot release` releases the robot's own controller."
            if topic is LOWCMD
            else "Stop it: one program at a time can move the arms.",
        )


def _fit(motion: Motion, robot: G1, config: Config) -> Playable:
    """The motion as it may be played."""
    motion, changed = stand_if_asked(motion, robot, config)
    playable = fit_to_robot(motion, robot, config, simulated=is_local_only(config.dds.interface))
    if changed:
        playable = playable._replace(events=((logging.INFO, changed), *playable.events))
    return playable


def _arm(
    participant: Participant,
    config: Config,
    trajectory: Trajectory,
    interval: Interval,
    arm: Callable[[ArmingReport], bool] | None,
) -> None:
    if arm is None:
        if config.stream.via == "arm_sdk":
            motion_service(participant, config)
        return
    first = trajectory.sample(interval.start).joint_pos
    if not arm(inspect_for_arming(participant, config, first)):
        raise SafetyError(
            f"Arming on {config.dds.interface} was not confirmed; nothing was sent.",
            "Run it again, and type the name of the interface.",
        )


def with_robot_limits(config: Config) -> Config:
    """A config in which robot.toml's values stand wherever nothing is set; unchanged on loopback.

    Its domain and interface are not taken over.
    """
    if is_local_only(config.dds.interface):
        return config
    robot = load_config(SHIPPED / "robot.toml")
    tables = {}
    for name in robot.model_fields_set - {"dds"}:
        given, cautious = getattr(config, name), getattr(robot, name)
        unset = {
            key: getattr(cautious, key)
            for key in cautious.model_fields_set
            if key not in given.model_fields_set or getattr(given, key) is None
        }
        tables[name] = given.model_copy(update=unset)
    return config.model_copy(update=tables)


def for_wire(config: Config) -> Config:
    """A config whose unset values that depend on the wire are set.

    On loopback there is a simulator, which may be silent for longer than a robot. Anywhere else
    there may be a robot, for which robot.toml has the values. With `stream.via` = arm_sdk, its
    topic decides on others.

    Raises:
        ConfigError: the settings ask for what is not possible with `stream.via` = arm_sdk.
    """
    if is_local_only(config.dds.interface):
        timeout = config.safety.state_timeout or _STATE_TIMEOUT_OF_SIMULATOR
        safety = config.safety.model_copy(update={"state_timeout": timeout})
        config = config.model_copy(update={"safety": safety})
    else:
        config = with_robot_limits(config)
    if config.stream.via == "arm_sdk":
        config = config.model_copy(update={"stream": settings_for_arm_sdk(config.stream)})
    return config


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
    topic = COMMANDS[config.stream.via].name
    findings = explain_no_robot(config.dds.domain, config.dds.interface, wire, topic)
    for finding in findings:
        _LOGGER.error("%s", finding.cause)
    return findings
