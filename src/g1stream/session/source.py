"""Sources of a `Recording`: files on disk, or messages in memory.

`SessionFiles` reads from disk. `MemorySource` returns what was written to it, so that a run in
lockstep gives a session without a file:

    source = MemorySource("rollout")
    source.add_metadata({"motion": {"name": "walk"}})
    source.write("/lowstate", sample, log_time, publish_time)
    session = Session(source)
"""

from __future__ import annotations

import os
import re
from abc import ABC, abstractmethod
from collections import Counter
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any, Final, Protocol

import numpy as np

from g1stream.errors import RecordingError
from g1stream.files import read_file
from g1stream.input_limits import SETTINGS_FILE
from g1stream.session.format import CHANNELS, metadata_from_strings, metadata_to_strings
from g1stream.session.mcap_reader import McapFile, Messages

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import ArrayLike, NDArray

__all__ = [
    "JOINT_STATES",
    "METADATA_YAML",
    "ExtendedSource",
    "FilesSource",
    "MemorySource",
    "RecordingFile",
    "SessionFiles",
    "SessionSource",
    "files_of",
]

METADATA_YAML: Final = "metadata.yaml"
"""The file that makes a directory a bag of ROS 2."""


JOINT_STATES: Final = {
    ("foxglove.JointStates", "protobuf"),
    ("sensor_msgs/msg/JointState", "cdr"),
}
"""Types and encodings of the joint states that other programs record."""


def files_of(path: Path) -> list[Path]:
    """A file itself, or the files that metadata.yaml lists in the directory of a bag.

    Raises:
        RecordingError: the directory has no metadata.yaml, or it cannot be read.
    """
    if not os.path.isdir(path):  # noqa: PTH112  # which does not raise: opening the file does
        return [path]
    import yaml

    try:
        text = read_file(path / METADATA_YAML, SETTINGS_FILE).decode("utf-8")
        about: dict[str, Any] = yaml.safe_load(text)["rosbag2_bagfile_information"]
        # The files are in the directory itself, whatever the paths say.
        names = [PurePath(name).name for name in about["relative_file_paths"]]
        if not names or not all(names):
            raise ValueError("it lists no files")
    except FileNotFoundError as error:
        raise RecordingError(
            f"{path} is a directory without {METADATA_YAML}.",
            "Give an MCAP file, or the directory of a bag.",
        ) from error
    except Exception as error:  # a YAML file may fail in many ways
        raise RecordingError(
            f"{path / METADATA_YAML} cannot be read: {getattr(error, 'strerror', None) or error}.",
            "Give one of the files in the directory instead.",
        ) from error
    return [path / name for name in names]


class RecordingFile(Protocol):
    """A file of messages, such as `McapFile`.

    Attributes:
        types: message type and encoding by topic.
        counts: number of messages by topic.
        unread: bytes at its end that are an incomplete record.
    """

    counts: Counter[str]
    unread: int

    @property
    def types(self) -> dict[str, tuple[str, str]]:
        """By topic."""

    def batches(self, topics: set[str]) -> Iterator[tuple[str, Messages]]:
        """The messages of some topics, in batches of one topic, each topic in order."""


