"""Facts about this machine."""

from __future__ import annotations

import fcntl
import os
import socket
import struct
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Final

from g1stream.doctor.facts import HostFacts, Interface
from g1stream.realtime import on_time

if TYPE_CHECKING:
    from g1stream.config import RealtimeConfig

__all__ = ["look_at_host"]

_IFF_UP, _IFF_LOOPBACK, _IFF_MULTICAST = 0x1, 0x8, 0x1000  # netdevice(7)
_SIOCGIFADDR: Final = 0x8915  # <linux/sockios.h>


def look_at_host(config: RealtimeConfig) -> HostFacts:
    """What this machine is like; asks the system for real-time rights, and gives them back."""
    with on_time(config.priority, config.cpu) as grants:
        granted = tuple(grants)
    buffer = _read("/proc/sys/net/core/rmem_max")
    return HostFacts(
        interfaces=tuple(_interface(name) for _, name in socket.if_nameindex()),
        uri=os.environ.get("CYCLONEDDS_URI", ""),
        cyclonedds=version("cyclonedds"),
        rmem_max=int(buffer) if buffer else None,
        clock_source=_read("/sys/devices/system/clocksource/clocksource0/current_clocksource"),
        grants=granted,
    )


def _interface(name: str) -> Interface:
    flags = int(_read(f"/sys/class/net/{name}/flags") or "0", 16)
    return Interface(
        name,
        up=bool(flags & _IFF_UP),
        loopback=bool(flags & _IFF_LOOPBACK),
        multicast=bool(flags & _IFF_MULTICAST),
        address=_address(name),
    )


def _address(name: str) -> str:
    """The IPv4 address of an interface, or "" (netdevice(7))."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        try:
            answer = fcntl.ioctl(any_socket, _SIOCGIFADDR, struct.pack("256s", name.encode()))
        except OSError:
            return ""
    return socket.inet_ntoa(answer[20:24])


def _read(path: str) -> str:
    try:
        return Path(path).read_text().strip()
    except OSError:
        return ""
