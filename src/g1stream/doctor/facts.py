"""What the doctor knows: plain values, so that every judgement can be tested without a wire."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from g1stream.realtime import Grant

__all__ = [
    "Facts",
    "HostFacts",
    "Interface",
    "Peer",
    "Punctuality",
    "Qos",
    "StateFacts",
    "WireFacts",
]


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
        grants: what the system grants a loop that must be on time.
    """

    interfaces: tuple[Interface, ...]
    uri: str
    cyclonedds: str
    rmem_max: int | None
    clock_source: str
    grants: tuple[Grant, ...]


@dataclass(frozen=True)
class Punctuality:
    """How punctually a thread with the loop's rights was woken when nothing else was asked of it.

    Attributes:
        rate: deadlines per second, Hz.
        deadlines: how many there were.
        missed: how many had passed by a whole period or more when the thread ran.
        usual_ns, worst_ns: how late it ran, the median and the most, ns.
    """

    rate: float
    deadlines: int
    missed: int
    usual_ns: int
    worst_ns: int


@dataclass(frozen=True)
class Qos:
    """The policies by which DDS decides whether a writer and a reader fit; times in ns.

    Attributes:
        reliable: guaranteed delivery is offered, or asked for.
        durability: 0 volatile, 1 transient local, 2 transient, 3 persistent.
        deadline: the longest time between two samples.
        exclusive: whether only the strongest writer is heard.
        partitions: names of the partitions; empty: the default one.
        xcdr1: whether plain CDR is written, or can be read.
    """

    reliable: bool = False
    durability: int = 0
    deadline: int = 2**63 - 1
    exclusive: bool = False
    partitions: tuple[str, ...] = ()
    xcdr1: bool = True


@dataclass(frozen=True)
class Peer:
    """A writer or reader that somebody else has on a topic.

    Attributes:
        topic, type_name: as announced.
        same_type: whether its type is that of g1stream; None where it does not announce one.
        qos: its policies.
        who: its process, or its participant.
        participant: the GUID of its participant.
        only_looks: it says that it does not obey what it reads.
    """

    topic: str
    type_name: str
    same_type: bool | None = True
    qos: Qos = field(default_factory=Qos)
    who: str = "somebody"
    participant: str = ""
    only_looks: bool = False


@dataclass(frozen=True)
class StateFacts:
    """The LowStates that came while the doctor listened.

    Attributes:
        seconds: for how long it listened.
        received: how many came.
        malformed: how many came that were no LowState.
        ages_ms: from its publish time to its reception, the median and the longest.
        tick_step: the tick's usual step, ms; None where it stands still.
        missed: how many did not come, by their ticks; None where they cannot tell.
        crc_right, crc_zero: how many carried their own checksum, and how many none.
        mode_machine: of the last.
        has_rpy, has_motor_modes: whether the last had any of these.
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
    """Who and what is in the domain.

    Attributes:
        writers, readers: everybody else's, on any topic.
        state: what came on rt/lowstate.
        states_matched: how many writers of rt/lowstate are matched with our reader.
        commands_matched: how many obedient readers of rt/lowcmd are matched with a writer of ours;
            None where there is none, as the doctor has none.
        elsewhere: where else somebody publishes rt/lowstate: (domain, interface, who); looked for
            only if nobody does here.
        searched: the places that were looked at for that, (domain, interface).
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
    """All of it.

    Attributes:
        domain, interface: where the doctor looked.
        robots: values of mode_machine that may be commanded.
        host: this machine.
        wire: the domain; None where it could not be joined.
        cannot_join: why not.
        punctuality: how a trial of this machine's deadlines went; None where there was none.
    """

    domain: int
    interface: str
    robots: tuple[int, ...]
    host: HostFacts
    wire: WireFacts | None
    cannot_join: str = ""
    punctuality: Punctuality | None = None
