"""The physics of the motion that a session played, as a section of its report."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from g1stream.analysis.summary import played
from g1stream.errors import MotionError, RecordingError, RobotError
from g1stream.extras.physics.measure import motion_physics
from g1stream.extras.physics.result import reasons
from g1stream.extras.report import html
from g1stream.extras.report.tables import Column, table
from g1stream.session.motions import attached_motion
from g1stream.text import counted, short_name

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from g1stream.extras.physics.result import MotionPhysics
    from g1stream.session.session import Session
    from g1stream.session.summary import Summary

__all__ = ["physics_section", "session_physics"]

#: Frames per second at which the reference is looked at, where the motion is not attached.
_FPS: Final = 30.0
#: More would take seconds.
_MOST_FRAMES: Final = 10_000

_EXCESSES: Final = (
    Column("what", "", "cause"),
    Column("of", "", "where"),
    Column("worst", "", "worst", ".4g"),
    Column("limit", "", "limit", ".4g"),
    Column("unit", "", "unit"),
    Column("at", "s", "time_s", ".2f"),
    Column("longest", "s", "longest_s", ".2f"),
    Column("forbids it", "", "forbids"),
)
_FEET: Final = (
    Column("contact", "% of frames", "contact_share", ".0f", 100.0),
    Column("height", "mm in contact", "height_mm", ".1f"),
    Column("penetration", "mm at most", "penetration_mm", ".1f"),
    Column("skating", "mm/s, mean", "skating_mm_s", ".1f"),
    Column("fastest", "mm/s", "skating_max_mm_s", ".1f"),
)
_PEAKS: Final = (
    Column("joint", "", "joint"),
    Column("torque", "N·m", "torque_nm", ".1f"),
    Column("limit", "N·m", "limit_nm"),
    Column("at", "s", "time_s", ".2f"),
    Column("beyond", "frames", "frames"),
)
_COLLISIONS: Final = (
    Column("in", "", "other"),
    Column("depth", "mm", "depth_mm", ".1f"),
    Column("at", "s", "time_s", ".2f"),
    Column("simulated", "", "simulated"),
)
#: Torques of each support, and pairs of links, that are shown.
_MOST_PEAKS: Final = 3
_MOST_PAIRS: Final = 12


def session_physics(
    session: Session, summary: Summary, progress: Callable[[float], None]
) -> MotionPhysics | str:
    """What it takes to play the motion of a session, or why that is not told.

    It is that of the attached motion where that was played as it is, else that of the reference; or
    of what `convert` made of a motion.

    Args:
        session: any.
        summary: of it.
        progress: called with the fraction that is done, 0 to 1.
    """
    if played(summary.phases) > 1:
        return "Several motions were played."
    fps = (summary.motion and summary.motion.fps) or _FPS
    try:
        motion = session.motion() if session.converted else attached_motion(session)
        frames = motion.n_frames if motion else round((summary.termination.played_s or 0.0) * fps)
        if frames > _MOST_FRAMES:
            return (
                f"The motion has {frames} frames, more than the {_MOST_FRAMES} that a report takes "
                f"the time for: g1stream physics {session.path.name}."
            )
        motion = motion or session.motion(fps)
        max_tilt = (summary.settings or {}).get("safety.max_tilt")
        return motion_physics(
            motion,
            session.robot,
            max_tilt=max_tilt if isinstance(max_tilt, float) else None,
            progress=progress,
        )
    except (MotionError, RecordingError, RobotError) as error:
        return error.cause


def physics_section(physics: MotionPhysics | str, support: str | None, key: str) -> str:
    """The section as HTML.

    Args:
        physics: what `session_physics` found.
        support: how the robot was held in the session, where that is known.
        key: where the physics are in the JSON of the report.
    """
    if isinstance(physics, str):
        return html.missing(physics)
    values = physics.model_dump(mode="json")

    def each(path: str, name: str, rows: Sequence[Any]) -> list[tuple[str, str, Any]]:
        return [(short_name(row[name]), f"{key}.{path}.{i}", row) for i, row in enumerate(rows)]

    verdicts = [
        (f"{one}, as in this session" if one == support else one, str(verdict))
        for one, verdict in physics.verdicts.items()
    ]
    more = [("tilt", physics.tilt), ("centre of pressure", physics.pressure)]
    # The same excess may speak against several supports: it is in the JSON of each.
    keys = {
        excess: f"{key}.verdicts.{one}.excesses.{i}"
        for one, verdict in physics.verdicts.items()
        for i, excess in enumerate(verdict.excesses)
    }
    against = [
        (of, keys[excess], excess.model_dump(mode="json"))
        for of, excess in reasons(physics.verdicts)
    ]
    peaks = [
        (one, f"{key}.torques.{one}.{i}", row)
        for one, rows in values["torques"].items()
        for i, row in enumerate(rows[:_MOST_PEAKS])
    ]
    collisions = each("collisions", "link", values["collisions"])
    n_pairs = counted(len(collisions), "pair")
    deepest = f": the {_MOST_PAIRS} deepest" if len(collisions) > _MOST_PAIRS else ""
    return "\n".join(
        (
            html.facts([*verdicts, *(one for one in more if one[1])]),
            table("support", _EXCESSES, against),
            table("foot", _FEET, each("feet", "link", values["feet"])),
            table("support", _PEAKS, peaks),
            html.details(
                f"{n_pairs} of links that are inside each other{deepest}",
                table("link", _COLLISIONS, collisions[:_MOST_PAIRS]),
            ),
        )
    )
