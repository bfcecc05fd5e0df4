"""Everything on one machine: our bridge, a motion played on it, a recording, and a figure."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Final

from g1stream.config import Config
from g1stream.dds.domain import DISCOVERY, Participant, is_local_only, is_loopback
from g1stream.dds.topics import LOWSTATE
from g1stream.errors import ConfigError, RecordingError, WireError
from g1stream.programs.child_process import Child
from g1stream.programs.stream import stream

if TYPE_CHECKING:
    from collections.abc import Callable

    from g1stream.control.loop import StreamLoop
    from g1stream.motion.motion import Motion
    from g1stream.session.summary import Summary

__all__ = ["FIGURE", "demo"]

FIGURE: Final = "tracking.png"
"""Name of the figure in the output directory."""


def demo(
    motion: Motion | str | Path,
    out: Path,
    config: Config | None = None,
    *,
    force: bool = False,
    on_loop: Callable[[StreamLoop], None] | None = None,
) -> Summary:
    """Play a motion on our own bridge and record it, all on this machine.

    Returns the summary of the session; where no command was sent, what the stream counted.

    Args:
        motion: a motion, a motion file, or the name of a bundled motion.
        out: directory for session.mcap and tracking.png, the figure of `Session.plot`; made where
            it is missing.
        config: all settings; the defaults if left out.
        force: replace files that are there already.
        on_loop: is given the loop before it runs.

    Raises:
        ConfigError: the domain is not this machine's alone.
        RecordingError: a file is there already and `force` is off, or none can be made there.
        G1StreamError: another setting or the wire does not allow it.
    """
    from g1stream.analysis.plots import draw
    from g1stream.session.session import open_session

    config = config or Config()
    _check_local_only(config.dds.interface)
    session_path, figure_path = out / "session.mcap", out / FIGURE
    if not force:
        named_anew = config.record.auto_name  # with the time in it
        _check_absent(*([] if named_anew else [session_path]), figure_path)
    _make_directory(out)
    _check_no_other_publisher(config)
    sim = Child("sim", config)
    try:
        sim.wait_until_ready()
        played = stream(motion, config, record=session_path, force=force, on_loop=on_loop)
        sim.finish()
    finally:
        sim.kill()
    recorder = played.recorder
    if not (played.stream and played.stream.commands and recorder):
        return played
    session = open_session(recorder.path)  # it may have the time in its name
    draw(session, figure_path)
    return session.summary()


def _check_local_only(interface: str) -> None:
    if is_local_only(interface):
        return
    what = "CYCLONEDDS_URI is set, which could lead elsewhere"
    if not is_loopback(interface):
        what = f"the interface {interface} is not the loopback"
    raise ConfigError(
        f"A demo is local to this machine, but {what}.",
        "Leave that out; to play on a robot use `g1stream stream`.",
    )


def _check_absent(*paths: Path) -> None:
    for path in paths:
        if path.exists():
            raise RecordingError(
                f"The file {path} exists already.",
                "Give --force to replace it, or choose another --out.",
            )


def _make_directory(out: Path) -> None:
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RecordingError(
            f"The directory {out} cannot be created: {error.strerror}.", "Choose another --out."
        ) from error


def _check_no_other_publisher(config: Config) -> None:
    with Participant(config.dds.domain, config.dds.interface) as participant:
        time.sleep(DISCOVERY)
        others = participant.writers(LOWSTATE.name)
    if others:
        raise WireError(
            f"Another publisher on {LOWSTATE.name} in domain {config.dds.domain}: "
            f"{', '.join(map(str, others))}.",
            f"End it, or choose a free domain, such as --domain {config.dds.domain + 1}.",
        )
