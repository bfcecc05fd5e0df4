"""Find the DDS participants on this machine by their UDP ports, without joining a domain.

RTPS derives the ports of a participant from its domain (RTPS 2.5, 9.6.2): 7400 + 250 * domain is
the multicast port of discovery, and participant i has the unicast ports 10 + 2 i and 11 + 2 i above
that. Some participants have unicast ports assigned by the kernel instead.
"""

from __future__ import annotations

import os
from collections import defaultdict
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from g1stream.dds.domain import MAX_DOMAIN
from g1stream.dds.udp_sockets import socket_inodes, udp_sockets

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

__all__ = ["LocalParticipant", "domains_of_ports", "local_participants"]

_FIRST, _PER_DOMAIN, _UNICAST = 7400, 250, 10
_LONGEST: Final = 80


@dataclass(frozen=True, order=True)
class LocalParticipant:
    """A program on this machine that participates in a domain.

    Attributes:
        domain: the domain id.
        pid: process id; 0 if unknown, as for programs of another user.
        command: command line of the program, or its user if unknown.
        apart: whether it is in another network namespace, such as a container.
    """

    domain: int
    pid: int
    command: str
    apart: bool = False

    def __str__(self) -> str:
        return f"{self.command} (pid {self.pid})" if self.pid else self.command


def domains_of_ports(ports: Iterable[int]) -> set[int]:
    """The domains that correspond to the UDP ports of a program."""
    held, found = set(ports), set()
    for port in held:
        domain, offset = divmod(port - _FIRST, _PER_DOMAIN)
        unicast = offset >= _UNICAST and offset % 2 == 0 and port + 1 in held
        if 0 <= domain <= MAX_DOMAIN and (offset == 0 or unicast):
            found.add(domain)
    return found


def local_participants(proc: Path = Path("/proc")) -> list[LocalParticipant]:
    """Programs on this machine in any domain, without this program and its child processes."""
    programs = _programs(proc)
    # A guard process has its stream's sockets, too, and the higher process id.
    by_age = sorted(programs, reverse=True)
    owners = {inode: pid for pid in by_age for inode in socket_inodes(proc / str(pid))}
    found = set()
    for namespace, apart in _namespaces(proc, programs):
        ports: dict[tuple[int, str], set[int]] = defaultdict(set)
        for one in udp_sockets(namespace):
            if not one.connected:
                pid = owners.get(one.inode, 0)
                ports[pid, programs.get(pid) or f"a program of user {one.uid}"].add(one.port)
        for (pid, command), held in ports.items():
            if not _is_ours(proc, pid):
                found |= {LocalParticipant(d, pid, command, apart) for d in domains_of_ports(held)}
    return sorted(found)


def _programs(proc: Path) -> dict[int, str]:
    """Command lines of all processes, by process id."""
    found = {}
    for path in proc.glob("[0-9]*"):
        with suppress(OSError):
            program, *arguments = (path / "cmdline").read_text(errors="replace").split("\0")
            line = " ".join((Path(program).name, *arguments)).strip()
            found[int(path.name)] = line if len(line) <= _LONGEST else f"{line[:_LONGEST]}..."
    return found


def _is_ours(proc: Path, pid: int) -> bool:
    """Return whether a process is this one or a descendant, such as a recorder's receiver."""
    with suppress(OSError):
        while pid > 1 and pid != os.getpid():
            pid = int((proc / str(pid) / "stat").read_text().rpartition(")")[2].split()[1])
    return pid == os.getpid()


def _namespaces(proc: Path, pids: Iterable[int]) -> Iterator[tuple[Path, bool]]:
    """A process of each visible network namespace, this one's first, and whether it is another."""
    known: set[int] = set()
    for process in (proc / "self", *(proc / str(pid) for pid in pids)):
        with suppress(OSError):
            namespace = (process / "ns" / "net").stat().st_ino
            if namespace not in known:
                yield process, bool(known)
                known.add(namespace)
