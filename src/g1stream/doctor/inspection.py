"""Gather facts about this machine and a DDS domain, without publishing, and evaluate them."""

from __future__ import annotations

import fcntl
import os
import socket
import struct
import time
from collections.abc import Iterable
from contextlib import ExitStack, suppress
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from statistics import median
from typing import Final

from g1stream.clock import Clock, SystemClock, Ticker
from g1stream.config import Config, RealtimeConfig
from g1stream.control.report import Lateness
from g1stream.dds.discovery import AnnouncedBridge
from g1stream.dds.domain import Participant
from g1stream.dds.endpoints import RawReader
from g1stream.dds.local_participants import local_participants
from g1stream.dds.messages import LOWSTATE, LowState
from g1stream.dds.ticks import TickGaps
from g1stream.doctor.facts import (
    Facts,
    Finding,
    HostFacts,
    Interface,
    StateFacts,
    WakeupLatency,
    WireFacts,
)
from g1stream.doctor.findings import evaluate
from g1stream.errors import WireError
from g1stream.network import InterfaceFlags, interface_flags, interfaces, is_loopback
from g1stream.realtime import on_time
from g1stream.robot.model import G1

_POLL_S = 0.001
#: Time for the discovery of participants in other domains, s.
_DISCOVERY_S = 0.6
_ROBOT_DOMAIN: Final = 0


def inspect_domain(
    domain: int, interface: str, interfaces: Iterable[Interface], seconds: float
) -> WireFacts:
    """Listen in a domain and, if LowState is not published there, search for it elsewhere."""
    with Participant(domain, interface) as participant:
        facts = inspect_participant(participant, seconds)
    # With CYCLONEDDS_URI, the interface cannot be chosen.
    return search_elsewhere(facts, [] if participant.uses_environment else interfaces)


def inspect_participant(participant: Participant, seconds: float) -> WireFacts:
    """Listen in a participant's domain for a number of seconds."""
    reader, gaps = RawReader(participant, LOWSTATE, depth=4096), TickGaps()
    state = _listen(reader, gaps, seconds)
    writers = participant.writers()
    if bridge := AnnouncedBridge.by(one for one in writers if one.topic == LOWSTATE.name):
        state = replace(state, missed=gaps.missed(bridge.tick_step))
    return WireFacts(
        participant.domain,
        participant.interface,
        writers=tuple(one for one in writers if one.topic.startswith("rt/")),
        readers=tuple(one for one in participant.readers() if one.topic.startswith("rt/")),
        state=state,
        states_matched=reader.matched,
    )


def _listen(reader: RawReader, gaps: TickGaps, seconds: float) -> StateFacts:
    message = LowState()
    ages: list[float] = []
    right = zero = 0
    start = time.monotonic()
    while time.monotonic() < start + seconds:
        time.sleep(_POLL_S)
        for sample in reader.take():
            message.load(sample.data)
            ages.append((time.time_ns() - sample.publish_time) / 1e6)
            gaps.add(int(message.tick))
            right += message.crc_matches()
            zero += int(message.crc) == 0
    return StateFacts(
        seconds=time.monotonic() - start,
        received=gaps.received,
        malformed=reader.malformed,
        ages_ms=(median(ages), max(ages)) if ages else (0.0, 0.0),
        tick_step=gaps.step,
        tick_jumps=gaps.jumps,
        crc_right=right,
        crc_zero=zero,
        mode_machine=int(message.mode_machine),
        mode_pr=int(message.mode_pr),
        has_rpy=bool(message.rpy.any()),
        has_motor_modes=bool(message.motor_mode.any()),
    )


