"""Who is there, and whether it fits; pure."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from g1stream.doctor.facts import Qos, StateFacts, WireFacts

__all__ = ["LOWCMD", "LOWSTATE", "SPORTMODESTATE", "mismatch", "our_program", "recognise"]

LOWCMD: Final = "rt/lowcmd"
LOWSTATE: Final = "rt/lowstate"
SPORTMODESTATE: Final = "rt/sportmodestate"

_OUR_LOG, _OUR_REFERENCE = "rt/g1stream/log", "rt/g1stream/reference"
_ROBOT_WRITES = {"rt/lf/lowstate", "rt/odommodestate"}
_ROBOT_READS = {"rt/arm_sdk"}
_DURABILITIES = ("volatile", "transient local", "transient", "persistent")


def mismatch(offered: Qos, requested: Qos) -> str:
    """Why a writer's policies do not serve a reader's, or "" where they do (DDS 1.4, 2.2.3)."""
    apart = set(offered.partitions or ("",)).isdisjoint(requested.partitions or ("",))
    reasons = {
        "the reader asks for reliable delivery, the writer offers best effort": requested.reliable
        and not offered.reliable,
        f"the reader asks for durability {_DURABILITIES[requested.durability]}, "
        f"the writer offers {_DURABILITIES[offered.durability]}": requested.durability
        > offered.durability,
        f"the reader asks for a sample every {requested.deadline / 1e6:g} ms at least, "
        "and the writer promises none": requested.deadline < offered.deadline,
        "one has exclusive ownership, the other shared": requested.exclusive != offered.exclusive,
        f"the writer is in partition {_listed(offered.partitions)}, "
        f"the reader in {_listed(requested.partitions)}": apart,
        "one has only the encoding XCDR2, the other XCDR1": requested.xcdr1 != offered.xcdr1,
    }
    return next((reason for reason, holds in reasons.items() if holds), "")


def our_program(written: set[str], read: set[str]) -> str:
    """Which program of ours has these topics, or "" where none of ours has."""
    if _OUR_REFERENCE in written:
        return "g1stream stream"
    if _OUR_LOG in written and LOWSTATE in written:
        return "g1stream sim"
    if {_OUR_LOG, _OUR_REFERENCE} <= read and not written:
        return "g1stream record"
    return ""


def recognise(wire: WireFacts) -> str:
    """Which of the known publishers of LowState this looks like; "" where there is none."""
    publishers = {peer.participant for peer in wire.writers if peer.topic == LOWSTATE}
    if not publishers:
        return ""
    topics = {peer.topic for peer in wire.writers if peer.participant in publishers}
    if _OUR_LOG in topics:
        return "g1stream's own bridge"
    read = {peer.topic for peer in wire.readers if peer.participant in publishers}
    if _ROBOT_WRITES & topics or _ROBOT_READS & read:
        return "a robot"
    return _simulator(wire.state, topics)


def _simulator(state: StateFacts, topics: set[str]) -> str:
    if state.received and SPORTMODESTATE in topics:
        if state.tick_step is None and state.crc_zero == state.received and not state.has_rpy:
            return "unitree_mujoco's Python simulator (it has no tick, checksum or rpy)"
        if not state.has_motor_modes:
            return "unitree_mujoco's C++ simulator"
    return "an unknown publisher"


def _listed(partitions: tuple[str, ...]) -> str:
    return ", ".join(partitions) or "the default one"
