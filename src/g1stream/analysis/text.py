"""How well a session went, as text for people."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.analysis.formatting import carried, most
from g1stream.analysis.message_stats import GAP
from g1stream.analysis.metrics import pooled
from g1stream.robot.joints import JOINT_GROUPS, JOINT_NAMES, N_JOINTS

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from g1stream.analysis.loop import LoopFigures
    from g1stream.analysis.message_stats import MessageStats, Percentiles
    from g1stream.analysis.metrics import Tracking
    from g1stream.analysis.summary import Summary

__all__ = [
    "WIDTH",
    "line",
    "loop_lines",
    "message_table",
    "render",
    "table",
    "tracking_lines",
    "tracking_table",
]

WIDTH: Final = 100
"""No line is longer, as long as names of files and topics are not."""

_UNKNOWN: Final = "not recorded"
_NAME_WIDTH: Final = 13

#: Joints that were held at a limit are named up to so many.
_MOST_JOINTS: Final = 6


def render(summary: Summary) -> str:
    """The summary as text without colour, lines of `WIDTH` columns at most."""
    paragraphs = [
        [
            line("session", summary.session),
            line("motion", summary.motion or _UNKNOWN),
            line("ended", str(summary.ending)),
        ],
        tracking_table(summary.tracking),
        [*tracking_lines(summary.tracking), *loop_lines(summary.loop)],
        message_table(summary.counts, summary.streams),
        [
            line("missing", _missing(summary)),
            line("gaps", f"publish intervals of more than {GAP:g} medians; longest: of them all"),
            line("latency", "from the publisher's stamp to the recorder's reception"),
        ],
        [line("note", note) for note in summary.notes],
    ]
    return "\n\n".join("\n".join(lines) for lines in paragraphs if lines)


def tracking_table(tracking: Tracking | None) -> list[str]:
    """How closely the robot followed, a row for each limb; nothing where that is not known."""
    if tracking is None:
        return []
    limbs: dict[str, Sequence[int]] = {**JOINT_GROUPS, "all joints": range(N_JOINTS)}
    figures = {**tracking.rmse_by_limb, "all joints": tracking.overall}
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


def tracking_lines(tracking: Tracking | None) -> list[str]:
    """By how much the robot is late, and what was compared to know."""
    if tracking is None:
        return [line("tracking", _UNKNOWN)]
    compared = tracking.compared
    left_out = f"; {compared.left_out} left out, in holes of the reference"
    return [
        line("delay", _delay(tracking)),
        line(
            "compared",
            f"{len(compared.time)} states with the reference, over {compared.duration:.2f} s of "
            f"PLAY{left_out if compared.left_out else ''}",
        ),
    ]


def _delay(tracking: Tracking) -> str:
    if tracking.delay is None:
        return "not determined: too little moves, or no delay explains the error"
    seconds, rmse, std = tracking.delay
    where = "behind" if seconds >= 0 else "ahead of"
    return (
        f"the robot is {abs(seconds) * 1e3:.1f} ms {where} the reference; without that, RMSE "
        f"{pooled(rmse):.4f} rad; without each joint's mean error as well, {pooled(std):.4f}"
    )


def loop_lines(loop: LoopFigures | None) -> list[str]:
    """What commands carried, and how the streamer kept its deadlines."""
    if loop is None:
        return [line(name, _UNKNOWN) for name in ("feedforward", "commands", "lateness")]
    lines = [
        line("feedforward", _feedforward(loop)),
        line(
            "commands",
            f"{_figure(loop.commands)} at {_figure(loop.rate, '.2f')} Hz "
            f"({_figure(loop.nominal_rate, 'g')} asked for), "
            f"{_figure(loop.skipped)} ticks skipped",
        ),
        line("lateness", _percentiles(loop.lateness)),
    ]
    if loop.clamped:
        held = most(loop.clamped, _MOST_JOINTS)
        lines.append(line("limits", f"ticks at which a target was held at its limit: {held}"))
    if loop.saturated:
        held = most(loop.saturated, _MOST_JOINTS)
        lines.append(line("torques", f"ticks at which one was held at its limit: {held}"))
    return lines


def _feedforward(loop: LoopFigures) -> str:
    if loop.feedforward is None:
        return _UNKNOWN
    return carried(loop.feedforward, loop.support, loop.feedforward_events)


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
    return ", ".join(f"{name} {us:.0f} us" for name, us in figures.as_dict().items())


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
