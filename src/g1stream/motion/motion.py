"""A motion: one pose of the whole robot per frame, at a constant frame rate."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property
from hashlib import sha256
from math import ceil, floor
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Final

import numpy as np

from g1stream.errors import MotionError
from g1stream.files import check_not_input, check_suffix, complete_file
from g1stream.input_limits import NUMBER
from g1stream.motion.blend import COAST, blend_frames
from g1stream.motion.spline import REACH, Spline
from g1stream.optional import extension, load_object
from g1stream.robot.joints import (
    JOINT_NAMES,
    MIRROR_SIGN,
    MIRRORED_JOINT,
    N_JOINTS,
)
from g1stream.robot.kinematics import BLOCK
from g1stream.robot.model import G1
from g1stream.robot.rotations import (
    quat_from_yaw,
    quat_mul,
    quat_rotate,
    sign_continuous,
    yaw_of,
)
from g1stream.robot.soles import Soles
from g1stream.text import counted

if TYPE_CHECKING:
    import os
    from collections.abc import Iterator, Sequence

    from numpy.typing import ArrayLike, NDArray

    from g1stream.motion.spline import TrajectoryPoint
    from g1stream.types import Floats, Ints, MotionFormat, Velocities

__all__ = [
    "DEFAULT_FPS",
    "MOTION_SUFFIXES",
    "ROOT_COLUMNS",
    "SMALLEST_QUAT",
    "Motion",
    "check_fps",
    "height_of_floor",
    "norm_warning",
]

_WRITERS: Final = {"csv": "g1stream.motion.csv:write_csv", "npz": "g1stream.motion.npz:write_npz"}
MOTION_SUFFIXES: Final = tuple(f".{name}" for name in _WRITERS)
"""Suffixes of the files that `Motion.save` writes."""
ROOT_COLUMNS: Final = ("Frame", "X", "Y", "Z", "QX", "QY", "QZ", "QW")
"""The columns of a CSV file that come before the joints."""
DEFAULT_FPS: Final = 30.0
"""Default frame rate of a CSV file, which has none: the rate of LAFAN1."""

SMALLEST_QUAT: Final = 1e-6
"""A quaternion with a norm up to this counts as zero."""
#: Quaternion norms that differ from 1 by more than the first value give a warning. Beyond the
#: second, the difference is not a rounding error.
_NORM_TOLERANCE: Final = 1e-3
_NORM_ROUNDING: Final = 0.1
#: Lowest and highest frame rate of a motion.
_FPS: Final = (1e-3, 1e6)
#: Longest blend, s.
_LONGEST_BLEND: Final = 60.0
#: Most frames of a repeated motion: ten hours at 30 fps.
_MOST_FRAMES: Final = 1_000_000
#: Below this speed a sole stands, m/s.
_STANDS: Final = 0.25
#: Reflection across the plane between left and right, for points and for rotations (the vector
#: part of a quaternion is a pseudovector).
_MIRROR: Final = np.array([1.0, -1.0, 1.0])
_MIRROR_QUAT: Final = np.array([1.0, -1.0, 1.0, -1.0])
#: Fields that say where a motion comes from.
_ORIGIN: Final = ("name", "source", "sha256", "warnings", "operations")


@dataclass(frozen=True, eq=False, repr=False)
class Motion:
    """Poses of the 29 joints and the pelvis. The arrays are read-only float64 copies.

    Attributes:
        name: name of the motion, from its file name without the suffix.
        fps: frames per second, above 0.
        joint_names: `g1stream.JOINT_NAMES`, one for each column of `joint_pos`.
        joint_pos: (T, 29) joint angles in motor order, rad, T >= 2.
        root_pos: (T, 3) position of the pelvis in the world frame, m.
        root_quat_wxyz: (T, 4) orientation of the pelvis in the world frame, unit, w first. Its sign
            is continuous: q or -q, whichever is closer to the previous frame.
        source: the file it came from, if any.
        sha256: hash of the whole source file, in hex, also if the motion is only a part of it.
        warnings: what was assumed, not used, filled in or corrected when it was read.
        operations: changes to the motion in the file, in this order, such as `mirrored`.
        parts: the motions that were joined, in order; empty if it is not joined.
        part_of: (T,) number of the joined motion of each frame; -1 in a blend. All 0 by default.

    Raises:
        MotionError: the shapes do not match, there is only one frame, a value is not finite or too
            large, a quaternion is zero, or `fps` is not a frame rate.
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
    part_of: Ints = field(default_factory=lambda: np.zeros(0, np.int64))
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
        """Make a motion of the 29 joints from arrays.

        Args:
            joint_pos: (T, 29) joint angles, rad, T >= 2.
            root_pos: (T, 3) position of the pelvis in the world frame, m; the origin if None.
            root_quat_wxyz: (T, 4) orientation of the pelvis in the world frame, w first; no
                rotation if None. Quaternions of any length above 0 are normalised.
            fps: frames per second.
            joint_names: the joint in each column of `joint_pos`, in any order; motor order
                (`g1stream.JOINT_NAMES`) if None.
            name: name of the motion, for messages and recordings.

        Returns:
            The motion, its joints in motor order.

        Raises:
            MotionError: a shape is wrong, a value is not finite, a quaternion is zero, `fps` is
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
                "Give every frame an orientation; no rotation is 1, 0, 0, 0 (wxyz).",
            )
        # Unit quaternions are kept bit for bit, so that a saved motion is read back exactly.
        quat = np.where(np.abs(norms - 1.0) <= 4.0 * np.finfo(float).eps, quat, quat / norms)
        set_field = object.__setattr__
        set_field(self, "fps", float(self.fps))
        part_of = np.array(self.part_of, np.int64) if len(self.part_of) else np.zeros(n_frames, int)
        if part_of.shape != (n_frames,):
            raise MotionError(
                f"The motion {self.name} has {n_frames} frames and part_of of {part_of.shape}.",
                "Give it a number for each frame, or none.",
            )
        for name, values in (
            ("joint_pos", joint_pos),
            ("root_pos", root_pos),
            ("root_quat_wxyz", sign_continuous(quat)),
            ("part_of", part_of),
        ):
            values.setflags(write=False)
            set_field(self, name, values)

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
        """SHA-256 of frame rate, joint angles and root poses, in hex. It identifies the motion.

        Unlike `sha256`, it exists for motions without a file and differs between parts of one file.
        """
        digest = sha256(repr(self.fps).encode())
        for values in (self.joint_pos, self.root_pos, self.root_quat_wxyz):
            digest.update(values.astype("<f8").tobytes())
        return digest.hexdigest()

    def frames(self, start: int, stop: int) -> Motion:
        """The frames from `start` up to, but not including, `stop`.

        Raises:
            MotionError: the range is outside the motion or has fewer than two frames.
        """
        if not 0 <= start <= stop - 2 <= self.n_frames - 2:
            raise MotionError(
                f"Frames {start} to {stop} are not a part of {self.name}, which has "
                f"{counted(self.n_frames, 'frame')}.",
                f"Give a start and a stop within 0 to {self.n_frames}, two frames or more apart.",
            )
        cut = () if stop - start == self.n_frames else (f"cut to frames {start} to {stop}",)
        return replace(self.at_frames(slice(start, stop)), operations=self.operations + cut)

    def at_frames(self, numbers: NDArray[np.intp] | slice) -> Motion:
        """The frames with these indices; a repeated index makes a pause."""
        return replace(
            self,
            joint_pos=self.joint_pos[numbers],
            root_pos=self.root_pos[numbers],
            root_quat_wxyz=self.root_quat_wxyz[numbers],
            part_of=self.part_of[numbers],
        )

    def split(self) -> list[Motion]:
        """The joined motions, without the blends between them, as they are in this motion.

        A motion of blend frames only is one.
        """
        found, ends = [], np.flatnonzero(np.diff(self.part_of)) + 1
        for frames in np.split(np.arange(self.n_frames), ends):
            if (number := int(self.part_of[frames[0]])) >= 0 and len(frames) > 1:
                of = self.parts[number % len(self.parts)] if self.parts else self
                origin = {name: getattr(of, name) for name in _ORIGIN}
                found.append(replace(self.at_frames(frames), parts=(), **origin))
        return found or [self]

    def samples(
        self, rate: float, start: int, stop: int
    ) -> Iterator[tuple[range, TrajectoryPoint]]:
        """Sample the spline through the frames at the times i / rate, in blocks.

        Args:
            rate: samples per second, Hz.
            start: first frame of the part to sample.
            stop: frame after its last frame.

        Yields:
            Sample indices i, in order, and the samples, a row each. A part of a motion has the
            same indices and samples as in the whole.

        Raises:
            MotionError: the part contains no sample time, or the rate is not above 0.
        """
        if not (np.isfinite(rate) and rate > 0):
            raise MotionError(
                f"The motion {self.name} cannot be sampled at {rate} Hz.",
                "Give a rate above 0, such as 100.",
            )
        samples_per_frame = Fraction(repr(float(rate))) / Fraction(repr(self.fps))
        last = stop - 1
        end = floor(last * samples_per_frame) + 1
        if last <= start or ceil(start * samples_per_frame) >= end:
            raise MotionError(
                f"At {rate:g} Hz there is no sample between the frames {start} and {last} of "
                f"{self.name}.",
                "Give a higher rate, or more frames.",
            )
        for first in range(start, last, BLOCK):
            behind = min(first + BLOCK, last)
            upper = end if behind == last else ceil(behind * samples_per_frame)
            numbers = range(ceil(first * samples_per_frame), upper)
            if not numbers:
                continue
            lowest = max(0, first - REACH)
            part = slice(lowest, behind + REACH + 1)
            frames = self.joint_pos[part], self.root_pos[part], self.root_quat_wxyz[part]
            spline = Spline(self.fps, *frames)
            times = np.arange(numbers.start, numbers.stop) / rate - lowest / self.fps
            # Rounding must not move the last sample past the end, where the spline rests.
            yield numbers, spline.sample_many(np.minimum(times, spline.duration))

    def resample(self, fps: float) -> Motion:
        """The motion at another frame rate: the spline of `Trajectory` at the times i / fps.

        It starts at the first frame and ends less than 1 / fps before the last frame, or at it.

        Raises:
            MotionError: `fps` is not positive, or leaves fewer than two frames.
        """
        numbers, points = zip(*self.samples(fps, 0, self.n_frames), strict=True)
        times = np.concatenate(numbers) / fps
        return self._changed(
            f"resampled to {fps:g} fps",
            fps=fps,
            part_of=self.part_of[np.rint(times * self.fps).astype(np.int64)],
            joint_pos=np.concatenate([point.joint_pos for point in points]),
            root_pos=np.concatenate([point.root_pos for point in points]),
            root_quat_wxyz=np.concatenate([point.root_quat_wxyz for point in points]),
        )

    def trim(self, start: float = 0.0, end: float | None = None) -> Motion:
        """The part between two times, s, to the nearest frame. `end` is the last frame if None.

        Raises:
            MotionError: the part is outside the motion or has fewer than two frames.
        """
        last = self.duration if end is None else end
        margin = 0.5 / self.fps
        if not (-margin < start and last < self.duration + margin and last - start > margin):
            raise MotionError(
                f"{self.name} has no part from {start:g} to {last:g} s; its duration is "
                f"{self.duration:.2f} s.",
                f"Give a start and an end from 0 to {self.duration:.2f} s, two frames or more "
                "apart.",
            )
        first, behind = round(start * self.fps), round(last * self.fps) + 1
        part = self.frames(max(first, 0), min(behind, self.n_frames))
        done = f"trimmed to {start:g} to {last:g} s"
        return replace(part, operations=(*self.operations, done))

    def mirrored(self) -> Motion:
        """The mirror image across the world's x-z plane, which swaps left and right.

        Bodies are within 0.1 mm of the exact mirror image, as the URDF is not exactly symmetric.
        """
        return self._changed(
            "mirrored",
            joint_pos=MIRROR_SIGN * self.joint_pos[:, MIRRORED_JOINT],
            root_pos=_MIRROR * self.root_pos,
            root_quat_wxyz=_MIRROR_QUAT * self.root_quat_wxyz,
        )

    def at_speed(self, factor: float) -> Motion:
        """The same frames at `factor` times the frame rate.

        Raises:
            MotionError: the factor is not positive.
        """
        if not (np.isfinite(factor) and factor > 0):
            raise MotionError(
                f"{self.name} cannot be played at {factor:g} times its speed.",
                "Give a factor above 0, such as 0.5.",
            )
        return self._changed(f"at {factor:g} times its speed", fps=self.fps * factor)

    def fixed_root(self) -> Motion:
        """The motion with the pelvis's pose fixed to that of the first frame."""
        return self._changed(
            "pelvis fixed as in the first frame",
            root_pos=np.broadcast_to(self.root_pos[0], self.root_pos.shape),
            root_quat_wxyz=np.broadcast_to(self.root_quat_wxyz[0], self.root_quat_wxyz.shape),
        )

    def on_floor(self, robot: G1 | None = None) -> Motion:
        """Raise or lower the whole motion until the standing feet are on the floor.

        The floor is at height 0. The height of the feet is the median height of the lower sole,
        over the frames in which its lowest corner is slower than 0.25 m/s.

        Args:
            robot: robot with the soles; the default G1 if None.

        Raises:
            MotionError: no foot stands in the motion.
            RobotError: the robot's soles are not known.
        """
        height = height_of_floor(self, robot or G1.default())
        if height is None:
            raise MotionError(
                f"{self.name} cannot be put on the floor: no foot stands in it.",
                "Use it without this change.",
            )
        way = "raised" if height < 0 else "lowered"
        return self._changed(
            f"{way} by {abs(height) * 1e3:.1f} mm, onto the floor",
            root_pos=self.root_pos - [0.0, 0.0, height],
        )

    def then(self, other: Motion, blend: float = 0.5) -> Motion:
        """Join this motion, a blend and another motion.

        All frames of both are kept, at the higher of the two frame rates. The other motion is
        turned and moved to continue with the heading and the place at the end of this one. Its
        height and tilt do not change. In the blend each joint coasts from its last velocity, moves
        on a minimum-jerk path and accelerates to its first velocity, so that a `Trajectory` through
        it is smooth (C2). If the blend is too short for the distance, the joints are too fast:
        `g1stream motion` reports this and `stream` refuses it.

        Args:
            other: the next motion.
            blend: time from the last frame of this motion to the first frame of the other, s; one
                frame if 0.

        Raises:
            MotionError: the blend is negative or longer than 60 s.
        """
        if not 0.0 <= blend <= _LONGEST_BLEND:
            raise MotionError(
                f"A blend of {blend:g} s is not possible.", f"Give 0 to {_LONGEST_BLEND:g} s."
            )
        about = f"then {other.name}"
        about += f" ({', '.join(other.operations)})" if other.operations else ""
        fps = max(self.fps, other.fps)
        first, second = (one if one.fps == fps else one.resample(fps) for one in (self, other))
        n_steps = max(1, round(blend * fps))
        second = _continued(first, second, n_steps / fps)
        linear, quat = [first._linear], [first.root_quat_wxyz]
        if n_steps > 1:
            coasting = np.full(N_JOINTS + 3, COAST)
            coasting[N_JOINTS : N_JOINTS + 2] = n_steps / fps  # travel over the ground continues
            path, turned = blend_frames(
                (first._linear[-2:], second._linear[:2]),
                (first.root_quat_wxyz[-2:], second.root_quat_wxyz[:2]),
                fps,
                n_steps,
                coasting,
            )
            linear.append(path)
            quat.append(turned)
        rows = np.concatenate([*linear, second._linear])
        return self._changed(
            f"{about} after a blend of {blend:g} s",
            name=f"{self.name}+{other.name}",
            fps=fps,
            joint_pos=rows[:, :N_JOINTS],
            root_pos=rows[:, N_JOINTS:],
            root_quat_wxyz=np.concatenate([*quat, second.root_quat_wxyz]),
            source=None,
            sha256=None,
            warnings=tuple(dict.fromkeys(self.warnings + other.warnings)),
            parts=(*(self.parts or (self,)), *(other.parts or (other,))),
            part_of=np.concatenate(
                [
                    first.part_of,
                    np.full(n_steps - 1, -1),
                    np.where(second.part_of < 0, -1, second.part_of + first.part_of.max() + 1),
                ]
            ),
        )

    def looped(self, n: int, blend: float = 0.5) -> Motion:
        """The motion `n` times, joined as by `then`.

        Raises:
            MotionError: `n` is less than 1 or the result is too long, or the blend is not possible.
        """
        if n < 1 or n * (self.n_frames + blend * self.fps) > _MOST_FRAMES:
            raise MotionError(
                f"{self.name} cannot be repeated {n} times.",
                f"Give a number of repetitions from 1 that makes {_MOST_FRAMES} frames at most.",
            )
        if n == 1:
            return self
        # By doubling, because each `then` copies the whole motion.
        repeated, power, left = self, self, n - 1
        while left:
            if left % 2:
                repeated = repeated.then(power, blend)
            left //= 2
            power = power.then(power, blend) if left else power
        return self._changed(
            f"{n} times with blends of {blend:g} s",
            joint_pos=repeated.joint_pos,
            root_pos=repeated.root_pos,
            root_quat_wxyz=repeated.root_quat_wxyz,
            part_of=repeated.part_of,
        )

    def save(
        self,
        path: str | os.PathLike[str],
        *,
        format: MotionFormat | None = None,  # noqa: A002
        velocities: Velocities = "spline",
        robot: G1 | None = None,
        force: bool = False,
    ) -> Path:
        """Write a motion file of g1stream or of another program. `load_motion` reads it back.

        A CSV file has a header and 37 columns: frame number, root position (m), root quaternion
        (xyzw) and the joints (rad). It has no frame rate: give `load_motion` the `fps` of the
        motion if it is not 30. An NPZ file has the arrays `joint_pos`, `root_pos` and
        `root_quat_wxyz` of this class, `joint_names` and `fps`. Both preserve every bit.

        The formats of other programs have their own orders and their own frame rate, at which the
        spline of `Trajectory` is sampled. docs/formats.md lists them.

        Args:
            path: ends in .csv or .npz; in .pkl for `gmr`, and for `sonic` it is a directory.
            format: format of another program; by the suffix of the path if None.
            velocities: how velocities are computed in training formats.
            robot: robot with the bodies in training formats; the default G1 if None.
            force: replace an existing file.

        Raises:
            ConfigError: the path does not have the suffix of the format.
            MotionError: the path has an unknown suffix, or the format cannot hold the motion.
            RobotError: the format cannot hold the robot.
            RecordingError: the file exists, is the motion's source, or cannot be written.
        """
        path = Path(path)
        name = format or path.suffix.lower()[1:]
        if name in _WRITERS:
            if velocities != "spline":
                raise MotionError(f"The format {name} has no velocities.", "Remove --velocities.")
            check_not_input(path, self.source, *(part.source for part in self.parts))
            check_suffix(path, f"a file of the format {name}", f".{name}")
            with complete_file(path, force=force) as temporary:
                load_object(_WRITERS[name])(self, temporary)
        elif format:
            write_motion = extension("write_motion")
            write_motion(self, path, format, robot=robot, velocities=velocities, force=force)
        else:
            raise MotionError(
                f"A motion cannot be saved as {path.name}.",
                f"Give a file name that ends in {', '.join(MOTION_SUFFIXES)}, or give a format.",
            )
        return path

    def _changed(self, what: str, **fields: Any) -> Motion:
        """The motion with other fields; `what` describes the change."""
        return replace(self, operations=(*self.operations, what), **fields)

    @property
    def _linear(self) -> Floats:
        """(T, 32) joint angles, rad, and root position, m."""
        return np.concatenate([self.joint_pos, self.root_pos], axis=1)

    def _array(self, field: str, shape: tuple[int, int]) -> Floats:
        values = np.array(getattr(self, field), dtype=np.float64, order="C")
        if values.shape != shape:
            raise MotionError(
                f"The motion {self.name} has {field} of shape {values.shape}.",
                f"Give it shape {shape}, a row per frame.",
            )
        if not (values.min() >= -NUMBER and values.max() <= NUMBER):  # False for NaN
            frame, column = np.argwhere(~(np.abs(values) <= NUMBER))[0].tolist()
            raise MotionError(
                f"The motion {self.name} has {values[frame, column]:g} in {field}, frame {frame}.",
                f"Give it finite numbers, at most {NUMBER:g}.",
            )
        return values


