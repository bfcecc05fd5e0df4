"""Gather facts about this machine and a DDS domain, and evaluate them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from g1stream.doctor.facts import Facts
from g1stream.doctor.findings import evaluate
from g1stream.doctor.host import inspect_host, measure_wakeup_latency
from g1stream.doctor.wire import inspect_domain
from g1stream.errors import WireError
from g1stream.robot.model import G1

if TYPE_CHECKING:
    from g1stream.config import Config
    from g1stream.doctor.facts import Finding

__all__ = ["diagnose"]


def diagnose(config: Config, seconds: float = 1.0) -> list[Finding]:
    """Check this machine and the domain; each check has a finding, also where all is well.

    Only listens: nothing is published, so that no other program is disturbed.

    Args:
        config: where to look (`dds`), which robots may be commanded (`safety`), and what the loop
            requests of the system (`realtime`, and `stream.rate`).
        seconds: how long to listen for LowState.
    """
    domain, interface = config.dds.domain, config.dds.interface
    host = inspect_host(config.realtime)
    latency = measure_wakeup_latency(config.realtime, config.stream.rate)
    wire, join_error = None, ""
    try:
        wire = inspect_domain(domain, interface, host.interfaces, seconds)
    except WireError as error:
        join_error = error.cause
    robots = G1.load(config.robot).joint_set.allowed(config.safety.mode_machine)
    via = config.stream.via
    return evaluate(Facts(domain, interface, robots, host, wire, join_error, latency, via))
