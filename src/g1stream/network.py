"""The network interfaces of a machine, and whether DDS on one of them stays on this machine."""

from __future__ import annotations

import fcntl
import os
import socket
import struct
from contextlib import suppress
from enum import IntFlag
from typing import Final

from g1stream.errors import WireError

__all__ = [
    "InterfaceFlags",
    "interface_flags",
    "interfaces",
    "is_local_only",
    "is_loopback",
    "network_name",
    "require_interface",
]


def interfaces() -> list[str]:
    """Names of this machine's network interfaces."""
    return [name for _, name in socket.if_nameindex()]


def require_interface(interface: str) -> None:
    """Check that a network interface exists.

    Raises:
        WireError: this machine has no interface of that name.
    """
    if interface not in interfaces():
        raise WireError(
            f"This machine has no network interface {interface!r}.",
            f"Choose one of {', '.join(interfaces())}.",
        )


_SIOCGIFFLAGS: Final = 0x8913  # <linux/sockios.h>


class InterfaceFlags(IntFlag):
    """Kernel flags of a network interface, IFF_* in netdevice(7)."""

    UP = 0x1
    LOOPBACK = 0x8
    MULTICAST = 0x1000


def interface_flags(interface: str) -> InterfaceFlags:
    """Read the kernel flags of an interface; none if they cannot be read.

    /sys may show the interfaces of another network namespace, a socket belongs to this one's.
    """
    request = struct.pack("16sH14x", os.fsencode(interface), 0)
    with suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        return InterfaceFlags(
            struct.unpack("16xH14x", fcntl.ioctl(any_socket, _SIOCGIFFLAGS, request))[0]
        )
    return InterfaceFlags(0)


def is_loopback(interface: str) -> bool:
    """Return whether an interface is the loopback."""
    return InterfaceFlags.LOOPBACK in interface_flags(interface)


def is_local_only(interface: str) -> bool:
    """Return whether samples cannot leave this machine; False if CYCLONEDDS_URI is set."""
    return not os.environ.get("CYCLONEDDS_URI") and is_loopback(interface)


def network_name(interface: str) -> str:
    """Name of the network for messages: the interface, or CYCLONEDDS_URI if it is set."""
    return "CYCLONEDDS_URI" if os.environ.get("CYCLONEDDS_URI") else interface
