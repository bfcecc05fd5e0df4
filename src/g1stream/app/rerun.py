"""Show a session, or what is on DDS, in a Rerun viewer."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from g1stream.analysis.tracking import worst_joints
from g1stream.dds.messages import Samples
from g1stream.errors import ConfigError, WireError
from g1stream.recorder.observer import observe
from g1stream.robot.model import G1
from g1stream.session.streams import Base, LogEvent, Measured, Reference, Stream
from g1stream.view.layouts import DEFAULT_JOINTS
from g1stream.viewers.rerun_layout import APPLICATION, import_rerun, rerun_layout
from g1stream.viewers.rerun_log import RerunLog, log_session

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from numpy.typing import NDArray

    from g1stream.app.session import Session
    from g1stream.config import Config
    from g1stream.session.format import MessageBatch

__all__ = ["log_live", "show_live", "show_session"]

#: Where a viewer that is started listens.
_HOST: Final = "127.0.0.1"
#: How long a viewer that was started may take to listen, and any to answer, s.
_START, _ANSWER = 60.0, 20.0
#: Live, samples are collected for this long, s: a viewer takes few large pieces better.
_COLLECT: Final = 0.2


def show_session(session: Session, address: str | None = None) -> None:
    """Show a session in a viewer.

    Args:
        session: the session.
        address: HOST:PORT of a viewer that runs; returns when it has all of the session. If None,
            a viewer is started; returns when that is closed.

    Raises:
        ConfigError: there is no viewer at the address, none can be started, or Rerun is not
            installed.
        RecordingError: the session is damaged.
        RobotError: its URDF cannot be used.
        WireError: the viewer does not take the data.
    """
    if address is not None:
        with _connected(
            *_parse(address), rerun_layout(worst_joints(session, 6) or DEFAULT_JOINTS)
        ) as recording:
            log_session(session, recording)
        return
    with TemporaryDirectory(prefix="g1stream-") as directory:
        path = session.to_rerun(Path(directory, session.path.name).with_suffix(".rrd"))
        viewer = _start_viewer("--port", "auto", str(path))
        if viewer.wait():
            raise _cannot_start()


def show_live(
    config: Config,
    address: str | None = None,
    *,
    should_stop: Callable[[], bool] = lambda: False,
    on_ready: Callable[[], None] = lambda: None,
) -> None:
    """Show what is on DDS in a viewer, until told to stop or the viewer that was started is closed.

    It only subscribes, so it cannot disturb robot, stream and recorder.

    Args:
        config: all settings.
        address: HOST:PORT of a viewer that runs; if None, one is started, and stays at the end.
        should_stop: asked several times per second.
        on_ready: called when a viewer is there and samples are being received.

    Raises:
        ConfigError: there is no viewer at the address, none can be started, or Rerun is not
            installed.
        RecordingError: samples cannot be received any more.
        RobotError: the URDF cannot be used.
        WireError: the viewer does not take the data, or DDS cannot be set up.
    """
    robot, blueprint = G1.load(config.robot), rerun_layout(DEFAULT_JOINTS, live=True)
    viewer, showing = None, False
    if address is not None:
        host, port = _parse(address)
    else:
        host, port = _HOST, _free_port()
        viewer = _start_viewer("--port", str(port), "--expect-data-soon", new_session=True)

    def ended() -> bool:
        return should_stop() or (viewer is not None and viewer.poll() is not None)

    def ready() -> None:
        nonlocal showing
        showing = True
        on_ready()

    try:
        if viewer and not _wait_for(viewer, port, should_stop):
            return
        with _connected(host, port, blueprint) as recording:
            log_live(config, robot, recording, ended, ready)
    except WireError:
        if viewer is None or viewer.poll() is None:
            raise
        if viewer.returncode:
            raise _cannot_start() from None
    finally:
        if viewer and not showing:
            _kill(viewer)


def log_live(
    config: Config,
    robot: G1,
    recording: Any,
    should_stop: Callable[[], bool],
    on_ready: Callable[[], None] = lambda: None,
) -> None:
    """Log what is on DDS into a `rerun.RecordingStream`, until told to stop; see `show_live`."""
    log = RerunLog(recording, robot, tf_rate=config.record.tf_rate)
    raw = config.record.model_copy(update={"channels": "raw"})  # nothing more is needed
    collected: dict[str, list[MessageBatch]] = {}
    with closing(observe(config.model_copy(update={"record": raw}), should_stop)) as lists:
        next(lists)
        on_ready()
        due = time.monotonic() + _COLLECT
        for batches in lists:
            for batch in batches:
                collected.setdefault(batch.topic, []).append(batch)
            if time.monotonic() >= due:
                _log_batches(log, collected)
                collected = {}
                recording.flush(timeout_sec=_ANSWER)
                due = time.monotonic() + _COLLECT
    _log_batches(log, collected)


def _log_batches(log: RerunLog, collected: Mapping[str, list[MessageBatch]]) -> None:
    if batches := collected.get(Base.topic):
        log.add_positions(_stream(Base, batches))
    if batches := collected.get(Reference.topic):
        log.add_references(_stream(Reference, batches))
    if batches := collected.get(Measured.topic):
        log.add_states(_stream(Measured, batches))
    if batches := collected.get("/log"):
        events = [LogEvent.decode(bytes(data)) for batch in batches for data in batch.payloads]
        log.add_events(*_times(batches), events)


def _stream(kind: type[Stream], batches: list[MessageBatch]) -> Any:
    """The samples of some batches as a stream."""
    samples = Samples(kind.source, [bytes(data) for batch in batches for data in batch.payloads])
    paths = kind.wire_fields()

    def load(names: list[str]) -> dict[str, NDArray[Any]]:
        columns = {name: samples[paths[name]] for name in names}
        return {n: c.astype(float) if c.dtype.kind == "f" else c for n, c in columns.items()}

    published, logged = _times(batches)
    return kind(load, publish_time=published, log_time=logged)


def _times(batches: list[MessageBatch]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Publish and log times."""
    return (
        np.concatenate([batch.publish_times for batch in batches]),
        np.concatenate([batch.log_times for batch in batches]),
    )


