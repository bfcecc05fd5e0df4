"""A motion: one pose of the whole robot per frame, at a constant frame rate."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Final

import numpy as np

from g1stream.errors import MotionError
from g1stream.input_limits import NUMBER
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.rotations import sign_continuous
from g1stream.text import counted

if TYPE_CHECKING:
    import os
    from collections.abc import Callable, Sequence

    from matplotlib.figure import Figure
    from numpy.typing import ArrayLike, NDArray

    from g1stream.robot.model import G1
    from g1stream.types import Floats

__all__ = [
    "SMALLEST_QUAT",
    "Motion",
    "check_fps",
    "norm_warnings",
]

SMALLEST_QUAT: Final = 1e-6
"""A quaternion whose norm is not above this counts as zero."""
#: Quaternion norms that differ from 1 by more than this give a warning; by more than the second
#: they are no rounding error.
_NORM_TOLERANCE: Final = 1e-3
_NORM_ROUNDING: Final = 0.1
#: Frames per second of a motion, lowest and highest.
_FPS: Final = (1e-3, 1e6)


@dataclass(frozen=True, eq=False, repr=False)
class Motion:
    """Poses of the 29 joints and the pelvis. The arrays are read-only float64 copies.

    Attributes:
        name: of the motion; that of the file without its suffix.
        fps: frames per second, above 0.
        joint_names: `g1stream.JOINT_NAMES`, one for each column of `joint_pos`.
        joint_pos: (T, 29) joint angles in motor order, rad, T >= 2.
        root_pos: (T, 3) position of the pelvis in the world frame, m.
        root_quat_wxyz: (T, 4) orientation of the pelvis in the world frame, unit, w first. Its sign
            is continuous: of q and -q, the one nearer to the previous frame.
        source: the file it came from, if any.
        sha256: of the whole source file, in hex, also where this is only a part of it.
        warnings: what a reader corrected, a sentence each.
        operations: what was done to the motion in the file, in this order, such as `mirrored`.
        parts: the motions that it was joined of, in their order; empty where it was not.

    Raises:
        MotionError: the shapes do not fit together, there is only one frame, a value is not finite
            or too large, a quaternion is zero, or `fps` is not a frame rate.
    """

    name: str
    fps: float
    joint_pos: Floats
    root_pos: Floats
    root_quat_wxyz: Floats
    source: Path | None = None
    sha256: str | None = None
    warnings: tuple[str, ...] = ()
    operations: tuple[str, ...] = ()
    parts: tuple[Motion, ...] = ()
    joint_names: ClassVar = JOINT_NAMES

    @classmethod
    def from_arrays(
        cls,
        joint_pos: ArrayLike,
        root_pos: ArrayLike | None = None,
        root_quat_wxyz: ArrayLike | None = None,
        *,
        fps: float,
        joint_names: Sequence[str] | None = None,
        name: str = "motion",
    ) -> Motion:
        """A motion of the 29 joints, from arrays.

        Args:
            joint_pos: (T, 29) joint angles, rad, T >= 2.
            root_pos: (T, 3) position of the pelvis in the world frame, m; the origin if None.
            root_quat_wxyz: (T, 4) orientation of the pelvis in the world frame, w first; no
                rotation if None. Quaternions of any length above 0 are normalised.
            fps: frames per second.
            joint_names: the joint in each column of `joint_pos`, in any order; motor order
                (`g1stream.JOINT_NAMES`) if None.
            name: of the motion, for messages and recordings.

        Returns:
            The motion, its joints in motor order.

        Raises:
            MotionError: a shape does not fit, a value is not finite, a quaternion is zero, `fps` is
                not positive, or the names are not those of the 29 joints.
        """
        angles = np.asarray(joint_pos, dtype=np.float64)
        if joint_names is not None:
            _check_joint_names(name, joint_names)
            if angles.ndim == 2 and angles.shape[1] == len(joint_names):
                angles = angles[:, [list(joint_names).index(joint) for joint in JOINT_NAMES]]
        n_frames = len(np.atleast_1d(angles))
        if root_pos is None:
            root_pos = np.zeros((n_frames, 3))
        if root_quat_wxyz is None:
            root_quat_wxyz = np.tile([1.0, 0.0, 0.0, 0.0], (n_frames, 1))
        return cls(name, fps, angles, np.asarray(root_pos), np.asarray(root_quat_wxyz))

    def __post_init__(self) -> None:
        check_fps(self.fps, self.name)
        n_frames = len(np.atleast_1d(self.joint_pos))
        if n_frames < 2:
            raise MotionError(
                f"The motion {self.name} has {counted(n_frames, 'frame')}.",
                "Give it two frames or more.",
            )
        joint_pos = self._array("joint_pos", (n_frames, len(JOINT_NAMES)))
        root_pos = self._array("root_pos", (n_frames, 3))
        quat = self._array("root_quat_wxyz", (n_frames, 4))
        norms = np.linalg.norm(quat, axis=1, keepdims=True)
        if norms.min() <= SMALLEST_QUAT:
            raise MotionError(
                f"The motion {self.name} has a zero quaternion in frame {int(np.argmin(norms))}.",
                "Give every frame an orientation; without rotation it is 1, 0, 0, 0 (wxyz).",
            )
        # Those that are unit already stay as they are, to the last bit, so that a saved motion is
        # read back exactly.
        quat = np.where(np.abs(norms - 1.0) <= 4.0 * np.finfo(float).eps, quat, quat / norms)
        set_field = object.__setattr__
        set_field(self, "fps", float(self.fps))
        for field, values in (
            ("joint_pos", joint_pos),
            ("root_pos", root_pos),
            ("root_quat_wxyz", sign_continuous(quat)),
        ):
            values.setflags(write=False)
            set_field(self, field, values)

    def __repr__(self) -> str:
        return (
            f"Motion(name={self.name!r}, fps={self.fps:g}, n_frames={self.n_frames}, "
            f"duration={self.duration:.2f} s)"
        )

    @property
    def n_frames(self) -> int:
        return len(self.joint_pos)

    @property
    def duration(self) -> float:
        """Seconds from the first frame to the last."""
        return (self.n_frames - 1) / self.fps

    @cached_property
    def content_sha256(self) -> str:
        """SHA-256 of frame rate, joint angles and root poses, in hex: which motion this is.

        Other than `sha256` it tells parts of a file apart, and there is one without a file.
        """
        digest = sha256(repr(self.fps).encode())
        for values in (self.joint_pos, self.root_pos, self.root_quat_wxyz):
            digest.update(values.astype("<f8").tobytes())
        return digest.hexdigest()

    def frames(self, start: int, stop: int) -> Motion:
        """The frames `start` up to, but without, `stop`.

        Raises:
            MotionError: these are not two frames or more of this motion.
        """
        if not 0 <= start <= stop - 2 <= self.n_frames - 2:
            raise MotionError(
                f"Frames {start} to {stop} are not a part of {self.name}, which has "
                f"{counted(self.n_frames, 'frame')}.",
                f"Give a start and a stop, two frames or more apart, from 0 to {self.n_frames}.",
            )
        cut = () if stop - start == self.n_frames else (f"cut to frames {start} to {stop}",)
        return replace(self.at_frames(slice(start, stop)), operations=self.operations + cut)

    def at_frames(self, numbers: NDArray[np.intp] | slice) -> Motion:
        """The frames of these numbers; one that is repeated is a pause."""
        return replace(
            self,
            joint_pos=self.joint_pos[numbers],
            root_pos=self.root_pos[numbers],
            root_quat_wxyz=self.root_quat_wxyz[numbers],
        )

    def resample(self, fps: float) -> Motion:
        """The motion at another frame rate: the spline of `Trajectory` at the times i / fps.

        It starts at the first frame and ends at or less than 1 / fps before the last one.

        Raises:
            MotionError: `fps` is not positive, or leaves fewer than two frames.
        """
        from g1stream.motion.operations import resampled

        return resampled(self, fps)

    def trim(self, start: float = 0.0, end: float | None = None) -> Motion:
        """The part between two times, s, to the nearest frame; to the last frame if `end` is None.

        Raises:
            MotionError: these are not two frames or more of this motion.
        """
        from g1stream.motion.operations import trimmed

        return trimmed(self, start, end)

    def mirrored(self) -> Motion:
        """The mirror image across the world's x-z plane: left is right.

        Which joint mirrors which, and with which sign, follows from the axes in the URDF. Bodies
        are where the mirror image puts them, to the 0.1 mm to which the URDF is symmetric.
        """
        from g1stream.motion.operations import mirrored

        return mirrored(self)

    def at_speed(self, factor: float) -> Motion:
        """The same frames, `factor` times as many per second.

        Raises:
            MotionError: the factor is not positive.
        """
        from g1stream.motion.operations import at_speed

        return at_speed(self, factor)

    def fixed_root(self) -> Motion:
        """The motion with the pelvis where it is, and as it is turned, in the first frame."""
        from g1stream.motion.operations import fixed_root

        return fixed_root(self)

    def on_floor(self, robot: G1 | None = None) -> Motion:
        """The motion raised or lowered as a whole until the feet that stand are on the floor.

        The floor is at height 0. The feet stand at the median height of the lower sole, over the
        frames in which its lowest corner is slower than 0.25 m/s.

        Args:
            robot: whose soles stand; the default G1 if None.

        Raises:
            MotionError: no foot stands in it.
            RobotError: the robot's soles are not known.
        """
        from g1stream.motion.operations import on_floor
        from g1stream.robot.model import G1

        return on_floor(self, robot or G1.default())

    def then(self, other: Motion, blend: float = 0.5) -> Motion:
        """The motion, a blend, and another motion.

        All frames of both are kept, at the higher frame rate of the two. The other motion is turned
        to the heading in which this one ends, and goes on from where it ends; height and tilt stay
        as they are. In the blend each joint coasts out of its last velocity, moves on a
        minimum-jerk path and is brought up to its first velocity, so that a `Trajectory` through it
        is smooth (C2). A blend that is too short for the way is too fast for the joints, as
        `g1stream motion` says and `stream` refuses.

        Args:
            other: what comes next.
            blend: seconds from the last frame of this to the first one of the other; one frame if
                0.

        Raises:
            MotionError: the blend is negative or longer than a minute.
        """
        from g1stream.motion.operations import joined

        return joined(self, other, blend)

    def looped(self, n: int, blend: float = 0.5) -> Motion:
        """The motion `n` times, one after the other as by `then`.

        Raises:
            MotionError: `n` is less than 1, that is too long, or the blend is not possible.
        """
        from g1stream.motion.operations import looped

        return looped(self, n, blend)

    def plot(self, joints: Sequence[str] | None = None) -> Figure:
        """Draw joint angles over time.

        Args:
            joints: names of the joints to draw, in one diagram; if None all joints, in a diagram
                per limb.

        Returns:
            A matplotlib figure, time in s and angles in rad; its `savefig` writes a file.

        Raises:
            MotionError: the motion does not have one of the joints.
        """
        from g1stream.motion.figure import draw_motion

        return draw_motion(self, joints)

    def save(self, path: str | os.PathLike[str], *, force: bool = False) -> Path:
        """Write a CSV or NPZ file that `load_motion` reads back to the last bit.

        A CSV file has a header and 37 columns: frame number, root position (m), root quaternion
        (xyzw) and the joints (rad). It has no frame rate: give `load_motion` the `fps` of the
        motion if it is not 30. An NPZ file has the arrays `joint_pos`, `root_pos` and
        `root_quat_wxyz` of this class, `joint_names` and `fps`.

        Args:
            path: ends in .csv or .npz.
            force: replace a file that exists.

        Raises:
            MotionError: the path has another ending.
            RecordingError: the file exists, is the one the motion came from, or cannot be written.
        """
        from g1stream.motion.save import save_motion

        path = Path(path)
        save_motion(self, path, force=force)
        return path

    def _array(self, field: str, shape: tuple[int, int]) -> Floats:
        values = np.array(getattr(self, field), dtype=np.float64, order="C")
        if values.shape != shape:
            raise MotionError(
                f"The motion {self.name} has {field} of shape {values.shape}.",
                f"Give it shape {shape}, a row per frame.",
            )
        valid = np.abs(values) <= NUMBER  # NaN is not
        if not valid.all():
            frame, column = np.argwhere(~valid)[0].tolist()
            raise MotionError(
                f"The motion {self.name} has {values[frame, column]:g} in {field}, frame {frame}.",
                f"Give it finite numbers, at most {NUMBER:g}.",
            )
        return values


def check_fps(fps: float, name: str) -> None:
    """Raise MotionError unless `fps` is a frame rate: between 0.001 and a million."""
    if not _FPS[0] <= fps <= _FPS[1]:
        raise MotionError(
            f"The motion {name} cannot have {fps} frames per second.",
            f"Give a frame rate between {_FPS[0]:g} and {_FPS[1]:g}, such as 30.",
        )


def norm_warnings(norms: Floats, name: str, where: Callable[[int], str]) -> tuple[str, ...]:
    """A warning about quaternion norms (T,) that are not 1.

    Args:
        norms: of the frames.
        name: of the file.
        where: says where a frame is in the file.
    """
    off = np.abs(norms - 1.0)
    worst = int(np.argmax(off))
    if off[worst] <= _NORM_TOLERANCE:
        return ()
    doubt = "; that is no rounding error, check the file" if off[worst] > _NORM_ROUNDING else ""
    return (
        f"{name}: normalised {int((off > _NORM_TOLERANCE).sum())} of {len(norms)} quaternions, "
        f"which were not unit. Furthest off is {where(worst)}, with norm "
        f"{norms[worst]:.4g}{doubt}.",
    )


def _check_joint_names(name: str, joint_names: Sequence[str]) -> None:
    missing = [joint for joint in JOINT_NAMES if joint not in joint_names]
    if missing or len(joint_names) != len(JOINT_NAMES):
        wrong = [joint for joint in joint_names if joint not in JOINT_NAMES]
        raise MotionError(
            f"The joint names of the motion {name} are not those of the 29 joints: "
            f"{len(joint_names)} names, missing {', '.join(missing) or 'none'}, unknown "
            f"{', '.join(wrong) or 'none'}.",
            "Name each of the joints in g1stream.JOINT_NAMES once.",
        )
