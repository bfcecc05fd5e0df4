"""A recording, from a file, a directory of files or memory, as numpy arrays.

It has only recorded data; `g1stream.Session` adds computed results.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from functools import cached_property, wraps
from heapq import merge
from itertools import compress, repeat
from pathlib import Path
from types import MappingProxyType, NoneType
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeVar

import numpy as np

from g1stream.dds.messages import Batch, Samples
from g1stream.errors import RecordingError, WireError
from g1stream.robot.model import G1
from g1stream.session.format import CHANNELS
from g1stream.session.mcap_reader import RECOVER, Slices
from g1stream.session.records import AttachedInfo, PolicyInfo, SessionInfo, read_record
from g1stream.session.source import SessionFiles
from g1stream.session.streams import (
    LEAST_STEP_NS,
    BaseStream,
    CommandStream,
    LogEvent,
    MeasuredStream,
    PolicyStream,
    ReferenceStream,
    Stream,
    StreamT,
    TorsoImuStream,
    read_only,
)
from g1stream.text import counted
from g1stream.types import Floats, Phase

if TYPE_CHECKING:
    import os
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from g1stream.session.mcap_reader import Messages
    from g1stream.session.records import ClockStep, PhaseInterval
    from g1stream.session.source import SessionSource

__all__ = ["CONVERTED", "Message", "Recording", "has_essentials", "once", "open_recording"]

CONVERTED: Final = "/reference/joint_states"
"""What `convert` makes of a motion has its joints on this topic, and no samples of DDS."""

_ESSENTIAL: Final = (ReferenceStream.topic, CommandStream.topic, MeasuredStream.topic)

#: Rows that have room at once, 70 minutes at 500 Hz; a file may say that it has any number of them.
_ROWS: Final = 2**21

#: Log time of a block of messages, ns.
_BLOCK: Final = 1_000_000_000

T = TypeVar("T")
RecordingT = TypeVar("RecordingT", bound="Recording")


class Message(NamedTuple):
    """One message of the file.

    Attributes:
        log_time: time of reception by the recorder, ns since the epoch.
        publish_time: time of publication by its producer, ns since the epoch.
        data: its bytes; for a DDS topic exactly those of the sample, including the CDR header.
    """

    log_time: int
    publish_time: int
    data: bytes


def once(make: Callable[[Recording], T]) -> Callable[[Recording], T]:
    """Cache the result of a function of a recording, as long as the recording exists."""

    @wraps(make)
    def kept(recording: Recording) -> T:
        results = recording.computed
        if make not in results:
            results[make] = make(recording)
        result: T = results[make]
        return result

    return kept


def has_essentials(topics: Mapping[str, int]) -> bool:
    """Whether a session has one of the topics that it must have, by messages of each."""
    return any(topics.get(topic) for topic in (*_ESSENTIAL, CONVERTED))


def open_recording(path: str | os.PathLike[str]) -> Recording:
    """Open a session file, also one whose recorder was killed, without analysis.

    Raises:
        RecordingError: there is no such file, or it is no session, or it is damaged.
    """
    return Recording(SessionFiles(Path(path)))


class Recording:
    """The samples, events, metadata and attachments of one run.

    Columns of a topic are read when they are first used, and kept. Whatever reads them raises a
    RecordingError where the file is damaged, or a topic that it needs is not in this session.

    Args:
        source: source of the data; `open_recording` uses the files on disk.

    Attributes:
        source: as given.
        path: path of the file or directory; for a session in memory only a name.
        paths: paths of the file or its parts, oldest first; empty in memory.
        complete: whether all files exist and were closed properly.
        unread: bytes at the ends of files that are incomplete records, as after a power failure.
        topics: number of messages by topic, in the whole session.
        metadata: metadata from stream and recorder.
        computed: results of functions decorated with `once`.

    Raises:
        RecordingError: the source has none of the topics that a session has.
    """

    def __init__(self, source: SessionSource) -> None:
        self.source = source
        self.path = source.path
        self.paths = source.paths
        self.complete = source.complete
        self.unread = source.unread
        self.topics = source.topics
        self.metadata = source.metadata
        self.computed: dict[Callable[..., Any], Any] = {}
        self._streams: dict[type[Stream], Any] = {}
        # The recording that a selection is a part of, and its ranges of time (first, end), s.
        self._whole: Recording | None = None
        self._ranges: Sequence[tuple[float, float]] = ()
        if not has_essentials(source.topics):
            raise self._without_essentials()

    def __repr__(self) -> str:
        counts = ", ".join(f"{topic} {n}" for topic, n in sorted(self.topics.items()) if n)
        whole = "" if self.closed else ", not closed by its recorder"
        selection = ", of which this is a part" if self.selected else ""
        return f"<{type(self).__name__} {str(self.path)!r}: {counts}{whole}{selection}>"

    @property
    def closed(self) -> bool:
        """Whether the recorder closed all files; False for a repaired one."""
        return self.complete and not self.metadata.get("repaired")

    @property
    def selected(self) -> bool:
        """Whether it is a part of another, by `sel`."""
        return self._whole is not None

    @property
    def converted(self) -> bool:
        """Whether `g1stream convert` made it from a motion, which was not played."""
        return bool(
            self.paths and self.topics.get(CONVERTED) and not self.topics.get(ReferenceStream.topic)
        )

    @property
    def reference(self) -> ReferenceStream:
        """The target at each tick, computed from the motion."""
        return self.stream(ReferenceStream)

    @property
    def command(self) -> CommandStream:
        """The commands to the motors."""
        return self.stream(CommandStream)

    @property
    def measured(self) -> MeasuredStream:
        """The state of the robot."""
        return self.stream(MeasuredStream)

    @property
    def base(self) -> BaseStream | None:
        """Position of the pelvis; None if it was not published, for example by a real robot."""
        return self.stream(BaseStream) if self.topics.get(BaseStream.topic) else None

    @property
    def torso_imu(self) -> TorsoImuStream | None:
        """The IMU in the torso; None if it was not published."""
        return self.stream(TorsoImuStream) if self.topics.get(TorsoImuStream.topic) else None

    @property
    def policy(self) -> PolicyStream | None:
        """The steps of a learned policy; None if no policy played."""
        if not self.topics.get(PolicyStream.topic):
            return None
        stream = self.stream(PolicyStream)
        info = self.policy_info
        stream.terms = MappingProxyType(info.columns if info else {})
        return stream

    @cached_property
    def policy_info(self) -> PolicyInfo | None:
        """The policy that played, with its inputs and outputs; None if they are unknown."""
        return read_record(PolicyInfo, self.metadata.get("policy"))[0]

    @cached_property
    def attached(self) -> AttachedInfo | None:
        """How the reference was found, if it was attached afterwards; otherwise None."""
        return read_record(AttachedInfo, self.metadata.get("attached"))[0]

    def stream(self, kind: type[StreamT]) -> StreamT:
        """The samples of a DDS topic, by one of the values of `STREAMS`."""
        if kind not in self._streams:
            if self._whole is not None:
                whole = self._whole.stream(kind)
                self._streams[kind] = whole[self._inside(whole.time)]
            else:
                self._require(kind.topic)
                self._streams[kind] = self._made(
                    kind, lambda names: self._columns({kind: names})[kind]
                )
        stream: StreamT = self._streams[kind]
        return stream

    def read(self, columns: Mapping[type[Stream], Sequence[str]]) -> None:
        """Read columns of several streams in one pass, which is faster than one pass for each.

        Args:
            columns: names by stream, all of its columns if there are none. Of a topic without
                messages nothing is read.

        Raises:
            RecordingError: the file is damaged, or a stream has no such column.
        """
        if self._whole is not None:
            self._whole.read(columns)
            return
        streams = {kind: self.stream(kind) for kind in columns if self.topics.get(kind.topic)}
        missing = {kind: stream.missing(*columns[kind]) for kind, stream in streams.items()}
        wanted = {kind: names for kind, names in missing.items() if names}
        if wanted:
            for kind, found in self._columns(wanted).items():
                streams[kind].keep(found)

    def excerpts(
        self, wanted: Mapping[type[Stream], tuple[NDArray[np.intp], Sequence[str]]]
    ) -> dict[type[Stream], Any]:
        """Some samples of streams; columns that are not read yet are read of these alone.

        Args:
            wanted: by stream, indices (K,) of samples, rising, and names of columns.

        Raises:
            RecordingError: the file is damaged, or a stream has no such column.
        """
        parts = {
            kind: self.stream(kind).read("log_time")[rows] for kind, (rows, _) in wanted.items()
        }
        for kind, (rows, columns) in wanted.items():
            missing = self.stream(kind).missing(*columns)
            if not missing or self._whole is not None:
                continue
            found: dict[str, list[NDArray[Any]]] = {name: [] for name in missing}
            end = 0
            for start, block in self.blocks(kind, missing, int(rows[0]) if len(rows) else 0):
                end = start + len(block[missing[0]])
                first, last = np.searchsorted(rows, (start, end))
                for name, values in block.items():
                    found[name].append(values[rows[first:last] - start])
                if last == len(rows):
                    break  # what is left of the file is not wanted
            if sum(map(len, found[missing[0]])) < len(rows):
                raise self._incomplete(kind.topic, end)
            parts[kind].keep({name: np.concatenate(values) for name, values in found.items()})
        return parts

    def blocks(
        self, kind: type[Stream], columns: Sequence[str], number: int = 0
    ) -> Iterator[tuple[int, Mapping[str, NDArray[Any]]]]:
        """Columns of a stream, some samples at a time, of which none are kept.

        Args:
            kind: one of the values of `STREAMS`.
            columns: names of those that come from the samples themselves.
            number: of the first sample that is wanted; some before it may be left out.

        Yields:
            The number of the first sample, and the values (n, ...) by name, floats in any
            precision.

        Raises:
            RecordingError: the file is damaged, or the topic is not in this session.
        """
        if self._whole is not None:
            stream = self.stream(kind).read(*columns)
            yield 0, {name: getattr(stream, name) for name in columns}
            return
        self._require(kind.topic)
        start, batches = self.source.since(kind.topic, number)
        for messages in batches:
            yield start, self._fields(kind, columns, messages)
            start += len(messages.log_times)

    def _fields(
        self, kind: type[Stream], columns: Sequence[str], messages: Messages
    ) -> dict[str, NDArray[Any]]:
        """Those columns that come from the samples themselves; views of them where it can be."""
        paths = {name: path for name, path in kind.wire_fields().items() if name in columns}
        if not paths:
            return {}
        rows = messages.data.rows() if isinstance(messages.data, Slices) else None
        found = self.samples(kind, messages.data if rows is None else rows)
        return {name: found.shown(path) for name, path in paths.items()}

    @cached_property
    def robot(self) -> G1:
        """The robot of the attached URDF; the default one without an attached URDF.

        Raises:
            RobotError: the URDF cannot be used.
        """
        urdf = self.attachments.get("robot.urdf")
        if urdf is None:
            return G1.default()
        return G1.from_urdf(urdf.decode(errors="replace"), f"robot.urdf of {self.path}")

    @cached_property
    def attachments(self) -> dict[str, bytes]:
        """The attached files by name."""
        return self.source.attachments()

    @cached_property
    def log(self) -> list[LogEvent]:
        """The events of the session, in the order of the file."""
        if self._whole is not None:
            whole = self._whole.log
            seconds = np.array([event.time_ns - self.start_ns for event in whole]) / 1e9
            return list(compress(whole, self._inside(seconds)))
        return [
            LogEvent.decode(data)
            for _, batch in self.source.batches({"/log"})
            for data in batch.data
        ]

    @cached_property
    def times(self) -> dict[str, Stream]:
        """By topic, the times of its messages; of all topics, so it takes a while to read."""
        if self._whole is not None:
            return {topic: one[self._inside(one.time)] for topic, one in self._whole.times.items()}
        return self._times([topic for topic, n in sorted(self.topics.items()) if n])

    def messages(self, topic: str) -> Iterator[Message]:
        """The messages of any topic, one after the other, in the order of the file."""
        self._require(topic)
        if self._whole is not None:
            times = self._whole._times([topic])[topic].time
            yield from compress(self._whole.messages(topic), self._inside(times))
            return
        for _, batch in self.source.batches({topic}):
            times_ns = batch.log_times.tolist(), batch.publish_times.tolist()
            yield from map(Message, *times_ns, batch.data)

    def rounds(self, topics: Iterable[str]) -> Iterator[dict[str, Batch]]:
        """The messages of some topics in blocks of a second of log time, by topic, in its order.

        Memory does not grow with the length of the recording.
        """
        several = (zip(self.messages(topic), repeat(topic)) for topic in topics)
        block: dict[str, Batch] = defaultdict(Batch)
        end: int | None = None
        for message, topic in merge(*several, key=lambda pair: pair[0].log_time):
            if end is None or message.log_time >= end:
                if block:
                    yield block
                block, end = defaultdict(Batch), message.log_time + _BLOCK
            batch = block[topic]
            batch.data.append(message.data)
            batch.log_times.append(message.log_time)
            batch.publish_times.append(message.publish_time)
        if block:
            yield block

    def replay_bytes(self, topic: str = CommandStream.topic) -> Iterator[bytes]:
        """The samples of a DDS topic, bit for bit as they were published, in order."""
        return (message.data for message in self.messages(topic))

    def some(self, topic: str, most: int) -> Iterator[bytes]:
        """The bytes of about `most` messages of any topic, evenly spread over the whole session."""
        step, at = -(-self.topics.get(topic, 0) // most), 0
        for _, batch in self.source.batches({topic}):
            yield from batch.data[-at % step :: step]
            at += len(batch.data)

    def samples(self, kind: type[Stream], data: Sequence[bytes] | NDArray[np.uint8]) -> Samples:
        """The fields of samples of a DDS topic, from their bytes.

        Raises:
            RecordingError: one of them is not of the topic's type.
        """
        try:
            return Samples(kind.source, data)
        except WireError as error:
            raise RecordingError(
                f"{kind.topic} in {self.path} cannot be decoded. {error.cause}",
                "Read it with the version of g1stream that recorded it.",
            ) from error

    @cached_property
    def clock_steps(self) -> list[ClockStep]:
        """Steps of the clock of the recorder's machine that change a result."""
        info, _ = read_record(SessionInfo, self.metadata)
        steps = info.clock_steps if info else []
        return [step for step in steps if abs(step.step_ns) >= LEAST_STEP_NS]

    @cached_property
    def start_ns(self) -> int:
        """Time 0 of the motion's clock, ns since the epoch on the recorder's clock.

        It is the publish time of the motion's first frame, even if that was not played. If no
        motion was played, it is the first sample of the reference, the commands or the state. For
        a converted motion it is the first frame.
        """
        if self._whole is not None:
            return self._whole.start_ns
        for kind in (ReferenceStream, CommandStream, MeasuredStream):
            if self.topics.get(kind.topic):
                return self.stream(kind).start_ns
        return self._times([CONVERTED])[CONVERTED].start_ns

    @property
    def phases(self) -> list[PhaseInterval]:
        """The phases in order, in s on the motion's clock: its first frame is at 0.

        Each lasts until the next one begins, and the last until the last sample of the reference.
        It is empty without a reference.

        Raises:
            RecordingError: a number stands for no phase.
        """
        return self.reference.phases if self.topics.get(ReferenceStream.topic) else []

    def sel(
        self: RecordingT, phase: str | Phase | None = None, time: slice | None = None
    ) -> RecordingT:
        """The part of the session in a phase, in a time range, or in both.

        Streams, times, messages and the log are restricted to it, by publish time; `topics`,
        attachments and metadata are those of the whole session, with `selected` in the latter.

        Args:
            phase: name of a phase, such as `"PLAY"`.
            time: s on the motion's clock, such as `slice(2.0, 5.0)`, including both ends.

        Raises:
            RecordingError: there is no phase of this name.
            TypeError: `time` is not a slice.
        """
        if not isinstance(time, (slice, NoneType)):
            raise TypeError(f"time takes a slice of seconds, such as slice(2.0, 5.0), not {time!r}")
        ranges = [(-np.inf, np.inf)] if phase is None else self._phase_ranges(phase)
        if time is not None:
            first = -np.inf if time.start is None else time.start
            end = np.inf if time.stop is None else np.nextafter(time.stop, np.inf)
            ranges = [(max(a, first), min(b, end)) for a, b in ranges]
        part = type(self)(self.source)
        part._whole, part._ranges = self, ranges
        part.metadata = {**self.metadata, "selected": True}  # also in a file that is made of it
        return part

    def _phase_ranges(self, phase: str | Phase) -> list[tuple[float, float]]:
        name = phase.name if isinstance(phase, Phase) else phase.upper()
        if name not in Phase.__members__:
            raise RecordingError(
                f"There is no phase {phase!r}.", f"Choose from {', '.join(Phase.__members__)}."
            )
        phases = self.phases
        ends = [*(one.start_s for one in phases[1:]), np.inf][: len(phases)]
        return [
            (one.start_s, end)
            for one, end in zip(phases, ends, strict=True)
            if one.phase is Phase[name]
        ]

    def _inside(self, times: Floats) -> NDArray[np.bool_]:
        """Which times (N,), s, are in the ranges of a selection; their ends are excluded."""
        inside = np.zeros(len(times), dtype=bool)
        for first, end in self._ranges:
            inside |= (times >= first) & (times < end)
        return inside

    def _times(self, topics: Sequence[str]) -> dict[str, Stream]:
        found = self._read(topics, lambda *_: {})
        return {t: self._made(Stream, lambda _, t=t: found[t]) for t in found}

    def _made(
        self, kind: type[StreamT], load: Callable[..., Mapping[str, NDArray[Any]]]
    ) -> StreamT:
        return kind(load, lambda: self.start_ns, host_steps=self.clock_steps)

    def _columns(
        self, wanted: Mapping[type[Stream], Sequence[str]]
    ) -> dict[type[Stream], dict[str, NDArray[Any]]]:
        """Some columns of streams by name, in the wire's precision, and both their times."""
        kinds = {kind.topic: kind for kind in wanted}

        def decode(topic: str, messages: Messages) -> dict[str, NDArray[Any]]:
            return self._fields(kinds[topic], wanted[kinds[topic]], messages)

        read = self._read(list(kinds), decode)
        return {kind: read[topic] for topic, kind in kinds.items()}

    def _read(
        self,
        topics: Sequence[str],
        decode: Callable[[str, Messages], dict[str, NDArray[Any]]],
    ) -> dict[str, dict[str, NDArray[Any]]]:
        """By topic and attribute, what all messages of some topics have; read in one pass."""
        found: dict[str, dict[str, NDArray[Any]]] = {topic: {} for topic in topics}
        counts: Counter[str] = Counter()
        for topic, messages in self.source.batches(set(topics)):
            start, columns = counts[topic], found[topic]
            counts[topic] = end = start + len(messages.log_times)
            times = {"log_time": messages.log_times, "publish_time": messages.publish_times}
            for name, values in (times | decode(topic, messages)).items():
                column = columns.get(name, values[:0])
                if end > len(column):
                    n_rows = max(end, min(self.topics[topic], max(2 * end, _ROWS)))
                    columns[name] = np.empty((n_rows, *values.shape[1:]), values.dtype)
                    columns[name][:start] = column[:start]
                columns[name][start:end] = values
        for topic in topics:
            if counts[topic] != self.topics[topic]:
                raise self._incomplete(topic, counts[topic])
        for columns in found.values():
            columns.update({name: read_only(column) for name, column in columns.items()})
        return found

    def _incomplete(self, topic: str, n_found: int) -> RecordingError:
        n_messages = counted(self.topics[topic], "message")
        return RecordingError(
            f"{self.path} is damaged: of {n_messages} on {topic} it has {n_found}.", RECOVER
        )

    def _require(self, topic: str) -> None:
        if not self.topics.get(topic):
            raise RecordingError(
                f"{self.path} has no messages on {topic}, {self._other_topics()}.",
                "Record while its publisher runs.",
            )

    def _without_essentials(self) -> RecordingError:
        none = f"{', '.join(_ESSENTIAL[:-1])} or {_ESSENTIAL[-1]}"
        if not self.complete:
            return RecordingError(
                f"The session file {self.path} ends before the first sample of {none}.",
                "Copy it again, or record again.",
            )
        header = {"/log", *(topic for topic, channel in CHANNELS.items() if channel.latched)}
        if {
            "started_ns",
            "domain",
        } <= self.metadata.keys() and self.topics.keys() <= header:  # without a sample
            where = f"domain {self.metadata['domain']}", str(self.metadata["interface"])
            return RecordingError(
                f"Nothing was recorded into {self.path}: there was no publisher of {none} on "
                f"{' on '.join(where)}.",
                f"`g1stream doctor --{where[0]} --interface {where[1]}` lists the participants; "
                "start the robot or the simulator, then record.",
            )
        return RecordingError(
            f"{self.path} is not a session of g1stream: it has no messages on {none}, "
            f"{self._other_topics()}.",
            "Give a file that `g1stream record` or `g1stream stream --record` made, with all its "
            "topics.",
        )

    def _other_topics(self) -> str:
        if not self.topics:
            return "nor on any other topic"
        return "only on " + ", ".join(sorted(self.topics))