def height_of_floor(motion: Motion, robot: G1) -> float | None:
    """Height of the floor on which the feet of a motion stand, m; None if none stands.

    See `Motion.on_floor`. A retargeted foot slides slightly while it stands.

    Raises:
        RobotError: the robot's soles are not known.
    """
    corners = Soles(robot).path(motion.joint_pos, motion.root_pos, motion.root_quat_wxyz)
    speed = np.linalg.norm(np.gradient(corners, axis=0), axis=-1) * motion.fps
    lowest = corners[..., 2].argmin(axis=1)[:, np.newaxis]
    slow = np.take_along_axis(speed, lowest, axis=1) < _STANDS
    heights = np.take_along_axis(corners[..., 2], lowest, axis=1)[slow]
    return float(np.median(heights)) if heights.size else None


def check_fps(fps: float, name: str) -> None:
    """Raise MotionError unless `fps` is a frame rate: between 0.001 and a million."""
    if not _FPS[0] <= fps <= _FPS[1]:
        raise MotionError(
            f"The motion {name} cannot have {fps} frames per second.",
            f"Give a frame rate between {_FPS[0]:g} and {_FPS[1]:g}, such as 30.",
        )


def norm_warning(norms: Floats, where: str) -> list[str]:
    """A list with a warning about quaternion norms (T,) that are not 1, or empty."""
    off = np.abs(norms - 1.0)
    if off.max() <= _NORM_TOLERANCE:
        return []
    doubt = "; this is not a rounding error, check the file" if off.max() > _NORM_ROUNDING else ""
    return [
        f"normalised {int((off > _NORM_TOLERANCE).sum())} of {len(norms)} quaternions. "
        f"The worst is {where}, with norm {norms[int(off.argmax())]:.4g}{doubt}."
    ]


