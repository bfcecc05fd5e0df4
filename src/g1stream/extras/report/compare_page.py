"""The page of a comparison: what differs, and both sides over each other."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from g1stream.analysis.signals import Line
from g1stream.app.session import Session, open_session
from g1stream.extras.report import html
from g1stream.extras.report.compare_table import compared, significance, verdict
from g1stream.extras.report.figures import curve
from g1stream.extras.report.tables import differences
from g1stream.files import complete_file
from g1stream.robot.joints import JOINT_NAMES

if TYPE_CHECKING:
    from collections.abc import Sequence

    from g1stream.extras.report.compare import Comparison
    from g1stream.types import Floats

__all__ = ["write_page"]

#: Of all lines of a joint together, so that a page of many sessions is no larger.
_MOST_POINTS: Final = 8000
#: Colours of base and other.
_COLOURS: Final = ("#0072b2", "#d55e00")


def write_page(
    comparison: Comparison,
    sources: Sequence[Sequence[Session | str | Path]],
    joints: Sequence[int],
    path: Path,
    *,
    force: bool = False,
) -> None:
    """Write the page of a comparison.

    Args:
        comparison: of these sessions.
        sources: the sessions of base and other, or their files.
        joints: motor indices of those that are compared.
        path: of the page.
        force: replace a file that is there.

    Raises:
        RecordingError: a session is damaged, or the page cannot be written.
    """
    with complete_file(path, force=force) as temporary:
        drawn = _drawn(comparison, sources, list(joints))
        content = html.template("comparison.html").substitute(
            differences(comparison.model_dump(mode="json")),
            verdict=html.escaped(verdict(comparison, "deg")),
            good=_class_of_verdict(comparison),
            compared=html.facts(_compared(comparison)),
            differs=_differs(comparison),
            significance=html.escaped(significance(comparison)),
            overlay=html.figure(
                "overlay", f"Joint {html.joint_choice(drawn['first_joint'], comparison.joints)}"
            ),
            errors=html.figure(
                "errors", "RMS error of all joints over the motion, a line for each session"
            ),
            sides_rmse=html.figure(
                "sides_rmse",
                "RMSE of each joint, mean and range of the sessions; a click shows it below",
            ),
        )
        page = html.page("comparison", f"Comparison: {comparison.motion}", content, [drawn])
        temporary.write_text(page, encoding="utf-8")


def _class_of_verdict(comparison: Comparison) -> str:
    """That of page.css; "" where the difference may be noise."""
    rmse = comparison.metrics["rmse"]
    if not rmse.significant:
        return ""
    return "bad" if rmse.difference > 0.0 else "good"


def _compared(comparison: Comparison) -> list[tuple[str, str]]:
    return [
        ("motion", compared(comparison)),
        ("base", ", ".join(comparison.base)),
        ("other", ", ".join(comparison.other)),
    ]


def _differs(comparison: Comparison) -> str:
    if not comparison.differs:
        return html.missing("Nothing else that was recorded of the sessions.")
    rows = [(name, *sides) for name, sides in comparison.differs.items()]
    return html.text_table(("", "base", "other"), rows)


def _drawn(
    comparison: Comparison, sources: Sequence[Sequence[Session | str | Path]], joints: list[int]
) -> dict[str, Any]:
    """What the page's script draws; times are s of the motion, angles degrees.

    Signals are reduced, without losing a peak, so that the page does not grow with the sessions.
    """
    lines: list[dict[str, Any]] = []
    reference: list[dict[str, str]] = []
    most = max(200, _MOST_POINTS // (1 + sum(map(len, sources))))
    for number, side in enumerate(sources):
        for source in side:
            session = source if isinstance(source, Session) else open_session(source)
            found = session.tracking()
            inside = (found.motion_time >= comparison.start_s) & (
                found.motion_time <= comparison.stop_s
            )
            time = found.motion_time[inside]
            asked = np.degrees(found.reference[inside])
            measured = np.degrees(found.measured[inside])
            error = asked - measured
            rms = np.sqrt(np.mean(np.square(error[:, joints]), axis=1, keepdims=True))
            reference = reference or _curves(time, asked, most)
            lines.append(
                {
                    "side": number,
                    "name": session.path.name,
                    "measured": _curves(time, measured, most),
                    "error": _curves(time, error, most),
                    "rms": _curves(time, rms, most)[0],
                }
            )
    return {
        "sides": [
            {"name": name, "colour": colour, "rmse_deg": _of_each_joint(comparison, name)}
            for name, colour in zip(("base", "other"), _COLOURS, strict=True)
        ],
        "joints": [name.removesuffix("_joint") for name in JOINT_NAMES],
        "first_joint": JOINT_NAMES.index(next(iter(comparison.joints))),
        "reference": reference,
        "lines": lines,
    }


def _curves(time: Floats, values: Floats, most: int) -> list[dict[str, str]]:
    line = Line.from_samples("", time, values)
    return [curve(line.time, column, most) for column in line.values.T]


def _of_each_joint(comparison: Comparison, side: str) -> list[list[float] | None]:
    """By motor index the RMSE of each session of a side, deg; None for a joint not compared."""
    of = comparison.joints
    return [
        np.degrees(getattr(of[name], f"{side}_values")).tolist() if name in of else None
        for name in JOINT_NAMES
    ]
