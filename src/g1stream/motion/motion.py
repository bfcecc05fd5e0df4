"""What a motion file says: one pose of the whole robot per frame, at a constant frame rate."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from g1stream.errors import MotionError

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import ArrayLike, NDArray

    from g1stream.robot.model import G1

__all__ = ["Motion"]


@dataclass(frozen=True, eq=False)
class Motion:
    """Poses of the robot at `fps` frames a second. The arrays are read-only float64 copies.

    Attributes:
        name: what people call it: the file's name without its ending.
        fps: frames a second, above 0.
        joint_names: one for each column of `joint_pos`; from `load_motion` they are the 29 motor
            names in motor order.
        joint_pos: (T, len(joint_names)) joint angles in rad, T >= 2.
        root_pos: (T, 3) position of the pelvis in the world frame, m.
        root_quat_wxyz: (T, 4) orientation of the pelvis in the world frame. Whatever is given is
            made unit, and sign-continuous: of q and -q, the one nearer to the frame before.
        source: the file it came from, if any.
        sha256: of the whole source file, in hex, also where this is only a part of it.
        warnings: what a reader put right in the source, a sentence each.

    Raises:
        MotionError: the shapes do not fit together, there is only one frame, a value is not finite,
            a quaternion is zero, or `fps` is not positive.
    """

    name: str
    fps: float
    joint_names: tuple[str, ...]
    joint_pos: NDArray[np.float64]
    root_pos: NDArray[np.float64]
    root_quat_wxyz: NDArray[np.float64]
    source: Path | None = None
    sha256: str | None = None
    warnings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_fps(self.fps, self.name)
        n_frames = len(self.joint_pos)
        if n_frames < 2:
            raise MotionError(
                f"The motion {self.name} has {n_frames} frame{'s' * (n_frames != 1)}.",
                "Give it two frames or more: with fewer there is nothing to move between.",
            )
        joint_pos = self._array("joint_pos", (n_frames, len(self.joint_names)))
        root_pos = self._array("root_pos", (n_frames, 3))
        quat = self._array("root_quat_wxyz", (n_frames, 4))
        norms = np.linalg.norm(quat, axis=1)
        if not norms.all():
            raise MotionError(
                f"The motion {self.name} has a zero quaternion in frame {int(np.argmin(norms))}.",
                "Give every frame an orientation; none at all is 1, 0, 0, 0 (wxyz).",
            )
        set_field = object.__setattr__
        set_field(self, "fps", float(self.fps))
        set_field(self, "joint_names", tuple(self.joint_names))
        set_field(self, "joint_pos", _frozen(joint_pos))
        set_field(self, "root_pos", _frozen(root_pos))
        set_field(self, "root_quat_wxyz", _frozen(_sign_continuous(quat / norms[:, np.newaxis])))

    @property
    def n_frames(self) -> int:
        """How many frames there are."""
        return len(self.joint_pos)

    @property
    def duration(self) -> float:
        """Seconds from the first frame to the last."""
        return (self.n_frames - 1) / self.fps

    def frames(self, start: int, stop: int) -> Motion:
        """The motion made of the frames `start` up to, but without, `stop`.

        Raises:
            MotionError: these are not two frames or more of this motion.
        """
        if not 0 <= start <= stop - 2 <= self.n_frames - 2:
            raise MotionError(
                f"Frames {start} to {stop} are not a part of {self.name}, which has "
                f"{self.n_frames} frames.",
                f"Ask for at least two frames between 0 and {self.n_frames}.",
            )
        part = slice(start, stop)
        return replace(
            self,
            joint_pos=self.joint_pos[part],
            root_pos=self.root_pos[part],
            root_quat_wxyz=self.root_quat_wxyz[part],
        )

    def _array(self, field: str, shape: tuple[int, int]) -> NDArray[np.float64]:
        values = np.array(getattr(self, field), dtype=np.float64)
        if values.shape != shape:
            raise MotionError(
                f"The motion {self.name} has {field} of shape {values.shape}.",
                f"Give it {shape}: a row for each frame.",
            )
        if not np.isfinite(values).all():
            frame = int(np.argwhere(~np.isfinite(values))[0, 0])
            raise MotionError(
                f"The motion {self.name} has a value that is not finite in {field}, frame {frame}.",
                "Give it numbers only.",
            )
        return values

    def require_joints_of(self, robot: G1) -> None:
        """Refuse a robot that has other joints, or these in another order.

        Raises:
            MotionError: the motion's joints are not the robot's.
        """
        if self.joint_names != robot.joint_names:
            raise MotionError(
                f"The joints of the motion {self.name} are not those of the robot {robot.name}.",
                "Load the motion for this robot: load_motion(path, robot).",
            )


def check_fps(fps: float, name: str) -> None:
    """Raise MotionError unless `fps` is a frame rate: finite and above 0."""
    if not (np.isfinite(fps) and fps > 0):
        raise MotionError(
            f"The motion {name} cannot have {fps} frames a second.",
            "Give a frame rate above 0, such as 30.",
        )


def _sign_continuous(quat: NDArray[np.float64]) -> NDArray[np.float64]:
    """Flip quaternions (T, 4) so that each has a non-negative dot product with the one before."""
    flips = np.einsum("ij,ij->i", quat[1:], quat[:-1]) < 0
    signs = np.where(np.logical_xor.accumulate(flips), -1.0, 1.0)
    return np.concatenate([quat[:1], quat[1:] * signs[:, np.newaxis]])


def _frozen(values: ArrayLike) -> NDArray[np.float64]:
    array = np.ascontiguousarray(values, dtype=np.float64)
    array.setflags(write=False)
    return array
