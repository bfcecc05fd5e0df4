"""DDS writers and readers whose samples are bytes.

cyclonedds-python serialises field by field, which takes a few hundred microseconds for a LowState.
However, its writer calls `serialize` of the sample, and its reader calls `deserialize` of the
topic's class. Therefore a plain class with the identity of the generated type and its own two
methods transports bytes unchanged in both directions.
"""

# `c_call` reads annotations when a class is created, so they must not be postponed here.
import ctypes
from collections.abc import Sequence
from functools import cache
from typing import Any, Protocol

from cyclonedds.core import DDSException, Policy, Qos
from cyclonedds.internal import DDS, c_call, dds_c_t
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic as CycloneTopic

from g1stream.dds.domain import Participant
from g1stream.dds.layout import Layout

__all__ = ["AnyTopic", "PublishersByTurns", "RawReader", "RawSample", "RawWriter"]


class AnyTopic(Protocol):
    """Interface of a topic, from `g1stream.dds.messages` or elsewhere.

    Attributes:
        name: topic name on DDS.
        idl_type: cyclonedds class with the type name on DDS.
    """

    @property
    def name(self) -> str: ...
    @property
    def idl_type(self) -> Any: ...


class RawSample:
    """A sample as bytes.

    Attributes:
        data: the serialised sample, including the CDR header.
        sample_info: Cyclone's SampleInfo; `source_timestamp` is the writer's CLOCK_REALTIME, ns.
    """

    __slots__ = ("data", "sample_info")

    def __init__(self, data: bytes) -> None:
        self.data = data
        self.sample_info: Any = None

    @property
    def publish_time(self) -> int:
        """The source timestamp, ns since the epoch."""
        return int(self.sample_info.source_timestamp)

    def serialize(self, use_version_2: bool | None = None) -> bytes:
        """Called by cyclonedds' writer."""
        return self.data

    @classmethod
    def deserialize(cls, data: bytes) -> "RawSample":
        """Called by cyclonedds' reader."""
        return cls(data)

    # For a type without a key, the end of a writer is announced with an empty sample.
    deserialize_key = deserialize


@cache
def _raw_type(idl_type: Any) -> type[RawSample]:
    """Make a class of samples that Cyclone treats as the generated type.

    It is not a subclass of the generated type, because that would announce a base type in
    discovery, and peers would reject it.
    """
    identity = {"__idl__": idl_type.__idl__, "__idl_typename__": idl_type.__idl_typename__}
    return type(f"Raw{idl_type.__name__}", (RawSample,), {"__slots__": (), **identity})


class _Statuses(DDS):  # type: ignore[misc]
    """Status counts of an entity that the Python classes of 0.10.2 do not provide.

    Listeners would also provide them, but a listener is called from Cyclone's own thread. If it
    waits for the GIL while the interpreter deletes the entity, it never returns.
    """

    @c_call("dds_get_publication_matched_status")  # type: ignore[untyped-decorator]
    def readers(
        self,
        writer: dds_c_t.entity,
        status: ctypes.POINTER(dds_c_t.publication_matched_status),  # type: ignore[valid-type]
    ) -> dds_c_t.returnv: ...

    @c_call("dds_get_subscription_matched_status")  # type: ignore[untyped-decorator]
    def writers(
        self,
        reader: dds_c_t.entity,
        status: ctypes.POINTER(dds_c_t.subscription_matched_status),  # type: ignore[valid-type]
    ) -> dds_c_t.returnv: ...

    @c_call("dds_get_sample_lost_status")  # type: ignore[untyped-decorator]
    def lost(
        self,
        reader: dds_c_t.entity,
        status: ctypes.POINTER(dds_c_t.sample_lost_status),  # type: ignore[valid-type]
    ) -> dds_c_t.returnv: ...


_STATUSES = _Statuses(0)


def _create(
    kind: type[DataWriter[Any]] | type[DataReader[Any]],
    participant: Participant,
    topic: AnyTopic,
    user_data: bytes,
    *policies: Any,
) -> Any:
    """Create Cyclone's writer or reader of a topic whose samples are bytes."""
    raw_type = _raw_type(topic.idl_type)
    announced = [Policy.Userdata(user_data)] if user_data else []
    cyclone_topic = CycloneTopic(participant.entity, topic.name, raw_type)
    return kind(participant.entity, cyclone_topic, Qos(*policies, *announced))


