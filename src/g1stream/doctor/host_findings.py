"""Findings about this machine; pure."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from g1stream.doctor.finding import Finding, Level

if TYPE_CHECKING:
    from collections.abc import Iterator

    from g1stream.doctor.facts import Facts, HostFacts, Punctuality

__all__ = ["examine_host", "examine_interface", "examine_punctuality"]

#: Room for a hundred LowStates, with what the kernel keeps beside each.
_ENOUGH_BUFFER: Final = 1 << 20
_SLOW_CLOCKS: Final = ("hpet", "acpi_pm", "jiffies", "refined-jiffies")


def examine_interface(facts: Facts) -> Iterator[Finding]:
    """Whether DDS can work on the interface."""
    host, about = facts.host, "interface"
    if host.uri:
        yield Finding(
            Level.WARNING,
            about,
            f"CYCLONEDDS_URI is set and chooses the interface, not {facts.interface}: {host.uri}",
            "Unset it, unless you mean it.",
        )
    found = next((one for one in host.interfaces if one.name == facts.interface), None)
    if found is None:
        names = ", ".join(one.name for one in host.interfaces)
        yield Finding(
            Level.PROBLEM,
            about,
            f"this machine has no interface {facts.interface}",
            f"Choose --interface from {names}.",
        )
    elif not found.up:
        remedy = f"Bring it up: ip link set {found.name} up."
        yield Finding(Level.PROBLEM, about, f"{found.name} is down", remedy)
    elif not found.address:
        yield Finding(
            Level.PROBLEM,
            about,
            f"{found.name} has no IPv4 address",
            "Give it one; Unitree's robots are in 192.168.123.0/24.",
        )
    elif not found.multicast and not found.loopback:
        yield Finding(
            Level.PROBLEM,
            about,
            f"{found.name} has no multicast, by which DDS finds others",
            f"Allow it: ip link set {found.name} multicast on.",
        )
    else:
        multicast = "multicast" if found.multicast else "no multicast; others are found by address"
        yield Finding(Level.OK, about, f"{found.name} is up, {found.address}, {multicast}")


def examine_host(host: HostFacts) -> Iterator[Finding]:
    """Whether this machine is fit to be on time."""
    if host.cyclonedds.split(".")[0] == "11" or host.cyclonedds.startswith("0.10."):
        yield Finding(Level.OK, "cyclonedds", host.cyclonedds)
    else:
        yield Finding(
            Level.WARNING,
            "cyclonedds",
            f"{host.cyclonedds} was never tried against Unitree's peers",
            "Install 0.10.2, as the SDK has it, or 11.",
        )
    if host.rmem_max is not None and host.rmem_max < _ENOUGH_BUFFER:
        yield Finding(
            Level.WARNING,
            "sockets",
            f"the kernel allows receive buffers of {host.rmem_max // 1024} KiB: a burst overflows",
            "Run: sysctl -w net.core.rmem_max=4194304",
        )
    elif host.rmem_max is not None:
        yield Finding(Level.OK, "sockets", f"receive buffers up to {host.rmem_max // 1024} KiB")
    if host.clock_source in _SLOW_CLOCKS:
        yield Finding(
            Level.WARNING,
            "clock",
            f"the clock source is {host.clock_source}: each look at the time costs microseconds",
            "See why the kernel does not trust tsc: dmesg | grep -i tsc",
        )
    elif host.clock_source:
        yield Finding(Level.OK, "clock", f"source {host.clock_source}")
    for grant in host.grants:
        if grant.granted:
            yield Finding(Level.OK, "real time", f"{grant.what}: {grant.detail}")
        else:
            cost = f"; without it, {grant.cost}" if grant.cost else ""
            cause = f"{grant.what}: {grant.detail}{cost}"
            yield Finding(Level.WARNING, "real time", cause, grant.remedy)


def examine_punctuality(tried: Punctuality) -> Finding:
    """Whether this machine wakes a thread when it asks for it."""
    about, figures = "punctuality", _figures(tried)
    at = f"at {tried.rate:g} Hz"
    worst = f"{tried.worst_ns / 1e6:.2f} ms late at worst"
    if not tried.missed:
        cause = f"woken {tried.deadlines} times {at}, {worst}, no deadline missed"
        return Finding(Level.OK, about, cause, figures=figures)
    return Finding(
        Level.WARNING,
        about,
        f"{tried.missed} of {tried.deadlines} deadlines {at} were missed by a whole "
        f"period, {worst}: this machine stops its programs by itself: another load or a hypervisor",
        "End other load and mend what real time lacks; where it stays, use a machine that is not "
        "virtual, or expect skipped ticks.",
        figures,
    )


def _figures(tried: Punctuality) -> dict[str, float]:
    return {
        "rate_hz": tried.rate,
        "deadlines": tried.deadlines,
        "missed_deadlines": tried.missed,
        "median_lateness_us": tried.usual_ns / 1000.0,
        "worst_lateness_us": tried.worst_ns / 1000.0,
    }
