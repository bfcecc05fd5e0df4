"""Peers that are seen and do not match, or match and say nothing; pure."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from g1stream.doctor.facts import Qos
from g1stream.doctor.finding import Finding, Level
from g1stream.doctor.peers import LOWCMD, LOWSTATE, mismatch

if TYPE_CHECKING:
    from collections.abc import Iterable

    from g1stream.doctor.facts import Peer, WireFacts

__all__ = [
    "command_misfits",
    "misfits",
    "names",
    "obedient",
    "silence",
    "state_misfits",
    "unanswered",
]

_OUR_READER: Final = Qos()
_OUR_WRITER: Final = Qos(reliable=True)


def misfits(writers: Iterable[Peer], message: str) -> list[Finding]:
    """Writers that our reader of a message cannot match."""
    found = (_misfit(peer, mismatch(peer.qos, _OUR_READER), message) for peer in writers)
    return [one for one in found if one]


def state_misfits(wire: WireFacts) -> list[Finding]:
    """Why publishers of LowState and our reader do not match."""
    writers = [peer for peer in wire.writers if peer.topic == LOWSTATE]
    found = misfits(writers, "LowState")
    # Cyclone 0.10.2 does not show the types that others announce.
    if writers and not found and not wire.states_matched:
        found.append(_other_type(writers, LOWSTATE, "LowState"))
    return found


def command_misfits(wire: WireFacts) -> list[Finding]:
    """Why those who read LowCmd to obey it do not match a writer of ours."""
    readers = obedient(wire)
    found = [_misfit(peer, mismatch(_OUR_WRITER, peer.qos), "LowCmd") for peer in readers]
    told = [one for one in found if one]
    if readers and not told and wire.commands_matched == 0:
        told.append(_other_type(readers, LOWCMD, "LowCmd"))
    return told


def obedient(wire: WireFacts) -> list[Peer]:
    """The readers of LowCmd that do not say that they only look."""
    return [peer for peer in wire.readers if peer.topic == LOWCMD and not peer.only_looks]


def silence(wire: WireFacts) -> list[Finding]:
    """A publisher of LowState that is matched, and of which nothing comes."""
    state = wire.state
    if not wire.states_matched or state.received:
        return []
    odd = f"; {state.malformed} samples were no LowState" if state.malformed else ""
    return [
        Finding(
            Level.PROBLEM,
            "LowState",
            f"a publisher of {LOWSTATE} is matched, but silent for {state.seconds:.1f} s{odd}",
            "See whether it hangs or is paused, or whether a firewall stops its packets.",
        )
    ]


def unanswered(domain: int, interface: str, wire: WireFacts) -> list[Finding]:
    """Why a streamer that waited for LowState and for a reader of LowCmd waited in vain."""
    found = [*state_misfits(wire), *silence(wire), *command_misfits(wire)]
    if found:
        return found
    here = f"domain {domain} on {interface}"
    ask = f"Run g1stream doctor --domain {domain} --interface {interface}: it looks elsewhere too."
    if not any(peer.topic == LOWSTATE for peer in wire.writers):
        return [Finding(Level.PROBLEM, "publisher", f"nobody publishes {LOWSTATE} in {here}", ask)]
    if not obedient(wire):
        cause = f"nobody reads {LOWCMD} in {here}: commands would move nothing"
        return [Finding(Level.PROBLEM, "LowCmd", cause, ask)]
    return [Finding(Level.WARNING, "wire", f"a robot is in {here} by now", "Play again.")]


def names(peers: Iterable[Peer]) -> str:
    """Who they are, each once."""
    return ", ".join(sorted({peer.who for peer in peers}))


def _misfit(peer: Peer, qos_reason: str, message: str) -> Finding | None:
    if peer.same_type is False:
        return Finding(
            Level.PROBLEM,
            "types",
            f"{peer.who} has {peer.topic} with a type of another structure, {peer.type_name}",
            f"Make it use Unitree's {message}_, as idl/ has it.",
        )
    if qos_reason:
        return Finding(
            Level.PROBLEM,
            "QoS",
            f"{peer.who} does not match on {peer.topic}: {qos_reason}",
            "Make it use the SDK's policies: reliable or best effort, volatile, XCDR1.",
        )
    return None


def _other_type(peers: list[Peer], topic: str, message: str) -> Finding:
    return Finding(
        Level.PROBLEM,
        "types",
        f"{names(peers)} does not match on {topic} though its policies fit: "
        "its type must be of another structure",
        f"Make it use Unitree's {message}_, as idl/ has it.",
    )