class RawWriter:
    """Publishes samples of one topic as bytes, until it or its participant is closed.

    It is reliable, like the simulators' writers, so that reliable and best-effort readers match. A
    slow reliable reader never blocks it, because samples that cannot be written immediately are
    dropped.

    Args:
        participant: the participant of the writer.
        topic: the topic.
        depth: number of samples that are kept for reliable readers that have not confirmed them.
        latched: keep the last sample for later readers (transient local).
        user_data: user data for discovery.

    Attributes:
        dropped: number of samples that could not be written.
    """

    def __init__(
        self,
        participant: Participant,
        topic: AnyTopic,
        depth: int = 1,
        *,
        latched: bool = False,
        user_data: bytes = b"",
    ) -> None:
        self.topic = topic
        self.dropped = 0
        self._type = _raw_type(topic.idl_type)
        policies = [Policy.Reliability.Reliable(0), Policy.History.KeepLast(depth)]
        if latched:
            policies.append(Policy.Durability.TransientLocal)
        self._participant = participant
        self._writer = _create(DataWriter, participant, topic, user_data, *policies)
        participant.register(self)

    def close(self) -> None:
        self._writer = None

    def write(self, data: bytes, timestamp: int | None = None) -> bool:
        """Publish one sample.

        Args:
            data: the serialised sample, including the CDR header.
            timestamp: publish time, ns since the epoch; None: now.

        Returns:
            Whether the sample was written.
        """
        try:
            self._writer.write(self._type(data), timestamp)
        except DDSException as error:
            if error.code != DDSException.DDS_RETCODE_TIMEOUT:
                raise
            self.dropped += 1
            return False
        return True

    def announce(self, user_data: bytes) -> None:
        """Change the user data for discovery."""
        self._writer.set_qos(Qos(Policy.Userdata(user_data)))

    @property
    def matched(self) -> int:
        """Number of matched readers."""
        status = dds_c_t.publication_matched_status()
        _STATUSES.readers(self._writer._ref, ctypes.byref(status))
        return int(status.current_count)

    def subscribers(self) -> int:
        """Number of matched readers, without recorders and other observers."""
        if not (matched := self.matched):
            return 0
        readers = self._participant.readers(self.topic.name)
        return max(0, matched - sum(reader.observer for reader in readers))


class PublishersByTurns:
    """Distinguishes several active publishers from one that was restarted.

    A restarted program has a new publisher, and its old publisher sends no more samples.
    """

    def __init__(self) -> None:
        self._by_recency: list[int] = []  # the newest last

    def hear(self, publisher: int) -> bool:
        """Add the publisher of a sample; return whether it alternates with another publisher."""
        heard = self._by_recency
        if heard and publisher == heard[-1]:
            return False
        again = publisher in heard
        if again:
            heard.remove(publisher)
        heard.append(publisher)
        return again


class RawReader:
    """Receives samples of one topic as bytes, until it or its participant is closed.

    It is best effort, so that it can never block a writer.

    Args:
        participant: the participant of the reader.
        topic: the topic.
        depth: number of samples that are kept between two takes before the oldest is lost.
        ignore_own: do not match writers of the same participant.
        user_data: user data for discovery.

    Attributes:
        malformed: number of received samples that were not of the topic's type.
    """

    def __init__(
        self,
        participant: Participant,
        topic: AnyTopic,
        depth: int = 1,
        *,
        ignore_own: bool = False,
        user_data: bytes = b"",
    ) -> None:
        self.topic = topic
        self._layout = Layout.of(topic.idl_type)
        self.malformed = 0
        policies = [Policy.Reliability.BestEffort, Policy.History.KeepLast(depth)]
        if ignore_own:
            policies.append(Policy.IgnoreLocal.Participant)
        self.entity = _create(DataReader, participant, topic, user_data, *policies)
        participant.register(self)

    def close(self) -> None:
        self.entity = None

    def take(self, most: int = 256) -> Sequence[RawSample]:
        """Take the samples received since the last take, oldest first; does not wait.

        Data that is not one sample of the topic's type in plain little-endian CDR is left out and
        counted in `malformed`. It can occur because a writer without type information always
        matches.
        """
        whole = []
        for sample in self.entity.take(most):
            if isinstance(sample, RawSample):
                if self._layout.matches(sample.data):
                    whole.append(sample)
                else:
                    self.malformed += 1
        return whole

    def take_latest(self) -> RawSample | None:
        """Take the newest sample since the last take, or None; does not wait."""
        samples = self.take()
        return samples[-1] if samples else None

    @property
    def matched(self) -> int:
        """Number of matched writers."""
        return self.matches[0]

    @property
    def matches(self) -> tuple[int, int]:
        """Number of matched writers, now and in total."""
        status = dds_c_t.subscription_matched_status()
        _STATUSES.writers(self.entity._ref, ctypes.byref(status))
        return int(status.current_count), int(status.total_count)

    @property
    def lost(self) -> int:
        """Number of samples that DDS reports as lost."""
        status = dds_c_t.sample_lost_status()
        _STATUSES.lost(self.entity._ref, ctypes.byref(status))
        return int(status.total_count)
