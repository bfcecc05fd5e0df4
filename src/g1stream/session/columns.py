"""The columns of topics: what all messages of a session have, read in one pass into arrays."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from g1stream.dds.messages import Samples
from g1stream.errors import RecordingError, WireError
from g1stream.session.mcap_reader import RECOVER
from g1stream.session.source import Slices
from g1stream.session.stream import Stream
from g1stream.session.streams import Command, Measured, Reference
from g1stream.text import counted

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from g1stream.session.source import Messages, SessionSource

__all__ = ["CONVERTED", "Columns", "samples"]

_ESSENTIAL: Final = (Reference.topic, Command.topic, Measured.topic)

CONVERTED: Final = "/reference/joint_states"
"""What `convert` makes of a motion has its joints on this topic, and no samples of DDS."""


class Columns:
    """Reads the columns of a session's topics.

    Args:
        source: of the session.

    Raises:
        RecordingError: it has none of the topics that a session has.
    """

    def __init__(self, source: SessionSource) -> None:
        self._source = source
        if not any(source.topics.get(topic) for topic in (*_ESSENTIAL, CONVERTED)):
            raise self._without_essentials()

    def of(
        self, wanted: Mapping[type[Stream], Sequence[str]], *, as_recorded: bool = True
    ) -> dict[type[Stream], dict[str, NDArray[Any]]]:
        """Some columns of streams by name, and both their times.

        Args:
            wanted: columns by stream.
            as_recorded: floats are in the wire's precision; else all are float64.

        Raises:
            RecordingError: the file is damaged.
        """
        kinds = {kind.topic: kind for kind in wanted}

        def decode(topic: str, messages: Messages) -> dict[str, NDArray[Any]]:
            kind = kinds[topic]
            paths = {name: kind.wire_fields().get(name) for name in wanted[kind]}
            fields = {name: path for name, path in paths.items() if path}  # times have none
            if not fields:
                return {}
            rows = messages.data.rows() if isinstance(messages.data, Slices) else None
            found = samples(kind, messages.data if rows is None else rows, self._source.path)
            return {name: found.shown(path) for name, path in fields.items()}

        read = self._read(list(kinds), decode, as_recorded=as_recorded)
        return {kind: read[topic] for topic, kind in kinds.items()}

    def times(self, topics: Sequence[str]) -> dict[str, dict[str, NDArray[Any]]]:
        """Log and publish times of any topics, by topic and name.

        Raises:
            RecordingError: the file is damaged.
        """
        return self._read(topics, lambda *_: {})

    def require(self, topic: str) -> None:
        """Check that there are messages on a topic.

        Raises:
            RecordingError: there are none.
        """
        if not self._source.topics.get(topic):
            raise RecordingError(
                f"{self._source.path} has no messages on {topic}, {self._other_topics()}.",
                "Record while its publisher runs.",
            )

    def _read(
        self,
        topics: Sequence[str],
        decode: Callable[[str, Messages], dict[str, NDArray[Any]]],
        *,
        as_recorded: bool = True,
    ) -> dict[str, dict[str, NDArray[Any]]]:
        """By topic and attribute, what all messages of some topics have; read in one pass."""
        columns: dict[str, dict[str, NDArray[Any]]] = {topic: {} for topic in topics}
        filled = dict.fromkeys(topics, 0)
        for topic, messages in self._source.batches(set(topics)):
            begin, end = filled[topic], filled[topic] + len(messages.log_times)
            times = {"log_time": messages.log_times, "publish_time": messages.publish_times}
            if end <= self._source.topics[topic]:
                for name, values in (times | decode(topic, messages)).items():
                    if not begin:
                        widened = values.dtype.kind == "f" and not as_recorded
                        dtype = np.dtype(np.float64) if widened else values.dtype
                        columns[topic][name] = self._empty(topic, values.shape[1:], dtype)
                    columns[topic][name][begin:end] = values
            filled[topic] = end
        for topic, found in filled.items():
            if found != self._source.topics[topic]:
                raise self._miscounted(topic, f"it has {found}")
            for values in columns[topic].values():
                values.setflags(write=False)
        return columns

    def _empty(self, topic: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> NDArray[Any]:
        """A column (N, *shape) for all messages of a topic."""
        try:
            return np.empty((self._source.topics[topic], *shape), dtype)
        except (MemoryError, ValueError) as error:  # the number comes from the file
            raise self._miscounted(topic, "no memory has room for so many") from error

    def _miscounted(self, topic: str, found: str) -> RecordingError:
        messages = counted(self._source.topics[topic], "message")
        return RecordingError(
            f"{self._source.path} is damaged: of {messages} on {topic} {found}.", RECOVER
        )

    def _without_essentials(self) -> RecordingError:
        path, metadata = self._source.path, self._source.metadata
        none = f"{', '.join(_ESSENTIAL[:-1])} or {_ESSENTIAL[-1]}"
        if not self._source.complete:
            return RecordingError(
                f"The session file {path} was cut off before the first sample of {none}.",
                "Copy it again, or record again.",
            )
        if "started_ns" in metadata:  # a recording without samples
            where = f"domain {metadata['domain']}", str(metadata["interface"])
            return RecordingError(
                f"Nothing was recorded into {path}: there was no publisher of {none} on "
                f"{' on '.join(where)}.",
                f"`g1stream doctor --{where[0]} --interface {where[1]}` lists the participants; "
                "start the robot or the simulator, then record.",
            )
        return RecordingError(
            f"{path} is not a session of g1stream: it has no messages on {none}, "
            f"{self._other_topics()}.",
            "Give a file that `g1stream record` or `g1stream stream --record` made.",
        )

    def _other_topics(self) -> str:
        if not self._source.topics:
            return "nor on any other topic"
        return "only on " + ", ".join(sorted(self._source.topics))


def samples(kind: type[Stream], data: Sequence[bytes] | NDArray[np.uint8], path: Path) -> Samples:
    """The fields of samples of a DDS topic, from their bytes; `path` is that of the session.

    Raises:
        RecordingError: one of them is not of the topic's type.
    """
    try:
        return Samples(kind.source, data)
    except WireError as error:
        raise RecordingError(
            f"{kind.topic} in {path} cannot be decoded. {error.cause}",
            "Read it with the version of g1stream that recorded it.",
        ) from error
