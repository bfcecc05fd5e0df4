"""Record what is published on DDS into a session file."""

from __future__ import annotations

import logging
import socket
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final
from uuid import uuid4

from g1stream._version import __version__
from g1stream.analysis.summarise import summarise_run
from g1stream.analysis.summary import Summary
from g1stream.child_process import Parent, publishing_for_ros2, run_child
from g1stream.config import Config
from g1stream.dds.domain import Participant
from g1stream.dds.messages import COMMANDS, POLICY, REFERENCE
from g1stream.errors import RecordingError
from g1stream.events import ConsoleHandler, handled_by
from g1stream.realtime import lower_priority
from g1stream.recorder.receiver import SampleReceiver
from g1stream.recorder.recorder import Recorder
from g1stream.robot.model import G1
from g1stream.session.format import CHANNELS
from g1stream.session.records import RecorderSummary, SessionInfo
from g1stream.session.writer import SessionWriter, attach_run
from g1stream.view.pipeline import MessagePipeline

__all__ = ["record"]

_POLL_PERIOD: Final = 0.05
#: Longest time from the end of a stream to its guard's first command, s.
_GUARD_DELAY: Final = 1.0


def record(
    path: str | Path,
    config: Config | None = None,
    *,
    force: bool = False,
    session: SessionInfo | None = None,
    should_stop: Callable[[], bool] = lambda: False,
    on_ready: Callable[[], None] = lambda: None,
    on_recorder: Callable[[Recorder], None] = lambda _: None,
    on_stopped: Callable[[str], None] = lambda cause: None,
    final_metadata: Callable[[], Mapping[str, Any]] = dict,
) -> Summary:
    """Record until stopped, or until the disk is full.

    Events are logged below the logger `g1stream.recorder`, and written to /log in the file.

    Args:
        path: session file; its directory must exist. A file without samples is removed.
        config: all settings; the defaults if omitted.
        force: replace an existing file.
        session: motion that a stream is about to play, for the metadata. The recorder then calls
            `on_ready` only after it is matched with the stream.
        should_stop: called several times per second; True ends the recording.
        on_ready: called when no message published from then on can be missed.
        on_recorder: called with the recorder before it runs, to display it.
        on_stopped: called with the cause if the recording ends before it is stopped.
        final_metadata: returns more metadata; called when stopped. Its `stopped` is the reason why
            the recording ended early.

    Returns:
        The recorded summary. `recorder.stopped` is the reason if it ended early, and
        `recorder.removed` is true if there was nothing to record.

    Raises:
        G1StreamError: the file, a setting or the wire is not valid.
    """
    config = config or Config()
    settings, robot = config.record, G1.of_config(config)
    info = session or SessionInfo()
    # Before the file is created, because this may raise.
    pipeline = MessagePipeline(robot, settings, info.policy)
    about, now = _metadata(config, info), time.time_ns()

    with ExitStack() as stack:
        receiver = stack.enter_context(SampleReceiver(config))
        participant = stack.enter_context(Participant(config.dds.domain, config.dds.interface))
        if not session:  # with a session, the stream publishes it
            stack.enter_context(publishing_for_ros2(config, should_stop))
        writer = SessionWriter(path, force=force)
        stack.callback(_remove_if_empty, writer)
        stack.enter_context(writer)
        writer.add_metadata(about)
        attach_run(writer, robot, config, info, now)
        for messages in pipeline.file_header(time.time_ns()):
            writer.write_batch(*messages)
        writer.flush()
        recorder = Recorder(receiver, participant, writer, pipeline)
        on_recorder(recorder)
        awaited = []
        if session:
            policy = [POLICY] if config.stream.policy else []
            awaited = [one.name for one in (COMMANDS[config.stream.via], REFERENCE, *policy)]
        report = recorder.run(should_stop, on_ready, awaited)
        if report.stopped:
            on_stopped(report.stopped)
        while session and not should_stop():  # a full disk must not end the stream
            time.sleep(_POLL_PERIOD)
        _close(writer, report, final_metadata())
    return summarise_run(config, recorder=report)


def _has_samples(writer: SessionWriter) -> bool:
    return any(n and CHANNELS[topic].dds_topic for topic, n in writer.counts.items())


def _remove_if_empty(writer: SessionWriter) -> None:
    """Remove a closed recording without samples, so that it does not block the next one."""
    if writer.exists and not _has_samples(writer):  # otherwise the path is an older recording's
        with suppress(OSError):
            writer.path.unlink()


def _close(
    writer: SessionWriter, report: RecorderSummary, final_metadata: Mapping[str, Any]
) -> None:
    """Write the final metadata and the index. On a full disk this may fail."""
    final = dict(final_metadata)
    told = final.pop("stopped", "")
    report.stopped = report.stopped or told
    try:
        recorder = report.model_dump(mode="json", exclude={"removed"})
        values = {**final, "recorder": recorder, "measured_tf": recorder["measured_tf"]}
        writer.add_metadata(values)
        writer.close()
    except RecordingError as error:
        report.stopped = report.stopped or error.cause
    report.removed = not _has_samples(writer)


def _metadata(config: Config, session: SessionInfo) -> dict[str, Any]:
    """The metadata that is written before the first sample."""
    packages = ("cyclonedds", "mcap", "numpy")
    return {
        "g1stream": __version__,
        "versions": {name: version(name) for name in packages},
        "host": socket.gethostname(),
        "domain": config.dds.domain,
        "interface": config.dds.interface,
        "session_id": uuid4().hex,
        "started_ns": time.time_ns(),
        # Log times come from this host's clock, publish times from the publisher's clock.
        "log_clock": f"CLOCK_REALTIME of {socket.gethostname()}",
        "realtime_minus_monotonic_ns": time.time_ns() - time.monotonic_ns(),
        **session.model_dump(mode="json", exclude_unset=True),
    }


def _run_child(parent: Parent) -> RecorderSummary | None:
    """Record for a stream. The startup message has the arguments of `record`."""
    config: Config = parent.startup_message.get("config") or Config()
    # If the stream has died, its guard still damps the robot.
    longer = config.stream.damp + _GUARD_DELAY if config.safety.guard else 0.0

    def should_stop() -> bool:
        parent.beat()
        if parent.signal:
            parent.failed(stopped())
        if parent.gone is not None and not parent.signal:
            return time.monotonic() >= parent.gone + longer
        return parent.done.is_set()

    def stopped() -> str:
        return f"g1stream record was ended by {parent.signal}." if parent.signal else ""

    with handled_by(ConsoleHandler(logging.WARNING, "record")):
        summary = record(
            **parent.startup_message,
            should_stop=should_stop,
            on_ready=parent.ready,
            on_recorder=lambda _: lower_priority(),  # not that of the receiver, already running
            on_stopped=parent.failed,
            final_metadata=lambda: parent.final_message or {"stopped": stopped()},
        )
    return summary.recorder


if __name__ == "__main__":
    run_child(_run_child)
