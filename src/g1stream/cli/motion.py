"""`g1stream motion`."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Annotated

import tyro

from g1stream.cli.common import EXIT_OK, EXIT_STOPPED, Command, Flag, print_json, value

if TYPE_CHECKING:
    from g1stream.motion.check import MotionReport

__all__ = ["Inspect", "joint_lines"]


@dataclass(frozen=True, kw_only=True)
class Inspect(Command):
    """Check a motion file: frames, duration, joints, limits, fastest joint.

    Exit code 1 where a frame is beyond a joint's position limits or the spline through the frames
    beyond its speed limit; 2 where the file is not a motion. Warnings do not change it, nor do
    joint targets between frames that would be held at a position limit: they are safe.
    """

    motion: Annotated[str, tyro.conf.Positional, value("MOTION")]
    """Motion file (CSV), session file, or the name of a bundled motion: demo."""
    fps: Annotated[float | None, value("N", "30")] = None
    """Frames per second of the motion file. A session is sampled with its own rate, or with this
    one."""
    json: Flag = False
    """Print the report as JSON."""

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
