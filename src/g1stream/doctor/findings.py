"""Rules of the doctor, which derive findings from facts. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Final

from g1stream.dds.messages import COMMANDS, LOG, LOWCMD, LOWSTATE, SPORTMODESTATE
from g1stream.doctor.facts import (
    Facts,
    Finding,
    HostFacts,
    Level,
    Peer,
    Qos,
    StateFacts,
    WakeupLatency,
    WireFacts,
    ok,
    problem,
    warning,
)
from g1stream.robot.joints import JointSet
from g1stream.text import counted

if TYPE_CHECKING:
    from g1stream.dds.local_participants import LocalParticipant

#: Receive buffer for a hundred LowStates, including the kernel's overhead, bytes.
_ENOUGH_BUFFER: Final = 1 << 20
_SLOW_CLOCKS: Final = ("hpet", "acpi_pm", "jiffies", "refined-jiffies")
#: Maximum number of programs in a finding.
_MOST_PROGRAMS: Final = 5
_OUR_GUARD: Final = "g1stream guard"  # guard of the stream that calls the doctor
_START_ROBOT: Final = "Start a bridge (g1stream sim), or connect and switch on the robot."
_START_CONTROLLER: Final = "Let the robot stand with its own controller, which subscribes to it."

_OUR_READER: Final = Qos()
_OUR_WRITER: Final = Qos(reliable=True)
_DURABILITIES: Final = ("volatile", "transient local", "transient", "persistent")

# Topics of the robot's own services only.
_ROBOT_WRITES: Final = {"rt/lf/lowstate", "rt/odommodestate"}
_ROBOT_READS: Final = {one.name for one in COMMANDS.values()} - {LOWCMD.name}


def evaluate(facts: Facts) -> list[Finding]:
    """Derive all findings, in the order in which to fix them."""
    found = [*_interface(facts), *_host(facts.host)]
    if facts.ros_domain not in (None, facts.domain):
        cause = f"ROS_DOMAIN_ID is {facts.ros_domain}, but g1stream uses domain {facts.domain}"
        remedy = f"Use --domain {facts.ros_domain} for the domain of ROS 2."
        found.append(warning("domain", cause, remedy))
    if facts.wakeup_latency:
        found.append(_wakeup(facts.wakeup_latency))
    if facts.wire is None:
        # An unusable interface already explains it.
        if not any(one.about == "interface" and one.level is Level.PROBLEM for one in found):
            remedy = "Fix this, then run the doctor again to check the domain."
            found.append(problem("domain", facts.join_error, remedy))
        return found
    return [
        *found,
        *_publishers(facts.domain, facts.interface, facts.wire),
        *_states(facts, facts.wire),
        *_base(facts.wire),
        *_commands(facts.wire, COMMANDS[facts.via].name),
    ]


def explain_no_robot(
    domain: int, interface: str, wire: WireFacts, topic: str = LOWCMD.name
) -> list[Finding]:
    """Explain why a stream found no LowState or no subscriber of its topic in time."""
    found = [*_state_mismatches(wire), *_command_mismatches(wire, topic)]
    if wire.states_matched and not wire.state.received:
        found.append(_silent_publisher(wire.state))
    if found:
        return found
    if not wire.writers_of(LOWSTATE.name):
        return list(_publishers(domain, interface, wire))
    here = f"in domain {domain} on {interface}"
    remedy = f"Run g1stream doctor --domain {domain} --interface {interface} for more checks."
    if not _command_subscribers(wire, topic):
        return [problem("LowCmd", f"no subscriber on {topic} {here}", remedy)]
    return [warning("wire", f"a robot appeared {here} after the wait ended", "Stream again.")]


def _interface(facts: Facts) -> Iterator[Finding]:
    """Check that DDS can use the interface."""
    host, about = facts.host, "interface"
    if host.uri:
        yield warning(
            about,
            f"CYCLONEDDS_URI is set and selects the interface, not {facts.interface}: {host.uri}",
            "Unset it unless this is intended.",
        )
    found = next((one for one in host.interfaces if one.name == facts.interface), None)
    if found is None:
        names = ", ".join(one.name for one in host.interfaces)
        cause = f"this machine has no interface {facts.interface}"
        yield problem(about, cause, f"Choose --interface from {names}.")
    elif not found.up:
        remedy = f"Bring it up: ip link set {found.name} up."
        yield problem(about, f"{found.name} is down", remedy)
    elif not found.address:
        remedy = "Assign one; Unitree's robots are in 192.168.123.0/24."
        yield problem(about, f"{found.name} has no IPv4 address", remedy)
    elif not found.multicast and not found.loopback:
        remedy = f"Enable it: ip link set {found.name} multicast on."
        yield problem(about, f"{found.name} has no multicast, which DDS discovery needs", remedy)
    else:
        multicast = "multicast" if found.multicast else "no multicast; discovery by address"
        yield ok(about, f"{found.name} is up, {found.address}, {multicast}")


def _host(host: HostFacts) -> Iterator[Finding]:
    """Check that this machine is suitable for real-time work."""
    if host.cyclonedds.split(".")[0] == "11" or host.cyclonedds.startswith("0.10."):
        yield ok("cyclonedds", host.cyclonedds)
    else:
        cause = f"{host.cyclonedds} is not tested with Unitree's SDK and simulators"
        yield warning("cyclonedds", cause, "Install 0.10.2, the version of the SDK, or 11.")
    if host.rmem_max is not None and host.rmem_max < _ENOUGH_BUFFER:
        yield warning(
            "sockets",
            f"the kernel limits receive buffers to {host.rmem_max // 1024} KiB; a burst of samples "
            "overflows them",
            "Run: sysctl -w net.core.rmem_max=4194304",
        )
    elif host.rmem_max is not None:
        yield ok("sockets", f"receive buffers up to {host.rmem_max // 1024} KiB")
    if host.clock_source in _SLOW_CLOCKS:
        yield warning(
            "clock",
            f"the clock source is {host.clock_source}; reading the time takes microseconds",
            "Find out why the kernel does not use tsc: dmesg | grep -i tsc",
        )
    elif host.clock_source:
        yield ok("clock", f"source {host.clock_source}")
    for grant in host.grants:
        cause = f"{grant.what}: {grant.detail}"
        if grant.granted:
            yield ok("real time", cause)
        else:
            cost = f"; without it, {grant.cost}" if grant.cost else ""
            yield warning("real time", cause + cost, grant.remedy)


def _wakeup(latency: WakeupLatency) -> Finding:
    """Check that this machine wakes a thread at its deadlines."""
    at, worst = f"at {latency.rate:g} Hz", f"at most {latency.worst_ns / 1e6:.2f} ms late"
    if latency.missed:
        finding = warning(
            "wake-up",
            f"{latency.missed} of {latency.deadlines} deadlines {at} missed by a whole period, "
            f"{worst}; other load or a hypervisor stops the programs on this machine",
            "Stop other load and fix the real-time warnings; if deadlines are still missed, use a "
            "machine that is not virtual, or expect skipped ticks.",
        )
    else:
        finding = ok("wake-up", f"{latency.deadlines} deadlines {at}, none missed, {worst}")
    figures = {
        "rate_hz": latency.rate,
        "deadlines": latency.deadlines,
        "missed_deadlines": latency.missed,
        "median_lateness_us": latency.median_ns / 1000.0,
        "worst_lateness_us": latency.worst_ns / 1000.0,
    }
    return finding.model_copy(update={"figures": figures})


def _publishers(domain: int, interface: str, wire: WireFacts) -> Iterator[Finding]:
    """Check the publishers of LowState, here and elsewhere."""
    here = f"in domain {domain} on {interface}"
    writers = wire.writers_of(LOWSTATE.name)
    if writers:
        yield from _state_mismatches(wire)
        yield ok("publisher", f"{identify_publisher(wire)}: {_owners(writers)}")
        return
    for other, name, owner in wire.elsewhere:
        yield problem(
            "domain" if other != domain else "interface",
            f"no publisher on {LOWSTATE.name} {here}; {owner} publishes it in domain {other} on "
            f"{name}",
            f"Use --domain {other}." if other != domain else f"Use --interface {name}.",
        )
    if not wire.elsewhere:
        peers = (*wire.writers, *wire.readers)
        others = len({one.participant for one in peers if not one.owner.startswith(_OUR_GUARD)})
        searched = "".join(f", nor in domain {other} on {name}" for other, name in wire.searched)
        ask = "".join(
            f" To search {one}: g1stream doctor --interface {one}." for one in wire.unsearched
        )
        yield problem(
            "publisher",
            f"no publisher on {LOWSTATE.name} {here}{searched}; other programs discovered there: "
            f"{others}; DDS programs on this machine: "
            f"{_programs(one for one in wire.local if not one.apart)}",
            _START_ROBOT + ask,
        )
    if apart := [one for one in wire.local if one.apart]:
        yield warning(
            "containers",
            f"programs in other network namespaces, such as containers: {_programs(apart)}",
            "Start the container with --network host, or use an interface that reaches it.",
        )


def _programs(local: Iterable[LocalParticipant]) -> str:
    """Names of the first programs, with their domains."""
    named = [f"{one} in domain {one.domain}" for one in local]
    more = f" and {len(named) - _MOST_PROGRAMS} more" if len(named) > _MOST_PROGRAMS else ""
    return (", ".join(named[:_MOST_PROGRAMS]) or "none") + more


def _states(facts: Facts, wire: WireFacts) -> Iterator[Finding]:
    """Check the LowStates received on rt/lowstate."""
    state = wire.state
    if not wire.states_matched:
        return
    if not state.received:
        yield _silent_publisher(state)
        return
    age, oldest = state.ages_ms
    rate = state.received / state.seconds
    text = f"{rate:.0f} Hz, received {age:.2f} ms after publication, at most {oldest:.2f} ms"
    if abs(age) > 1000.0:
        yield warning(
            "LowState",
            f"{text}; the clocks of the publisher and of this machine differ",
            "Synchronise them with NTP or PTP, or do not compare publish times with log times.",
        )
    else:
        yield ok("LowState", text)
    yield from _tick_and_crc(state)
    if state.mode_machine in facts.allowed_robots:
        kind = JointSet.of_mode(state.mode_machine)
        text = "not provided" if state.mode_machine == 0 else f"{state.mode_machine}"
        text += f", {kind}" if kind else ""
        yield ok("mode_machine", text)
    else:
        yield problem(
            "mode_machine",
            f"{state.mode_machine}, but the robot of --robot has "
            f"{' or '.join(map(str, facts.allowed_robots))}",
            f"Use --robot {kind.name}."
            if (kind := JointSet.of_mode(state.mode_machine))
            else "Use a G1 with one of these values, or allow it with safety.mode_machine.",
        )


def _tick_and_crc(state: StateFacts) -> Iterator[Finding]:
    if state.tick_step is None:
        yield ok("tick", "not provided")
    elif state.missed is None:
        yield ok(
            "tick",
            f"steps of {state.tick_step} ms, {state.tick_jumps} larger; only the ticks of "
            "g1stream's own bridge number its samples",
        )
    elif state.missed:
        yield warning(
            "tick",
            f"{counted(state.missed, 'LowState')} lost in {state.seconds:.1f} s",
            "Check the load of both machines, the network, and the receive buffers.",
        )
    else:
        yield ok("tick", f"steps of {state.tick_step} ms, none missing")
    if state.crc_zero == state.received:
        yield ok("CRC", "not provided")
    elif state.crc_right < state.received:
        yield problem(
            "CRC",
            f"{state.received - state.crc_right} of {state.received} LowStates with a wrong CRC",
            "Make the publisher compute Unitree's CRC over the C struct.",
        )
    else:
        yield ok("CRC", "correct")


def _base(wire: WireFacts) -> Iterator[Finding]:
    """Check whether the position of the pelvis is published."""
    writers = wire.writers_of(SPORTMODESTATE.name)
    yield from _writer_mismatches(writers, "SportModeState")
    if writers:
        yield ok("base", f"{SPORTMODESTATE.name} from {_owners(writers)}")
    elif wire.writers_of(LOWSTATE.name):
        yield ok("base", "position and velocity not provided")


def _commands(wire: WireFacts, topic: str) -> Iterator[Finding]:
    """Check the readers and writers of LowCmd on a topic."""
    readers = _command_subscribers(wire, topic)
    mismatches = _command_mismatches(wire, topic)
    yield from mismatches
    if not readers and wire.writers_of(LOWSTATE.name):
        cause = f"no subscriber on {topic}, so commands have no effect"
        remedy = _START_ROBOT if topic == LOWCMD.name else _START_CONTROLLER
        yield problem("LowCmd", cause, remedy)
    elif readers and not mismatches:
        yield ok("LowCmd", f"subscriber: {_owners(readers)}")
    if writers := [one for one in wire.writers_of(topic) if not one.idle]:
        yield warning(
            "LowCmd",
            f"another publisher on {topic}, {_owners(writers)}; g1stream stream will refuse to "
            "start",
            "Stop it before you stream.",
        )


def qos_mismatch(offered: Qos, requested: Qos) -> str:
    """Why the QoS of a writer and a reader do not match, or "" (DDS 1.4, 2.2.3)."""
    if requested.reliable and not offered.reliable:
        return "the reader requests reliable delivery, the writer offers best effort"
    if requested.durability > offered.durability:
        return (
            f"the reader requests durability {_DURABILITIES[requested.durability]}, "
            f"the writer offers {_DURABILITIES[offered.durability]}"
        )
    if requested.deadline < offered.deadline:
        every = f"a sample every {requested.deadline / 1e6:g} ms"
        return f"the reader requests {every}, but the writer does not offer this deadline"
    if requested.exclusive != offered.exclusive:
        return "one has exclusive ownership, and the other shared ownership"
    if set(offered.partitions or ("",)).isdisjoint(requested.partitions or ("",)):
        offers, requests = (
            ", ".join(qos.partitions) or "the default one" for qos in (offered, requested)
        )
        return f"the writer is in partition {offers}, the reader in {requests}"
    same = requested.xcdr1 == offered.xcdr1
    return "" if same else "one uses only the encoding XCDR2, and the other XCDR1"


def _writer_mismatches(writers: Iterable[Peer], message: str) -> list[Finding]:
    """Findings for writers that g1stream's reader cannot match."""
    found = (_mismatch(peer, qos_mismatch(peer.qos, _OUR_READER), message) for peer in writers)
    return [one for one in found if one]