@contextmanager
def _connected(host: str, port: int, blueprint: Any) -> Iterator[Any]:
    """Yield a recording that the viewer at an address shows."""
    if not _listens(host, port):
        raise ConfigError(
            f"No Rerun viewer listens at {host}:{port}.",
            "Start one there with `rerun`, or leave --connect out to have one started here.",
        )
    recording = import_rerun().RecordingStream(APPLICATION)
    try:
        recording.connect_grpc(f"rerun+http://{host}:{port}/proxy", default_blueprint=blueprint)
        recording.flush(timeout_sec=_ANSWER)  # what is sent to nobody would wait without end
        yield recording
        recording.flush(timeout_sec=_ANSWER)
    except RuntimeError as error:
        raise WireError(
            f"The Rerun viewer at {host}:{port} does not take the data: {error}.",
            "Start it again, or save a session with --out FILE.rrd and open that.",
        ) from error
    finally:
        recording.disconnect()


def _parse(address: str) -> tuple[str, int]:
    """Host and port of HOST:PORT, or of the URL that a viewer prints."""
    text = address.removeprefix("rerun+http://").removesuffix("/proxy")
    host, _, port = text.rpartition(":")
    if not (host and port.isascii() and port.isdigit() and 0 < int(port) < 2**16):
        raise ConfigError(
            f"{address} is not the address of a Rerun viewer.",
            f"Give host and port, such as {_HOST}:9876.",
        )
    return host, int(port)


def _listens(host: str, port: int) -> bool:
    try:
        socket.create_connection((host, port), timeout=2.0).close()
    except OSError:
        return False
    return True


def _free_port() -> int:
    with socket.create_server((_HOST, 0)) as server:
        port: int = server.getsockname()[1]
        return port


def _start_viewer(*arguments: str, new_session: bool = False) -> subprocess.Popen[bytes]:
    """Start a viewer that listens on loopback only, unlike one of `rerun.spawn`.

    Args:
        arguments: more of them.
        new_session: Ctrl-C in this terminal does not end it.
    """
    import_rerun()
    if sys.platform == "linux" and not {"DISPLAY", "WAYLAND_DISPLAY"} & os.environ.keys():
        raise _cannot_start()
    return subprocess.Popen(
        [sys.executable, "-m", "rerun_cli", "--bind", _HOST, "--hide-welcome-screen", *arguments],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=new_session,
    )


def _wait_for(viewer: subprocess.Popen[bytes], port: int, should_stop: Callable[[], bool]) -> bool:
    """Wait until a viewer that was started listens; False if told to stop before."""
    end = time.monotonic() + _START
    while not _listens(_HOST, port):
        if should_stop():
            return False
        if viewer.poll() is not None or time.monotonic() >= end:
            raise _cannot_start()
        time.sleep(0.1)
    return True


def _kill(viewer: subprocess.Popen[bytes]) -> None:
    """Kill a viewer in a session of its own, with the process that its launcher has started."""
    with suppress(ProcessLookupError):
        os.killpg(viewer.pid, signal.SIGKILL)
    viewer.wait()


def _cannot_start() -> ConfigError:
    return ConfigError(
        "A Rerun viewer cannot be started here, or has failed.",
        "It needs a display, and Vulkan or OpenGL: `rerun` says what is missing. Save a session "
        "with --out FILE.rrd to look at it elsewhere, or in a browser: `rerun --web-viewer FILE`.",
    )
