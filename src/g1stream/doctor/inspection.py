"""Gather facts about this machine and a DDS domain, without publishing, and evaluate them."""

from __future__ import annotations

import fcntl
import os
import socket
import struct
import time
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, suppress
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from statistics import median
from typing import Any, Final

from cyclonedds.core import Policy

from g1stream.clock import Clock, SystemClock, Ticker
from g1stream.config import Config, RealtimeConfig
from g1stream.control.report import Lateness
from g1stream.dds.domain import OBSERVER, AnnouncedBridge, Endpoint, Participant
from g1stream.dds.endpoints import RawReader
from g1stream.dds.local_participants import local_participants
from g1stream.dds.messages import LOWSTATE, TOPICS, LowState
from g1stream.dds.ticks import TickGaps
from g1stream.doctor.facts import (
    Facts,
    Finding,
    HostFacts,
    Interface,
    Peer,
    Qos,
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
_DURABILITIES = (
    Policy.Durability.Volatile,
    Policy.Durability.TransientLocal,
    Policy.Durability.Transient,
    Policy.Durability.Persistent,
)


def inspect_domain(
    domain: int, interface: str, interfaces: Iterable[Interface], seconds: float
) -> WireFacts:
    """Listen in a domain and, if LowState is not published there, search for it elsewhere."""
    with Participant(domain, interface) as participant:
        facts = inspect_participant(participant, seconds)
    # With CYCLONEDDS_URI, the interface cannot be chosen.
    return search_elsewhere(
        facts, domain, interface, [] if participant.uses_environment else interfaces
    )


def inspect_participant(participant: Participant, seconds: float) -> WireFacts:
    """Listen in a participant's domain for a number of seconds."""
    reader, gaps = RawReader(participant, LOWSTATE, depth=4096), TickGaps()
    state = _listen(reader, gaps, seconds)
    writers = participant.writers()
    if bridge := AnnouncedBridge.by(one for one in writers if one.topic == LOWSTATE.name):
        state = replace(state, missed=gaps.missed(bridge.tick_step))
    return WireFacts(
        writers=tuple(_peers(participant, writers)),
        readers=tuple(_peers(participant, participant.readers())),
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
        has_rpy=bool(message.rpy.any()),
        has_motor_modes=bool(message.motor_mode.any()),
    )


def search_elsewhere(
    facts: WireFacts, domain: int, interface: str, interfaces: Iterable[Interface] = ()
) -> WireFacts:
    """Search for LowState elsewhere if it is not published in a domain; returns all facts.

    It searches the domains of programs on this machine, the domain of a robot unless on loopback,
    and this domain on loopback: joining a domain sends discovery messages, which only the interface
    that was asked for may carry. A domain that cannot be joined is left out.
    """
    if facts.writers_of(LOWSTATE.name):
        return facts
    local = local_participants()
    domains = {one.domain for one in local if not one.apart}
    domains |= set() if is_loopback(interface) else {_ROBOT_DOMAIN}
    others = [i for i in interfaces if i.up and i.address and i.name != interface]
    places = [(one, interface) for one in sorted(domains - {domain})]
    places += [(domain, one.name) for one in others if one.loopback]
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
        unsearched=tuple(one.name for one in others if not one.loopback),
        local=tuple(local),
    )


def ros_domain() -> int | None:
    """The DDS domain of ROS 2 in this environment; None if not set."""
    text = os.environ.get("ROS_DOMAIN_ID", "")
    return int(text) if text.isdecimal() else None


def _peers(participant: Participant, endpoints: Iterable[Endpoint]) -> Iterator[Peer]:
    """Endpoints on topics of the robot, without those of discovery."""
    for endpoint in endpoints:
        if endpoint.topic.startswith("rt/"):
            yield Peer(
                topic=endpoint.topic,
                type_name=endpoint.type_name,
                same_type=_same_type(endpoint),
                qos=qos_facts(endpoint.qos),
                owner=participant.owner(endpoint),
                participant=endpoint.participant,
                observer=endpoint.user_data == OBSERVER,
                idle=endpoint.idle,
            )


def _same_type(endpoint: Endpoint) -> bool | None:
    ours = {topic.name: topic.idl_type for topic in TOPICS}.get(endpoint.topic)
    if ours is None or endpoint.type_id is None:
        return None
    ours.__idl__.populate()
    return bool(endpoint.type_id == ours.__idl__.get_type_id())


def qos_facts(qos: Any) -> Qos:
    """The relevant policies of a Cyclone `Qos`; DDS's defaults for policies that are not set."""
    values = vars(Qos()).copy()
    for policy in qos or ():
        if isinstance(policy, Policy.Reliability.Reliable):
            values["reliable"] = True
        elif isinstance(policy, Policy.Deadline):
            values["deadline"] = policy.deadline
        elif isinstance(policy, Policy.Partition):
            values["partitions"] = tuple(policy.partitions)
        elif isinstance(policy, Policy.DataRepresentation):
            values["xcdr1"] = policy.use_cdrv0_representation
        elif policy == Policy.Ownership.Exclusive:
            values["exclusive"] = True
        elif policy in _DURABILITIES:
            values["durability"] = _DURABILITIES.index(policy)
    return Qos(**values)


_SIOCGIFADDR: Final = 0x8915  # <linux/sockios.h>


def inspect_host(config: RealtimeConfig) -> HostFacts:
    """Gather facts about this machine; temporarily requests real-time scheduling."""
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
    wire, join_error = None, ""
    try:
        wire = inspect_domain(domain, interface, host.interfaces, seconds)
    except WireError as error:
        join_error = error.cause
    robots = G1.of_config(config).joint_set.allowed(config.safety.mode_machine)
    via = config.stream.via
    of_ros = None if "domain" in config.dds.model_fields_set else ros_domain()
    known = Facts(domain, interface, robots, host, wire, join_error, latency, via, of_ros)
    return evaluate(known)
