"""Rules of the doctor, which derive findings from facts. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Final

from g1stream.dds.discovery import GUARD_PROGRAM, Qos, program_of, topics_of
from g1stream.dds.messages import COMMAND_NAMES, COMMANDS, LOG, LOWCMD, LOWSTATE, SPORTMODESTATE
from g1stream.doctor.facts import (
    Facts,
    Finding,
    HostFacts,
    Interface,
    Level,
    WakeupLatency,
    WireFacts,
    ok,
    problem,
    warning,
)
from g1stream.network import InterfaceFlags
from g1stream.robot.joints import JointSet
from g1stream.text import counted, listed

if TYPE_CHECKING:
    from g1stream.dds.local_participants import LocalParticipant
    from g1stream.dds.messages import Topic

_OK, _WARNING, _PROBLEM = Level
#: Receive buffer for a hundred LowStates, including the kernel's overhead, bytes.
_ENOUGH_BUFFER: Final = 1 << 20
_SLOW_CLOCKS: Final = ("hpet", "acpi_pm", "jiffies", "refined-jiffies")
#: Maximum number of programs in a finding.
_MOST_PROGRAMS: Final = 5
_START_ROBOT: Final = "Start a bridge (g1stream sim), or connect and switch on the robot."
_START_CONTROLLER: Final = "Let the robot stand with its own controller, which subscribes to it."

_OUR_READER: Final = Qos()
_OUR_WRITER: Final = Qos(reliable=True)
_DURABILITIES: Final = ("volatile", "transient local", "transient", "persistent")

# Topics of the robot's own services only.
_ROBOT_WRITES: Final = {"rt/lf/lowstate", "rt/odommodestate"}
_ROBOT_READS: Final = COMMAND_NAMES - {LOWCMD.name}


def _first(about: str, *rules: tuple[Level, object, str, str]) -> list[Finding]:
    """The finding of the first rule that applies, if any.

    A rule is a level, a test of the facts, and the cause and the remedy if the test is true.
    """
    return [
        Finding(level=level, about=about, cause=cause, remedy=remedy)
        for level, applies, cause, remedy in rules
        if applies
    ][:1]


def evaluate(facts: Facts) -> list[Finding]:
    """Derive all findings, in the order in which to fix them."""
    wire, via = facts.wire, COMMANDS[facts.via]
    interface = _interface(facts.host, wire.interface)
    found = [*interface, *_host(facts.host)]
    if facts.ros_domain not in (None, wire.domain):
        cause = f"ROS_DOMAIN_ID is {facts.ros_domain}, but g1stream uses domain {wire.domain}"
        remedy = f"Use --domain {facts.ros_domain} for the domain of ROS 2."
        found.append(warning("domain", cause, remedy))
    if facts.wakeup_latency:
        found.append(_wakeup(facts.wakeup_latency))
    if not wire.join_error:
        return [*found, *_publishers(wire), *_states(facts), *_base(wire), *_commands(wire, via)]
    # An unusable interface already explains it.
    if all(one.level is not _PROBLEM for one in interface):
        remedy = "Fix this, then run the doctor again to check the domain."
        found.append(problem("domain", wire.join_error, remedy))
    return found


def explain_no_robot(wire: WireFacts, topic: Topic = LOWCMD) -> list[Finding]:
    """Explain why a stream found no LowState or no subscriber of its topic in time."""
    found = [*_mismatches(wire, LOWSTATE), *_mismatches(wire, topic), *_silence(wire)]
    if found or not wire.writers_of(LOWSTATE):
        return found or list(_publishers(wire))
    if wire.readers_of(topic):
        late = f"a robot appeared {wire.here} after the wait ended"
        return [warning("wire", late, "Stream again.")]
    doctor = f"g1stream doctor --domain {wire.domain} --interface {wire.interface}"
    cause = f"no subscriber on {topic.name} {wire.here}"
    return [problem("LowCmd", cause, f"Run {doctor} for more checks.")]


def _interface(host: HostFacts, name: str) -> list[Finding]:
    """Check that DDS can use the interface."""
    about, known = "interface", {one.name: one for one in host.interfaces}
    choose = f"Choose --interface from {', '.join(known)}."
    used = known.get(name, Interface(name, InterfaceFlags(0), ""))
    multicast = InterfaceFlags.MULTICAST in used.flags
    kind = "multicast" if multicast else "no multicast; discovery by address"
    return [
        *_first(
            about,
            (
                _WARNING,
                host.uri,
                f"CYCLONEDDS_URI is set and selects the interface, not {name}: {host.uri}",
                "Unset it unless this is intended.",
            ),
        ),
        *_first(
            about,
            (_PROBLEM, name not in known, f"this machine has no interface {name}", choose),
            (
                _PROBLEM,
                InterfaceFlags.UP not in used.flags,
                f"{name} is down",
                f"Bring it up: ip link set {name} up.",
            ),
            (
                _PROBLEM,
                not used.address,
                f"{name} has no IPv4 address",
                "Assign one; Unitree's robots are in 192.168.123.0/24.",
            ),
            (
                _PROBLEM,
                not multicast and InterfaceFlags.LOOPBACK not in used.flags,
                f"{name} has no multicast, which DDS discovery needs",
                f"Enable it: ip link set {name} multicast on.",
            ),
            (_OK, True, f"{name} is up, {used.address}, {kind}", ""),
        ),
    ]


def _host(host: HostFacts) -> Iterator[Finding]:
    """Check that this machine is suitable for real-time work."""
    version, clock, buffer = host.cyclonedds, host.clock_source, host.rmem_max
    untested = f"{version} is not tested with Unitree's SDK and simulators"
    yield from _first(
        "cyclonedds",
        (_OK, version.startswith(("11.", "0.10.")), version, ""),
        (_WARNING, True, untested, "Install 0.10.2, the version of the SDK, or 11."),
    )
    limit = f"{(buffer or 0) // 1024} KiB"
    small = f"the kernel limits receive buffers to {limit}; a burst of samples overflows them"
    enlarge = "Run: sysctl -w net.core.rmem_max=4194304"
    yield from _first(
        "sockets",
        (_WARNING, buffer is not None and buffer < _ENOUGH_BUFFER, small, enlarge),
        (_OK, buffer, f"receive buffers up to {limit}", ""),
    )
    yield from _first(
        "clock",
        (
            _WARNING,
            clock in _SLOW_CLOCKS,
            f"the clock source is {clock}; reading the time takes microseconds",
            "Find out why the kernel does not use tsc: dmesg | grep -i tsc",
        ),
        (_OK, clock, f"source {clock}", ""),
    )
    for one in host.grants:
        cause, cost = f"{one.what}: {one.detail}", one.cost and f"; without it, {one.cost}"
        yield from _first(
            "real time",
            (_OK, one.granted, cause, ""),
            (_WARNING, True, cause + cost, one.remedy),
        )


def _wakeup(latency: WakeupLatency) -> Finding:
    """Check that this machine wakes a thread at its deadlines."""
    at, worst = f"at {latency.rate:g} Hz", f"at most {latency.worst_ns / 1e6:.2f} ms late"
    (finding,) = _first(
        "wake-up",
        (
            _WARNING,
            latency.missed,
            f"{latency.missed} of {latency.deadlines} deadlines {at} missed by a whole period, "
            f"{worst}; other load or a hypervisor stops the programs on this machine",
            "Stop other load and fix the real-time warnings; if deadlines are still missed, use a "
            "machine that is not virtual, or expect skipped ticks.",
        ),
        (_OK, True, f"{latency.deadlines} deadlines {at}, none missed, {worst}", ""),
    )
    figures = {
        "rate_hz": latency.rate,
        "deadlines": latency.deadlines,
        "missed_deadlines": latency.missed,
        "median_lateness_us": latency.median_ns / 1000.0,
        "worst_lateness_us": latency.worst_ns / 1000.0,
    }
    return finding.model_copy(update={"figures": figures})


def _publishers(wire: WireFacts) -> Iterator[Finding]:
    """Check the publishers of LowState, here and elsewhere."""
    if writers := wire.writers_of(LOWSTATE):
        yield from _mismatches(wire, LOWSTATE)
        yield ok("publisher", f"{identify_publisher(wire)}: {wire.owners(writers)}")
        return
    nobody = f"no publisher on {LOWSTATE.name} {wire.here}"
    for domain, name, owner in wire.elsewhere:
        there = f"{nobody}; {owner} publishes it in domain {domain} on {name}"
        if domain != wire.domain:
            yield problem("domain", there, f"Use --domain {domain}.")
        else:
            yield problem("interface", there, f"Use --interface {name}.")
    searched = "".join(f", nor in domain {other} on {name}" for other, name in wire.searched)
    asked = (f" To search {one}: g1stream doctor --interface {one}." for one in wire.unsearched)
    apart = [one for one in wire.local if one.apart]
    if not wire.elsewhere:
        local = _programs(one for one in wire.local if not one.apart)
        yield problem(
            "publisher",
            f"{nobody}{searched}; other programs discovered there: {_others(wire)}; DDS programs "
            f"on this machine: {local}",
            _START_ROBOT + "".join(asked),
        )
    if apart:
        yield warning(
            "containers",
            f"programs in other network namespaces, such as containers: {_programs(apart)}",
            "Start the container with --network host, or use an interface that reaches it.",
        )


def _others(wire: WireFacts) -> int:
    """Number of other participants, without the guard of the stream that calls the doctor."""
    found = wire.writers, wire.readers
    others = {one.participant for endpoints in found for one in endpoints}
    return sum(program_of(one, *found) != GUARD_PROGRAM for one in others)


def _programs(local: Iterable[LocalParticipant]) -> str:
    """Names of the first programs, with their domains."""
    return listed([f"{one} in domain {one.domain}" for one in local] or ["none"], _MOST_PROGRAMS)


def _silence(wire: WireFacts) -> list[Finding]:
    """Check that a matched publisher of LowState sends something."""
    bad = wire.state.malformed
    malformed = f"; malformed: {counted(bad, 'sample')}" if bad else ""
    return _first(
        "LowState",
        (
            _PROBLEM,
            wire.states_matched and not wire.state.received,
            f"a publisher of {LOWSTATE.name} is matched, but no LowState was received in "
            f"{wire.state.seconds:.1f} s{malformed}",
            "Check whether it hangs or is paused, or whether a firewall drops its packets.",
        ),
    )


def _states(facts: Facts) -> Iterator[Finding]:
    """Check the LowStates received on rt/lowstate."""
    yield from _silence(facts.wire)
    state, mode = facts.wire.state, facts.wire.state.mode_machine
    if not (facts.wire.states_matched and state.received):
        return
    age, oldest = state.ages_ms
    rate = state.received / state.seconds
    text = f"{rate:.0f} Hz, received {age:.2f} ms after publication, at most {oldest:.2f} ms"
    yield from _first(
        "LowState",
        (
            _WARNING,
            abs(age) > 1000.0,
            f"{text}; the clocks of the publisher and of this machine differ",
            "Synchronise them with NTP or PTP, or do not compare publish times with log times.",
        ),
        (_OK, True, text, ""),
    )
    steps = f"steps of {state.tick_step} ms"
    unnumbered = "only the ticks of g1stream's own bridge number its samples"
    yield from _first(
        "tick",
        (_OK, state.tick_step is None, "not provided", ""),
        (_OK, state.missed is None, f"{steps}, {state.tick_jumps} larger; {unnumbered}", ""),
        (_OK, state.missed == 0, f"{steps}, none missing", ""),
        (
            _WARNING,
            True,
            f"{counted(state.missed or 0, 'LowState')} lost in {state.seconds:.1f} s",
            "Check the load of both machines, the network, and the receive buffers.",
        ),
    )
    wrong = f"{state.received - state.crc_right} of {state.received} LowStates with a wrong CRC"
    compute = "Make the publisher compute Unitree's CRC over the C struct."
    yield from _first(
        "CRC",
        (_OK, state.crc_zero == state.received, "not provided", ""),
        (_PROBLEM, state.crc_right < state.received, wrong, compute),
        (_OK, True, "correct", ""),
    )
    kind = JointSet.of_mode(mode)
    told = (str(mode) if mode else "not provided") + (f", {kind}" if kind else "")
    other = f"{mode}, but the robot of --robot has {' or '.join(map(str, facts.allowed_robots))}"
    allow = "Use a G1 with one of these values, or allow it with safety.mode_machine."
    yield from _first(
        "mode_machine",
        (_OK, mode in facts.allowed_robots, told, ""),
        (_PROBLEM, True, other, f"Use --robot {kind.name}." if kind else allow),
    )
    yield from _first(
        "mode_pr",
        (
            _PROBLEM,
            state.mode_pr,
            f"{state.mode_pr}: ankles and waist are motors A and B, so nothing is played",
            "End the program that has set it, or restart the robot.",
        ),
    )


def _base(wire: WireFacts) -> list[Finding]:
    """Check whether the position of the pelvis is published."""
    writers, name = wire.writers_of(SPORTMODESTATE), SPORTMODESTATE.name
    states = wire.writers_of(LOWSTATE)
    given = _first(
        "base",
        (_OK, writers, f"{name} from {wire.owners(writers)}", ""),
        (_OK, states, "position and velocity not provided", ""),
    )
    return [*_mismatches(wire, SPORTMODESTATE), *given]


def _commands(wire: WireFacts, topic: Topic) -> Iterator[Finding]:
    """Check the readers and writers of LowCmd on a topic."""
    readers, mismatches = wire.readers_of(topic), _mismatches(wire, topic)
    yield from mismatches
    nobody = f"no subscriber on {topic.name}, so commands have no effect"
    start = _START_ROBOT if topic is LOWCMD else _START_CONTROLLER
    yield from _first(
        "LowCmd",
        (_PROBLEM, not readers and wire.writers_of(LOWSTATE), nobody, start),
        (_OK, readers and not mismatches, f"subscriber: {wire.owners(readers)}", ""),
    )
    writers = wire.writers_of(topic)
    other = f"another publisher on {topic.name}, {wire.owners(writers)}"
    refuses = f"{other}; g1stream stream will refuse to start"
    yield from _first("LowCmd", (_WARNING, writers, refuses, "Stop it before you stream."))


def _mismatches(wire: WireFacts, topic: Topic) -> list[Finding]:
    """Check that subscribers of commands, or publishers of another topic, match g1stream's."""
    if topic in COMMANDS.values():
        peers, matched = wire.readers_of(topic), wire.commands_matched
        reasons = [qos_mismatch(_OUR_WRITER, one.qos) for one in peers]
    else:
        peers = wire.writers_of(topic)
        matched = wire.states_matched if topic is LOWSTATE else None
        reasons = [qos_mismatch(one.qos, _OUR_READER) for one in peers]
    use_type = f"Make it use Unitree's {topic.idl_type.__name__} as in idl/."
    use_qos = "Make it use the SDK's QoS: reliable or best effort, volatile, XCDR1."
    found = []
    for peer, reason in zip(peers, reasons, strict=True):
        owner = wire.owners([peer])
        other = f"{owner} uses {topic.name} with another type, {peer.type_name}"
        apart = f"{owner} does not match on {topic.name}: {reason}"
        found += _first("types", (_PROBLEM, peer.same_type is False, other, use_type)) or _first(
            "QoS", (_PROBLEM, reason, apart, use_qos)
        )
    # Cyclone 0.10.2 does not show the announced types of other participants.
    owners = f"{wire.owners(peers)} does not match on {topic.name} although its QoS does"
    hidden = f"{owners}, so its type must be different"
    return found or _first("types", (_PROBLEM, peers and matched == 0, hidden, use_type))


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


def identify_publisher(wire: WireFacts) -> str:
    """Identify the publisher of LowState by its topics and values; "" without a publisher."""
    publishers = {one.participant for one in wire.writers_of(LOWSTATE)}
    written, read = topics_of(publishers, wire.writers, wire.readers)
    state, simulator = wire.state, wire.state.received and SPORTMODESTATE.name in written
    of_python = state.tick_step is None and state.crc_zero == state.received and not state.has_rpy
    names = (
        (not publishers, ""),
        (LOG.name in written, "g1stream's own bridge"),
        (_ROBOT_WRITES & written or _ROBOT_READS & read, "a robot"),
        (simulator and of_python, "unitree_mujoco's Python simulator (no tick, CRC or rpy)"),
        (simulator and not state.has_motor_modes, "unitree_mujoco's C++ simulator"),
    )
    return next((name for fits, name in names if fits), "an unknown publisher")
