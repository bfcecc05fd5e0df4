"""Endpoints of other participants as discovery announces them, and what g1stream announces."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import inf
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from cyclonedds.core import Policy

from g1stream.dds.messages import COMMAND_NAMES, LOG, LOWSTATE, REFERENCE, TOPICS

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable

__all__ = [
    "GUARD_PROGRAM",
    "IDLE",
    "OBSERVER",
    "PUBLISHING",
    "AnnouncedBridge",
    "Endpoint",
    "Qos",
    "identify_program",
    "program_of",
    "topics_of",
]

GUARD_PROGRAM: Final = "g1stream guard"
"""Name of a guard, as of `program_of`."""


# g1stream's programs announce themselves in the user data of their writers and readers. User data
# is part of discovery (DDS 1.4, 2.2.3.1), needs no topic or message, does not affect matching, and
# is ignored by other programs. A robot and unitree_mujoco announce nothing.
OBSERVER: Final = b"g1stream.observer"
"""User data of a reader of LowCmd that does not act on it."""

IDLE: Final = b"g1stream.idle"
"""User data of a writer of commands that has not published yet, such as a guard's."""

PUBLISHING: Final = b"g1stream.publishing"
"""User data of a writer of commands that has published."""

_BRIDGE: Final = "g1stream.bridge="


class AnnouncedBridge(NamedTuple):
    """Announcement of g1stream's own bridge in the user data of its LowState writer.

    Attributes:
        support: how the bridge holds the robot.
        robot: name of the simulated robot.
        rate: LowStates per second, Hz. Ticks count ms and number the LowStates only of this bridge.
    """

    support: str
    robot: str = ""
    rate: float = 500.0

    @classmethod
    def by(cls, writers: Iterable[Endpoint]) -> AnnouncedBridge | None:
        """Read the announcement of LowState writers; None if there is none or several differ."""
        found = {one.user_data for one in writers if one.user_data.startswith(_BRIDGE.encode())}
        if len(found) != 1:
            return None
        text = found.pop().decode(errors="replace").removeprefix(_BRIDGE)
        support, rate, robot = (*text.split(";", 2), "", "")[:3]
        try:
            announced = cls(support, robot, float(rate))
        except ValueError:
            return None
        return announced if 1.0 <= announced.rate < inf else None

    @property
    def user_data(self) -> bytes:
        """The announcement as user data."""
        return f"{_BRIDGE}{self.support};{self.rate};{self.robot}".encode()

    @property
    def tick_step(self) -> float:
        """Time from one LowState to the next, ms."""
        return 1000.0 / self.rate


_DURABILITIES: Final = (
    Policy.Durability.Volatile,
    Policy.Durability.TransientLocal,
    Policy.Durability.Transient,
    Policy.Durability.Persistent,
)


@dataclass(frozen=True)
class Qos:
    """The QoS policies that decide whether a writer and a reader match."""

    reliable: bool = False  # offered, or requested
    durability: int = 0  # 0 volatile, 1 transient local, 2 transient, 3 persistent
    deadline: int = 2**63 - 1  # maximum time between two samples, ns
    exclusive: bool = False  # exclusive ownership
    partitions: tuple[str, ...] = ()  # empty: the default partition
    xcdr1: bool = True  # whether plain CDR is written, or can be read

    @classmethod
    def of(cls, policies: Any) -> Qos:
        """The relevant policies of a Cyclone `Qos`; DDS's defaults for those that are not set."""
        given = {one.__scope__: one for one in policies or ()}
        durability = given.get("Durability", Policy.Durability.Volatile)
        return cls(
            isinstance(given.get("Reliability"), Policy.Reliability.Reliable),
            _DURABILITIES.index(durability),
            given["Deadline"].deadline if "Deadline" in given else cls.deadline,
            given.get("Ownership") == Policy.Ownership.Exclusive,
            tuple(given["Partition"].partitions) if "Partition" in given else (),
            getattr(given.get("DataRepresentation"), "use_cdrv0_representation", True),
        )


@dataclass(frozen=True)
class Endpoint:
    """A writer or reader of another participant.

    Attributes:
        topic, type_name: as announced in discovery.
        participant: GUID of its participant.
        host, pid, process: host, process id and process name of its participant; empty if not
            announced.
        handle: the `publication_handle` of its samples, for a writer.
        policies: Cyclone's Qos, as announced.
        type_id: XTypes identifier of the announced type; None if not announced.
    """

    topic: str
    type_name: str
    participant: str
    host: str = ""
    pid: str = ""
    process: str = ""
    handle: int = 0
    policies: Any = field(default=None, compare=False, repr=False)
    type_id: Any = field(default=None, compare=False, repr=False)

    # The policies and the type are looked at only on demand: a stream lists endpoints as it runs.
    @property
    def qos(self) -> Qos:
        """The announced QoS."""
        return Qos.of(self.policies)

    @property
    def user_data(self) -> bytes:
        """The announced user data; empty if there is none."""
        return next((p.data for p in self.policies or () if isinstance(p, Policy.Userdata)), b"")

    @property
    def idle(self) -> bool:
        """Whether it is announced as a writer of commands that has not published."""
        return self.user_data == IDLE

    @property
    def observer(self) -> bool:
        """Whether it is announced as a reader that does not act on samples."""
        return self.user_data == OBSERVER

    @property
    def same_type(self) -> bool | None:
        """Whether its type is g1stream's; None if not announced, or on a topic of others."""
        ours = next((one.idl_type for one in TOPICS if one.name == self.topic), None)
        if ours is None or self.type_id is None:
            return None
        ours.__idl__.populate()
        return bool(self.type_id == ours.__idl__.get_type_id())

    def owner(self, writers: Iterable[Endpoint], readers: Iterable[Endpoint]) -> str:
        """Its process or participant, named after the program that the topics of it show."""
        program = program_of(self.participant, writers, readers)
        if not self.pid:
            return f"participant {self.participant}"
        process, host = program or self.process or "process", self.host or "an unknown host"
        return f"{process} (pid {self.pid} on {host})"


def topics_of(
    participants: Collection[str], writers: Iterable[Endpoint], readers: Iterable[Endpoint]
) -> tuple[set[str], set[str]]:
    """Topics that participants, by GUID, write and read."""
    written = {one.topic for one in writers if one.participant in participants}
    return written, {one.topic for one in readers if one.participant in participants}


def program_of(participant: str, writers: Iterable[Endpoint], readers: Iterable[Endpoint]) -> str:
    """Name of the g1stream program that a participant, by GUID, belongs to, or ""."""
    return identify_program(*topics_of([participant], writers, readers))


def identify_program(written: set[str], read: set[str]) -> str:
    """Name of the g1stream program that writes and reads these topics, or ""."""
    if REFERENCE.name in written:
        return "g1stream stream"
    if {LOG.name, LOWSTATE.name} <= written:
        return "g1stream sim"
    if LOG.name in written and written & COMMAND_NAMES:
        return GUARD_PROGRAM
    if {LOG.name, REFERENCE.name} <= read and not written:
        return "g1stream record"
    return ""
