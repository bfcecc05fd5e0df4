"""`g1stream motion`: the check of a motion file."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from g1stream.analysis.render import counted
from g1stream.cli.command import EXIT_OK, EXIT_STOPPED, SettingsCommand, print_json
from g1stream.cli.flags import MOTION, argument, flag, fps_flag

if TYPE_CHECKING:
    from collections.abc import Sequence

    from g1stream.motion.check import MotionReport

__all__ = ["Inspect", "joint_lines", "render", "result_lines"]


@dataclass(frozen=True, kw_only=True)
class Inspect(SettingsCommand):
    """Prints frames, duration, joints, speeds, and what is beyond a limit.

    Warnings do not change the exit code. Joint targets between frames that the stream would hold at
    a position limit are a warning: they are safe.

    Examples:
      g1stream motion dance.csv
      g1stream motion dance.csv --fps 60 --json

    Exit codes:
      0  within the limits
      1  a frame is beyond a position limit, or the spline through the frames beyond a speed limit
      2  bad input: not a motion
    """

    motion: str = argument(MOTION, "MOTION")
    fps: float | None = fps_flag()
    json: bool = flag(False, "Print the report as JSON.")

    def run(self) -> int:
        """Print the report, and return the exit code."""
        from g1stream.motion.check import check_motion
        from g1stream.robot.model import G1
        from g1stream.session.motions import load_motion

        config = self.resolve()
        robot = G1.load(config.robot)
        motion = load_motion(self.motion, fps=self.fps)
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
            print(render(report))
        return EXIT_OK if report.within_limits else EXIT_STOPPED


def render(report: MotionReport) -> str:
    """The report as text."""
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
    return "\n".join([*lines, *joint_lines(report), *result_lines(report)])


def joint_lines(report: MotionReport) -> list[str]:
    """How fast a motion moves the joints."""
    streamed, frames, step = report.streamed, report.fastest, report.largest_step
    fastest = max(streamed.speeds, key=lambda speed: speed.value)
    return [
        f"  fastest         {fastest.joint}, {fastest.value:.1f} rad/s at {fastest.time:.2f} s, "
        f"streamed at {streamed.rate:g} Hz (limit {fastest.limit:g})",
        f"  in the frames   {frames.joint}, {frames.value:.1f} rad/s at {frames.time:.2f} s, "
        "by central differences",
        f"  largest step    {step.joint}, {step.value:.3f} rad from frame {step.frame} to "
        f"{step.frame + 1}",
    ]


def result_lines(report: MotionReport | None, fault: Sequence[str] = ()) -> list[str]:
    """Each problem and each warning, and how many there are.

    Args:
        report: None where the file is no motion.
        fault: why it is none, and what to do about it.
    """
    problems, warnings = ["\n                  ".join(fault)] if fault else [], []
    if report:
        problems += [
            f"{joint.joint} is at {joint.value:.3f} rad in frame {joint.time * report.fps:.0f}, "
            f"limit {joint.limit:.3f} ({counted(joint.count, 'frame')} beyond it)"
            for joint in report.frames_beyond
        ]
        streamed = report.streamed
        n_held = len(streamed.warnings) - bool(streamed.too_fast)  # the last is about speeds
        problems += streamed.warnings[n_held:]
        warnings += [*streamed.warnings[:n_held], *report.warnings]
    counts = {"problem": len(problems), "warning": len(warnings)}
    found = ", ".join(counted(n, noun) for noun, n in counts.items() if n)
    return [
        *(f"  problem         {text}" for text in problems),
        *(f"  warning         {text}" for text in warnings),
        f"  result          {found or 'no problems found'}",
    ]
