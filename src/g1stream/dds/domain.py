"""Join a DDS domain on one network interface, and list the endpoints of other participants.

On loopback the released Cyclone versions use multicast differently. Version 0.10.x, which the SDK
and the robot use, turns it off there, and 11.x does not. With a plain configuration the two
versions never discover each other. With 127.0.0.1 as a peer they do, in either start order. A wired
interface needs no such configuration.
"""

from __future__ import annotations

import os
import socket
import threading
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Protocol

from cyclonedds.builtin import (
    BuiltinDataReader,
    BuiltinTopicDcpsParticipant,
    BuiltinTopicDcpsPublication,
    BuiltinTopicDcpsSubscription,
)
from cyclonedds.core import (
    DDSException,
    InstanceState,
    ReadCondition,
    SampleState,
    ViewState,
)
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.internal import DDS

from g1stream.dds.discovery import Endpoint
from g1stream.dds.messages import LOWCMD
from g1stream.dds.udp_sockets import socket_inodes
from g1stream.errors import WireError
from g1stream.network import is_loopback, require_interface

__all__ = ["DISCOVERY", "SETTLE", "Participant"]

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


#: Entities that are read from discovery at once.
_AT_ONCE: Final = 1024

DISCOVERY: Final = 0.3
"""Time in which a new participant discovers the participants that are already in its domain, s."""

SETTLE: Final = 0.1
"""Additional time in which a participant that joined at the same time is discovered, s."""


class Closable(Protocol):
    """Interface of an entity that its participant closes."""

    def close(self) -> None: ...


@dataclass
class _Joined:
    """A domain that this process has joined.

    Attributes:
        interface: the network interface.
        entity: Cyclone's domain; None if CYCLONEDDS_URI configures it.
        threads: see `Participant`.
        sockets: file descriptors of the network sockets, with their inodes.
        participants: number of participants in it.
        log_mask: Cyclone's log mask before the sockets were shut down; None: they send.
    """

    interface: str
    entity: Domain | None
    threads: list[int]
    sockets: list[tuple[int, int]]
    participants: int = 0
    log_mask: int | None = None


class Participant:
    """One participant in a DDS domain, and the entities made from it.

    Args:
        domain: the DDS domain id, 0 to 232. Simulators use 1, and the robot uses 0.
        interface: the network interface to use, such as `lo` or `eth0`.

    Attributes:
        uses_environment: whether CYCLONEDDS_URI was set and used instead of `interface`.
        threads: ids of the threads that Cyclone runs for the domain. The loop depends on the
            messages that they receive, and sometimes on a lock that one holds.

    Raises:
        WireError: the interface does not exist, this process is in the domain on another interface
            or cannot send there any more, or Cyclone cannot start there.
    """

    # Cyclone accepts one configuration per domain id in a process, before the first participant.
    _domains: dict[int, _Joined] = {}  # noqa: RUF012

    def __init__(self, domain: int, interface: str) -> None:
        require_interface(interface)
        self.domain = domain
        self.interface = interface
        self.uses_environment = bool(os.environ.get("CYCLONEDDS_URI"))
        self._entities: list[Closable] = []
        joined = self._domains.get(domain)
        if joined:
            self._require_as(joined)
        entity: Domain | None = None
        threads, sockets = _native_threads(), socket_inodes(Path("/proc/self"))
        try:
            if not (joined or self.uses_environment):
                entity = Domain(domain, _config(interface))
            self.entity: Any = DomainParticipant(domain)
        except DDSException as error:
            del entity  # the traceback would keep it
            raise WireError(
                f"Cyclone DDS cannot join domain {domain} on {interface}: {error.msg or error}.",
                "Check CYCLONEDDS_URI if it is set, and that fewer than ten other participants use "
                "the domain on this machine (a recorder has two).",
            ) from error
        if joined is None:
            opened = socket_inodes(Path("/proc/self"))
            joined = self._domains[domain] = _Joined(
                interface,
                entity,
                sorted(_native_threads() - threads),
                sorted((opened[inode], inode) for inode in opened.keys() - sockets),
            )
        joined.participants += 1
        self._joined, self.threads = joined, joined.threads
        self._participants = _Discovered(self.entity, BuiltinTopicDcpsParticipant)
        self._writers = _Discovered(self.entity, BuiltinTopicDcpsPublication)
        self._readers = _Discovered(self.entity, BuiltinTopicDcpsSubscription)

    def _require_as(self, joined: _Joined) -> None:
        """Check that this participant can send as those that this process has in the domain.

        Raises:
            WireError: they use another interface, or a guard process has shut their sockets down.
        """
        uses = "CYCLONEDDS_URI" if joined.entity is None else joined.interface
        wanted = "CYCLONEDDS_URI" if self.uses_environment else self.interface
        if uses != wanted:
            raise WireError(
                f"This process uses {uses} for domain {self.domain} and cannot use {wanted} "
                "as well.",
                "Use the same interface for the domain, or another domain.",
            )
        if joined.log_mask is not None:
            raise WireError(
                f"The guard has shut down the sockets of this process for domain {self.domain}.",
                "Close the stream that it took over from, then start again.",
            )

    @property
    def sockets(self) -> list[int]:
        """File descriptors of the domain's network sockets, which send and receive."""
        return [number for number, inode in self._joined.sockets if _is_socket(number, inode)]

    def cut_off(self) -> None:
        """Note that the sockets have been shut down for sending, as by a guard process.

        Until the last participant is closed, Cyclone does not print a line for each packet.
        """
        if self._joined.log_mask is None:
            self._joined.log_mask = DDS._dll_handle.dds_get_log_mask()
            DDS._dll_handle.dds_set_log_mask(0)

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
        return endpoint.owner(self.writers(), self.readers())

    def _endpoints(self, discovered: _Discovered, topic: str | None) -> list[Endpoint]:
        properties = {
            str(one.key): {p.key: p.value for p in one.qos if hasattr(p, "value")}
            for one in self._participants.alive()
        }
        found = []
        for sample in discovered.alive():
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
        joined = self._joined
        joined.participants -= 1
        last = not joined.participants
        if last and joined.log_mask is not None:
            # The writers are gone. Cyclone 0.10 ends its receiving threads with a packet to itself.
            for descriptor in self.sockets:
                with suppress(OSError):
                    _renew(descriptor)
        del self.entity
        if last:
            del self._domains[self.domain]
            joined.entity = None
            if joined.log_mask is not None:
                DDS._dll_handle.dds_set_log_mask(joined.log_mask)

    def __enter__(self) -> Participant:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


