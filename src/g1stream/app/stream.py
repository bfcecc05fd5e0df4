"""Play a motion: plan, arm, connect, run and report, with a recorder if requested."""

from __future__ import annotations

import logging
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from traceback import extract_tb
from typing import TYPE_CHECKING, Any, Final

from g1stream.app.arming import confirm_arming, require_arming
from g1stream.child_process import Child, ChildError, publishing_for_ros2
from g1stream.clock import SystemClock
from g1stream.config import Config
from g1stream.control.guard import Guard
from g1stream.control.link import DdsLink
from g1stream.control.stop import Stop
from g1stream.control.wire_settings import for_wire
from g1stream.dds.domain import DISCOVERY, Participant
from g1stream.dds.endpoints import RawReader
from g1stream.dds.log_handler import dds_log_handler
from g1stream.errors import ConfigError, G1StreamError, SafetyError, WireError
from g1stream.events import handled_by
from g1stream.files import check_output_path
from g1stream.network import is_local_only
from g1stream.optional import extension
from g1stream.realtime import describe, on_time

if TYPE_CHECKING:
    from collections.abc import Callable

    from g1stream.analysis.summary import Summary
    from g1stream.app.arming import ArmingReport
    from g1stream.control.loop import StreamLoop
    from g1stream.control.plan import Plan
    from g1stream.control.report import LoopReport
    from g1stream.dds.messages import Topic
    from g1stream.doctor.facts import Finding
    from g1stream.motion.motion import Motion
    from g1stream.session.records import RecorderSummary, StreamSummary

__all__ = ["stream"]

_LOGGER = logging.getLogger(__name__)

#: Time to listen on DDS for a diagnosis if no robot answered, s.
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
    """Play a motion on the robot that subscribes to LowCmd, and return its summary.

    The robot is always damped before this returns or raises. If this process cannot do it, a guard
    process does. After the first command, an error does not raise but is the reason in the summary;
    the place of a bug is logged, and its traceback at level DEBUG.
    Events are logged below the logger `g1stream`, and published on rt/g1stream/log.

    Args:
        motion: a motion, a motion file, or the name of a bundled motion.
        config: all settings; by default domain 1 on loopback.
        record: also record the session into this file.
        force: replace an existing recording.
        arm: called before anything is sent with a report of what will be sent. Nothing is sent
            unless it returns True. Required on anything but the loopback interface.
        on_loop: called with the loop before it runs, to display it or to stop it.

    Raises:
        SystemExit: a signal handler of the caller raised it; its code is then not 0.
        SafetyError: it is not armed, the motion exceeds the robot's limits, or there is another
            publisher of LowCmd.
        G1StreamError: a file, a setting or the wire is not valid.
    """
    config = for_wire(config or Config())
    require_arming(config.dds.interface, armed=arm is not None)
    if config.stream.wait_for == "enter" and on_loop is None:
        raise ConfigError(
            "Nothing lets the motion go on: stream.wait_for is enter, and there is no `on_loop`.",
            "Give `on_loop`, and call `loop.go_on()` where the motion shall go on.",
        )
    path = None if record is None else Path(record)
    if path:
        check_output_path(path, force=force)
    clock = SystemClock()
    with (
        Participant(config.dds.domain, config.dds.interface) as participant,
        Guard(config, participant) as guard,
        ExitStack() as stack,
    ):
        joined = clock.now()
        # Not earlier, so that the guard starts and the participant discovers others meanwhile.
        from g1stream.control.loop import make_loop
        from g1stream.control.plan import plan
        from g1stream.motion.motion import Motion
        from g1stream.motion.readers import load_motion

        if not isinstance(motion, Motion):
            motion = load_motion(motion)  # once for both
        simulated = is_local_only(config.dds.interface)
        planned = plan(motion, config, simulated=simulated)
        if config.stream.policy and config.stream.rehearse:
            extension("rehearse_policy")(motion, config)
        confirm_arming(participant, planned, arm)
        stack.enter_context(publishing_for_ros2(config))  # nothing is published before arming
        steps = planned.source.traits.about is not None
        link = DdsLink(participant, guard.heartbeat, planned.receiver, steps=steps)
        planned.source.listen(partial(_newest, participant))
        events = dds_log_handler(participant, "stream")
        loop = make_loop(planned, link, clock)
        if not config.safety.allow_second_writer:
            clock.sleep_until(joined + round(DISCOVERY * 1e9))
            _refuse_if_commanded(participant, planned)
        guard.wait_until_ready()
        if on_loop:
            on_loop(loop)
        recorder = _RecorderChild(path, force, planned, loop) if path else None
        recording = None
        about: dict[str, Any] = {}
        try:
            # All events have been published when the recorder is stopped.
            with handled_by(events):
                planned.log_events()
                with on_time(
                    config.realtime.priority, config.realtime.cpu, participant.threads
                ) as granted:
                    about["realtime"] = granted
                    _LOGGER.info("real time: %s", describe(granted))
                    _run(loop, guard)
                about["findings"] = _diagnose(planned, participant, link, loop.report)
        finally:
            played = loop.report.summary(**planned.summary(), **link.counts(), **about)
            if recorder:
                recording = recorder.finish(played)
    return _summarise(planned, loop.report, played, recording)


