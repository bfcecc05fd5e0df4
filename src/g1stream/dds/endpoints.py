"""Writers and readers that carry samples as bytes.

cyclonedds-python serialises field by field, a few hundred microseconds for a LowState. Its writer
asks the sample itself for its bytes, though, and its reader hands received bytes to the topic's
class, so that a plain class with the generated type's identity and its own pair of methods carries
bytes untouched in both directions.
"""

# `c_call` reads annotations when a class is made, so they must not be postponed here.
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
    """A topic of `g1stream.dds.messages`, or of others.

    Attributes:
        name: on the wire.
        idl_type: the cyclonedds class that names its type there.
    """

    @property
    def name(self) -> str: ...
    @property
    def idl_type(self) -> Any: ...


class RawSample:
    """A sample as bytes.

    Attributes:
        data: the sample as it is on the wire, CDR header included.
        sample_info: Cyclone's; `source_timestamp` is the writer's CLOCK_REALTIME in ns.
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

    # A type without a key announces a writer's departure with a sample that holds nothing.
    deserialize_key = deserialize


@cache
def _raw_type(idl_type: Any) -> type[RawSample]:
    """A class of samples that Cyclone takes for the generated type.

    Not a subclass of it: that would announce a base type on the wire, and peers would refuse it.
    """
    identity = {"__idl__": idl_type.__idl__, "__idl_typename__": idl_type.__idl_typename__}
    return type(f"Raw{idl_type.__name__}", (RawSample,), {"__slots__": (), **identity})


class _Statuses(DDS):  # type: ignore[misc]
    """Counts of an entity that the Python classes of 0.10.2 do not show.

    They could be had from listeners too, but a listener is called from Cyclone's own thread, and
    one that waits for the interpreter while the interpreter deletes the entity waits for ever.
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
    """Cyclone's writer or reader of a topic whose samples are bytes."""
    raw_type = _raw_type(topic.idl_type)
    announced = [Policy.Userdata(user_data)] if user_data else []
    cyclone_topic = CycloneTopic(participant.entity, topic.name, raw_type)
    return kind(participant.entity, cyclone_topic, Qos(*policies, *announced))


class RawWriter:
    """Publishes samples of one topic as bytes, until it or its participant is closed.

    Reliable, as the simulators write, so that reliable and best-effort readers match.
    A slow reliable reader never blocks it: what cannot be written at once is counted in `dropped`.

    Args:
        depth: how many samples are kept for reliable readers that have not confirmed them.
        latched: the last sample is kept for readers that come later (transient local).
        user_data: announced in discovery.
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
        self._writer = _create(DataWriter, participant, topic, user_data, *policies)
        participant.register(self)

    def close(self) -> None:
        self._writer = None

    def write(self, data: bytes, timestamp: int | None = None) -> bool:
        """Publish one sample.

        Args:
            data: the sample, CDR header included.
            timestamp: the publish time, ns since the epoch; now when left out.

        Returns:
            Whether it was written at once.
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
        """Change what is announced in discovery."""
        self._writer.set_qos(Qos(Policy.Userdata(user_data)))

    @property
    def matched(self) -> int:
        """How many readers are matched."""
        status = dds_c_t.publication_matched_status()
        _STATUSES.readers(self._writer._ref, ctypes.byref(status))
        return int(status.current_count)


class PublishersByTurns:
    """Tells publishers that publish by turns from one that was started anew.

    A program that is started anew has another publisher, and its predecessor is heard no more.
    """

    def __init__(self) -> None:
        self._by_recency: list[int] = []  # the newest last

    def hear(self, publisher: int) -> bool:
        """Note the publisher of a sample; whether it was heard before another one, too."""
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

    Best effort, so that it can never block a writer.

    Args:
        depth: how many samples are kept between two takes before the oldest is lost.
        ignore_own: do not match writers of the same participant.
        user_data: announced in discovery.

    Attributes:
        malformed: samples received that were not of the topic's type.
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
        """The samples received since the last take, oldest first; never waits.

        What is not one sample of the topic's type in plain little-endian CDR is left out and
        counted in `malformed`: a writer without type information is matched whatever it writes.
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
        """The newest sample since the last take, or None; never waits."""
        samples = self.take()
        return samples[-1] if samples else None

    @property
    def matched(self) -> int:
        """How many writers are matched."""
        return self.matches[0]

    @property
    def matches(self) -> tuple[int, int]:
        """How many writers are matched, and how many ever were."""
        status = dds_c_t.subscription_matched_status()
        _STATUSES.writers(self.entity._ref, ctypes.byref(status))
        return int(status.current_count), int(status.total_count)

    @property
    def lost(self) -> int:
        """How many samples DDS reports as lost."""
        status = dds_c_t.sample_lost_status()
        _STATUSES.lost(self.entity._ref, ctypes.byref(status))
        return int(status.total_count)