def _state_mismatches(wire: WireFacts) -> list[Finding]:
    """Findings for publishers of LowState that g1stream's reader does not match."""
    writers = wire.writers_of(LOWSTATE.name)
    found = _writer_mismatches(writers, "LowState")
    # Cyclone 0.10.2 does not show the announced types of other participants.
    if writers and not found and not wire.states_matched:
        found.append(_other_type(writers, "LowState"))
    return found


def _command_mismatches(wire: WireFacts, topic: str) -> list[Finding]:
    """Findings for subscribers of LowCmd on a topic that g1stream's writer does not match."""
    readers = _command_subscribers(wire, topic)
    found = [_mismatch(peer, qos_mismatch(_OUR_WRITER, peer.qos), "LowCmd") for peer in readers]
    findings = [one for one in found if one]
    if readers and not findings and wire.commands_matched == 0:
        findings.append(_other_type(readers, "LowCmd"))
    return findings


def _command_subscribers(wire: WireFacts, topic: str) -> list[Peer]:
    """Subscribers of a topic, without observers."""
    return [peer for peer in wire.readers if peer.topic == topic and not peer.observer]


def _silent_publisher(state: StateFacts) -> Finding:
    """The finding for a matched publisher of LowState that sends nothing."""
    malformed = f"; malformed: {counted(state.malformed, 'sample')}" if state.malformed else ""
    return problem(
        "LowState",
        f"a publisher of {LOWSTATE.name} is matched, but no LowState was received in "
        f"{state.seconds:.1f} s{malformed}",
        "Check whether it hangs or is paused, or whether a firewall drops its packets.",
    )


