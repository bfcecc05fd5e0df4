"""From facts to findings, each with its cause and its remedy; pure."""

from __future__ import annotations

from typing import TYPE_CHECKING

from g1stream.doctor.endpoint_mismatches import (
    command_misfits,
    misfits,
    names,
    obedient,
    silence,
    state_misfits,
)
from g1stream.doctor.finding import Finding, Level
from g1stream.doctor.host_findings import examine_host, examine_interface, examine_punctuality
from g1stream.doctor.peers import LOWCMD, LOWSTATE, SPORTMODESTATE, recognise

if TYPE_CHECKING:
    from collections.abc import Iterator

    from g1stream.doctor.facts import Facts, StateFacts, WireFacts

__all__ = ["examine"]

_JOIN = "Mend that, and ask again for what is in the domain."


def examine(facts: Facts) -> list[Finding]:
    """Everything there is to say, in the order in which to mend it."""
    found = [*examine_interface(facts), *examine_host(facts.host)]
    if facts.punctuality:
        found.append(examine_punctuality(facts.punctuality))
    if facts.wire is None:
        # An interface that is none is the whole reason already.
        known = any(one.about == "interface" and one.level is Level.PROBLEM for one in found)
        cannot = Finding(Level.PROBLEM, "domain", facts.cannot_join, _JOIN)
        return found if known else [*found, cannot]
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
        yield from state_misfits(wire)
        yield Finding(Level.OK, "publisher", f"{recognise(wire)}: {names(writers)}")
        return
    for domain, interface, who in wire.elsewhere:
        is_domain = domain != facts.domain
        yield Finding(
            Level.PROBLEM,
            "domain" if is_domain else "interface",
            f"nobody publishes {LOWSTATE} in {here}; in domain {domain} on {interface}, {who} does",
            f"Use --domain {domain}." if is_domain else f"Use --interface {interface}.",
        )
    if not wire.elsewhere:
        others = len({peer.participant for peer in (*wire.writers, *wire.readers)})
        there = "1 other program is" if others == 1 else f"{others or 'no'} other programs are"
        yield Finding(
            Level.PROBLEM,
            "publisher",
            f"nobody publishes {LOWSTATE} in {here}{_nor_in(facts, wire)}; {there} there",
            "Start a bridge (g1stream sim), or connect and switch on the robot.",
        )


def _nor_in(facts: Facts, wire: WireFacts) -> str:
    """Where else nobody does."""
    domains = [str(domain) for domain, name in wire.searched if name == facts.interface]
    others = [name for _, name in wire.searched if name != facts.interface]
    text = f", nor in domains {', '.join(domains)} on it" if domains else ""
    return text + (f", nor on {', '.join(others)}" if others else "")


def _states(facts: Facts, wire: WireFacts) -> Iterator[Finding]:
    state, about = wire.state, "LowState"
    if not wire.states_matched:
        return
    if not state.received:
        yield from silence(wire)
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
    yield from misfits(writers, "SportModeState")
    if writers:
        yield Finding(Level.OK, "base", f"{SPORTMODESTATE} from {names(writers)}")
    elif any(peer.topic == LOWSTATE for peer in wire.writers):
        yield Finding(Level.OK, "base", "position and velocity not provided")


def _commands(wire: WireFacts) -> Iterator[Finding]:
    readers = obedient(wire)
    writers = [peer for peer in wire.writers if peer.topic == LOWCMD]
    apart = command_misfits(wire)
    yield from apart
    if not readers and any(peer.topic == LOWSTATE for peer in wire.writers):
        yield Finding(
            Level.PROBLEM,
            "LowCmd",
            f"nobody reads {LOWCMD}: commands would move nothing",
            "Start a bridge (g1stream sim), or connect and switch on the robot.",
        )
    elif readers and not apart:
        yield Finding(Level.OK, "LowCmd", f"read by {names(readers)}")
    if writers:
        yield Finding(
            Level.WARNING,
            "LowCmd",
            f"written already, by {names(writers)}: g1stream stream will refuse to start",
            "End it before you stream.",
        )
