"""`g1stream demo`."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from g1stream.cli.common import (
    Flag,
    WireCommand,
    announce_wire,
    on_signals,
    print_warning,
    value,
)
from g1stream.cli.progress import watching
from g1stream.cli.summary import exit_code, print_summary

if TYPE_CHECKING:
    from g1stream.control.loop import StreamLoop

__all__ = ["Demo"]


@dataclass(frozen=True, kw_only=True)
class Demo(WireCommand):
    """The whole job on this machine: simulate a G1, play a motion on it, record it, compare.

    Ends with session.mcap, tracking.png and a summary of how well the motion was followed.
    """

    settings: ClassVar[dict[str, str]] = {
        **WireCommand.settings,
        "support": "sim.support",
        "duration": "stream.duration",
        "feedforward": "stream.feedforward",
        "viewer": "sim.viewer",
    }

    motion: Annotated[str, value("MOTION", "demo, a bundled motion")] = "demo"
    """Motion file (CSV), session file, or the name of a bundled motion."""
    out: Annotated[Path, value("DIR", "demo-out")] = Path("demo-out")
    """Where session.mcap and tracking.png go."""
    force: Flag = False
    """Replace files that are there already."""
    support: Annotated[
        Literal["bolted", "hanging", "follow", "free"] | None,
        value("{bolted,hanging,follow,free}", "bolted"),
    ] = None
    """What holds the simulated pelvis: the world, an elastic band at the torso, the reference, or,
    once the motion is played, nothing."""
    feedforward: Annotated[
        Literal["none", "velocity", "dynamics"] | None,
        value("{none,velocity,dynamics}", "dynamics, but velocity where nothing holds it"),
    ] = None
    """What commands carry beside the position: nothing, velocity, or velocity and torque."""
    duration: Annotated[float | None, value("S", "to its end")] = None
    """How much of the motion to play."""
    viewer: Flag = False
    """Watch the robot in MuJoCo's viewer."""
    json: Flag = False
    """Print the summary as JSON on standard output."""

    def run(self) -> int:
        """Do it, and return the exit code."""
        from g1stream.programs.demo import FIGURE, demo
        from g1stream.robot.model import G1
        from g1stream.session.motions import load_motion

        config = self.resolve()
        motion = load_motion(self.motion, G1.load(config.robot))
        for warning in motion.warnings:
            print_warning(warning)

        with watching() as watch:

            def prepare(loop: StreamLoop) -> None:
                announce_wire(config)
                on_signals(loop.request_stop)
                watch(loop, motion)

            summary = demo(
                motion,
                self.out,
                config,
                force=self.force,
                on_loop=prepare,
            )
        print_summary(summary, as_json=self.json)
        if summary.tracking:
            print(
                f"Figure: {self.out / FIGURE}. Open the session in Foxglove, PlotJuggler or Rerun.",
                file=sys.stderr,
            )
        return exit_code(summary)
