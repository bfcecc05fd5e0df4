"""The doctor's records: facts that it gathers, and findings that it derives from them.

They are plain values, so that every rule can be tested without DDS.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum
from typing import TYPE_CHECKING

from pydantic import ConfigDict, Field, field_serializer

from g1stream.realtime import Grant
from g1stream.session import records
from g1stream.types import Via

if TYPE_CHECKING:
    from g1stream.dds.local_participants import LocalParticipant


class Level(IntEnum):
    """Severity of a finding; the highest one is the exit code."""

    OK = 0
    WARNING = 1  # may degrade a session
    PROBLEM = 2  # prevents a session


class Finding(records.Finding):
    """The result of one check; its level is a lower-case name in JSON."""

    model_config = ConfigDict(frozen=True)

    level: Level
    figures: dict[str, int | float] = Field(default_factory=dict)  # measured, by name and unit

    @field_serializer("level")
    def _level_name(self, level: Level) -> str:
        return level.name.lower()


def ok(about: str, cause: str) -> Finding:
    """A finding without a problem."""
    return Finding(level=Level.OK, about=about, cause=cause)


def warning(about: str, cause: str, remedy: str) -> Finding:
    """A finding that may degrade a session."""
    return Finding(level=Level.WARNING, about=about, cause=cause, remedy=remedy)


def problem(about: str, cause: str, remedy: str) -> Finding:
    """A finding that prevents a session."""
    return Finding(level=Level.PROBLEM, about=about, cause=cause, remedy=remedy)


@dataclass(frozen=True)
class Interface:
    """A network interface and the kernel's flags of it."""

    name: str
    up: bool = True
    loopback: bool = False
    multicast: bool = True
    address: str = "127.0.0.1"  # IPv4; empty where it has none


@dataclass(frozen=True)
class HostFacts:
    """The machine that the doctor runs on; None or empty where a value cannot be read."""

    interfaces: tuple[Interface, ...]
    uri: str  # the user's CYCLONEDDS_URI
    cyclonedds: str  # version of the Python package
    rmem_max: int | None  # the largest receive buffer of a socket, bytes
    clock_source: str  # the kernel's
    grants: tuple[Grant, ...]  # what the system grants a real-time thread


@dataclass(frozen=True)
class WakeupLatency:
    """How late the kernel wakes a thread that has the loop's rights and does nothing else."""

    rate: float  # deadlines per second, Hz
    deadlines: int
    missed: int  # deadlines at which the thread ran a whole period late or more
    median_ns: int
    worst_ns: int


@dataclass(frozen=True)
class Qos:
    """The QoS policies that decide whether a writer and a reader match."""

    reliable: bool = False  # offered, or requested
    durability: int = 0  # 0 volatile, 1 transient local, 2 transient, 3 persistent
    deadline: int = 2**63 - 1  # the longest time between two samples, ns
    exclusive: bool = False  # ownership
    partitions: tuple[str, ...] = ()  # empty: the default one
    xcdr1: bool = True  # plain CDR is written, or can be read


@dataclass(frozen=True)
class Peer:
    """A writer or reader of another participant."""

    topic: str
    type_name: str
    same_type: bool | None = True  # as that of g1stream; None where none is announced
    qos: Qos = field(default_factory=Qos)
    owner: str = "an unnamed participant"  # its process, or its participant
    participant: str = ""  # GUID
    observer: bool = False  # announces that it does not act on what it reads
    idle: bool = False  # announces that it has published no command, as a guard


@dataclass(frozen=True)
class StateFacts:
    """The LowStates that were received while the doctor listened."""

    seconds: float  # for how long it listened
    received: int = 0
    malformed: int = 0  # samples that were not one LowState
    ages_ms: tuple[float, float] = (0.0, 0.0)  # reception minus publish time: median, longest
    tick_step: int | None = None  # usual, ms; None where the tick is constant
    tick_jumps: int = 0  # steps that skipped a tick; without our bridge no more than a hint
    missed: int | None = None  # lost by their ticks; None without our bridge
    crc_right: int = 0
    crc_zero: int = 0
    mode_machine: int = 0  # of the last, as the two below
    has_rpy: bool = False
    has_motor_modes: bool = False


@dataclass(frozen=True)
class WireFacts:
    """The endpoints and samples in a DDS domain.

    Attributes:
        writers, readers: of other participants, on any topic.
        state: what was received on rt/lowstate.
        states_matched: how many writers of rt/lowstate match our reader.
        commands_matched: how many subscribers of our commands that are no observers match a writer
            of ours; None where we have no writer, as the doctor.
        elsewhere: other places where rt/lowstate is published, (domain, interface, owner); looked
            for only if it is not published here.
        searched: the places that were searched for it, (domain, interface).
        local: the programs of this machine that take part in any domain; likewise.
    """

    writers: tuple[Peer, ...] = ()
    readers: tuple[Peer, ...] = ()
    state: StateFacts = field(default_factory=lambda: StateFacts(0.0))
    states_matched: int = 0
    commands_matched: int | None = None
    elsewhere: tuple[tuple[int, str, str], ...] = ()
    searched: tuple[tuple[int, str], ...] = ()
    local: tuple[LocalParticipant, ...] = ()

    def writers_of(self, topic: str) -> list[Peer]:
        """The writers of a topic."""
        return [peer for peer in self.writers if peer.topic == topic]


@dataclass(frozen=True)
class Facts:
    """Everything the doctor knows."""

    domain: int
    interface: str
    allowed_robots: tuple[int, ...]  # values of mode_machine that may be commanded
    host: HostFacts
    wire: WireFacts | None  # None where the domain could not be joined
    join_error: str = ""  # why it could not be joined
    wakeup_latency: WakeupLatency | None = None  # None where it was not measured
    via: Via = "lowcmd"  # what is to be commanded
    ros_domain: int | None = None  # ROS_DOMAIN_ID, where no domain was given
