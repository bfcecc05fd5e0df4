"""From facts to findings, each with its cause and its remedy; pure."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from g1stream.doctor.facts import Qos
from g1stream.doctor.finding import Finding, Level
from g1stream.doctor.host_findings import examine_host, examine_interface, examine_punctuality
from g1stream.doctor.peers import LOWCMD, LOWSTATE, SPORTMODESTATE, mismatch, recognise

if TYPE_CHECKING:
    from collections.abc import Iterator

    from g1stream.doctor.facts import Facts, Peer, StateFacts, WireFacts

__all__ = ["examine"]

_OUR_READER: Final = Qos()
_OUR_WRITER: Final = Qos(reliable=True)


def examine(facts: Facts) -> list[Finding]:
    """Everything there is to say, in the order in which to mend it."""
    found = [*examine_interface(facts), *examine_host(facts.host)]
    if facts.punctuality:
        found.append(examine_punctuality(facts.punctuality))
    if facts.wire is None:
        return [*found, Finding(Level.PROBLEM, "domain", facts.cannot_join, "Mend that first.")]
    return [
        *found,
        *_presence(facts, facts.wire),
        *_states(facts, facts.wire),
        *_base(facts.wire),
        *_commands(facts.wire),
    ]


def _presence(facts: Facts, wire: WireFacts) -> Iterator[Finding]:
    here = f"domain {facts.domain} on {facts.interface}"
    writers = [peer for peer in wire.writers if peer.topic == LOWSTATE]
    if writers:
        yield from _misfits(writers, "LowState")
        yield Finding(Level.OK, "publisher", f"{recognise(wire)}: {_names(writers)}")
        return
    for domain, interface, who in wire.elsewhere:
        is_domain = domain != facts.domain
        yield Finding(
            Level.PROBLEM,
            "domain" if is_domain else "interface",
            f"nobody publishes {LOWSTATE} in {here}, but in domain {domain} on {interface} does "
            f"{who}",
            f"Use --domain {domain}." if is_domain else f"Use --interface {interface}.",
        )
    if not wire.elsewhere:
        others = len({peer.participant for peer in (*wire.writers, *wire.readers)})
        yield Finding(
            Level.PROBLEM,
            "publisher",
            f"nobody publishes {LOWSTATE} in {here}, nor in the domains beside it; "
            f"{others} other programs are there",
            "Start a bridge (g1stream sim), or connect and switch on the robot.",
        )


def _misfits(writers: list[Peer], name: str) -> Iterator[Finding]:
    for peer in writers:
        if reason := _misfit(peer, mismatch(peer.qos, _OUR_READER), name):
            yield reason


def _misfit(peer: Peer, qos_reason: str, name: str) -> Finding | None:
    if peer.same_type is False:
        return Finding(
            Level.PROBLEM,
            "types",
            f"{peer.who} has {peer.topic} with a type of another structure, {peer.type_name}",
            f"Make it use Unitree's {name}_, as idl/ has it.",
        )
    if qos_reason:
        return Finding(
            Level.PROBLEM,
            "QoS",
            f"{peer.who} does not match on {peer.topic}: {qos_reason}",
            "Make it use the SDK's policies: reliable or best effort, volatile, XCDR1.",
        )
    return None


def _states(facts: Facts, wire: WireFacts) -> Iterator[Finding]:
    state, about = wire.state, "LowState"
    if not wire.states_matched:
        writers = [peer for peer in wire.writers if peer.topic == LOWSTATE]
        # Cyclone 0.10.2 does not show the types that others announce.
        if writers and not any(_misfits(writers, "LowState")):
            yield Finding(
                Level.PROBLEM,
                "types",
                f"{_names(writers)} does not match on {LOWSTATE} though its policies fit: "
                "its type must be of another structure",
                "Make it use Unitree's LowState_, as idl/ has it.",
            )
        return
    if not state.received:
        yield Finding(
            Level.PROBLEM,
            about,
            f"a publisher of {LOWSTATE} is matched, but silent for {state.seconds:.1f} s"
            + (f"; {state.malformed} samples were no LowState" if state.malformed else ""),
            "See whether it hangs or is paused, or whether a firewall stops its packets.",
        )
        return
    rate, (age, oldest) = state.received / state.seconds, state.ages_ms
    text = f"{rate:.0f} a second, {age:.2f} ms old on arrival, {oldest:.2f} ms at most"
    if abs(age) > 1000.0:
        yield Finding(
            Level.WARNING,
            about,
            f"{text}: the publisher's clock and this one differ",
            "Set both by NTP or PTP, or do not compare publish times with log times.",
        )
    else:
        yield Finding(Level.OK, about, text)
    yield from _contents(facts, state)


def _contents(facts: Facts, state: StateFacts) -> Iterator[Finding]:
    if state.tick_step is None:
        yield Finding(Level.OK, "tick", "not provided: lost samples cannot be counted")
    elif state.missed:
        yield Finding(
            Level.WARNING,
            "tick",
            f"{state.missed} LowStates did not arrive in {state.seconds:.1f} s",
            "See to the load of both machines, the network, and the receive buffers.",
        )
    else:
        yield Finding(Level.OK, "tick", f"steps of {state.tick_step} ms, none missing")
    if state.crc_zero == state.received:
        yield Finding(Level.OK, "checksum", "not provided")
    elif state.crc_right < state.received:
        yield Finding(
            Level.PROBLEM,
            "checksum",
            f"{state.received - state.crc_right} of {state.received} LowStates carry a wrong one",
            "Make the publisher compute Unitree's, over the C struct.",
        )
    else:
        yield Finding(Level.OK, "checksum", "right")
    if state.mode_machine in facts.robots:
        what = "not provided" if state.mode_machine == 0 else f"{state.mode_machine}, 29 joints"
        yield Finding(Level.OK, "mode_machine", what)
    else:
        yield Finding(
            Level.PROBLEM,
            "mode_machine",
            f"{state.mode_machine}: not a robot with the 29 joints of the motions",
            "Use a 29-joint G1 (5), or allow it in the config: safety.mode_machine.",
        )


def _base(wire: WireFacts) -> Iterator[Finding]:
    writers = [peer for peer in wire.writers if peer.topic == SPORTMODESTATE]
    yield from _misfits(writers, "SportModeState")
    if writers:
        yield Finding(Level.OK, "base", f"{SPORTMODESTATE} from {_names(writers)}")
    else:
        yield Finding(Level.OK, "base", "position and velocity not provided")


def _commands(wire: WireFacts) -> Iterator[Finding]:
    readers = [peer for peer in wire.readers if peer.topic == LOWCMD]
    writers = [peer for peer in wire.writers if peer.topic == LOWCMD]
    misfits = [_misfit(peer, mismatch(_OUR_WRITER, peer.qos), "LowCmd") for peer in readers]
    yield from filter(None, misfits)
    if not readers and any(peer.topic == LOWSTATE for peer in wire.writers):
        yield Finding(
            Level.PROBLEM,
            "LowCmd",
            f"nobody reads {LOWCMD}: commands would move nothing",
            "Start a bridge (g1stream sim), or connect and switch on the robot.",
        )
    elif readers and not any(misfits):
        yield Finding(Level.OK, "LowCmd", f"read by {_names(readers)}")
    if writers:
        yield Finding(
            Level.WARNING,
            "LowCmd",
            f"written already, by {_names(writers)}: g1stream stream will refuse to start",
            "End it before you stream.",
        )


def _names(peers: list[Peer]) -> str:
    return ", ".join(sorted({peer.who for peer in peers}))
