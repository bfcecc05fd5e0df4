"""Results of `motion_physics` as records and as text.

Field names are those of the JSON, with units. Frames are counted from 0, and spans of frames
are inclusive.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, get_args

from pydantic import computed_field

from g1stream.session.records import Record
from g1stream.text import counted, labelled, ranges, table
from g1stream.types import StreamSupport, Support

__all__ = [
    "Collision",
    "Excess",
    "Foot",
    "MotionPhysics",
    "Playable",
    "TorquePeak",
    "Verdict",
    "reasons",
]

Playable = Literal["yes", "inexact", "no"]
"""Whether a motion can be played; `inexact`: with deviations from the motion."""

Cause = Literal[
    "self-collision",
    "torque",
    "tilt",
    "floor contact",
    "support",
    "centre of pressure",
    "friction",
    "penetration",
    "skating",
]

_LABEL = 16
_ROWS = 10
_SPANS = 4


class Excess(Record, frozen=True):
    """A quantity that is beyond its limit in some frames.

    Attributes:
        cause: self-collision: penetration depth of two links. torque: of a joint. tilt: of the
            pelvis. floor contact: depth of a link other than a foot below the floor. support: force
            that no contact can exert, because no foot is on the floor, or because the floor would
            have to pull. centre of pressure: distance outside of the support polygon. friction: the
            coefficient that is needed. penetration: depth of a foot below the floor. skating: speed
            of a foot on the floor.
        where: joint, links or foot of the worst value; empty for the whole robot.
        worst, limit: in `unit`; if the excess forbids the motion, within the spans that do.
        frame: frame of the worst value.
        time_s: time of that frame.
        spans: first and last frame of each run beyond the limit; if the excess forbids the
            motion, of the runs that do.
        longest_s: longest time that one joint, pair of links or foot is beyond it.
        forbids: whether the motion cannot be played; otherwise it is played with deviations.
    """

    cause: Cause
    where: str
    worst: float
    limit: float
    unit: str
    frame: int
    time_s: float
    spans: tuple[tuple[int, int], ...]
    longest_s: float
    forbids: bool

    def __str__(self) -> str:
        what = f"{self.cause} of {self.where}" if self.where else self.cause
        n_frames = sum(last - first + 1 for first, last in self.spans)
        worst = f"{_rounded(self.worst)} {self.unit}".rstrip()
        return (
            f"{what}: {worst} at {self.time_s:.2f} s, limit {_rounded(self.limit)}; "
            f"{counted(n_frames, 'frame')}, {ranges(self.spans, _SPANS)}"
        )


class Verdict(Record, frozen=True):
    """Whether a motion can be played with a support.

    Attributes:
        support: how the pelvis is held; `feet`: on its feet with `stream --support feet`, which
            changes the motion.
        excesses: problems, those that forbid the motion first; none for `feet`.
        changed: for `feet`: the changes, or "as it is".
        refused: for `feet`: why it cannot be played, and the frames.
        instead: for `feet`: what can be played instead, as flags of `stream`, if it was searched.
    """

    support: StreamSupport
    excesses: tuple[Excess, ...] = ()
    changed: str = ""
    refused: str = ""
    instead: str = ""

    @computed_field  # type: ignore[prop-decorator]
    @property
    def playable(self) -> Playable:
        """`no` if an excess forbids it, `inexact` with other excesses, otherwise `yes`."""
        if self.refused or any(excess.forbids for excess in self.excesses):
            return "no"
        return "inexact" if self.excesses else "yes"

    def __str__(self) -> str:
        if self.refused:
            return f"cannot be played: {'; '.join(filter(None, (self.refused, self.instead)))}"
        against = [e.cause for e in self.excesses if e.forbids]
        harmless = [e.cause for e in self.excesses if not e.forbids and e.cause not in against]
        answers = [f"cannot be played: {', '.join(against)}"] if against else []
        plays = "also inexact" if against else "plays, but inexactly"
        answers += [f"{plays}: {', '.join(harmless)}"] if harmless else []
        # Nothing in the loop controls the mass centre.
        how = "by a controller that balances" if self.support == "free" else self.changed
        return "; ".join(answers) or f"can be played {how}".rstrip()


class Foot(Record, frozen=True):
    """A foot on the floor at height 0.

    Attributes:
        link: link of the foot.
        contact_share: fraction of the frames in which one of its corners touches the floor.
        height_mm: mean height of its lowest corner above the floor while one touches.
        penetration_mm: largest depth of its lowest corner below the floor.
        penetration_frame: frame of that depth.
        skating_mm_s: mean horizontal speed of the touching corners.
        skating_max_mm_s: largest horizontal speed of the touching corners.
        skating_max_frame: frame of that speed.
    """

    link: str
    contact_share: float
    height_mm: float | None
    penetration_mm: float
    penetration_frame: int
    skating_mm_s: float | None
    skating_max_mm_s: float | None
    skating_max_frame: int | None


class Collision(Record, frozen=True):
    """Two links that penetrate each other.

    Attributes:
        link, other: names of the links.
        depth_mm: largest distance that one must be moved until they only touch.
        frame: frame of that depth.
        time_s: time of that frame.
        spans: first and last frame of each run in which they penetrate.
        simulated: whether Unitree's simulators and g1stream's let these links collide.
    """

    link: str
    other: str
    depth_mm: float
    frame: int
    time_s: float
    spans: tuple[tuple[int, int], ...]
    simulated: bool


class TorquePeak(Record, frozen=True):
    """The largest torque of a joint in a motion.

    Attributes:
        joint: name of the joint.
        torque_nm: the torque, with its sign.
        limit_nm: the smaller of the motor's limit and the URDF's effort.
        frame: frame of the peak.
        time_s: time of that frame.
        frames: number of frames beyond the limit.
    """

    joint: str
    torque_nm: float
    limit_nm: float
    frame: int
    time_s: float
    frames: int

    @property
    def share(self) -> float:
        """Torque as a fraction of the limit."""
        return abs(self.torque_nm) / self.limit_nm


class MotionPhysics(Record, frozen=True):
    """The physics of a motion.

    `str()` gives the text that `g1stream physics` prints.

    Attributes:
        motion: name of the motion.
        first_frame, frames: first analysed frame, and their number.
        fps: frame rate of the motion.
        robot: name of the model.
        mass_kg: mass of the robot.
        verdicts: by support, including `feet`.
        tilt_rad: largest tilt of the pelvis in the motion.
        hanging_tilt_rad: largest tilt of the pelvis if the robot hangs at rest in a pose of the
            motion.
        feet: left and right.
        supported_share: fraction of the frames with a foot on the floor.
        inside_share: fraction of the frames with the centre of pressure inside the support polygon,
            among those with a fifth of the weight on the feet or more; None without such frames.
        margin_mm: least distance from the centre of pressure to the edge of the polygon; negative
            outside; None without such frames.
        margin_frame: frame of that margin.
        collisions: the deepest first.
        torques: by support, every joint, the largest fraction of its limit first.
    """

    motion: str
    first_frame: int = 0
    frames: int
    fps: float
    robot: str
    mass_kg: float
    verdicts: dict[StreamSupport, Verdict]
    tilt_rad: float
    hanging_tilt_rad: float
    feet: tuple[Foot, ...]
    supported_share: float
    inside_share: float | None
    margin_mm: float | None
    margin_frame: int | None
    collisions: tuple[Collision, ...]
    torques: dict[Support, tuple[TorquePeak, ...]]

    def __str__(self) -> str:
        sections = (
            [
                _line("physics", f"of {self.robot}, {self.mass_kg:.1f} kg, {self.played}"),
                *(_line(f"  {support}", str(one)) for support, one in self.verdicts.items()),
            ],
            [_line(of, str(excess)) for of, excess in reasons(self.verdicts)],
            self._feet(),
            self._torques(),
            self._collisions(),
        )
        return "\n\n".join("\n".join(lines) for lines in sections if lines)

    @property
    def played(self) -> str:
        """The time range of the frames in the motion."""
        last = self.first_frame + self.frames - 1
        return f"{self.first_frame / self.fps:.2f} to {last / self.fps:.2f} s of the motion"

    @property
    def pressure(self) -> str:
        """The place of the centre of pressure, in a sentence; empty without weight on the feet."""
        if self.margin_mm is None or self.margin_frame is None:
            return ""
        side = "inside" if self.margin_mm >= 0 else "outside"
        return (
            f"inside the support polygon in {self.inside_share:.0%} of the frames with weight on a "
            f"foot ({self.supported_share:.0%} have a foot on the floor); in the worst frame "
            f"{abs(self.margin_mm):.0f} mm {side}, at "
            f"{self.margin_frame / self.fps:.2f} s"
        )

    @property
    def tilt(self) -> str:
        """The tilt of the pelvis, in a sentence."""
        return (
            f"at most {self.tilt_rad:.2f} rad; {self.hanging_tilt_rad:.2f} rad if the robot "
            "hangs at rest in a pose of the motion, and more while it swings"
        )

    def _feet(self) -> list[str]:
        rows = [("foot", "contact", "height mm", "deepest mm", "skating mm/s", "fastest mm/s")]
        rows += [
            (
                foot.link,
                f"{foot.contact_share:.0%}",
                _number(foot.height_mm),
                _number(foot.penetration_mm),
                _number(foot.skating_mm_s),
                _number(foot.skating_max_mm_s),
            )
            for foot in self.feet
        ]
        lines = [*table(rows, left=(0,)), "", _line("tilt", self.tilt)]
        return [*lines, _line("pressure", self.pressure)] if self.pressure else lines

    def _torques(self) -> list[str]:
        rows = [("support", "largest torques", "N·m", "limit", "at s", "frames beyond")]
        rows += [
            (
                support,
                peak.joint.removesuffix("_joint"),
                f"{peak.torque_nm:.1f}",
                f"{peak.limit_nm:.0f}",
                f"{peak.time_s:.2f}",
                f"{peak.frames}",
            )
            for support, peaks in self.torques.items()
            for peak in peaks[:2]
        ]
        return table(rows, left=(0, 1))

    def _collisions(self) -> list[str]:
        if not self.collisions:
            return [_line("self-collision", "none")]
        rows = [("self-collision", "with", "mm", "at s", "frames", "simulated")]
        rows += [
            (
                one.link,
                one.other,
                f"{one.depth_mm:.1f}",
                f"{one.time_s:.2f}",
                str(sum(last - first + 1 for first, last in one.spans)),
                "yes" if one.simulated else "no",
            )
            for one in self.collisions[:_ROWS]
        ]
        more = len(self.collisions) - _ROWS
        return [*table(rows, left=(0, 1, 5)), *([f"and {more} more pairs"] if more > 0 else [])]


def reasons(verdicts: Mapping[StreamSupport, Verdict]) -> list[tuple[str, Excess]]:
    """Each excess once, those that forbid a motion first, with the names of its supports.

    `any support` means all but `feet`, for which the motion is changed.
    """
    supports: dict[Excess, list[str]] = {}
    for support, verdict in verdicts.items():
        for excess in verdict.excesses:
            supports.setdefault(excess, []).append(support)
    return [
        ("any support" if len(of) == len(get_args(Support)) else ", ".join(of), excess)
        for excess, of in sorted(supports.items(), key=lambda one: not one[0].forbids)
    ]


def _line(label: str, text: str) -> str:
    return labelled(f"{label} ".ljust(_LABEL), text)


def _rounded(value: float) -> str:
    """The value with three digits, or as a whole number."""
    return f"{value:.0f}" if abs(value) >= 1000.0 else f"{value:.3g}"


def _number(value: float | None) -> str:
    return "" if value is None else f"{round(value, 1) + 0.0:.1f}"  # + 0.0 avoids -0.0