def identify_publisher(wire: WireFacts) -> str:
    """Identify the publisher of LowState by its topics and values; "" without a publisher."""
    publishers = {peer.participant for peer in wire.writers_of(LOWSTATE.name)}
    if not publishers:
        return ""
    written = {peer.topic for peer in wire.writers if peer.participant in publishers}
    read = {peer.topic for peer in wire.readers if peer.participant in publishers}
    if LOG.name in written:
        return "g1stream's own bridge"
    if _ROBOT_WRITES & written or _ROBOT_READS & read:
        return "a robot"
    state = wire.state
    if state.received and SPORTMODESTATE.name in written:
        if state.tick_step is None and state.crc_zero == state.received and not state.has_rpy:
            return "unitree_mujoco's Python simulator (no tick, CRC or rpy)"
        if not state.has_motor_modes:
            return "unitree_mujoco's C++ simulator"
    return "an unknown publisher"


def _owners(peers: Iterable[Peer]) -> str:
    """The owners of peers, each once."""
    return ", ".join(sorted({peer.owner for peer in peers}))


def _mismatch(peer: Peer, qos_reason: str, message: str) -> Finding | None:
    if peer.same_type is False:
        return problem(
            "types",
            f"{peer.owner} uses {peer.topic} with another type, {peer.type_name}",
            f"Make it use Unitree's {message}_ as in idl/.",
        )
    if qos_reason:
        return problem(
            "QoS",
            f"{peer.owner} does not match on {peer.topic}: {qos_reason}",
            "Make it use the SDK's QoS: reliable or best effort, volatile, XCDR1.",
        )
    return None


def _other_type(peers: list[Peer], message: str) -> Finding:
    return problem(
        "types",
        f"{_owners(peers)} does not match on {peers[0].topic} although its QoS does, so its type "
        "must be different",
        f"Make it use Unitree's {message}_ as in idl/.",
    )
