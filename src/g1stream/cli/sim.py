"""`g1stream sim`."""

from __future__ import annotations

import logging
import sys
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from g1stream.cli.common import (
    EXIT_OK,
    Flag,
    WireCommand,
    announce_wire,
    on_signals,
    print_json,
    value,
)
from g1stream.events import console_handler, handled_by

if TYPE_CHECKING:
    from g1stream.sim.robot import SimReport

__all__ = ["Sim"]

_HELD = {
    "bolted": "its pelvis bolted to the world",
    "hanging": "hanging from an elastic band",
    "follow": "its pelvis driven along the reference",
    "free": "let go of when a motion begins",
}


@dataclass(frozen=True, kw_only=True)
class Sim(WireCommand):
    """Be a simulated G1 on DDS: a MuJoCo bridge on the topics of the robot.

    Publishes rt/lowstate, rt/sportmodestate and rt/secondary_imu; obeys rt/lowcmd. Ctrl-C ends it.
    """

    settings: ClassVar[dict[str, str]] = {
        **WireCommand.settings,
        "support": "sim.support",
        "rate": "sim.rate",
        "duration": "sim.duration",
        "viewer": "sim.viewer",
    }

    support: Annotated[
        Literal["bolted", "hanging", "follow", "free"] | None,
        value("{bolted,hanging,follow,free}", "bolted"),
    ] = None
    """What holds the pelvis: bolted: the world; hanging: an elastic band at the torso; follow: the
    reference that is streamed; free: nothing, once the motion begins. A robot that has fallen stays
    on the floor, and the next stream refuses it as tilted: start the simulation anew then."""
    rate: Annotated[float | None, value("HZ", "500")] = None
    """LowState per second."""
    duration: Annotated[float | None, value("S", "until stopped")] = None
    """End by itself after so long."""
    viewer: Flag = False
    """Open MuJoCo's viewer."""
    json: Flag = False
    """Print the summary as JSON on standard output."""

    def run(self) -> int:
        """Simulate, and return the exit code."""
        from g1stream.programs.sim import simulate

        stopped: list[str] = []
        on_signals(stopped.append)
        config = self.resolve()

        def begun() -> None:
            announce_wire(config, commands=False)
            held = _HELD[config.sim.support]
            print(f"Simulating a G1, {held}. Ctrl-C ends it.", file=sys.stderr)

        with handled_by(console_handler("sim", logging.INFO)):
            report = simulate(config, should_stop=lambda: bool(stopped), on_ready=begun)
        if self.json:
            print_json(asdict(report))
        else:
            print(_summary(report))
        return EXIT_OK


def _summary(report: SimReport) -> str:
    lines = [
        f"simulated {report.simulated:.1f} s in {report.elapsed:.1f} s",
        f"  states    {report.states} published",
        f"  commands  {report.commands} obeyed, {sum(report.refused.values())} refused",
    ]
    lines += [f"            {count} x {why}" for why, count in report.refused.items()]
    if report.timeouts:
        times = "once" if report.timeouts == 1 else f"{report.timeouts} times"
        lines.append(f"  timeout   {times} no LowCmd came any more, and the motors only damped")
    if report.behind:
        lines.append(f"  behind    {report.behind:.2f} s skipped: this machine is too slow")
    return "\n".join(lines)
