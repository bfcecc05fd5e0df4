"""A stream of a session: the samples of one topic as arrays, read when they are first used."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Final, TypeVar

import numpy as np

from g1stream.errors import RecordingError
from g1stream.input_limits import LATEST_NS
from g1stream.text import counted
from g1stream.types import Floats, Ints

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from g1stream.dds.messages import Topic

__all__ = ["Columns", "Stream", "StreamT"]

_TIMES: Final = ("log_time", "publish_time")

#: If half of the messages take longer than this, ns, it is the clocks that differ.
_SLOWEST_WIRE: Final = 20_000_000

Columns = Mapping[str, "NDArray[Any]"]
StreamT = TypeVar("StreamT", bound="Stream")


class Stream:
    """N samples of one topic, oldest first; all arrays are read-only.

    Columns are read from the file when they are first used: the two times alone, any other column
    together with all that are not read yet. `read` reads only those that it names. An index, slice
    or boolean mask gives a stream of these samples: `session.measured[mask]`.

    A stream of this class has only the times of the messages of some topic. Subclasses say where
    their samples come from: the `topic` in the file, the `source` on the wire, and in `paths` the
    IDL field of a column that has another name there.

    Args:
        load: reads columns by name, floats in any precision; without it there are only the
            `columns` given.
        time: computes `time`.
        columns: those that are known already.

    Attributes:
        log_time: (N,) int64, when the recorder received each, ns since the epoch.
        publish_time: (N,) int64, when its producer published it, ns since the epoch.
    """

    topic: ClassVar[str]
    source: ClassVar[Topic]
    paths: ClassVar[Mapping[str, str]] = MappingProxyType({})

    log_time: Ints
    publish_time: Ints
    _load: Callable[[list[str]], Columns] | None
    _time: Callable[[], Floats] | None

    def __init__(
        self,
        load: Callable[[list[str]], Columns] | None = None,
        time: Callable[[], Floats] | None = None,
        **columns: NDArray[Any],
    ) -> None:
        self.__dict__.update(columns, _load=load, _time=time)

    @classmethod
    def wire_fields(cls) -> dict[str, str]:
        """Column -> path in the IDL, of all that comes from the samples themselves."""
        names = () if cls is Stream else cls.__annotations__
        return {name: cls.paths.get(name, name) for name in names}

    def read(self: StreamT, *columns: str) -> StreamT:
        """Read columns of a file in one pass, all if none are named; the stream itself.

        Raises:
            RecordingError: the file is damaged, or the stream has no such column.
        """
        missing = self.missing(*columns)
        if missing:
            if self._load is None:
                raise AttributeError(f"{type(self).__name__} has no {', '.join(missing)}")
            self.keep(dict(self._load(missing)))
        return self

    def missing(self, *columns: str) -> list[str]:
        """Of some columns and the times, those that are not read yet; of all if none are named.

        Raises:
            RecordingError: the stream has no such column.
        """
        known = self.wire_fields()
        if unknown := [name for name in columns if name not in known and name not in _TIMES]:
            raise RecordingError(
                f"{type(self).__name__} has no column {unknown[0]!r}.",
                f"Choose from {', '.join((*_TIMES, *known))}.",
            )
        wanted = dict.fromkeys((*_TIMES, *(columns or known)))
        return [name for name in wanted if name not in self.__dict__]

    def keep(self, columns: dict[str, NDArray[Any]]) -> None:
        """Take in columns that were read, floats in any precision; none is left in the dict."""
        for name in list(columns):  # one after the other: of a long recording each is large
            self.__dict__[name] = _as_float64(columns.pop(name))

    def as_recorded(self: StreamT, *columns: str) -> StreamT:
        """The same samples with these columns only, in the wire's precision: half the memory.

        They are read anew, and this stream does not keep them.

        Raises:
            RecordingError: the file is damaged.
        """
        if self._load is None:
            return self
        found = self._load(list(dict.fromkeys((*_TIMES, *columns))))
        self.__dict__.update({name: found[name] for name in _TIMES})
        return type(self)(None, lambda: self.time, **found)

    if not TYPE_CHECKING:  # so that a type checker knows the columns, and no others

        def __getattr__(self, name: str) -> Any:
            if name not in _TIMES and name not in self.wire_fields():
                raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
            return vars(self.read(*_TIMES) if name in _TIMES else self.read())[name]

    def __len__(self) -> int:
        return len(self.log_time)

    def __getitem__(
        self: StreamT, index: slice | NDArray[np.bool_] | NDArray[np.integer[Any]]
    ) -> StreamT:
        """The samples of a slice, a boolean mask (N,), or indices.

        Raises:
            TypeError: the index is a number, which would leave no stream; or a name.
        """
        if not isinstance(index, (slice, np.ndarray)):
            raise TypeError(
                f"a stream takes a slice or an array, not {index!r}: "
                f"stream[5:6] is the sixth sample, stream.{next(iter(self.wire_fields()), 'time')} "
                "a column"
            )

        def load(names: list[str]) -> Columns:
            self.read(*names)
            return {name: _read_only(getattr(self, name)[index]) for name in names}

        return type(self)(load, lambda: _read_only(self.time[index]))

    def __repr__(self) -> str:
        columns = ", ".join(self.wire_fields())
        return f"<{type(self).__name__}: {counted(len(self), 'sample')} of {columns or 'a topic'}>"

    @cached_property
    def time(self) -> Floats:
        """(N,) s, publish times on the motion's clock: its first frame is at 0."""
        return self._time() if self._time else self.since(self.start_ns)

    @property
    def start_ns(self) -> int:
        """When the first sample was published, ns since the epoch on the recorder's clock."""
        return int(self.publish_time.min()) + self.clock_offset

    def since(self, start_ns: int) -> Floats:
        """(N,) s, publish times on the recorder's clock since a time on it."""
        # Nanoseconds since the epoch need more digits than a float has; the differences do not.
        shift = self.clock_offset - start_ns
        shift = max(-LATEST_NS, min(shift, LATEST_NS))
        return _read_only((self.publish_time + shift) / 1e9)

    @property
    def clock_offset(self) -> int:
        """What must be added to publish times to be on the recorder's clock, ns.

        No message arrives before it is sent, and few take longer than 20 ms: if half of them seem
        to, producer and recorder have clocks that differ. The median of log_time - publish_time is
        then taken for the difference; it is too large by the usual latency, which nobody can tell
        from it.
        """
        if not len(self):
            return 0
        median = int(np.median(self.log_time - self.publish_time))
        return 0 if 0 <= median <= _SLOWEST_WIRE else median


def _as_float64(values: NDArray[Any]) -> NDArray[Any]:
    return _read_only(values.astype(np.float64)) if values.dtype == np.float32 else values


def _read_only(values: NDArray[Any]) -> NDArray[Any]:
    values.setflags(write=False)
    return values
