"""Join a DDS domain on one network interface, and list the endpoints of other participants.

On loopback the released Cyclone versions use multicast differently. Version 0.10.x, which the SDK
and the robot use, turns it off there, and 11.x does not. With a plain configuration the two
versions never discover each other. With 127.0.0.1 as a peer they do, in either start order. A wired
interface needs no such configuration.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field, replace
from math import inf
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Protocol

from cyclonedds.builtin import (
    BuiltinDataReader,
    BuiltinTopicDcpsParticipant,
    BuiltinTopicDcpsPublication,
    BuiltinTopicDcpsSubscription,
)
from cyclonedds.core import DDSException, InstanceState, Policy
from cyclonedds.domain import Domain, DomainParticipant

from g1stream.dds.messages import ARM_SDK, LOG, LOWCMD, LOWSTATE, REFERENCE
from g1stream.errors import WireError
from g1stream.network import is_loopback, require_interface

if TYPE_CHECKING:
    from collections.abc import Iterable

__all__ = [
    "DISCOVERY",
    "GUARD_PROGRAM",
    "IDLE",
    "OBSERVER",
    "PUBLISHING",
    "SETTLE",
    "AnnouncedBridge",
    "Endpoint",
    "Participant",
    "identify_program",
]

GUARD_PROGRAM: Final = "g1stream guard"
"""First words of `Participant.owner` for a guard."""

#: Highest domain id; the ports of a higher one would be above 65535 (RTPS 2.5, 9.6.2).
MAX_DOMAIN: Final = 232

# The kernel limits the receive buffer to net.core.rmem_max. Cyclone's 1 MB overflows if a busy
# machine does not schedule a process for 0.1 s.
_CONFIG: Final = (
    '<CycloneDDS><Domain Id="any">'
    '<General><Interfaces><NetworkInterface name="{interface}"/></Interfaces>{multicast}</General>'
    '<Internal><SocketReceiveBufferSize max="16MB"/></Internal>'
    "{discovery}</Domain></CycloneDDS>"
)
#: Samples use unicast, because on loopback, multicast would wake every process in the domain,
#: including the sender.
_LOOPBACK_MULTICAST: Final = "<AllowMulticast>spdp</AllowMulticast>"
_LOOPBACK_DISCOVERY: Final = (
    "<Discovery><ParticipantIndex>auto</ParticipantIndex>"
    '<Peers><Peer Address="127.0.0.1"/></Peers></Discovery>'
)


DISCOVERY: Final = 0.3
"""Time in which a new participant discovers the participants that are already in its domain, s."""

SETTLE: Final = 0.1
"""Additional time in which a participant that joined at the same time is discovered, s."""


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


@dataclass(frozen=True)
class Endpoint:
    """A writer or reader of another participant.

    Attributes:
        topic, type_name: as announced in discovery.
        participant: GUID of its participant.
        host, pid, process: host, process id and process name of its participant; empty if not
            announced.
        handle: the `publication_handle` of its samples, for a writer.
        qos: Cyclone's Qos, as announced.
        type_id: XTypes identifier of the announced type; None if not announced.
    """

    topic: str
    type_name: str
    participant: str
    host: str = ""
    pid: str = ""
    process: str = ""
    handle: int = 0
    qos: Any = field(default=None, compare=False, repr=False)
    type_id: Any = field(default=None, compare=False, repr=False)

    @property
    def user_data(self) -> bytes:
        """The announced user data; empty if there is none."""
        return next((p.data for p in self.qos or () if isinstance(p, Policy.Userdata)), b"")

    @property
    def idle(self) -> bool:
        """Whether it is announced as a writer of commands that has not published."""
        return self.user_data == IDLE

    def __str__(self) -> str:
        if not self.pid:
            return f"participant {self.participant}"
        return f"{self.process or 'process'} (pid {self.pid} on {self.host or 'an unknown host'})"


def identify_program(written: set[str], read: set[str]) -> str:
    """Name of the g1stream program that writes and reads these topics, or ""."""
    if REFERENCE.name in written:
        return "g1stream stream"
    if {LOG.name, LOWSTATE.name} <= written:
        return "g1stream sim"
    if LOG.name in written and written & {LOWCMD.name, ARM_SDK.name}:
        return GUARD_PROGRAM
    if {LOG.name, REFERENCE.name} <= read and not written:
        return "g1stream record"
    return ""


class Closable(Protocol):
    """Interface of an entity that its participant closes."""

    def close(self) -> None: ...


class Participant:
    """One participant in a DDS domain, and the entities made from it.

    Args:
        domain: the DDS domain id, 0 to 232. Simulators use 1, and the robot uses 0.
        interface: the network interface to use, such as `lo` or `eth0`.

    Attributes:
        uses_environment: whether CYCLONEDDS_URI was set and used instead of `interface`.

    Raises:
        WireError: the interface does not exist, this process is in the domain on another interface,
            or Cyclone cannot start there.
    """

    # Cyclone accepts one configuration per domain id in a process, before the first participant.
    _domains: dict[int, tuple[Domain, str, int]] = {}  # noqa: RUF012

    def __init__(self, domain: int, interface: str) -> None:
        require_interface(interface)
        self.domain = domain
        self.interface = interface
        self.uses_environment = bool(os.environ.get("CYCLONEDDS_URI"))
        self._entities: list[Closable] = []
        try:
            if not self.uses_environment:
                self._configure()
            self.entity: Any = DomainParticipant(domain)
        except DDSException as error:
            self._release()
            raise WireError(
                f"Cyclone DDS cannot join domain {domain} on {interface}: {error.msg or error}.",
                "Check CYCLONEDDS_URI if it is set, and that fewer than ten other participants use "
                "the domain on this machine (a recorder has two).",
            ) from error
        self._participants = BuiltinDataReader(self.entity, BuiltinTopicDcpsParticipant)
        self._writers = BuiltinDataReader(self.entity, BuiltinTopicDcpsPublication)
        self._readers = BuiltinDataReader(self.entity, BuiltinTopicDcpsSubscription)

    def _configure(self) -> None:
        entity, interface, users = self._domains.get(self.domain, (None, self.interface, 0))
        if interface != self.interface:
            raise WireError(
                f"This process uses {interface} for domain {self.domain} and cannot use "
                f"{self.interface} as well.",
                "Use the same interface for the domain, or another domain.",
            )
        if entity is None:
            here = is_loopback(self.interface)
            config = _CONFIG.format(
                interface=self.interface,
                multicast=_LOOPBACK_MULTICAST if here else "",
                discovery=_LOOPBACK_DISCOVERY if here else "",
            )
            entity = Domain(self.domain, config)
        self._domains[self.domain] = (entity, interface, users + 1)

    def _release(self) -> None:
        entity, interface, users = self._domains.get(self.domain, (None, "", 0))
        if entity is None or self.uses_environment:
            return
        if users > 1:
            self._domains[self.domain] = (entity, interface, users - 1)
        else:
            del self._domains[self.domain]

    def register(self, entity: Closable) -> None:
        """Close an entity together with this participant, even if there are references to it."""
        self._entities.append(entity)

    def writers(self, topic: str | None = None) -> list[Endpoint]:
        """Discovered writers of a topic, or of all topics, without this participant's."""
        return self._endpoints(self._writers, topic)

    def readers(self, topic: str | None = None) -> list[Endpoint]:
        """Discovered readers of a topic, or of all topics, without this participant's."""
        return self._endpoints(self._readers, topic)

    def commanders(self, topic: str = LOWCMD.name) -> list[Endpoint]:
        """Discovered writers of commands, without idle ones and this participant's."""
        return [writer for writer in self.writers(topic) if not writer.idle]

    def owner(self, endpoint: Endpoint) -> str:
        """The process or participant of an endpoint, with the name of a g1stream program."""
        program = identify_program(
            {one.topic for one in self.writers() if one.participant == endpoint.participant},
            {one.topic for one in self.readers() if one.participant == endpoint.participant},
        )
        return str(replace(endpoint, process=program) if program else endpoint)

    def _endpoints(self, reader: Any, topic: str | None) -> list[Endpoint]:
        properties = {
            str(one.key): {p.key: p.value for p in one.qos if hasattr(p, "value")}
            for one in _alive(self._participants)
        }
        found = []
        for sample in _alive(reader):
            if topic not in (None, sample.topic_name):
                continue
            if sample.participant_key == self.entity.guid:
                continue
            owner = str(sample.participant_key)
            about = properties.get(owner, {})
            host, pid, process = (
                about.get(key, "") for key in ("__Hostname", "__Pid", "__ProcessName")
            )
            found.append(
                Endpoint(
                    sample.topic_name,
                    sample.type_name,
                    owner,
                    host,
                    pid,
                    process,
                    sample.sample_info.instance_handle,
                    sample.qos,
                    sample.type_id,
                )
            )
        return found

    def close(self) -> None:
        """Leave the domain; closes all entities made from this participant."""
        if not hasattr(self, "entity"):
            return
        # Cyclone's Python entities are deleted with their last reference, so the order matters:
        # children first, the domain last.
        for entity in self._entities:
            entity.close()
        self._entities.clear()
        del self._participants, self._writers, self._readers
        del self.entity
        self._release()

    def __enter__(self) -> Participant:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def _alive(reader: Any) -> list[Any]:
    """Samples of a built-in reader whose entities exist now; they are not removed from it."""
    alive = InstanceState.Alive
    return [s for s in reader.read(1024) if s.sample_info.instance_state & alive]
