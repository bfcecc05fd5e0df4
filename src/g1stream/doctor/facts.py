"""The doctor's records: facts that it gathers, and findings that it derives from them.

They are plain values, so that every rule can be tested without DDS.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum

from pydantic import ConfigDict, Field, field_serializer

from g1stream.realtime import Grant
from g1stream.session import summary

__all__ = [
    "Facts",
    "Finding",
    "HostFacts",
    "Interface",
    "Level",
    "Peer",
    "Qos",
    "StateFacts",
    "WakeupLatency",
    "WireFacts",
    "ok",
    "problem",
    "warning",
]


class Level(IntEnum):
    """Severity of a finding; the highest one is the exit code."""

    OK = 0
    WARNING = 1
    PROBLEM = 2


class Finding(summary.Finding):
    """The result of one check.

    Attributes:
        level: severity; its lower-case name in JSON.
        figures: measured values, by name and unit.
    """

    model_config = ConfigDict(frozen=True)

    level: Level
    figures: dict[str, int | float] = Field(default_factory=dict)

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
    """A network interface.

    Attributes:
        name: such as `lo` or `eth0`.
        up, loopback, multicast: the kernel's flags.
        address: its IPv4 address; empty where it has none.
    """

    name: str
    up: bool = True
    loopback: bool = False
    multicast: bool = True
    address: str = "127.0.0.1"


@dataclass(frozen=True)
class HostFacts:
    """The machine that the doctor runs on.

    Attributes:
        interfaces: all of them.
        uri: the user's CYCLONEDDS_URI; empty where it is not set.
        cyclonedds: the version of the Python package.
        rmem_max: the largest receive buffer of a socket, bytes; None where it cannot be read.
        clock_source: the kernel's; empty where it cannot be read.
        grants: what the system grants a real-time thread.
    """

    interfaces: tuple[Interface, ...]
    uri: str
    cyclonedds: str
    rmem_max: int | None
    clock_source: str
    grants: tuple[Grant, ...]


@dataclass(frozen=True)
class WakeupLatency:
    """How late the kernel wakes a thread that has the loop's rights and does nothing else.

    Attributes:
        rate: deadlines per second, Hz.
        deadlines: how many there were.
        missed: at how many the thread ran a whole period late or more.
        median_ns, worst_ns: latency, ns.
    """

    rate: float
    deadlines: int
    missed: int
    median_ns: int
    worst_ns: int


@dataclass(frozen=True)
class Qos:
    """The QoS policies that decide whether a writer and a reader match; times in ns.

    Attributes:
        reliable: reliable delivery is offered, or requested.
        durability: 0 volatile, 1 transient local, 2 transient, 3 persistent.
        deadline: the longest time between two samples.
        exclusive: exclusive ownership.
        partitions: names of the partitions; empty: the default one.
        xcdr1: plain CDR is written, or can be read.
    """

    reliable: bool = False
    durability: int = 0
    deadline: int = 2**63 - 1
    exclusive: bool = False
    partitions: tuple[str, ...] = ()
    xcdr1: bool = True


@dataclass(frozen=True)
class Peer:
    """A writer or reader of another participant.

    Attributes:
        topic, type_name: as announced.
        same_type: whether its type is that of g1stream; None where it does not announce one.
        qos: its policies.
        owner: its process, or its participant.
        participant: the GUID of its participant.
        observer: it announces that it does not act on what it reads, as our recorder does.
    """

    topic: str
    type_name: str
    same_type: bool | None = True
    qos: Qos = field(default_factory=Qos)
    owner: str = "an unnamed participant"
    participant: str = ""
    observer: bool = False


@dataclass(frozen=True)
class StateFacts:
    """The LowStates that were received while the doctor listened.

    Attributes:
        seconds: for how long it listened.
        received: how many LowStates were received.
        malformed: samples that were not one LowState.
        ages_ms: reception minus publish time, the median and the longest.
        tick_step: the usual step of the tick, ms; None where it is constant.
        missed: samples lost, by their ticks; None where the ticks cannot tell.
        crc_right, crc_zero: how many had a correct CRC, and how many had 0.
        mode_machine: of the last.
        has_rpy, has_motor_modes: whether the last had any of these set.
    """

    seconds: float
    received: int = 0
    malformed: int = 0
    ages_ms: tuple[float, float] = (0.0, 0.0)
    tick_step: int | None = None
    missed: int | None = None
    crc_right: int = 0
    crc_zero: int = 0
    mode_machine: int = 0
    has_rpy: bool = False
    has_motor_modes: bool = False


@dataclass(frozen=True)
class WireFacts:
    """The endpoints and samples in a DDS domain.

    Attributes:
        writers, readers: of other participants, on any topic.
        state: what was received on rt/lowstate.
        states_matched: how many writers of rt/lowstate match our reader.
        commands_matched: how many subscribers of rt/lowcmd that are no observers match a writer of
            ours; None where we have no writer, as the doctor.
        elsewhere: other places where rt/lowstate is published, (domain, interface, owner); looked
            for only if it is not published here.
        searched: the places that were searched for it, (domain, interface).
    """

    writers: tuple[Peer, ...] = ()
    readers: tuple[Peer, ...] = ()
    state: StateFacts = field(default_factory=lambda: StateFacts(0.0))
    states_matched: int = 0
    commands_matched: int | None = None
    elsewhere: tuple[tuple[int, str, str], ...] = ()
    searched: tuple[tuple[int, str], ...] = ()


@dataclass(frozen=True)
class Facts:
    """Everything the doctor knows.

    Attributes:
        domain, interface: where it looked.
        allowed_robots: values of mode_machine that may be commanded.
        host: this machine.
        wire: the domain; None where it could not be joined.
        join_error: why it could not be joined.
        wakeup_latency: of a thread on this machine; None where it was not measured.
    """

    domain: int
    interface: str
    allowed_robots: tuple[int, ...]
    host: HostFacts
    wire: WireFacts | None
    join_error: str = ""
    wakeup_latency: WakeupLatency | None = None
