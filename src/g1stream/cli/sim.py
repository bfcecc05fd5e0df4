"""`g1stream sim`: runs the MuJoCo bridge."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from g1stream.cli.command import (
    EXIT_OK,
    LiveCommand,
    announce_wire,
    on_signals,
    print_note,
    print_result,
)
from g1stream.cli.flags import flag
from g1stream.cli.progress import ProgressDisplay, sim_status
from g1stream.events import ConsoleHandler, handled_by

if TYPE_CHECKING:
    from g1stream.sim.robot import SimReport

_SUPPORT = {
    "bolted": "its pelvis bolted to the world",
    "hanging": "hanging from an elastic band",
    "follow": "its pelvis driven along the reference",
    "free": "released when a motion begins",
}


@dataclass(frozen=True, kw_only=True)
class Sim(LiveCommand):
    """Publishes rt/lowstate, rt/sportmodestate and rt/secondary_imu; subscribes to rt/lowcmd.

    Ctrl-C ends it. A robot that has fallen stays on the floor, and the next stream refuses it
    because it is tilted. Start the simulation again.

    Examples:
      g1stream sim
      g1stream sim --support hanging --viewer
      g1stream sim --domain 7 --duration 60
      g1stream sim --robot g1_23dof
      g1stream sim --onboard ai --support follow

    Exit codes:
      0  success, also after Ctrl-C
      2  bad input
    """

    json: bool = flag(False, "Print the summary as JSON on standard output.")

    def run(self) -> int:
        """Simulate, and return the exit code."""
        from g1stream.app.sim import simulate

        stopped: list[int] = []
        config = self.resolve()

        def on_ready() -> None:
            announce_wire(config, commands=False)
            support = _SUPPORT[config.sim.held_by]
            print_note(f"Simulating a G1, {support}. Ctrl-C ends it.")

        log = handled_by(ConsoleHandler())
        # Ctrl-C also ends a server that is starting.
        with self.serving(config), on_signals(stopped.append), log, ExitStack() as stack:

            def on_report(report: SimReport) -> None:
                stack.enter_context(ProgressDisplay(lambda: sim_status(report)))

            report = simulate(
                config, should_stop=lambda: bool(stopped), on_ready=on_ready, on_report=on_report
            )
        print_result(asdict(report), render(report), as_json=self.json)
        return EXIT_OK


def render(report: SimReport) -> str:
    """The report as text."""
    lines = [
        f"simulated {report.simulated:.1f} s in {report.elapsed:.1f} s",
        f"  states    {report.states} published",
        f"  commands  {report.commands} accepted, {sum(report.refused.values())} refused "
        "(counting the newest command at each state)",
    ]
    lines += [f"            {count} x {why}" for why, count in report.refused.items()]
    if report.timeouts:
        lines.append(f"  timeouts  {report.timeouts}: without LowCmd the motors only damped")
    if report.behind:
        lines.append(f"  skipped   {report.behind:.2f} s, because this machine is too slow")
    return "\n".join(lines)
