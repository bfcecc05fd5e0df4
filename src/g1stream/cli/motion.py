"""`g1stream motion`: checks a motion file."""

from __future__ import annotations

import sys
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from g1stream.cli.command import (
    EXIT_OK,
    EXIT_STOPPED,
    SettingsCommand,
    print_json,
    print_lines,
    print_warning,
)
from g1stream.cli.flags import argument, flag
from g1stream.cli.motion_flags import MOTIONS, MotionPartFlags
from g1stream.events import is_quiet
from g1stream.robot.joints import N_JOINTS
from g1stream.text import counted, labelled, listed, told_apart

if TYPE_CHECKING:
    from g1stream.motion.check import MotionReport
    from g1stream.motion.readers import Evidence

__all__ = ["Motion", "render"]

#: Feet within this height of 0 stand on the floor, m: compliance of soles and floors.
_ON_FLOOR = 2e-3


@dataclass(frozen=True, kw_only=True)
class Motion(SettingsCommand, MotionPartFlags):
    """Prints a motion file's contents, the speeds that it needs, and every limit that it exceeds.

    `stream` makes the same check. Warnings do not change the exit code. It is a warning if the
    stream would clamp joint targets between frames to a position limit, because that is safe.

    Examples:
      g1stream motion dance.csv
      g1stream motion dance.csv --fps 60 --json
      g1stream motion wave.csv dance.npz --blend 1 --on-floor

    Exit codes:
      0  within the limits
      1  a frame is beyond a position limit, the spline beyond a speed limit, or
         a unit is wrong
      2  bad input: not a motion
    """

    motions: tuple[str, ...] = argument(MOTIONS, "MOTION...")
    json: bool = flag(False, "Print the report as JSON.")

    def run(self) -> int:
        """Print the report, and return the exit code."""
        from g1stream.motion.check import check_motion
        from g1stream.robot.model import G1

        config = self.resolve()
        robot = G1.of_config(config)
        rate, margin = config.stream.rate, config.safety.position_margin
        evidence = None
        if len(self.motions) == 1:
            reader = self.find(self.motions[0], robot).open()
            evidence, motion = reader.evidence, self.join([reader.motion()], robot)
            del reader  # which has the content of the file
        else:
            motion = self.load(self.motions, robot)
        report = check_motion(motion, robot, rate=rate, position_margin=margin)
        if robot.warning:
            print_warning(robot.warning)
        if self.json:
            more = {"n_held": report.streamed.n_held, "within_limits": report.within_limits}
            print_json({**asdict(report), **more, "file": evidence and asdict(evidence)})
        else:
            max_tilt = config.safety.tilt_limit("free")
            if is_quiet():
                *found, _ = _result_lines(report, max_tilt)
                if found:
                    print_lines("\n".join(found), sys.stderr)
            else:
                print_lines(render(report, evidence, max_tilt))
        return EXIT_OK if report.passed else EXIT_STOPPED


def render(report: MotionReport, evidence: Evidence | None, max_tilt: float) -> str:
    """The report as text, with the evidence of one file; a tilt of `max_tilt`, rad, ends a run."""
    lines = [report.name]
    if report.suspicion:  # first, because it explains the figures below
        lines.append(_line("problem", f"It looks as if {report.suspicion}."))
    lines += _evidence_lines(evidence) if evidence else []
    return "\n".join([*lines, *_motion_lines(report), *_result_lines(report, max_tilt)])


def _evidence_lines(evidence: Evidence) -> list[str]:
    """The arrays in a file, and how each was interpreted."""
    found = {**evidence.used, **evidence.assumptions}
    lines = [_line(subject, text) for subject, text in found.items()]
    for label, names in (("not used", evidence.not_used), ("not in the file", evidence.missing)):
        lines += [_line(label, listed(names))] * bool(names)
    return lines


def _motion_lines(report: MotionReport) -> list[str]:
    root = report.root
    travel = (
        f"travels {root.path:.2f} m along the ground and ends {root.displacement:.2f} m from its "
        f"start; height {root.lowest:.2f} to {root.highest:.2f} m"
    )
    lines = [
        *(_line("changed", what) for what in report.operations),
        _line("frames", f"{report.n_frames} at {report.fps:g} fps, {report.duration:.2f} s"),
        _line("root", travel),
        _line("feet", _feet(report.floor)),
        _line("joints", str(N_JOINTS - len(report.dropped.joints if report.dropped else ()))),
    ]
    if report.dropped and not report.dropped.moved:
        lines.append(_line("left out", f"{report.dropped}"))
    lines += [
        f"    {group:<12}  {lowest:6.2f} to {highest:5.2f} rad"
        for group, (lowest, highest) in report.groups.items()
    ]
    return [*lines, *_speed_lines(report)]


def _feet(floor: float | None) -> str:
    """The height of the feet above the floor."""
    if floor is None:
        return "not standing, or the robot's soles are unknown"
    if abs(floor) < _ON_FLOOR:
        return f"stand on the floor, within {abs(floor) * 1e3:.1f} mm"
    side = "above" if floor > 0 else "below"
    return f"stand {abs(floor) * 1e3:.0f} mm {side} the floor; --on-floor corrects this"


def _speed_lines(report: MotionReport) -> list[str]:
    """The highest joint speeds of a motion."""
    streamed, frames, step = report.streamed, report.fastest, report.largest_step
    fastest = max(streamed.speeds, key=lambda speed: speed.value)
    return [
        _line(
            "fastest",
            f"{fastest.joint}, {fastest.value:.1f} rad/s at {fastest.time:.2f} s, streamed at "
            f"{streamed.rate:g} Hz (limit {fastest.limit:g})",
        ),
        _line(
            "in the frames",
            f"{frames.joint}, {frames.value:.1f} rad/s at {frames.time:.2f} s, by central "
            "differences",
        ),
        _line(
            "largest step",
            f"{step.joint}, {step.value:.3f} rad from frame {step.frame} to {step.frame + 1}",
        ),
    ]


def _result_lines(report: MotionReport, max_tilt: float) -> list[str]:
    """Each problem and each warning, then their number."""
    streamed = report.streamed
    n_held = len(streamed.warnings) - bool(streamed.too_fast)  # the last is about speeds
    problems = []
    for joint in report.frames_beyond:
        value, limit = told_apart(joint.value, joint.limit)
        problems.append(
            f"{joint.joint} is at {value} rad in frame {joint.time * report.fps:.0f}, "
            f"limit {limit} ({counted(joint.count, 'frame')} beyond it)"
        )
    problems += streamed.warnings[n_held:]
    warnings = [*streamed.warnings[:n_held], *report.warnings]
    if report.dropped and report.dropped.moved:
        warnings.append(f"{report.dropped}.")
    if (root := report.root).tilt > max_tilt:
        warnings.append(
            f"The pelvis tilts by {root.tilt:.2f} rad at {root.tilt_frame / report.fps:.2f} s; "
            f"unless the pelvis is held, {max_tilt:g} rad end a run (safety.max_tilt)."
        )
    counts = {"problem": len(problems) + bool(report.suspicion), "warning": len(warnings)}
    found = ", ".join(counted(n, noun) for noun, n in counts.items() if n)
    return [
        *(_line("problem", text) for text in problems),
        *(_line("warning", text) for text in warnings),
        _line("result", found or "no problems found"),
    ]


def _line(label: str, text: str) -> str:
    return labelled(f"  {label:<15} ", text)
