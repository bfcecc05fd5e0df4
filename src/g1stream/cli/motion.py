"""`g1stream motion`."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Annotated

import tyro

from g1stream.cli.common import EXIT_OK, EXIT_STOPPED, Command, Flag, print_json, value

if TYPE_CHECKING:
    from g1stream.motion.check import MotionReport

__all__ = ["Inspect"]


@dataclass(frozen=True, kw_only=True)
class Inspect(Command):
    """Look at a motion file: frames, duration, joints, limits, fastest joint.

    Exit code 1 where a joint goes beyond its limits.
    """

    motion: Annotated[str, tyro.conf.Positional, value("MOTION")]
    """Motion file (CSV), or the name of a bundled motion: demo."""
    fps: Annotated[float | None, value("N", "30")] = None
    """Frames per second of the motion file."""
    json: Flag = False
    """Print the findings as JSON."""

    def run(self) -> int:
        """Look, and return the exit code."""
        from g1stream.motion.check import check_motion
        from g1stream.recording.motions import load_motion
        from g1stream.robot.model import G1

        robot = G1.load(self.resolve().robot)
        motion = load_motion(self.motion, robot, fps=self.fps)
        report = check_motion(motion, robot)
        if self.json:
            print_json(asdict(report))
        else:
            print(_text(report))
        return EXIT_OK if report.within_limits else EXIT_STOPPED


def _text(report: MotionReport) -> str:
    fastest, step, root = report.fastest, report.largest_step, report.root
    lines = [
        report.name,
        f"  frames        {report.n_frames} at {report.fps:g} fps, {report.duration:.2f} s",
        f"  root          {root.path:.2f} m over the ground, height {root.lowest:.2f} to "
        f"{root.highest:.2f} m",
        f"  fastest       {fastest.joint}, {fastest.value:.1f} rad/s at {fastest.time:.2f} s "
        f"(limit {fastest.limit:g})",
        f"  largest step  {step.joint}, {step.value:.3f} rad after frame {step.frame}",
        "  joints        29",
    ]
    lines += [f"    {g.group:<10}  {g.lowest:6.2f} to {g.highest:5.2f} rad" for g in report.groups]
    lines += [
        f"  beyond limit  {v.joint}: {v.value:.3f} rad at frame {v.frame}, limit {v.limit:.3f} "
        f"({v.n_frames} frames)"
        for v in report.limit_violations
    ]
    lines += [
        f"  too fast      {v.joint}: {v.value:.1f} rad/s at {v.time:.2f} s, limit {v.limit:g}"
        for v in report.too_fast
    ]
    lines += [f"  warning       {warning}" for warning in report.warnings]
    if report.within_limits:
        lines.append("  limits        all kept")
    return "\n".join(lines)