class SessionSource(ABC):
    """The messages, metadata and attachments of one session.

    Attributes:
        path: the file or directory; for a session in memory only a name for error messages.
        paths: the files that it was read from, oldest first; empty in memory.
        topics: number of messages by topic.
        foreign: topics of channels for viewers with messages of another type, such as those of a
            bag, or of an earlier version.
        metadata: the values of all metadata records; a later one replaces an earlier one.
        complete: whether its recorder closed it.
        unread: bytes at the ends of files that are incomplete records.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.paths: list[Path] = []
        self.topics: dict[str, int] = {}
        self.foreign: set[str] = set()
        self.metadata: dict[str, Any] = {}
        self.complete = True
        self.unread = 0

    @abstractmethod
    def batches(self, topics: set[str]) -> Iterator[tuple[str, Messages]]:
        """The messages of some topics in batches; the batches of a topic are in order.

        Raises:
            RecordingError: the file is damaged.
        """

    def since(self, topic: str, number: int) -> tuple[int, Iterator[Messages]]:
        """The messages of a topic from a batch on, and the number of the batch's first message.

        Messages before `number` are left out as far as the index allows.

        Raises:
            RecordingError: the file is damaged.
        """
        return 0, (messages for _, messages in self.batches({topic}))

    @abstractmethod
    def attachments(self) -> dict[str, bytes]:
        """The attached files by name.

        Raises:
            RecordingError: the file is damaged.
        """


#: Topics of a G1 that are read where the usual one has no messages.
_INSTEAD: Final = {"/lf/lowstate": "/lowstate", "/odommodestate": "/sportmodestate"}


class FilesSource(SessionSource):
    """Several message files read as one, with the topics of a session."""

    def _read_from(self, files: Sequence[RecordingFile]) -> None:
        """Use the messages of some files, in their order."""
        self._of_messages = files
        counts = sum((file.counts for file in files), Counter[str]())
        kinds = {name: kind for file in files for name, kind in file.types.items()}
        self._names = _session_topics(counts, kinds)
        self.topics = {topic: counts[name] for topic, name in self._names.items()}
        self.unread = sum(file.unread for file in files)
        for topic in CHANNELS.keys() & self._names.keys():
            one, kind = CHANNELS[topic], kinds.get(self._names[topic])
            if not one.dds_topic and kind != (one.schema_name, one.message_encoding):
                self.foreign.add(topic)

    def batches(self, topics: set[str]) -> Iterator[tuple[str, Messages]]:
        """The messages of some topics in batches, in the order of the files."""
        names = {self._names[topic]: topic for topic in topics if topic in self._names}
        for file in self._of_messages:
            for name, messages in file.batches(set(names)):
                yield names[name], _as_now(names[name], messages)


def _as_now(topic: str, messages: Messages) -> Messages:
    """Messages with the type of today, with zeros where it has grown."""
    before, at, more = CHANNELS[topic].grown if topic in CHANNELS else (0, 0, 0)
    if not before or len(messages.data[0]) != before:
        return messages
    return messages._replace(data=[one[:at] + bytes(more) + one[at:] for one in messages.data])


def _session_topics(
    counts: Mapping[str, int], kinds: Mapping[str, tuple[str, str]]
) -> dict[str, str]:
    """The session's topic -> the same topic in a file, such as `/rt/lowstate`.

    A topic of the robot with another type, such as a G1's /sportmodestate of unitree_hg, is none of
    the session, and has its type behind its name.

    Args:
        counts: number of messages by topic in the file. Topics with messages are preferred, then
            those of the usual name, then those with the most messages.
        kinds: schema name and encoding by topic.
    """
    names = {topic: _plain(topic) for topic in counts}
    found: dict[str, str] = {}

    def rank(topic: str) -> tuple[bool, bool, bool, int]:
        n, name = counts[topic], names[topic]
        return n > 0, name not in _INSTEAD, topic == name, n

    for topic in sorted(counts, key=rank):
        usual = _INSTEAD.get(names[topic], names[topic])
        channel, kind = CHANNELS.get(usual), kinds.get(topic, ("", ""))[0]
        if channel is None:
            found[topic] = topic
        elif channel.dds_topic and kind and _package(kind) != _package(channel.schema_name):
            found[f"{topic} ({kind})"] = topic
        else:
            if usual in found:
                found[found[usual]] = found[usual]
            found[usual] = topic
    return found


def _plain(name: str) -> str:
    """The name of a topic as a session has it, such as /lowstate of rt/lowstate."""
    return f"/{name.removeprefix('/').removeprefix('rt/')}"


def _package(kind: str) -> str:
    """The package of a type, which tells types of one name apart."""
    return re.split(r"/|::|\.", kind)[0]


class SessionFiles(FilesSource):
    """The files of a session, read as one.

    Args:
        path: an MCAP file, or the directory of a bag of ROS 2.

    Raises:
        RecordingError: the path is not a session, or nothing in it can be read.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._files = [McapFile(one) for one in files_of(path)]
        self.paths = [file.path for file in self._files]
        self.complete = all(file.complete for file in self._files)
        self._read_from(self._files)
        self.metadata = {k: v for file in self._files for k, v in file.metadata.items()}
        for topic, name in self._names.items():
            if _plain(name) in _INSTEAD and topic != name:
                told = self.metadata.get("log")
                known = told if isinstance(told, dict) else {}
                self.metadata["log"] = {**known, topic: f"read from {name}"}

    @property
    def has_joint_states(self) -> bool:
        """Whether it has joint states that other programs record."""
        return not all(JOINT_STATES.isdisjoint(file.types.values()) for file in self._files)

    def since(self, topic: str, number: int) -> tuple[int, Iterator[Messages]]:
        """The messages of a topic from `number` or earlier, and the number of the first."""
        if len(self._files) > 1:
            return super().since(topic, number)
        (file,), name = self._files, self._names[topic]
        chunk, start = file.place_of(name, number)
        return start, (_as_now(topic, messages) for _, messages in file.batches({name}, chunk))

    def attachments(self) -> dict[str, bytes]:
        """The attached files by name."""
        return {one.name: one.data for file in self._files for one in file.attachments()}


