"""Gather facts about this machine and a DDS domain, and judge them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from g1stream.doctor.facts import Facts
from g1stream.doctor.findings import examine
from g1stream.doctor.host import look_at_host
from g1stream.doctor.wakeup_latency import try_waking
from g1stream.doctor.wire import look_at_wire
from g1stream.errors import WireError

if TYPE_CHECKING:
    from g1stream.config import Config
    from g1stream.doctor.finding import Finding

__all__ = ["diagnose"]


def diagnose(config: Config, seconds: float = 1.0) -> list[Finding]:
    """What there is to say about this machine and the domain, worst or not.

    Only listens: nothing is published, and nobody is disturbed.

    Args:
        config: where to look (`dds`), which robots may be commanded (`safety`), and how punctual
            the loop wants to be (`realtime`, and `stream.rate`).
        seconds: how long to listen for LowState.
    """
    domain, interface = config.dds.domain, config.dds.interface
    host = look_at_host(config.realtime)
    punctuality = try_waking(config.realtime, config.stream.rate)
    wire, cannot_join = None, ""
    try:
        wire = look_at_wire(domain, interface, host.interfaces, seconds)
    except WireError as error:
        cannot_join = error.cause
    robots = config.safety.mode_machine
    return examine(Facts(domain, interface, robots, host, wire, cannot_join, punctuality))
