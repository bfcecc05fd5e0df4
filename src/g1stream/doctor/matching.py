"""Which endpoints match ours, which do not and why, and which program they belong to; pure."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from g1stream.dds.topics import LOG, LOWCMD, LOWSTATE, SPORTMODESTATE
from g1stream.doctor.facts import Finding, Peer, Qos, StateFacts, WireFacts, problem, warning

if TYPE_CHECKING:
    from collections.abc import Iterable

__all__ = [
    "command_mismatches",
    "command_subscribers",
    "explain_no_robot",
    "identify_publisher",
    "owners",
    "qos_mismatch",
    "silent_publisher",
    "state_mismatches",
    "writer_mismatches",
]

_OUR_READER: Final = Qos()
_OUR_WRITER: Final = Qos(reliable=True)
_DURABILITIES: Final = ("volatile", "transient local", "transient", "persistent")

# Topics that only the robot's own services have.
_ROBOT_WRITES: Final = {"rt/lf/lowstate", "rt/odommodestate"}
_ROBOT_READS: Final = {"rt/arm_sdk"}


def qos_mismatch(offered: Qos, requested: Qos) -> str:
    """Why a writer's QoS does not serve a reader's, or "" where it does (DDS 1.4, 2.2.3)."""
    if requested.reliable and not offered.reliable:
        return "the reader requests reliable delivery, the writer offers best effort"
    if requested.durability > offered.durability:
        return (
            f"the reader requests durability {_DURABILITIES[requested.durability]}, "
            f"the writer offers {_DURABILITIES[offered.durability]}"
        )
    if requested.deadline < offered.deadline:
        every = f"a sample every {requested.deadline / 1e6:g} ms"
        return f"the reader requests {every}, the writer offers no such deadline"
    if requested.exclusive != offered.exclusive:
        return "one has exclusive ownership, the other shared"
    if set(offered.partitions or ("",)).isdisjoint(requested.partitions or ("",)):
        offers, requests = (
            ", ".join(qos.partitions) or "the default one" for qos in (offered, requested)
        )
        return f"the writer is in partition {offers}, the reader in {requests}"
    same = requested.xcdr1 == offered.xcdr1
    return "" if same else "one uses only the encoding XCDR2, the other XCDR1"


def writer_mismatches(writers: Iterable[Peer], message: str) -> list[Finding]:
    """Writers that our reader of a message cannot match."""
    found = (_mismatch(peer, qos_mismatch(peer.qos, _OUR_READER), message) for peer in writers)
    return [one for one in found if one]


def state_mismatches(wire: WireFacts) -> list[Finding]:
    """Why publishers of LowState and our reader do not match."""
    writers = wire.writers_of(LOWSTATE.name)
    found = writer_mismatches(writers, "LowState")
    # Cyclone 0.10.2 does not show the types that others announce.
    if writers and not found and not wire.states_matched:
        found.append(_other_type(writers, "LowState"))
    return found


def command_mismatches(wire: WireFacts) -> list[Finding]:
    """Why subscribers of LowCmd do not match a writer of ours."""
    readers = command_subscribers(wire)
    found = [_mismatch(peer, qos_mismatch(_OUR_WRITER, peer.qos), "LowCmd") for peer in readers]
    findings = [one for one in found if one]
    if readers and not findings and wire.commands_matched == 0:
        findings.append(_other_type(readers, "LowCmd"))
    return findings


def command_subscribers(wire: WireFacts) -> list[Peer]:
    """The subscribers of LowCmd that may act on it."""
    return [peer for peer in wire.readers if peer.topic == LOWCMD.name and not peer.observer]


def silent_publisher(state: StateFacts) -> Finding:
    """A publisher of LowState that is matched and sends nothing."""
    malformed = f"; {state.malformed} samples were no LowState" if state.malformed else ""
    return problem(
        "LowState",
        f"a publisher of {LOWSTATE.name} is matched, and no LowState was received in "
        f"{state.seconds:.1f} s{malformed}",
        "Check whether it hangs or is paused, or whether a firewall drops its packets.",
    )


def explain_no_robot(domain: int, interface: str, wire: WireFacts) -> list[Finding]:
    """Why a streamer that waited for LowState and for a subscriber of LowCmd had no success."""
    found = [*state_mismatches(wire), *command_mismatches(wire)]
    if wire.states_matched and not wire.state.received:
        found.append(silent_publisher(wire.state))
    if found:
        return found
    here = f"in domain {domain} on {interface}"
    remedy = f"Run g1stream doctor --domain {domain} --interface {interface}: it searches further."
    if not wire.writers_of(LOWSTATE.name):
        return [problem("publisher", f"no publisher on {LOWSTATE.name} {here}", remedy)]
    if not command_subscribers(wire):
        return [problem("LowCmd", f"no subscriber on {LOWCMD.name} {here}", remedy)]
    return [warning("wire", f"a robot appeared {here} after the wait ended", "Stream again.")]


def identify_publisher(wire: WireFacts) -> str:
    """Which known publisher of LowState this looks like; "" where there is none."""
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


def owners(peers: Iterable[Peer]) -> str:
    """The processes that peers belong to, each once."""
    return ", ".join(sorted({peer.owner for peer in peers}))


def _mismatch(peer: Peer, qos_reason: str, message: str) -> Finding | None:
    if peer.same_type is False:
        return problem(
            "types",
            f"{peer.owner} has {peer.topic} with another type, {peer.type_name}",
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
        f"{owners(peers)} does not match on {peers[0].topic} though its QoS fits: "
        "its type must differ",
        f"Make it use Unitree's {message}_ as in idl/.",
    )
