"""The UDP sockets of this machine, from /proc of Linux."""

from __future__ import annotations

import re
from contextlib import suppress
from typing import TYPE_CHECKING, Final, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

__all__ = ["UdpSocket", "socket_inodes", "udp_sockets"]

#: The state of a UDP socket that is not connected: TCP_CLOSE.
_UNCONNECTED: Final = "07"


class UdpSocket(NamedTuple):
    """A UDP socket.

    Attributes:
        port: the bound port.
        connected: whether it is connected to a peer.
        uid: user id of its owner.
        inode: inode, which identifies the socket in a process, see `socket_inodes`.
        dropped: number of datagrams that the kernel discarded because the buffer was full.
    """

    port: int
    connected: bool
    uid: int
    inode: int
    dropped: int


def socket_inodes(process: Path) -> dict[int, int]:
    """File descriptors of a process's sockets by their inodes; none without permission.

    `process` is the directory of the process, such as /proc/self.
    """
    found = {}
    with suppress(OSError):
        for file in (process / "fd").iterdir():
            with suppress(OSError):  # the file was closed meanwhile
                if match := re.fullmatch(r"socket:\[(\d+)\]", str(file.readlink())):
                    found[int(match[1])] = int(file.name)
    return found


def udp_sockets(process: Path) -> Iterator[UdpSocket]:
    """All UDP sockets in a process's network namespace; none without permission."""
    for name in ("udp", "udp6"):
        with suppress(OSError):
            for line in (process / "net" / name).read_text().splitlines()[1:]:
                _, local, _, state, _, _, _, uid, _, inode, *_, dropped = line.split()
                port = int(local.rpartition(":")[2], 16)
                connected = state != _UNCONNECTED
                yield UdpSocket(port, connected, int(uid), int(inode), int(dropped))
