"""Facts about this machine, and how late it wakes a thread."""

from __future__ import annotations

import fcntl
import os
import socket
import struct
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Final

from g1stream.clock import SystemClock, Ticker
from g1stream.control.report import Lateness
from g1stream.dds.domain import InterfaceFlags, interface_flags, interfaces
from g1stream.doctor.facts import HostFacts, Interface, WakeupLatency
from g1stream.realtime import on_time

if TYPE_CHECKING:
    from g1stream.clock import Clock
    from g1stream.config import RealtimeConfig

__all__ = ["inspect_host", "measure_wakeup_latency", "wakeup_latency"]

_SIOCGIFADDR: Final = 0x8915  # <linux/sockios.h>


def inspect_host(config: RealtimeConfig) -> HostFacts:
    """Gather facts about this machine; requests real-time rights, and gives them back."""
    with on_time(config.priority, config.cpu) as grants:
        granted = tuple(grants)
    buffer = _read("/proc/sys/net/core/rmem_max")
    return HostFacts(
        interfaces=tuple(map(_interface, interfaces())),
        uri=os.environ.get("CYCLONEDDS_URI", ""),
        cyclonedds=version("cyclonedds"),
        rmem_max=int(buffer) if buffer else None,
        clock_source=_read("/sys/devices/system/clocksource/clocksource0/current_clocksource"),
        grants=granted,
    )


def measure_wakeup_latency(
    realtime: RealtimeConfig, rate: float, seconds: float = 0.5
) -> WakeupLatency:
    """Sleep until absolute deadlines (Hz) with the rights that the loop gets, and do nothing else.

    The priority is one below the loop's: a loop that runs meanwhile, maybe on the same isolated
    CPU, comes first, and no command of it is delayed.
    """
    with on_time(max(0, realtime.priority - 1), realtime.cpu):
        return wakeup_latency(SystemClock(), round(1e9 / rate), round(seconds * rate))


def wakeup_latency(clock: Clock, period: int, deadlines: int) -> WakeupLatency:
    """Let a clock wake this thread at so many deadlines, `period` ns apart."""
    ticker = Ticker(clock, period, clock.now() + period)
    lateness, passed = Lateness(), 0
    for k, _ in ticker:
        # The deadline that was slept for, not the one that replaced it.
        lateness.add(clock.now() - (ticker.start + passed * period))
        passed = k + 1
        if passed >= deadlines:
            break
    median = round(lateness.percentile_us(50.0) * 1000.0)
    return WakeupLatency(1e9 / period, passed, ticker.skipped, median, lateness.maximum_ns)


def _interface(name: str) -> Interface:
    flags = interface_flags(name)
    return Interface(
        name,
        up=InterfaceFlags.UP in flags,
        loopback=InterfaceFlags.LOOPBACK in flags,
        multicast=InterfaceFlags.MULTICAST in flags,
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
