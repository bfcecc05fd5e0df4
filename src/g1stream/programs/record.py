"""Record what is on the wire into a session file."""

from __future__ import annotations

import socket
import time
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from g1stream._version import __version__
from g1stream.config import Config
from g1stream.dds.domain import Participant
from g1stream.dds.topics import LOWCMD, REFERENCE
from g1stream.recording.recorder import Recorder
from g1stream.recording.writer import SessionWriter
from g1stream.robot.model import G1

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from g1stream.recording.recorder import RecorderReport

__all__ = ["record"]

_MATCH_TIMEOUT = 10.0
_LARGE = 16 * 2**20


def record(
    path: str | Path,
    config: Config | None = None,
    *,
    force: bool = False,
    session: Mapping[str, Any] | None = None,
    should_stop: Callable[[], bool] = lambda: False,
    on_ready: Callable[[], None] = lambda: None,
    last_words: Callable[[], Mapping[str, Any]] = dict,
) -> RecorderReport:
    """Record until told to stop.

    Args:
        path: the session file; its directory must exist.
        config: all settings; the defaults if left out.
        force: replace a file that is there already.
        session: what the streamer says of the session: motion, gains. Then the recorder waits until
            it is matched with the streamer before it calls `on_ready`.
        should_stop: asked a few times a second.
        on_ready: called when nothing that is published from then on can be missed.
        last_words: more metadata, asked for at the end.

    Raises:
        G1StreamError: the file, a setting or the wire does not allow it.
    """
    config = config or Config()
    robot = G1.load(config.robot)
    with (
        Participant(config.dds.domain, config.dds.interface) as participant,
        SessionWriter(path, force=force) as writer,
    ):
        recorder = Recorder(participant, writer, robot, config.record)
        writer.add_metadata(_preface(config, session or {}))
        _attach(writer, robot, config, session or {})
        if session:
            _wait_for_streamer(recorder)
        on_ready()
        report = recorder.run(should_stop)
        writer.add_metadata({**last_words(), "recorder": report.as_dict()})
    return report


def _wait_for_streamer(recorder: Recorder) -> None:
    end = time.monotonic() + _MATCH_TIMEOUT
    while time.monotonic() < end:
        matched = recorder.matched()
        if matched[LOWCMD.name] and matched[REFERENCE.name]:
            return
        time.sleep(0.01)


def _preface(config: Config, session: Mapping[str, Any]) -> dict[str, Any]:
    """What is known before the first sample, for the file's metadata record."""
    packages = ("cyclonedds", "mcap", "numpy")
    return {
        "g1stream": __version__,
        "versions": {name: version(name) for name in packages},
        "host": socket.gethostname(),
        "domain": config.dds.domain,
        "interface": config.dds.interface,
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
    source = (session.get("motion") or {}).get("source")
    if source and Path(source).is_file() and Path(source).stat().st_size <= _LARGE:
        writer.attach(Path(source).name, "text/csv", Path(source).read_bytes(), now)
