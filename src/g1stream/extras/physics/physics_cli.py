"""`g1stream physics`: what it would take to play a motion, and how feet change it."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

from g1stream.cli.command import EXIT_OK, SettingsCommand, print_json, print_lines, print_warning
from g1stream.cli.flags import argument, flag
from g1stream.cli.motion_flags import MOTIONS, MotionFlags
from g1stream.cli.progress import ProgressDisplay

__all__ = ["Physics"]


@dataclass(frozen=True, kw_only=True)
class Physics(SettingsCommand, MotionFlags):
    """Prints what it would take to play a motion bolted, hanging, with the pelvis led or standing.

    That is contacts and skating of the feet, self-collision, centre of pressure, tilt and torques,
    and the frames that forbid it; and whether `stream --support feet` can play it, or what else.
    All of it is about what `stream` would play with the same --joints, --start and --duration.

    Examples:
      g1stream physics dance.csv
      g1stream physics dance.csv --joints arms,waist --start 10 --json
      g1stream physics steps.npz --feet-figure steps.png

    Exit codes:
      0  printed, whatever the answer
      2  bad input: not a motion, or no --feet-figure
    """

    motions: tuple[str, ...] = argument(MOTIONS, "MOTION...")
    feet_figure: Path | None = flag(
        None, "Draw how `--support feet` changes the motion: a .png, .svg or .pdf.", "OUT"
    )
    force: bool = flag(False, "Replace a figure that is there.")
    json: bool = flag(False, "Print what was found as JSON.")

    def run(self) -> int:
        """Print what was found, draw the figure, and return the exit code."""
        from g1stream.extras.physics.measure import motion_physics
        from g1stream.extras.physics.stand import stand_or_explain
        from g1stream.files import save_figure
        from g1stream.motion.check import check_motion
        from g1stream.motion.fit import require_si_units
        from g1stream.motion.limits import Interval
        from g1stream.robot.model import G1

        config = self.resolve()
        robot = G1.load(config.robot, own_limits=config.safety.urdf_limits)
        if robot.warning:
            print_warning(robot.warning)
        motion = self.load(self.motions, robot)
        require_si_units(check_motion(motion, robot, rate=config.stream.rate))
        frames = Interval.from_config(config.stream, motion).frames(motion)
        played = robot.select(config.stream.played_joints)
        done = 0.0

        def progress(fraction: float) -> None:
            nonlocal done
            done = fraction

        with ProgressDisplay(lambda: (done, f"physics {100 * done:3.0f} %")):
            physics = motion_physics(
                motion,
                robot,
                max_tilt=config.safety.max_tilt,
                played=played,
                frames=frames,
                suggest=True,
                progress=progress,
            )
        if self.json:
            print_json(physics.model_dump(mode="json"))
        else:
            print_lines(str(physics))
        if self.feet_figure:
            standing = stand_or_explain(motion, robot, frames, played)
            save_figure(standing.plot, self.feet_figure, force=self.force)
            how = str(standing) or "as it is"
            print_lines(f"\n{self.feet_figure}: how it is played on the feet, {how}", sys.stderr)
        return EXIT_OK