def _summarise(
    planned: Plan, report: LoopReport, played: StreamSummary, recording: RecorderSummary | None
) -> Summary:
    """The summary of the file, if there is one, otherwise of the loop's counters."""
    from g1stream.analysis.summarise import summarise_run
    from g1stream.analysis.summary import Termination
    from g1stream.analysis.tracking import errors_of_run
    from g1stream.app.session import open_session
    from g1stream.session.records import MotionInfo, ParametersInfo

    met = played.commands or played.states_used  # otherwise the file has nothing of a motion
    if met and recording and not recording.stopped and not recording.removed:
        try:
            return open_session(recording.path).summary()
        except (G1StreamError, OSError) as error:  # the motion was played nevertheless
            _LOGGER.error("the recording cannot be read: %s", error)
    followed = errors_of_run(report.error, planned.played)
    return summarise_run(
        planned.config,
        motion=MotionInfo.from_motion(planned.motion),
        params=ParametersInfo.from_robot(planned.robot),
        termination=Termination(
            reason=played.reason,
            played_s=report.played / 1e9,
            motion_s=planned.motion.duration,
            start_s=planned.interval.start,
        ),
        stream=played,
        recorder=recording,
        tracking=followed.summary() if followed else None,
    )


def _run(loop: StreamLoop, guard: Guard) -> None:
    """Run the loop. After the first command, an error becomes the reason why it ended."""
    try:
        with guard.protecting(loop):
            loop.run()
    except SystemExit as error:  # 0 would mean that the motion was played
        raise SystemExit(error.code or 1) from error
    except Exception as error:
        if not loop.report.commands:
            raise
        if not isinstance(error, G1StreamError):
            frames = reversed(extract_tb(error.__traceback__))
            places = (f"{Path(one.filename).name}:{one.lineno} ({one.name})" for one in frames)
            _LOGGER.error("%r was raised in %s", error, ", called by ".join(places))
            _LOGGER.debug("traceback", exc_info=True)


class _RecorderChild:
    """The recorder as a child process. It receives everything published after the constructor.

    If it fails while the motion is played, the failure is logged at once. With
    `safety.require_record` it also ends the motion.
    """

    def __init__(self, path: Path, force: bool, planned: Plan, loop: StreamLoop) -> None:
        self._path, self._loop = path, loop
        self._required = planned.config.safety.require_record
        self._failure = ""
        arguments = {
            "path": path,
            "config": planned.config,
            "force": force,
            "session": planned.session_info(),
        }
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
            text = f"the recording failed: {cause.rstrip('.')}"
            self._loop.end_for_error(Stop("recorder", text))

    def finish(self, stream: StreamSummary) -> RecorderSummary:
        """End the recording, and return its summary, or only the cause if the recorder failed.

        A signal during this time ends the recorder at once.
        """
        from g1stream.session.records import RecorderSummary

        summary: RecorderSummary
        final = {"stream": stream.model_dump(mode="json"), "stopped": self._failure}
        requests = self._loop.stop_requests
        self._child.resume()  # a stopped recorder can still close its file
        try:
            summary = self._child.finish(
                final, abandoned=lambda: self._loop.stop_requests > requests
            )
        except ChildError as error:
            return RecorderSummary(path=str(self._path), stopped=self._failure or error.cause)
        if not (summary.removed or Path(summary.path).exists()):
            summary.stopped = summary.stopped or f"{summary.path} no longer exists."
        return summary


def _newest(participant: Participant, topic: Topic) -> Callable[[], bytes | None]:
    """Subscribe to a topic; the result returns its newest sample since the last call."""
    reader = RawReader(participant, topic)
    return lambda: sample.data if (sample := reader.take_latest()) else None


def _refuse_if_commanded(participant: Participant, planned: Plan) -> None:
    """Refuse to start if another program publishes commands; ours would stop another g1stream."""
    topic = planned.receiver.topic
    others = participant.commanders(topic.name)
    if others:
        raise SafetyError(
            f"There is another publisher on {topic.name}: "
            f"{', '.join(map(participant.owner, others))}.",
            planned.receiver.end_other,
        )


def _diagnose(
    planned: Plan, participant: Participant, link: DdsLink, report: LoopReport
) -> list[Finding]:
    """Find out why there was no robot, and log it so that the recording has it."""
    from g1stream.doctor.findings import explain_no_robot
    from g1stream.doctor.inspection import inspect_participant, search_elsewhere

    waited = report.stop and report.stop.kind == "no_robot"
    if report.commands or not waited or (report.states and link.subscribers()):
        return []
    try:
        wire = inspect_participant(participant, _LISTEN)
    except WireError:  # the outcome is reported anyway
        return []
    # The loop has listened for longer. Subscribers are counted only now, so that one that
    # appeared in the meantime counts as matched.
    state = replace(wire.state, received=wire.state.received or report.states)
    wire = replace(wire, state=state, commands_matched=link.subscribers())
    findings = explain_no_robot(search_elsewhere(wire), planned.receiver.topic)
    for finding in findings:
        _LOGGER.error("%s", finding.cause)
    return findings
