"""The flags of the commands that take a motion: how it is read, and what is done to it."""

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
MOTIONS: Final = f"{MOTION} Several are joined in their order."
"""Help of an argument that names motions."""


@dataclass(frozen=True, kw_only=True)
class MotionFlags(Command):
    """Flags of the commands that take a motion, or several.

    Each motion is mirrored, put on the floor and changed in speed; then they are joined, that is
    repeated, and the pelvis fixed.
    """

    fps: float | None = flag(
        None,
        "Frames per second of the motion file, or to sample a session at.",
        "HZ",
        shown="what the file says, or 30",
        gt=0,
    )
    joint_order: JointOrder | None = flag(
        None,
        "Order of the joints in a motion file that does not name them.",
        shown="told by bodies and joint limits",
        advanced=True,
    )
    mirror: bool = flag(False, "Mirror it: left is right.", advanced=True)
    on_floor: bool = flag(
        False, "Raise or lower each motion until its feet stand on the floor.", advanced=True
    )
    speed: float = flag(1.0, "How many times as fast as its frame rate says.", "FACTOR", gt=0)
    blend: float = flag(
        0.5,
        "Time from the end of a motion to the start of the next.",
        "SECONDS",
        advanced=True,
    )
    repeat: int = flag(1, "How many times to play it, with blends.", "N", gt=0, advanced=True)
    root: Literal["follow", "fix"] = flag(
        "follow", "The pelvis as in the motion, or fixed as in its first frame.", advanced=True
    )

    def load(self, motions: Sequence[str], robot: G1 | None = None) -> Motion:
        """Read one motion or more, and make one of them, for a robot.

        Raises:
            ConfigError: a flag does not fit.
            MotionError: a file is no motion, or what is asked for is not possible.
            RecordingError: a session is damaged, or no motion was played in it.
            RobotError: the robot's soles, which --on-floor needs, are not known.
        """
        return self.join([self.find(one, robot).open().motion() for one in motions], robot)

    def find(self, motion: str, robot: G1 | None = None) -> MotionFile:
        """A motion file, to be read as the flags say."""
        from g1stream.motion.readers import find_motion

        return find_motion(motion, fps=self.fps, joint_order=self.joint_order, robot=robot)

    def join(self, motions: Sequence[Motion], robot: G1 | None = None) -> Motion:
        """What the flags make of motions that are read.

        Raises:
            ConfigError: a flag does not fit.
            MotionError: what is asked for is not possible.
            RobotError: the robot's soles, which --on-floor needs, are not known.
        """
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
    """Flags of the commands that take a motion and have no settings for the part that is played."""

    start: float = flag(0.0, "Where in the motion to start.", "SECONDS")
    duration: float | None = flag(
        None, "How much of the motion to take.", "SECONDS", shown="to its end", gt=0
    )

    def join(self, motions: Sequence[Motion], robot: G1 | None = None) -> Motion:
        """What the flags make of motions that are read; the part is that of the whole.

        Raises:
            ConfigError: a flag does not fit.
            MotionError: what is asked for is not possible.
            RobotError: the robot's soles, which --on-floor needs, are not known.
        """
        motion = super().join(motions, robot)
        if not self.start and self.duration is None:
            return motion
        return motion.trim(
            self.start, None if self.duration is None else self.start + self.duration
        )
