"""The recorder beside a stream: a child process, and what becomes of its file."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from g1stream.container.output import create
from g1stream.programs.children import Child, ChildError
from g1stream.recording.earlier_parts import make_way
from g1stream.recording.file_names import part_path, timestamped

if TYPE_CHECKING:
    from collections.abc import Collection

    from g1stream.config import Config, RecordConfig
    from g1stream.control.gains import Gains
    from g1stream.motion.motion import Motion

__all__ = ["discard_if_empty", "files_beside", "finish_recorder", "refuse_path", "start_recorder"]

#: What is in a file of which nothing was received: what the recorder and the loop say themselves.
_OUR_OWN_WORDS: Final = frozenset({"/log", "/scene", "/robot_description"})


def refuse_path(path: Path, settings: RecordConfig, force: bool) -> None:
    """Refuse a path at which no recording can be made, by making a file there and removing it.

    What is there already is left as it is.

    Raises:
        RecordingError: there is a file already and `force` is off, or none can be made there.
    """
    if settings.auto_name:
        path = timestamped(path, time.time_ns())
    if settings.split_size is not None or settings.split_duration is not None:
        if not force:
            make_way(path, force=False)
        path = part_path(path, 1)
    if force and path.is_file():
        return
    create(path, force=False).close()
    path.unlink()


def files_beside(path: Path) -> set[Path]:
    """What is in the directory of a recording."""
    return set(path.parent.iterdir())


def start_recorder(path: Path, force: bool, config: Config, motion: Motion, gains: Gains) -> Child:
    """Start a recorder, and wait until it misses nothing that is published from then on.

    Raises:
        ChildError: it cannot record.
    """
    greeting = {
        "config": config.model_dump(mode="json"),
        "gains": {name: values.tolist() for name, values in gains._asdict().items()},
        "motion": {
            "name": motion.name,
            "fps": motion.fps,
            "frames": motion.n_frames,
            "sha256": motion.sha256,
            "source": str(motion.source) if motion.source else None,
        },
    }
    recorder = Child(["record", str(path), *(["--force"] if force else [])], greeting)
    try:
        recorder.wait_for("ready", timeout=20.0)
    except BaseException:
        recorder.kill()
        raise
    return recorder


def finish_recorder(recorder: Child, path: Path) -> dict[str, Any]:
    """The recorder's summary; where it died, that it did, as how the motion went still counts."""
    try:
        return recorder.finish()
    except ChildError as error:
        return {
            "path": str(path),
            "paths": [str(path)],
            "stopped": error.cause,
            "missing": {},
            "malformed": {},
            "dropped_datagrams": 0,
        }


def discard_if_empty(recording: dict[str, Any], earlier: Collection[Path]) -> bool:
    """Remove the files of a recording that received nothing, lest the next one be refused.

    Args:
        recording: the recorder's summary.
        earlier: what was beside them before; of that, nothing is removed.

    Returns:
        Whether they were removed.
    """
    received = recording.get("counts", {"unknown": 1}).keys() - _OUR_OWN_WORDS
    files = [Path(path) for path in recording["paths"]]
    if received or any(file in earlier for file in files):
        return False
    for file in files:
        file.unlink(missing_ok=True)
    return True
