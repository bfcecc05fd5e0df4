"""A session file, or the parts of one, as numpy arrays."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeVar

import numpy as np

from g1stream.errors import RecordingError
from g1stream.session.events import LogEvent, log_event
from g1stream.session.parts import SessionFiles
from g1stream.session.samples import Samples
from g1stream.session.streams import Base, Command, Measured, Reference, Stream, TorsoImu

if TYPE_CHECKING:
    import os
    from collections.abc import Callable, Iterator, Mapping

    import pandas
    from numpy.typing import NDArray

    from g1stream.motion.motion import Motion
    from g1stream.session.source import Messages, SessionSource

__all__ = [
    "STREAMS",
    "Base",
    "Command",
    "LogEvent",
    "Measured",
    "Message",
    "Reference",
    "Session",
    "Stream",
    "TorsoImu",
    "open_session",
]

STREAMS: Final[dict[str, type[Stream]]] = {
    kind.topic: kind for kind in (Reference, Command, Measured, Base, TorsoImu)
}
"""By topic, the samples of the wire that can be had as arrays."""

_ESSENTIAL: Final = (Reference.topic, Command.topic, Measured.topic)

StreamT = TypeVar("StreamT", bound=Stream)


class Message(NamedTuple):
    """One message as it is in the file.

    Attributes:
        log_time: when the recorder received it, ns since the epoch.
        publish_time: when its producer published it, ns since the epoch.
        data: its bytes; of a topic of the wire exactly those that were on it, CDR header included.
    """

    log_time: int
    publish_time: int
    data: bytes


def open_session(path: str | os.PathLike[str]) -> Session:
    """Open a session file, also one whose recorder was killed.

    Args:
        path: of the file, of one of the parts it was split into, or what those are called after.

    Raises:
        RecordingError: there is no such file, or it is no session, or it is damaged.
    """
    return Session(SessionFiles(Path(path)))


class Session:
    """A session file, or several that are the parts of one.

    The samples of a topic are read when they are first asked for, and kept.

    Args:
        source: what it is read from; `open_session` gives the files on disk.

    Attributes:
        path: of the file or directory; of a session in memory only a name.
        paths: of the file or its parts, oldest first; empty in memory.
        absent_parts: numbers of parts that should be there and are not or cannot be read.
        unreadable_parts: of the latter, the reason, a sentence, by number.
        complete: whether everything is there and was closed properly.
        topics: number of messages by topic.
        metadata: what the recorder noted about the session.
    """

    def __init__(self, source: SessionSource) -> None:
        self._source = source
        self.path = source.path
        self.paths = source.paths
        self.absent_parts = source.absent_parts
        self.unreadable_parts = source.unreadable_parts
        self.complete = source.complete
        self.topics = source.topics
        self.metadata = source.metadata
        self._streams: dict[type[Stream], Any] = {}
        if not any(self.topics.get(topic) for topic in _ESSENTIAL):
            raise self._without_essentials()

    def __repr__(self) -> str:
        counts = ", ".join(f"{topic} {n}" for topic, n in self.topics.items() if n)
        whole = "" if self.complete else ", not closed by its recorder"
        return f"<Session {str(self.path)!r}: {counts}{whole}>"

    @cached_property
    def attachments(self) -> dict[str, bytes]:
        """The attached files by name."""
        return self._source.attachments()

    @property
    def reference(self) -> Reference:
        """What the motion asked for.

        Raises:
            RecordingError: nobody published it in this session, or the file is damaged.
        """
        return self.stream(Reference)

    @property
    def command(self) -> Command:
        """What the motors were told.

        Raises:
            RecordingError: nobody commanded in this session, or the file is damaged.
        """
        return self.stream(Command)

    @property
    def measured(self) -> Measured:
        """What the robot reported.

        Raises:
            RecordingError: no robot was there in this session, or the file is damaged.
        """
        return self.stream(Measured)

    @property
    def base(self) -> Base | None:
        """Where the pelvis was; None where nobody knew, as on a real robot."""
        return self.stream(Base) if self.topics.get(Base.topic) else None

    @property
    def torso_imu(self) -> TorsoImu | None:
        """What the IMU in the torso reported; None where nobody published it."""
        return self.stream(TorsoImu) if self.topics.get(TorsoImu.topic) else None

    @cached_property
    def log(self) -> list[LogEvent]:
        """The events of the session, in the order of the file."""
        return [
            log_event(data) for _, batch in self._source.batches({"/log"}) for data in batch.data
        ]

    @cached_property
    def times(self) -> dict[str, Stream]:
        """By topic, only the times of its messages; of all topics, so it takes a while to read.

        Raises:
            RecordingError: the file is damaged.
        """
        columns = self._columns({topic: lambda _: {} for topic, n in self.topics.items() if n})
        return {topic: Stream(**columns[topic]) for topic in sorted(columns)}

    def messages(self, topic: str) -> Iterator[Message]:
        """The messages of any topic, one after the other, in the order of the file.

        Raises:
            RecordingError: the topic is not in this session, or the file is damaged.
        """
        self._require(topic)
        for _, batch in self._source.batches({topic}):
            times = batch.log_times.tolist(), batch.publish_times.tolist()
            yield from map(Message, *times, batch.data)

    def replay_bytes(self, topic: str = Command.topic) -> Iterator[bytes]:
        """The samples of a topic of the wire, bit for bit as they were on it, in their order.

        Raises:
            RecordingError: the topic is not in this session, or the file is damaged.
        """
        return (message.data for message in self.messages(topic))

    def motion(self, fps: float | None = None) -> Motion:
        """The motion that was played, as the reference has it.

        Args:
            fps: frames a second; the rate of the reference if None.

        Raises:
            RecordingError: no motion was played in this session, or the file is damaged.
            MotionError: `fps` is not a frame rate, or leaves less than two frames.
        """
        from g1stream.session.session_to_motion import played_motion

        return played_motion(self.reference, self.path, fps)

    def to_pandas(self, topic: str) -> pandas.DataFrame:
        """The samples of a topic as a table; see `g1stream.session.export.to_pandas`."""
        from g1stream.session.export import to_pandas

        return to_pandas(self, topic)

    def to_parquet(self, directory: str | Path) -> list[Path]:
        """Every topic as a Parquet file; see `g1stream.session.export.to_parquet`."""
        from g1stream.session.export import to_parquet

        return to_parquet(self, Path(directory))

    def stream(self, kind: type[StreamT]) -> StreamT:
        """The samples of a topic of the wire as arrays; kept once they are read.

        Args:
            kind: one of `STREAMS`.

        Raises:
            RecordingError: the topic is not in this session, or the file is damaged.
        """
        if kind not in self._streams:
            self._streams[kind] = self._read(kind)
        stream: StreamT = self._streams[kind]
        return stream

    def _read(self, kind: type[StreamT]) -> StreamT:
        def decode(messages: Messages) -> dict[str, NDArray[Any]]:
            try:
                samples = Samples(kind.source, messages.data)
            except ValueError as error:
                raise RecordingError(
                    f"{self.path} does not fit this version of g1stream: on {kind.topic} {error}.",
                    "Read it with the version that recorded it.",
                ) from error
            return {attribute: samples[path] for attribute, path in kind.wire_fields().items()}

        self._require(kind.topic)
        return kind(**self._columns({kind.topic: decode})[kind.topic])

    def _columns(
        self, decoders: Mapping[str, Callable[[Messages], dict[str, NDArray[Any]]]]
    ) -> dict[str, dict[str, NDArray[Any]]]:
        """By topic and attribute, what all messages of some topics have; read in one pass."""
        parts: dict[str, dict[str, list[NDArray[Any]]]] = {topic: {} for topic in decoders}
        for topic, messages in self._source.batches(set(decoders)):
            times = {"log_time": messages.log_times, "publish_time": messages.publish_times}
            for attribute, values in (times | decoders[topic](messages)).items():
                parts[topic].setdefault(attribute, []).append(values)
        for topic, columns in parts.items():
            found = sum(map(len, columns.get("log_time", ())))
            if found != self.topics[topic]:
                raise RecordingError(
                    f"{self.path} is damaged: of {self.topics[topic]} messages on {topic} it has "
                    f"{found}.",
                    "Save the rest of it with a tool such as `mcap recover`.",
                )
        return {
            topic: {attribute: _joined(columns.pop(attribute)) for attribute in list(columns)}
            for topic, columns in parts.items()
        }

    def _require(self, topic: str) -> None:
        if not self.topics.get(topic):
            raise RecordingError(
                f"{self.path} has no messages on {topic}, {self._what_there_is()}.",
                "Record while its producer runs.",
            )

    def _without_essentials(self) -> RecordingError:
        none = f"{', '.join(_ESSENTIAL[:-1])} or {_ESSENTIAL[-1]}"
        if "started_ns" in self.metadata:  # a recorder's, that saw nobody
            where = f"domain {self.metadata['domain']}", str(self.metadata["interface"])
            return RecordingError(
                f"Nothing was recorded into {self.path}: while it was made, nobody published "
                f"{none} on {' on '.join(where)}.",
                f"`g1stream doctor --{where[0]} --interface {where[1]}` shows who is there; start "
                "the robot or the simulator, then record.",
            )
        return RecordingError(
            f"{self.path} is not a session of g1stream: it has no messages on {none}, "
            f"{self._what_there_is()}.",
            "Give a file that `g1stream record` or `g1stream stream --record` made.",
        )

    def _what_there_is(self) -> str:
        if not self.topics:
            return "nor on any other topic"
        return "only on " + ", ".join(sorted(self.topics))


def _joined(parts: list[NDArray[Any]]) -> NDArray[Any]:
    values = np.concatenate(parts, dtype=np.float64 if parts[0].dtype.kind == "f" else None)
    values.setflags(write=False)
    return values