class MemorySource(SessionSource):
    """A session in memory: written with the methods of `SessionWriter`, read as a `SessionSource`.

    Args:
        name: shown instead of a path, as in error messages.
    """

    def __init__(self, name: str = "memory") -> None:
        super().__init__(Path(name))
        self._messages: dict[str, list[tuple[int, int, bytes]]] = {}
        self._attachments: dict[str, bytes] = {}

    def write(self, topic: str, data: bytes, log_time: int, publish_time: int) -> None:
        """Add one message; times in ns since the epoch."""
        self.write_batch(topic, [data], [log_time], [publish_time])

    def write_batch(
        self,
        topic: str,
        payloads: Sequence[bytes] | NDArray[np.uint8],
        log_times: ArrayLike,
        publish_times: ArrayLike,
    ) -> None:
        """Add T messages of one topic; see `SessionWriter.write_batch`."""
        times = np.asarray(log_times).tolist(), np.asarray(publish_times).tolist()
        if messages := list(zip(*times, map(bytes, payloads), strict=True)):
            self._messages.setdefault(topic, []).extend(messages)
            self.topics[topic] = len(self._messages[topic])

    def add_metadata(self, values: Mapping[str, Any]) -> None:
        """Add metadata: JSON values, and numpy arrays, which become lists."""
        self.metadata |= metadata_from_strings(metadata_to_strings(values))

    def attach(self, name: str, media_type: str, data: bytes, time_ns: int) -> None:
        """Add a file. Media type and time are for files on disk, and unused here."""
        self._attachments[name] = data

    def batches(self, topics: set[str]) -> Iterator[tuple[str, Messages]]:
        """The messages of some topics, one batch for each topic."""
        for topic in topics & self._messages.keys():
            log_times, publish_times, data = zip(*self._messages[topic], strict=True)
            times = np.array(log_times, np.int64), np.array(publish_times, np.int64)
            yield topic, Messages(*times, list(data))

    def attachments(self) -> dict[str, bytes]:
        """The attached files by name."""
        return dict(self._attachments)


class ExtendedSource(SessionSource):
    """A session with topics that it does not have added to it, and metadata and attachments.

    Added metadata and attachments replace those with the same name.
    """

    def __init__(self, source: SessionSource, added: MemorySource) -> None:
        super().__init__(source.path)
        self._source, self._added = source, added
        self.paths, self.complete, self.unread = source.paths, source.complete, source.unread
        self.topics = source.topics | added.topics
        self.foreign = source.foreign
        self.metadata = source.metadata | added.metadata

    def batches(self, topics: set[str]) -> Iterator[tuple[str, Messages]]:
        """The messages of some topics: those of the session, then the added ones."""
        yield from self._source.batches(topics - self._added.topics.keys())
        yield from self._added.batches(topics)

    def since(self, topic: str, number: int) -> tuple[int, Iterator[Messages]]:
        """The messages of a topic from `number` or earlier, and the number of the first."""
        source = self._added if topic in self._added.topics else self._source
        return source.since(topic, number)

    def attachments(self) -> dict[str, bytes]:
        """The attached files by name."""
        return self._source.attachments() | self._added.attachments()
