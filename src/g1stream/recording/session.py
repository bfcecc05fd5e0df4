"""A session file as numpy arrays."""

from __future__ import annotations

from collections import defaultdict
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeVar

import numpy as np
from foxglove_schemas_protobuf.Log_pb2 import Log

from g1stream.errors import RecordingError
from g1stream.recording.metadata import METADATA_NAME, metadata_from_strings
from g1stream.recording.reader import McapFile
from g1stream.recording.samples import Samples
from g1stream.recording.streams import Base, Command, Measured, Reference, Stream

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from g1stream.recording.reader import Messages

__all__ = ["Base", "Command", "LogEvent", "Measured", "Reference", "Session", "open_session"]


class LogEvent(NamedTuple):
    """One event of a session.

    Attributes:
        time: when it happened, ns since the epoch.
        level: DEBUG, INFO, WARNING, ERROR or FATAL.
        name: the program that told it.
        text: what happened.
    """

    time: int
    level: str
    name: str
    text: str


_STREAMS: Final[dict[str, type[Stream]]] = {
    kind.topic: kind for kind in (Reference, Command, Measured, Base)
}
_ESSENTIAL: Final = (Reference.topic, Command.topic, Measured.topic)

StreamT = TypeVar("StreamT", bound=Stream)


def open_session(path: str | Path) -> Session:
    """Open a session file, also one whose recorder was killed.

    Raises:
        RecordingError: there is no such file, or it is no session, or it is damaged.
    """
    return Session(path)


class Session:
    """A session file. Arrays are read at first use, all in one pass.

    Attributes:
        path: of the file.
        complete: whether it was closed properly; otherwise it ends with its last whole chunk.
        topics: number of messages by topic.
        metadata: what the recorder noted about the session.
    """

    def __init__(self, path: str | Path) -> None:
        self._file = McapFile(path)
        self.path = self._file.path
        self.complete = self._file.complete
        self.topics: dict[str, int] = dict(self._file.counts)
        self.metadata: dict[str, Any] = {}
        for record in self._file.metadata:
            if record.name == METADATA_NAME:
                self.metadata |= metadata_from_strings(record.metadata)
        if not any(self.topics.get(topic) for topic in _ESSENTIAL):
            raise RecordingError(
                f"{self.path} is not a session of g1stream: it has no messages on "
                f"{', '.join(_ESSENTIAL[:-1])} or {_ESSENTIAL[-1]}, {self._what_there_is()}.",
                "Give a file that `g1stream record` or `g1stream stream --record` made.",
            )

    @cached_property
    def attachments(self) -> dict[str, bytes]:
        """The attached files by name."""
        return {attachment.name: attachment.data for attachment in self._file.attachments()}

    @cached_property
    def reference(self) -> Reference:
        """What the motion asked for.

        Raises:
            RecordingError: nobody published it in this session, or the file is damaged.
        """
        return self._stream(Reference)

    @cached_property
    def command(self) -> Command:
        """What the motors were told.

        Raises:
            RecordingError: nobody commanded in this session, or the file is damaged.
        """
        return self._stream(Command)

    @cached_property
    def measured(self) -> Measured:
        """What the robot reported.

        Raises:
            RecordingError: no robot was there in this session, or the file is damaged.
        """
        return self._stream(Measured)

    @cached_property
    def base(self) -> Base | None:
        """Where the pelvis was; None where nobody knew, as on a real robot."""
        return self._stream(Base) if Base.topic in self._columns else None

    @cached_property
    def log(self) -> list[LogEvent]:
        """The events of the session, in the order of the file."""
        return [
            _log_event(data) for _, batch in self._file.batches({"/log"}) for data in batch.data
        ]

    @cached_property
    def _columns(self) -> dict[str, dict[str, NDArray[Any]]]:
        """By topic and attribute, the samples of the wire as arrays; read in one pass."""
        parts: dict[str, dict[str, list[NDArray[Any]]]] = defaultdict(lambda: defaultdict(list))
        for topic, batch in self._file.batches(set(_STREAMS)):
            for attribute, values in self._decode(topic, batch).items():
                parts[topic][attribute].append(values)
        return {
            topic: {attribute: _joined(values) for attribute, values in columns.items()}
            for topic, columns in parts.items()
        }

    def _decode(self, topic: str, batch: Messages) -> dict[str, NDArray[Any]]:
        kind = _STREAMS[topic]
        try:
            samples = Samples(kind.source, batch.data)
        except ValueError as error:
            raise RecordingError(
                f"{self.path} does not fit this version of g1stream: on {topic} {error}.",
                "Read it with the version that recorded it.",
            ) from error
        return {
            "log_time": np.array(batch.log_times, dtype=np.int64),
            "publish_time": np.array(batch.publish_times, dtype=np.int64),
            **{attribute: samples[path] for attribute, path in kind.wire_fields().items()},
        }

    def _stream(self, kind: type[StreamT]) -> StreamT:
        if kind.topic not in self._columns:
            raise RecordingError(
                f"{self.path} has no messages on {kind.topic}, {self._what_there_is()}.",
                "Record while its producer runs.",
            )
        return kind(**self._columns[kind.topic])

    def _what_there_is(self) -> str:
        if not self.topics:
            return "nor on any other topic"
        return "only on " + ", ".join(sorted(self.topics))


def _joined(parts: list[NDArray[Any]]) -> NDArray[Any]:
    values = np.concatenate(parts)
    if values.dtype.kind == "f":
        values = values.astype(np.float64, copy=False)
    values.setflags(write=False)
    return values


def _log_event(data: bytes) -> LogEvent:
    message = Log.FromString(data)
    return LogEvent(
        message.timestamp.ToNanoseconds(),
        Log.Level.Name(message.level),
        message.name,
        message.message,
    )