class _Discovered:
    """The participants, writers or readers that Cyclone knows in a domain.

    Args:
        participant: Cyclone's participant.
        topic: built-in topic of the entities.
    """

    def __init__(self, participant: Any, topic: Any) -> None:
        self._reader = BuiltinDataReader(participant, topic)
        every = ViewState.Any | SampleState.Any
        gone = InstanceState.NotAliveDisposed | InstanceState.NotAliveNoWriters
        self._gone = ReadCondition(self._reader, every | gone)

    def alive(self) -> list[Any]:
        """Samples of the entities that exist now; they stay in the reader."""
        # Those of entities that are gone are removed: the reader would keep them all.
        while self._reader.take(_AT_ONCE, self._gone):
            pass
        most = _AT_ONCE
        while len(found := self._reader.read(most)) == most:
            most *= 2
        return [one for one in found if one.sample_info.instance_state & InstanceState.Alive]


def _config(interface: str) -> str:
    """Cyclone's configuration for a network interface."""
    here = is_loopback(interface)
    return _CONFIG.format(
        interface=interface,
        multicast=_LOOPBACK_MULTICAST if here else "",
        discovery=_LOOPBACK_DISCOVERY if here else "",
    )


def _is_socket(descriptor: int, inode: int) -> bool:
    """Whether a file descriptor still is the socket with this inode."""
    with suppress(OSError):
        return os.fstat(descriptor).st_ino == inode
    return False


def _renew(descriptor: int) -> None:
    """Replace a UDP socket that has been shut down for sending with one that sends as it did.

    Cyclone sends from a socket that is bound to an address. Those that it receives from, which are
    bound to any address, must stay: a thread may be waiting for a packet to their ports.
    """
    multicast = socket.IPPROTO_IP, socket.IP_MULTICAST_IF
    with (
        socket.socket(fileno=os.dup(descriptor)) as old,
        socket.socket(old.family, old.type) as new,
    ):
        address = old.getsockname()[0]
        if (old.family, old.type) == (socket.AF_INET, socket.SOCK_DGRAM) and address != "0.0.0.0":
            new.bind((address, 0))
            new.setsockopt(*multicast, old.getsockopt(*multicast, 4))
            os.dup2(new.fileno(), descriptor, inheritable=False)


def _native_threads() -> set[int]:
    """Ids of this process's threads that are not Python's."""
    with suppress(OSError):  # not on Linux
        running = {int(task.name) for task in Path("/proc/self/task").iterdir()}
        return running - {thread.native_id for thread in threading.enumerate()}
    return set()