def search_elsewhere(facts: WireFacts, interfaces: Iterable[Interface] = ()) -> WireFacts:
    """Search for LowState elsewhere if it is not published in the domain; returns all facts.

    It searches the domains of programs on this machine, the domain of a robot unless on loopback,
    and this domain on loopback: joining a domain sends discovery messages, which only the interface
    that was asked for may carry. A domain that cannot be joined is left out.
    """
    if facts.writers_of(LOWSTATE):
        return facts
    domain, interface, local = facts.domain, facts.interface, local_participants()
    domains = {one.domain for one in local if not one.apart}
    domains |= set() if is_loopback(interface) else {_ROBOT_DOMAIN}
    usable = (one for one in interfaces if InterfaceFlags.UP in one.flags and one.address)
    others = {one.name: InterfaceFlags.LOOPBACK in one.flags for one in usable}
    others.pop(interface, None)
    places = [(one, interface) for one in sorted(domains - {domain})]
    places += [(domain, name) for name, loopback in others.items() if loopback]
    joined: dict[tuple[int, str], Participant] = {}
    with ExitStack() as stack:
        for place in places:
            with suppress(WireError):
                joined[place] = stack.enter_context(Participant(*place))
        time.sleep(_DISCOVERY_S if joined else 0.0)
        elsewhere = tuple(
            (*place, participant.owner(writer))
            for place, participant in joined.items()
            for writer in participant.writers(LOWSTATE.name)
        )
    return replace(
        facts,
        elsewhere=elsewhere,
        searched=tuple(joined),
        unsearched=tuple(name for name, loopback in others.items() if not loopback),
        local=tuple(local),
    )


_SIOCGIFADDR: Final = 0x8915  # <linux/sockios.h>


def inspect_host(config: RealtimeConfig) -> HostFacts:
    """Gather facts about this machine; temporarily requests real-time scheduling."""
    with on_time(config.priority, config.cpu) as grants:
        granted = tuple(grants)
    buffer = _read("/proc/sys/net/core/rmem_max")
    return HostFacts(
        interfaces=tuple(Interface(n, interface_flags(n), _address(n)) for n in interfaces()),
        uri=os.environ.get("CYCLONEDDS_URI", ""),
        cyclonedds=version("cyclonedds"),
        rmem_max=int(buffer) if buffer else None,
        clock_source=_read("/sys/devices/system/clocksource/clocksource0/current_clocksource"),
        grants=granted,
    )


def measure_wakeup_latency(
    realtime: RealtimeConfig, rate: float, seconds: float = 0.5
) -> WakeupLatency:
    """Measure the wake-up latency at absolute deadlines (`rate` in Hz) with the loop's scheduling.

    The priority is one below the loop's, so that it does not delay a loop that is running, perhaps
    on the same isolated CPU.
    """
    with on_time(max(0, realtime.priority - 1), realtime.cpu):
        return wakeup_latency(SystemClock(), round(1e9 / rate), round(seconds * rate))


def wakeup_latency(clock: Clock, period: int, deadlines: int) -> WakeupLatency:
    """Measure the wake-up latency of a clock at a number of deadlines, `period` ns apart."""
    ticker = Ticker(clock, period, clock.now() + period)
    lateness, passed = Lateness(), 0
    for k, _ in ticker:
        # Relative to the deadline of the sleep, not to the one that replaced it.
        lateness.add(clock.now() - (ticker.start + passed * period))
        passed = k + 1
        if passed >= deadlines:
            break
    median = round(lateness.percentile_us(50.0) * 1000.0)
    return WakeupLatency(1e9 / period, passed, ticker.skipped, median, lateness.maximum_ns)


def _address(name: str) -> str:
    """IPv4 address of an interface, or "" (netdevice(7))."""
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


def diagnose(config: Config, seconds: float = 1.0) -> list[Finding]:
    """Check this machine and the domain; each check has a finding, even without a problem.

    It publishes nothing, so that other programs are not disturbed, and sends discovery messages
    only on the interface of the settings and on loopback.
    """
    domain, interface = config.dds.domain, config.dds.interface
    host = inspect_host(config.realtime)
    latency = measure_wakeup_latency(config.realtime, config.stream.rate)
    try:
        wire = inspect_domain(domain, interface, host.interfaces, seconds)
    except WireError as error:
        wire = WireFacts(domain, interface, join_error=error.cause)
    robots = G1.of_config(config).joint_set.allowed(config.safety.mode_machine)
    of_ros = "" if "domain" in config.dds.model_fields_set else os.environ.get("ROS_DOMAIN_ID", "")
    ros_domain = int(of_ros) if of_ros.isdecimal() else None
    return evaluate(Facts(wire, host, robots, latency, config.stream.via, ros_domain))
