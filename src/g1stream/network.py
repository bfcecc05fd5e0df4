"""The network interfaces of a machine, and whether DDS on one of them stays on this machine."""

from __future__ import annotations

import os
import socket
from enum import IntFlag
from pathlib import Path

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


class InterfaceFlags(IntFlag):
    """Kernel flags of a network interface, IFF_* in netdevice(7)."""

    UP = 0x1
    LOOPBACK = 0x8
    MULTICAST = 0x1000


def interface_flags(interface: str) -> InterfaceFlags:
    """Read the kernel flags of an interface; if they cannot be read, `lo` is the loopback."""
    try:
        return InterfaceFlags(int(Path("/sys/class/net", interface, "flags").read_text(), 16))
    except OSError:
        return InterfaceFlags.LOOPBACK if interface == "lo" else InterfaceFlags(0)


def is_loopback(interface: str) -> bool:
    """Return whether an interface is the loopback."""
    return InterfaceFlags.LOOPBACK in interface_flags(interface)


def is_local_only(interface: str) -> bool:
    """Return whether samples cannot leave this machine; False if CYCLONEDDS_URI is set."""
    return not os.environ.get("CYCLONEDDS_URI") and is_loopback(interface)


def network_name(interface: str) -> str:
    """Name of the network for messages: the interface, or CYCLONEDDS_URI if it is set."""
    return "CYCLONEDDS_URI" if os.environ.get("CYCLONEDDS_URI") else interface
