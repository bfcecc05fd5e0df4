"""The rows of a library's two tables: one a motion, and one a joint of a motion.

`compute` fills them; the Parquet files, the page and the documentation have the same columns.
"""

from __future__ import annotations

from math import isnan
from typing import TYPE_CHECKING, Any, Final, Literal, get_args

from pydantic import Field

from g1stream.extras.physics.result import Playable
from g1stream.session.records import Int, Record

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = [
    "CONDITION_NAMES",
    "FORMAT",
    "Command",
    "JointRow",
    "MotionRow",
    "Rows",
    "Status",
    "condition_value",
]

Command = Literal["check", "simulate", "convert"]
Status = Literal["ok", "broken", "refused", "huge", "slow", "crashed", "error"]
"""What became of a motion: computed; no motion can be read from the file; a motion that is not
played so; it took too much memory, or time; its process ended; or we failed."""


FORMAT: Final = 2
"""Of the tables: another number where a column changes, so that rows are computed again."""


def column(description: str, unit: str = "", default: Any = None) -> Any:
    """A column of a table, with its meaning and its unit."""
    return Field(default, description=description, json_schema_extra={"unit": unit})


class MotionRow(Record):
    """What is known of a motion. What was not computed is None."""

    key: str = column("of this row: content, variant, settings and versions", default=...)
    name: str = column("of the file, without its ending", default=...)
    path: str = column("of the file, or its URL", default=...)
    sha256: str = column("of its content", default=...)
    command: Command = column("that computed the row", default=...)
    variant: str = column("support and values of a sweep, or the format", default="")
    support: str | None = column("how the pelvis was held")
    status: Status = column("what became of it", default="ok")
    reason: str | None = column("why it is not ok")
    frames: Int | None = column("of the motion")
    fps: float | None = column("of the motion", "Hz")
    duration: float | None = column("of the motion", "s")

    bolted: Playable | None = column("whether it can be played, the pelvis bolted")
    hanging: Playable | None = column("whether it can be played, hanging")
    follow: Playable | None = column("whether it can be played, the pelvis following the reference")
    free: Playable | None = column("whether it can be played, standing free")
    feet: Playable | None = column("whether it can be played on its own feet, changed to stand")
    causes: str | None = column("what speaks against it, by support")
    within_limits: bool | None = column("whether it keeps the limits of position and speed")
    looks_like: str | None = column("what a limit that is passed looks like")
    max_speed: float | None = column("of a joint", "rad/s")
    max_tilt: float | None = column("of the pelvis", "rad")
    max_collision: float | None = column("depth of two links in each other", "mm")
    max_penetration: float | None = column("depth of a foot below the floor", "mm")
    max_skating: float | None = column("speed of a foot on the floor", "mm/s")
    least_margin: float | None = column(
        "from the centre of pressure to the edge of the support polygon", "mm"
    )
    supported: float | None = column("share of the frames with a foot on the floor")
    torque_bolted: float | None = column("the largest of a joint over its limit, bolted")
    torque_hanging: float | None = column("the largest of a joint over its limit, hanging")
    torque_follow: float | None = column("the largest of a joint over its limit, following")
    torque_free: float | None = column("the largest of a joint over its limit, free")

    completed: bool | None = column("whether it was played to its end")
    ended: str | None = column("why it was not")
    success: bool | None = column("played to its end and followed, as `session.metrics()` has it")
    progress: float | None = column("share of the motion that was played")
    rmse: float | None = column("of all joints", "rad")
    mae: float | None = column("mean absolute error of all joints", "rad")
    p99: float | None = column("99th percentile of the absolute error", "rad")
    max: float | None = column("the greatest error", "rad")
    bias: float | None = column("root mean square of the joints' mean errors", "rad")
    delay: float | None = column("by which the joints are behind the reference", "s")
    velocity_rmse: float | None = column("of all joints", "rad/s")
    mpjpe: float | None = column("mean distance of the links, in the pelvis's frame", "mm")
    mpjpe_root: float | None = column("distance of the links, with the pelvis's attitude", "mm")
    mpjpe_world: float | None = column("distance of the links, in the world", "mm")
    torque_rms: float | None = column("of all joints", "N·m")
    torque_use: float | None = column("99th percentile of a joint over its limit, the highest")
    saturated: float | None = column("share of the states with a joint at its limit")
    power: float | None = column("of all motors", "W")
    worst_joint: str | None = column("the one with the greatest RMSE")

    output: str | None = column("the file that was written, below the library's directory")
    report: str | None = column("the report of the session, below the library's directory")
    seconds: float | None = column("that it took to compute", "s")
    memory: float | None = column("of its process afterwards", "MB")
    limits: str = column("of time and memory for it", default="")
    picture: str | None = column("five poses, as the path of an SVG 100 wide and 30 high")


_PLAYABLE: Final = {"yes": 1.0, "inexact": 0.5, "no": 0.0}
_KINDS: Final[set[Any]] = {bool, float, Int, Playable}
CONDITION_NAMES: Final = (
    "ok",
    *(
        name
        for name, one in MotionRow.model_fields.items()
        if _KINDS.intersection(get_args(one.annotation))
    ),
)
"""What a condition on a row can name: its columns that are numbers or answers, and `ok`."""


def condition_value(row: Mapping[str, Any], name: str) -> float | None:
    """What a condition names, as a number; None for what is not known.

    Args:
        row: of the table of motions, with None or NaN for what was not computed.
        name: of `CONDITION_NAMES`.
    """
    value = row["status"] == "ok" if name == "ok" else row[name]
    unknown = value is None or (isinstance(value, float) and isnan(value))
    return None if unknown else float(_PLAYABLE.get(value, value))


class JointRow(Record):
    """What is known of a joint in a motion."""

    key: str = column("of the motion's row", default=...)
    joint: str = column("its name", default=...)
    lowest: float | None = column("the smallest angle in the motion", "rad")
    highest: float | None = column("the largest angle in the motion", "rad")
    max_speed: float | None = column("as streamed", "rad/s")
    torque_limit: float | None = column("the smaller of the motor's and the URDF's", "N·m")
    torque_bolted: float | None = column("the largest of the motion, with sign, bolted", "N·m")
    torque_hanging: float | None = column("the largest of the motion, with sign, hanging", "N·m")
    torque_follow: float | None = column("the largest of the motion, with sign, following", "N·m")
    torque_free: float | None = column("the largest of the motion, with sign, free", "N·m")
    rmse: float | None = column("of the simulated joint", "rad")
    bias: float | None = column("its mean error", "rad")
    p99: float | None = column("99th percentile of its absolute error", "rad")
    max: float | None = column("its greatest error", "rad")
    delay: float | None = column("by which it is behind the reference", "s")
    torque_p99: float | None = column("99th percentile of its absolute torque", "N·m")
    torque_use: float | None = column("the same over its limit")
    saturated: float | None = column("share of the states at its limit")


class Rows(Record):
    """The rows of one motion, and the values of a sweep that go into columns of their own."""

    motion: MotionRow
    joints: list[JointRow] = Field(default_factory=list)
    sweep: dict[str, float | str] = Field(default_factory=dict)