def _check_joint_names(name: str, joint_names: Sequence[str]) -> None:
    missing = [joint for joint in JOINT_NAMES if joint not in joint_names]
    if missing or len(joint_names) != len(JOINT_NAMES):
        wrong = [joint for joint in joint_names if joint not in JOINT_NAMES]
        raise MotionError(
            f"The joint names of the motion {name} are not those of the 29 joints: "
            f"{len(joint_names)} names, missing {', '.join(missing) or 'none'}, unknown "
            f"{', '.join(wrong) or 'none'}.",
            "Give each of the joints in g1stream.JOINT_NAMES once.",
        )


def _continued(first: Motion, second: Motion, seconds: float) -> Motion:
    """The second motion, moved and turned on the ground so that it continues the first one.

    Its heading is the one at the end of the first motion. Its place is where the pelvis gets in the
    time between them, at the mean of the velocities on either side. If it rests on both sides, that
    is where the first one ends.
    """
    turn = yaw_of(first.root_quat_wxyz[-1]) - yaw_of(second.root_quat_wxyz[0])
    turned = quat_from_yaw(turn)
    path = quat_rotate(turned, second.root_pos - second.root_pos[0])
    last, before = first.root_pos[-1], first.root_pos[-2]
    travel = (last - before + path[1] - path[0]) / 2.0 * first.fps * seconds
    path[:, :2] += last[:2] + travel[:2]
    path[:, 2] = second.root_pos[:, 2]
    return replace(second, root_pos=path, root_quat_wxyz=quat_mul(turned, second.root_quat_wxyz))
