"""The flags --arm and --yes: print what is about to happen, and ask."""

from __future__ import annotations

import sys
import textwrap
from typing import TYPE_CHECKING, Final

from g1stream.cli.command import confirmed, print_lines
from g1stream.cli.doctor import render as render_findings
from g1stream.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Callable

    from g1stream.app.arming import ArmingReport

_WIDTH: Final = 98


def arming(arm: bool, yes: str | None) -> Callable[[ArmingReport], bool] | None:
    """What `stream` calls to be armed; None without --arm."""
    if not arm:
        if yes is not None:
            raise ConfigError("The flag --yes has no effect without --arm.", "Add --arm.")
        return None

    def ask(report: ArmingReport) -> bool:
        print_lines(render(report), sys.stderr)
        return confirmed(report.interface, yes)

    return ask


def render(report: ArmingReport) -> str:
    """The report as text."""
    worst = report.furthest
    limits = ", ".join(f"{name} = {value}" for name, value in report.limits.items())
    lines = [
        f"ARMING: domain {report.domain} on {report.interface}",
        f"pose: pelvis tilted by {report.tilt:.2f} rad",
        "to the first frame:",
    ]
    for limb in report.limbs:
        kp, kd = (f"{low:g} to {high:g}" for low, high in (limb.kp, limb.kd))
        lines.append(f"  {limb.limb:<10} {limb.distance:+.2f} rad  {limb.joint}, kp {kp}, kd {kd}")
    service = report.motion_service
    said = f"{service.about}: {service.cause}"
    if service.remedy:  # a warning stands right above the question
        said = textwrap.fill(f"WARNING: {service.cause} {service.remedy}", _WIDTH)
    lines += [
        f"  furthest   {worst.distance:+.2f} rad  {worst.joint}",
        f"ramp: {report.ramp:.1f} s, at up to {report.peak_speed:.2f} rad/s",
        textwrap.fill(f"limits: {limits}", _WIDTH, subsequent_indent="  "),
        render_findings(report.findings),
        said,
    ]
    return "\n".join(lines)
