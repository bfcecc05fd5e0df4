"""Record what is on the wire into a session file."""

from __future__ import annotations

import socket
import time
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any
from uuid import uuid4

from g1stream._version import __version__
from g1stream.analysis.summary import summarise_run
from g1stream.config import Config
from g1stream.dds.domain import Participant
from g1stream.dds.topics import LOWCMD, REFERENCE
from g1stream.errors import RecordingError, WireError
from g1stream.events import console_handler, handled_by
from g1stream.files import timestamped
from g1stream.foxglove.pipeline import MessagePipeline
from g1stream.programs.child_process import run_child
from g1stream.realtime import lower_priority
from g1stream.recorder.recorder import Recorder
from g1stream.robot.model import G1
from g1stream.session.metadata import attach_motion
from g1stream.session.writer import SessionWriter, SplitLimits

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from g1stream.config import RecordConfig
    from g1stream.programs.child_process import Parent
    from g1stream.session.summary import RecorderSummary, Summary

__all__ = ["record"]

_MATCH_TIMEOUT = 10.0
_LOOK_EVERY = 0.05


def record(
    path: str | Path,
    config: Config | None = None,
    *,
    force: bool = False,
    session: Mapping[str, Any] | None = None,
    should_stop: Callable[[], bool] = lambda: False,
    on_ready: Callable[[], None] = lambda: None,
    final_metadata: Callable[[], Mapping[str, Any]] = dict,
) -> Summary:
    """Record until told to stop, or until the disk is full.

    What happens meanwhile is logged, below `g1stream.recorder`, and written into /log of the file.

    Args:
        path: the session file; its directory must exist.
        config: all settings; the defaults if left out.
        force: replace a file that is there already.
        session: what the streamer says of the session: motion, gains. Then the recorder waits until
            it is matched with the streamer before it calls `on_ready`.
        should_stop: asked a few times a second.
        on_ready: called when nothing that is published from then on can be missed.
        final_metadata: more metadata, asked for when told to stop.

    Returns:
        What the recording holds; `recorder.stopped` says why it ended early, if it did.

    Raises:
        G1StreamError: the file, a setting or the wire does not allow it.
    """
    config = config or Config()
    settings = config.record
    robot = G1.load(config.robot)
    path = timestamped(Path(path), time.time_ns()) if settings.auto_name else Path(path)
    pipeline = MessagePipeline(robot, settings.tf_rate)  # before there is a file: may refuse
    about = _about(config, session or {})

    def write_file_header(writer: SessionWriter) -> None:
        writer.add_metadata(about)
        _attach(writer, robot, config, session or {})
        for messages in pipeline.file_header(time.time_ns()):
            writer.write_batch(*messages)

    with (
        Participant(config.dds.domain, config.dds.interface) as participant,
        SessionWriter(
            path, force=force, limits=_limits(settings), file_header=write_file_header
        ) as writer,
    ):
        recorder = Recorder(participant, writer, pipeline, settings.batch)

        def on_started() -> None:
            if not session or _wait_for_streamer(recorder, should_stop):
                on_ready()

        report = recorder.run(should_stop, on_started=on_started)
        if session:
            # A full disk does not end the stream; its summary is still to come.
            _wait_until(should_stop)
        _close(writer, report, final_metadata())
    return summarise_run(config, recorder=report)


def _limits(settings: RecordConfig) -> SplitLimits:
    size, duration = settings.split_size, settings.split_duration
    return SplitLimits(
        None if size is None else round(size * 1e6),
        None if duration is None else round(duration * 1e9),
    )


def _wait_until(should_stop: Callable[[], bool]) -> None:
    while not should_stop():
        time.sleep(_LOOK_EVERY)


def _close(
    writer: SessionWriter, report: RecorderSummary, final_metadata: Mapping[str, Any]
) -> None:
    """Write the last metadata and the index; a disk that is full may not have room for them."""
    try:
        recorder = report.model_dump(mode="json", exclude={"removed"})
        values = {**final_metadata, "recorder": recorder, "measured_tf": recorder["measured_tf"]}
        writer.add_metadata(values)
        writer.close()
    except RecordingError as error:
        report.stopped = report.stopped or error.cause


def _wait_for_streamer(recorder: Recorder, should_stop: Callable[[], bool]) -> bool:
    """Wait until the streamer's writers are matched; False where told to stop before."""
    end = time.monotonic() + _MATCH_TIMEOUT
    while not should_stop():
        matched = recorder.matched()
        absent = [topic.name for topic in (LOWCMD, REFERENCE) if not matched[topic.name]]
        if not absent:
            return True
        if time.monotonic() >= end:
            raise WireError(
                f"No publisher of {' or '.join(absent)} was found within {_MATCH_TIMEOUT:g} s.",
                "Check with `g1stream doctor` that the recorder and the stream see each other on "
                "this domain and interface.",
            )
        time.sleep(0.01)
    return False


def _about(config: Config, session: Mapping[str, Any]) -> dict[str, Any]:
    """What is known before the first sample, for the file's metadata record."""
    packages = ("cyclonedds", "mcap", "numpy")
    return {
        "g1stream": __version__,
        "versions": {name: version(name) for name in packages},
        "host": socket.gethostname(),
        "domain": config.dds.domain,
        "interface": config.dds.interface,
        "session_id": uuid4().hex,
        "started_ns": time.time_ns(),
        # Log times come from this host's clock; publish times from that of whoever published.
        "log_clock": f"CLOCK_REALTIME of {socket.gethostname()}",
        "realtime_minus_monotonic_ns": time.time_ns() - time.monotonic_ns(),
        **session,
    }


def _attach(writer: SessionWriter, robot: G1, config: Config, session: Mapping[str, Any]) -> None:
    now = time.time_ns()
    writer.attach("robot.urdf", "application/xml", robot.urdf.encode(), now)
    writer.attach("config.json", "application/json", config.model_dump_json().encode(), now)
    motion = session.get("motion")
    source = motion.get("source") if isinstance(motion, dict) else None
    attach_motion(writer, Path(source) if isinstance(source, str) else None, now)


def _run_child(parent: Parent) -> RecorderSummary | None:
    """Record for a stream: the startup message has arguments of `record`."""
    lower_priority()
    with handled_by(console_handler("record")):
        summary = record(
            **parent.startup_message,
            should_stop=parent.done.is_set,
            on_ready=parent.ready,
            final_metadata=lambda: parent.final_message or {},
        )
    return summary.recorder


if __name__ == "__main__":
    run_child(_run_child)
