"""`g1stream motion`: the check of a motion file."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from g1stream.cli.command import EXIT_OK, EXIT_STOPPED, SettingsCommand, print_json
from g1stream.cli.flags import argument, flag

if TYPE_CHECKING:
    from g1stream.motion.check import MotionReport

__all__ = ["Inspect", "joint_lines"]


@dataclass(frozen=True, kw_only=True)
class Inspect(SettingsCommand):
    """Prints frames, duration, joints, limits and the fastest joint.

    Warnings do not change the exit code, nor do joint targets between frames that the stream would
    hold at a limit: they are safe.

    Examples:
      g1stream motion dance.csv
      g1stream motion dance.csv --fps 60 --json

    Exit codes:
      0  within the limits
      1  a frame is beyond a position limit, or the spline through the frames beyond a speed limit
      2  bad input: not a motion
    """

    motion: str = argument(
        "Motion file (CSV), session file, or the name of a bundled motion: demo.", "MOTION"
    )
    fps: float | None = flag(
        None,
        "Frames per second of the motion file, or to sample a session at.",
        "HZ",
        shown="30; a session's own",
        gt=0,
    )
    json: bool = flag(False, "Print the findings as JSON.")

    def run(self) -> int:
        """Print the report, and return the exit code."""
        from g1stream.motion.check import check_motion
        from g1stream.robot.model import G1
        from g1stream.session.motions import load_motion

        config = self.resolve()
        robot = G1.load(config.robot)
        motion = load_motion(self.motion, robot, fps=self.fps)
        report = check_motion(
            motion,
            robot,
            rate=config.stream.rate,
            position_margin=config.safety.position_margin,
        )
        if self.json:
            print_json(
                {
                    **asdict(report),
                    "n_held": report.streamed.n_held,
                    "within_limits": report.within_limits,
                }
            )
        else:
            print(_text(report))
        return EXIT_OK if report.within_limits else EXIT_STOPPED


def _text(report: MotionReport) -> str:
    root = report.root
    lines = [
        report.name,
        f"  frames          {report.n_frames} at {report.fps:g} fps, {report.duration:.2f} s",
        f"  root            travels {root.path:.2f} m along the ground, ending "
        f"{root.displacement:.2f} m from its start; height {root.lowest:.2f} to "
        f"{root.highest:.2f} m",
        f"  joints          {len(report.streamed.speeds)}",
    ]
    lines += [
        f"    {group:<12}  {lowest:6.2f} to {highest:5.2f} rad"
        for group, (lowest, highest) in report.groups.items()
    ]
    lines += joint_lines(report)
    if report.within_limits and not report.streamed.held:
        lines.append("  limits          all kept")
    return "\n".join(lines)


def joint_lines(report: MotionReport) -> list[str]:
    """What a motion asks of the joints, and where that passes a limit; a line each."""
    streamed, frames, step = report.streamed, report.fastest, report.largest_step
    fastest = max(streamed.speeds, key=lambda speed: speed.value)
    lines = [
        f"  fastest         {fastest.joint}, {fastest.value:.1f} rad/s at {fastest.time:.2f} s, as "
        f"streamed at {streamed.rate:g} Hz (limit {fastest.limit:g})",
        f"  of the frames   {frames.joint}, {frames.value:.1f} rad/s at {frames.time:.2f} s, "
        "by central differences",
        f"  largest step    {step.joint}, {step.value:.3f} rad from frame {step.frame} to "
        f"{step.frame + 1}",
    ]
    lines += [
        f"  frames beyond   {joint.joint}: {joint.value:.3f} rad at frame "
        f"{joint.time * report.fps:.0f}, limit {joint.limit:.3f} ({joint.count} frames)"
        for joint in report.frames_beyond
    ]
    warnings = (*streamed.warnings, *report.warnings)
    return lines + [f"  warning         {text}" for text in warnings]
