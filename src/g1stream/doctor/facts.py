"""Records of the doctor: the gathered facts, and the findings from them.

They are plain values, so every rule can be tested without DDS.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum
from typing import TYPE_CHECKING

from pydantic import ConfigDict, Field, field_serializer

from g1stream.dds.discovery import Endpoint
from g1stream.network import InterfaceFlags
from g1stream.realtime import Grant
from g1stream.session import records
from g1stream.types import Via

if TYPE_CHECKING:
    from collections.abc import Iterable

    from g1stream.dds.local_participants import LocalParticipant
    from g1stream.dds.messages import Topic


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
    """A network interface."""

    name: str
    flags: InterfaceFlags
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
    mode_machine: int = 0  # of the last LowState, like the next three fields
    mode_pr: int = 0
    has_rpy: bool = False
    has_motor_modes: bool = False


@dataclass(frozen=True)
class WireFacts:
    """The endpoints and samples in a DDS domain.

    Attributes:
        domain, interface: the domain, and the network interface on which it is used.
        writers, readers: endpoints of other participants, on topics of the robot.
        state: LowStates received on rt/lowstate.
        states_matched: number of writers of rt/lowstate that match the reader of this process.
        commands_matched: number of command subscribers, without observers, that match the writer of
            this process; None without a writer, as in the doctor.
        elsewhere: other publishers of rt/lowstate, as (domain, interface, owner); searched only if
            it is not published in this domain and on this interface.
        searched: the searched places, as (domain, interface).
        unsearched: the other interfaces of this machine.
        local: DDS programs on this machine in any domain; also only after a search.
        join_error: why the domain could not be joined, which leaves the rest unknown; or empty.
    """

    domain: int
    interface: str
    writers: tuple[Endpoint, ...] = ()
    readers: tuple[Endpoint, ...] = ()
    state: StateFacts = field(default_factory=lambda: StateFacts(0.0))
    states_matched: int = 0
    commands_matched: int | None = None
    elsewhere: tuple[tuple[int, str, str], ...] = ()
    searched: tuple[tuple[int, str], ...] = ()
    unsearched: tuple[str, ...] = ()
    local: tuple[LocalParticipant, ...] = ()
    join_error: str = ""

    @property
    def here(self) -> str:
        """The domain and the interface in a sentence."""
        return f"in domain {self.domain} on {self.interface}"

    def writers_of(self, topic: Topic) -> list[Endpoint]:
        """Writers of a topic, without those that have published no command."""
        return [one for one in self.writers if one.topic == topic.name and not one.idle]

    def readers_of(self, topic: Topic) -> list[Endpoint]:
        """Readers of a topic, without observers."""
        return [one for one in self.readers if one.topic == topic.name and not one.observer]

    def owners(self, endpoints: Iterable[Endpoint]) -> str:
        """The owners of endpoints, each once."""
        return ", ".join(sorted({one.owner(self.writers, self.readers) for one in endpoints}))


@dataclass(frozen=True)
class Facts:
    """All facts that the doctor gathered."""

    wire: WireFacts
    host: HostFacts
    allowed_robots: tuple[int, ...]  # values of mode_machine that may be commanded
    wakeup_latency: WakeupLatency | None = None  # None if not measured
    via: Via = "lowcmd"  # receiver of the commands
    ros_domain: int | None = None  # ROS_DOMAIN_ID, if no domain was given
