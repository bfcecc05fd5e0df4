"""Records of the doctor: the gathered facts, and the findings from them.

They are plain values, so every rule can be tested without DDS.
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
    """The result of one check; in JSON, its level is a lower-case name."""

    model_config = ConfigDict(frozen=True)

    level: Level
    figures: dict[str, int | float] = Field(default_factory=dict)  # measurements by name_unit

    @field_serializer("level")
    def _level_name(self, level: Level) -> str:
        return level.name.lower()


def ok(about: str, cause: str) -> Finding:
    """Make a finding without a problem."""
    return Finding(level=Level.OK, about=about, cause=cause)


def warning(about: str, cause: str, remedy: str) -> Finding:
    """Make a finding that may degrade a session."""
    return Finding(level=Level.WARNING, about=about, cause=cause, remedy=remedy)


def problem(about: str, cause: str, remedy: str) -> Finding:
    """Make a finding that prevents a session."""
    return Finding(level=Level.PROBLEM, about=about, cause=cause, remedy=remedy)


@dataclass(frozen=True)
class Interface:
    """A network interface with its kernel flags."""

    name: str
    up: bool = True
    loopback: bool = False
    multicast: bool = True
    address: str = "127.0.0.1"  # IPv4; empty without an address


@dataclass(frozen=True)
class HostFacts:
    """Facts about this machine; None or empty if a value cannot be read."""

    interfaces: tuple[Interface, ...]
    uri: str  # the user's CYCLONEDDS_URI
    cyclonedds: str  # version of the Python package
    rmem_max: int | None  # maximum receive buffer of a socket, bytes
    clock_source: str  # clock source of the kernel
    grants: tuple[Grant, ...]  # real-time requests and their results


@dataclass(frozen=True)
class WakeupLatency:
    """Wake-up latency of an idle thread with the scheduling of the loop."""

    rate: float  # deadlines per second, Hz
    deadlines: int
    missed: int  # deadlines at which the thread was late by a period or more
    median_ns: int
    worst_ns: int


@dataclass(frozen=True)
class Qos:
    """The QoS policies that decide whether a writer and a reader match."""

    reliable: bool = False  # offered, or requested
    durability: int = 0  # 0 volatile, 1 transient local, 2 transient, 3 persistent
    deadline: int = 2**63 - 1  # maximum time between two samples, ns
    exclusive: bool = False  # exclusive ownership
    partitions: tuple[str, ...] = ()  # empty: the default partition
    xcdr1: bool = True  # whether plain CDR is written, or can be read


@dataclass(frozen=True)
class Peer:
    """A writer or reader of another participant."""

    topic: str
    type_name: str
    same_type: bool | None = True  # whether its type is g1stream's; None if not announced
    qos: Qos = field(default_factory=Qos)
    owner: str = "an unnamed participant"  # its process or participant
    participant: str = ""  # GUID
    observer: bool = False  # whether it announces not to act on samples
    idle: bool = False  # whether it announces to have published no command, like a guard


@dataclass(frozen=True)
class StateFacts:
    """The LowStates that the doctor received."""

    seconds: float  # duration of listening
    received: int = 0
    malformed: int = 0  # samples that are not a LowState
    ages_ms: tuple[float, float] = (0.0, 0.0)  # reception minus publish time: median, maximum
    tick_step: int | None = None  # most frequent step, ms; None if the tick is constant
    tick_jumps: int = 0  # steps that skipped a tick; only a hint without g1stream's bridge
    missed: int | None = None  # lost samples by ticks; None without g1stream's bridge
    crc_right: int = 0
    crc_zero: int = 0
    mode_machine: int = 0  # of the last LowState, like the next two fields
    has_rpy: bool = False
    has_motor_modes: bool = False


@dataclass(frozen=True)
class WireFacts:
    """The endpoints and samples in a DDS domain.

    Attributes:
        writers, readers: endpoints of other participants, on any topic.
        state: LowStates received on rt/lowstate.
        states_matched: number of writers of rt/lowstate that match the reader of this process.
        commands_matched: number of command subscribers, without observers, that match the writer of
            this process; None without a writer, as in the doctor.
        elsewhere: other publishers of rt/lowstate, as (domain, interface, owner); searched only if
            it is not published in this domain and on this interface.
        searched: the searched places, as (domain, interface).
        unsearched: the other interfaces of this machine.
        local: DDS programs on this machine in any domain; also only after a search.
    """

    writers: tuple[Peer, ...] = ()
    readers: tuple[Peer, ...] = ()
    state: StateFacts = field(default_factory=lambda: StateFacts(0.0))
    states_matched: int = 0
    commands_matched: int | None = None
    elsewhere: tuple[tuple[int, str, str], ...] = ()
    searched: tuple[tuple[int, str], ...] = ()
    unsearched: tuple[str, ...] = ()
    local: tuple[LocalParticipant, ...] = ()

    def writers_of(self, topic: str) -> list[Peer]:
        """Writers of a topic."""
        return [peer for peer in self.writers if peer.topic == topic]


@dataclass(frozen=True)
class Facts:
    """All facts that the doctor gathered."""

    domain: int
    interface: str
    allowed_robots: tuple[int, ...]  # values of mode_machine that may be commanded
    host: HostFacts
    wire: WireFacts | None  # None if the domain could not be joined
    join_error: str = ""  # why it could not be joined
    wakeup_latency: WakeupLatency | None = None  # None if not measured
    via: Via = "lowcmd"  # receiver of the commands
    ros_domain: int | None = None  # ROS_DOMAIN_ID, if no domain was given
