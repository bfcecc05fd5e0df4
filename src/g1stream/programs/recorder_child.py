"""The recorder beside a stream: a child process, and what becomes of its file."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from g1stream.files import timestamped
from g1stream.programs.child_process import Child, ChildError
from g1stream.session.parts import check_recording_path, remove_recording

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from g1stream.config import Config, RecordConfig
    from g1stream.control.gains import Gains
    from g1stream.motion.motion import Motion

__all__ = ["RecorderChild", "discard_if_empty", "refuse_path"]

#: What is in a file of which nothing was received: what the recorder and the loop say themselves.
_OUR_OWN_WORDS: Final = frozenset({"/log", "/scene", "/robot_description"})


def refuse_path(path: Path, settings: RecordConfig, force: bool) -> None:
    """Refuse a path at which no recording can be made; what is there is left as it is.

    Raises:
        RecordingError: there is a file already and `force` is off, or none can be made there.
    """
    if settings.auto_name:
        path = timestamped(path, time.time_ns())
    split = settings.split_size is not None or settings.split_duration is not None
    check_recording_path(path, split=split, force=force)


class RecorderChild:
    """A recorder that runs beside a stream, and misses nothing that is published from now on.

    Args:
        path: the session file.
        force: replace a file that is there already.
        config: all settings.
        motion, gains: what is played, for the file's metadata.

    Raises:
        ChildError: it cannot record.
    """

    def __init__(
        self, path: Path, force: bool, config: Config, motion: Motion, gains: Gains
    ) -> None:
        self._path = path
        self._earlier = _beside(path)
        session = {
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
        arguments = {"path": path, "config": config, "force": force, "session": session}
        self._child = Child("record", arguments)
        try:
            self._child.wait_until_ready()
        except BaseException:
            self._child.kill()
            raise

    def finish(self, final_metadata: Mapping[str, Any], *, heard: bool) -> dict[str, Any]:
        """End it, and return its summary; where it died, that it did.

        How the motion went counts all the same.

        Args:
            final_metadata: goes into the file's metadata.
            heard: whether anybody was there to play to. If nobody was, a file in which there is
                nothing is removed, lest the next recording be refused; `removed` says so.
        """
        try:
            recording = self._child.finish(final_metadata)
        except ChildError as error:
            recording = {
                "path": str(self._path),
                "paths": [str(self._path)],
                "stopped": error.cause,
                "missing": {},
                "malformed": {},
                "dropped_datagrams": 0,
            }
        return {**recording, "removed": not heard and discard_if_empty(recording, self._earlier)}


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
    if received or any(file in earlier or file.parent in earlier for file in files):
        return False
    try:
        remove_recording(files)
    except OSError:  # how the run went is told all the same
        return False
    return True


def _beside(path: Path) -> set[Path]:
    """The files in a directory, as far as one may look."""
    try:
        return set(path.parent.iterdir())
    except OSError:
        return {path}
