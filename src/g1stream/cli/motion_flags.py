"""Flags of the commands that take a motion: how to read it, and how to change it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from typing import TYPE_CHECKING, Final, Literal

from g1stream.cli.command import Command
from g1stream.cli.flags import flag
from g1stream.types import JointOrder

if TYPE_CHECKING:
    from collections.abc import Sequence

    from g1stream.motion.motion import Motion
    from g1stream.motion.readers import MotionFile
    from g1stream.robot.model import G1

__all__ = ["MOTION", "MOTIONS", "MotionFlags", "MotionPartFlags"]

MOTION: Final = (
    "Motion file (CSV, NPZ, pickle), session, ROS 2 bag, or the name of a bundled motion: demo."
)
"""Help of a flag that names a motion."""
MOTIONS: Final = f"{MOTION} Several are joined in the given order."
"""Help of an argument that names motions."""


@dataclass(frozen=True, kw_only=True)
class MotionFlags(Command):
    """Flags of the commands that take one or more motions.

    Each motion is mirrored, put on the floor and changed in speed. Then they are joined, the result
    is repeated, and the pelvis is fixed.
    """

    fps: float | None = flag(
        None,
        "Frame rate of the motion file, or sampling rate of a session.",
        "HZ",
        shown="the file's rate, or 30",
        gt=0,
    )
    joint_order: JointOrder | None = flag(
        None,
        "Joint order of a motion file without joint names.",
        shown="detected from bodies and joint limits",
        advanced=True,
    )
    mirror: bool = flag(False, "Mirror the motion: swap left and right.", advanced=True)
    on_floor: bool = flag(
        False, "Raise or lower each motion until its feet stand on the floor.", advanced=True
    )
    speed: float = flag(1.0, "Speed as a multiple of the file's.", "FACTOR", gt=0)
    blend: float = flag(
        0.5,
        "Time from the end of a motion to the start of the next.",
        "SECONDS",
        advanced=True,
    )
    repeat: int = flag(1, "How many times to play it, with blends.", "N", gt=0, advanced=True)
    root: Literal["follow", "fix"] = flag(
        "follow",
        "Move the pelvis as in the motion, or fix it as in the first frame.",
        advanced=True,
    )

    def load(self, motions: Sequence[str], robot: G1 | None = None) -> Motion:
        """Read one or more motions, and join them, for a robot.

        Raises:
            ConfigError: a flag does not fit.
            MotionError: a file is no motion, or the requested change is not possible.
            RecordingError: a session is damaged, or no motion was played in it.
            RobotError: --on-floor needs the robot's soles, and they are unknown.
        """
        return self.join([self.find(one, robot).load() for one in motions], robot)

    def find(self, motion: str, robot: G1 | None = None) -> MotionFile:
        """A motion file, with the flags that say how to read it."""
        from g1stream.motion.readers import find_motion

        return find_motion(motion, fps=self.fps, joint_order=self.joint_order, robot=robot)

    def join(self, motions: Sequence[Motion], robot: G1 | None = None) -> Motion:
        """Apply the flags to loaded motions, and join them; see `load`."""
        parts = [self._part(motion, robot) for motion in motions]
        joined = reduce(lambda one, other: one.then(other, self.blend), parts)
        if self.repeat != 1:
            joined = joined.looped(self.repeat, self.blend)
        return joined.fixed_root() if self.root == "fix" else joined

    def _part(self, motion: Motion, robot: G1 | None) -> Motion:
        if self.mirror:
            motion = motion.mirrored()
        if self.on_floor:
            motion = motion.on_floor(robot)
        return motion.at_speed(self.speed) if self.speed != 1.0 else motion


@dataclass(frozen=True, kw_only=True)
class MotionPartFlags(MotionFlags):
    """Flags of the commands that take a motion and have no settings for the played part."""

    start: float = flag(0.0, "Start of the part, as a time in the motion.", "SECONDS")
    duration: float | None = flag(
        None, "Length of the part.", "SECONDS", shown="to the end of the motion", gt=0
    )

    def join(self, motions: Sequence[Motion], robot: G1 | None = None) -> Motion:
        """Apply the flags to loaded motions, join them, and cut the part from the result."""
        motion = super().join(motions, robot)
        if not self.start and self.duration is None:
            return motion
        end = None if self.duration is None else self.start + self.duration
        return motion.trim(self.start, end)
