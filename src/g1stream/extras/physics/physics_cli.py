"""`g1stream physics`: prints the contacts, collisions and torques of a motion."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from g1stream.cli.command import EXIT_OK, SettingsCommand, print_result, print_warning
from g1stream.cli.flags import argument, flag
from g1stream.cli.motion_flags import MOTIONS, MotionFlags
from g1stream.cli.progress import showing_progress


@dataclass(frozen=True, kw_only=True)
class Physics(SettingsCommand, MotionFlags):
    """Checks how a motion can physically be played: bolted, hanging, with a guided pelvis or free.

    It prints contacts and skating of the feet, self-collision, centre of pressure, tilt, torques
    and the frames that forbid the motion. It also prints whether `stream --support feet` can play
    the motion, or what it can play instead. It analyses the part that `stream` would play with the
    same --joints, --start and --duration.

    Examples:
      g1stream physics dance.csv
      g1stream physics dance.csv --joints arms,waist --start 10 --json

    Exit codes:
      0  printed, with any result
      2  bad input: not a motion
    """

    motions: tuple[str, ...] = argument(MOTIONS, "MOTION...")
    json: bool = flag(False, "Print the results as JSON.")

    def run(self) -> int:
        """Print the results, and return the exit code."""
        from g1stream.extras.physics.measure import motion_physics
        from g1stream.motion.check import check_motion
        from g1stream.motion.fit import require_si_units
        from g1stream.motion.limits import Interval
        from g1stream.robot.model import G1

        config = self.resolve()
        robot = G1.of_config(config)
        if robot.warning:
            print_warning(robot.warning)
        motion = self.load(self.motions, robot)
        print_warning(*motion.warnings)
        report = check_motion(motion, robot, rate=config.stream.rate)
        require_si_units(report)
        if report.dropped and report.dropped.moved:
            print_warning(f"{motion.name}: {report.dropped}.")
        frames = Interval.from_config(config.stream, motion).frames(motion)
        played = robot.select(config.stream.played_joints)
        with showing_progress() as progress:
            physics = motion_physics(
                motion,
                robot,
                max_tilt=config.safety.max_tilt,
                played=played,
                frames=frames,
                suggest=True,
                progress=partial(progress, "physics"),
            )
        print_result(physics.model_dump(mode="json"), str(physics), as_json=self.json)
        return EXIT_OK
