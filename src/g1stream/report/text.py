"""How well a session went, as text for people."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.report.messages import GAP
from g1stream.report.metrics import by_group, pooled
from g1stream.robot.joints import JOINT_GROUPS, JOINT_NAMES, N_JOINTS

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from g1stream.report.messages import MessageStats, Percentiles
    from g1stream.report.metrics import Tracking
    from g1stream.report.summary import LoopFigures, Summary

__all__ = ["WIDTH", "line", "loop_lines", "message_table", "render", "table"]

WIDTH: Final = 100
"""No line is longer, as long as names of files and topics are not."""

_UNKNOWN: Final = "not recorded"
_NAME_WIDTH: Final = 11


def render(summary: Summary) -> str:
    """The summary as text without colour, lines of `WIDTH` columns at most."""
    compared = f"{summary.states} states with the reference, over {summary.duration:.2f} s"
    paragraphs = [
        [
            line("session", summary.session),
            line("motion", summary.motion or _UNKNOWN),
            line("ended", _ending(summary.loop)),
            line("compared", compared),
        ],
        _tracking_table(summary.tracking) if summary.tracking else [],
        [*_tracking_lines(summary.tracking), *loop_lines(summary.loop)],
        message_table(summary.counts, summary.streams),
        [
            line("missing", _missing(summary)),
            line("gaps", f"publish intervals of more than {GAP:g} medians; longest: of them all"),
            line("latency", "from the publisher's stamp to the recorder's reception"),
        ],
        [line("note", note) for note in summary.notes],
    ]
    return "\n\n".join("\n".join(lines) for lines in paragraphs if lines)


def _ending(loop: LoopFigures | None) -> str:
    if loop is None or loop.reason is None:
        return _UNKNOWN
    return f"early: {loop.reason}" if loop.reason else "at the motion's end"


def _tracking_table(tracking: Tracking) -> list[str]:
    limbs: dict[str, Sequence[int]] = {**JOINT_GROUPS, "all joints": range(N_JOINTS)}
    figures = {**by_group(tracking.rmse), "all joints": pooled(tracking.rmse)}
    rows = [("limb", "RMSE rad", "RMSE deg", "worst joint", "RMSE deg", "max deg", "at s")]
    for limb, joints in limbs.items():
        worst = max(joints, key=lambda joint: float(tracking.rmse[joint]))
        rows.append(
            (
                limb.replace("_", " "),
                f"{figures[limb]:.4f}",
                f"{np.degrees(figures[limb]):.3f}",
                JOINT_NAMES[worst],
                f"{np.degrees(tracking.rmse[worst]):.3f}",
                f"{np.degrees(tracking.max_abs[worst]):.2f}",
                f"{tracking.max_abs_at[worst]:.2f}",
            )
        )
    return table(rows, left=(0, 3))


def _tracking_lines(tracking: Tracking | None) -> list[str]:
    if tracking is None:
        return [line("tracking", _UNKNOWN)]
    if tracking.delay is None:
        return [line("delay", "not determined: too little moves, or no delay explains the error")]
    seconds, rmse, std = tracking.delay
    where = "behind" if seconds >= 0 else "ahead of"
    return [
        line(
            "delay",
            f"the robot is {abs(seconds) * 1e3:.1f} ms {where} the reference; without that, RMSE "
            f"{pooled(rmse):.4f} rad; without each joint's mean error as well, {pooled(std):.4f}",
        )
    ]


def loop_lines(loop: LoopFigures | None) -> list[str]:
    """How the streamer kept its deadlines."""
    if loop is None:
        return [line(name, _UNKNOWN) for name in ("commands", "lateness")]
    lines = [
        line(
            "commands",
            f"{_figure(loop.commands)} at {_figure(loop.rate, '.2f')} Hz "
            f"({_figure(loop.nominal_rate, 'g')} asked for), "
            f"{_figure(loop.skipped)} ticks skipped",
        ),
        line("lateness", _percentiles(loop.lateness)),
    ]
    if loop.clamped:
        held = ", ".join(f"{joint} {ticks}" for joint, ticks in loop.clamped.items())
        lines.append(line("limits", f"ticks at which a target was held at its limit: {held}"))
    return lines


def message_table(counts: Mapping[str, int], streams: Mapping[str, MessageStats]) -> list[str]:
    """How the messages of each topic came, as far as that is known."""
    latency = ["latency p50 us", "p99 us", "p99.9 us", "max us"]
    rows = [["topic", "count", "Hz", "gaps", "longest ms", *latency]]
    for topic, count in counts.items():
        stats = streams.get(topic)
        rows.append([topic, str(count), *(_came(stats) if stats else [""] * 7)])
    return table(rows, left=(0,))


def _came(stats: MessageStats) -> list[str]:
    longest = None if stats.longest_interval is None else stats.longest_interval * 1e3
    return [
        _figure(stats.rate, ".1f"),
        str(stats.gaps),
        _figure(longest, ".1f"),
        *(f"{us:.0f}" for us in stats.latency),
    ]


def _missing(summary: Summary) -> str:
    if summary.missing is None:
        return _UNKNOWN
    by_topic = ", ".join(f"{topic} {n}" for topic, n in sorted(summary.missing.items()))
    return f"{by_topic}, by the numbers that samples carry"


def _percentiles(figures: Percentiles | None) -> str:
    if figures is None:
        return _UNKNOWN
    names = ("p50", "p99", "p99.9", "max")
    return ", ".join(f"{n} {us:.0f} us" for n, us in zip(names, figures, strict=True))


def _figure(value: float | None, spec: str = "") -> str:
    return "?" if value is None else format(value, spec)


def line(name: str, text: str) -> str:
    """`name  text`, the text wrapped beside itself."""
    return textwrap.fill(
        text,
        WIDTH,
        initial_indent=name.ljust(_NAME_WIDTH),
        subsequent_indent=" " * _NAME_WIDTH,
        break_long_words=False,
        break_on_hyphens=False,
    )


def table(rows: Sequence[Sequence[str]], left: Collection[int]) -> list[str]:
    """Rows in columns two spaces apart, set right except for those named; headings ruled off."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = [
        "  ".join(
            cell.ljust(width) if i in left else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]
    rule = "  ".join("-" * width for width in widths)
    return [lines[0], rule, *lines[1:]]
