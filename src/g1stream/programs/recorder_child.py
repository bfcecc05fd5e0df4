"""The recorder beside a stream: a child process, and what becomes of its file."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Final

from g1stream.files import timestamped
from g1stream.programs.child_process import Child, ChildError
from g1stream.session.parts import check_recording_path, remove_recording
from g1stream.session.summary import MotionInfo, RecorderSummary

if TYPE_CHECKING:
    from collections.abc import Collection

    from g1stream.config import Config, RecordConfig
    from g1stream.control.gains import Gains
    from g1stream.motion.motion import Motion
    from g1stream.session.summary import StreamSummary

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
            "motion": MotionInfo.of(motion).model_dump(mode="json"),
        }
        arguments = {"path": path, "config": config, "force": force, "session": session}
        self._child = Child("record", arguments)
        try:
            self._child.wait_until_ready()
        except BaseException:
            self._child.kill()
            raise

    def finish(self, stream: StreamSummary, *, heard: bool) -> RecorderSummary:
        """End it, and return its summary; where it died, only why.

        Args:
            stream: goes into the file's metadata.
            heard: whether a robot or subscriber was there. If not, a file that holds nothing is
                removed, so that the next recording is not refused; `removed` says so.
        """
        recording: RecorderSummary
        try:
            recording = self._child.finish({"stream": stream.model_dump(mode="json")})
        except ChildError as error:
            path = str(self._path)
            recording = RecorderSummary(path=path, paths=[path], stopped=error.cause)
        recording.removed = not heard and discard_if_empty(recording, self._earlier)
        return recording


def discard_if_empty(recording: RecorderSummary, earlier: Collection[Path]) -> bool:
    """Remove the files of a recording that received nothing, so that the next is not refused.

    Args:
        recording: the recorder's summary.
        earlier: what was beside them before; of that, nothing is removed.

    Returns:
        Whether they were removed.
    """
    unknown = not recording.counts
    received = recording.counts.keys() - _OUR_OWN_WORDS
    files = [Path(path) for path in recording.paths]
    if unknown or received or any(f in earlier or f.parent in earlier for f in files):
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
