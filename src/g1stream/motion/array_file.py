"""Motion files of named arrays: NPZ, pickles of arrays, and what PyTorch saves.

What the arrays are is told by their names and shapes, by the frame rate in the file, and where that
leaves a choice by evidence: see `joint_order`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from g1stream.errors import MotionError
from g1stream.input_limits import UNPACKED
from g1stream.motion.array_names import (
    ANGLES,
    BODY_POSITIONS,
    BODY_QUATS,
    FPS,
    HUMAN,
    NAMES,
    POSITIONS,
    QUATS,
    READ,
    ROOT,
    WRITERS,
)
from g1stream.motion.arrays import is_npy, is_zip, read_npy, read_npz
from g1stream.motion.csv import DEFAULT_FPS
from g1stream.motion.joint_order import Bodies, in_motor_order, names_in_order, tell_order
from g1stream.motion.motion import SMALLEST_QUAT, Motion, norm_warnings
from g1stream.motion.pickles import is_pickle, read_pickle
from g1stream.motion.torch_file import is_torch, read_torch
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS
from g1stream.robot.rotations import quat_normalize, quat_rotate, wxyz_from_xyzw

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from g1stream.types import Floats, JointOrder

__all__ = ["ArrayFile", "is_array_file"]

#: Numbers in an array that is converted to 64 bits.
_NUMBERS: Final = UNPACKED // 8
#: Motions of a file that an error names.
_NAMED: Final = 20
#: A pelvis that leans by more than the first on average, by less than the second if w is at the
#: other end, is taken to have it there, rad.
_LYING: Final = 1.05
_UPRIGHT: Final = 0.8
#: What each kind of file is called, how it is recognised, and what reads it.
_KINDS: Final[tuple[tuple[str, Callable[[bytes], bool], Callable[[bytes], Any]], ...]] = (
    ("NPY", is_npy, lambda data: {"qpos": read_npy(data)}),
    ("file of PyTorch", is_torch, read_torch),
    ("NPZ", is_zip, lambda data: read_npz(data, objects=True)),
    ("pickle", is_pickle, read_pickle),
)


def is_array_file(data: bytes) -> bool:
    """Whether content begins as that of a file which `ArrayFile` reads does."""
    return any(is_one(data) for _, is_one, _ in _KINDS)


class _Root(NamedTuple):
    """The pelvis's pose, (T, 3) m and (T, 4), and where it is from."""

    pos: Floats
    quat_wxyz: Floats
    source: str


class ArrayFile:
    """A motion file of named arrays: what they are, and on request the motion.

    Args:
        path: where it is, for messages.
        content: its bytes: an NPZ, an NPY, a file of PyTorch, or a pickle, plain or of joblib.
        joint_order: of the joints, if the file does not name them; told by evidence if None.
        member: the name of the motion, in a file of several.

    Raises:
        MotionError: it cannot be read, or has no such motion. Anything else wrong in it is an error
            only when what it is about is asked for.

    Attributes:
        path: as given.
        sha256: of the content, in hex.
        has_header: whether the file names the joints.
    """

    def __init__(
        self,
        path: Path,
        content: bytes,
        joint_order: JointOrder | None = None,
        member: str | None = None,
    ) -> None:
        self.path = path
        self._name = member or path.stem
        self.sha256 = hashlib.sha256(content).hexdigest()
        self._asked = joint_order
        self._kind, read = next((kind, read) for kind, is_one, read in _KINDS if is_one(content))
        try:
            arrays = read(content)
        except ValueError as error:
            raise self._error(str(error), READ) from error
        self._arrays = self._of_one_motion(arrays, member)
        self.has_header = bool(self._names)

    def motion(self, fps: float | None = None) -> Motion:
        """The motion in the file, its joints in motor order.

        Args:
            fps: frames per second; what the file says, or 30, if None.

        Raises:
            MotionError: an array is missing or has a wrong shape, or the order of the joints cannot
                be told.
        """
        if self.missing:
            raise self._error(
                f"it lacks the joints {', '.join(self.missing)}", "Give a motion of all 29 joints."
            )
        root = self._root
        motion = Motion.from_arrays(
            in_motor_order(self._angles, self.columns),
            root and root.pos,
            root and root.quat_wxyz,
            fps=fps or self._fps or DEFAULT_FPS,
            name=self._name,
        )
        warnings = []
        if self.unknown:
            warnings.append(f"Joints that no G1 has are left out: {', '.join(self.unknown)}.")
        if self._guessed:
            warnings.append(f"The order of the joints was told by their limits. {self._order[1]}.")
        if root:
            norms = np.linalg.norm(root.quat_wxyz, axis=1)
            warnings += norm_warnings(norms, self.path.name, lambda frame: f"frame {frame}")
        return replace(
            motion,
            source=self.path,
            sha256=self.sha256,
            warnings=tuple(warnings),
        )

    @cached_property
    def evidence(self) -> tuple[str, ...]:
        """What the arrays were taken for, and why, in short texts.

        Raises:
            MotionError: as `motion`.
        """
        writer = next((who for who, names in WRITERS if names <= self._arrays.keys()), "")
        pelvis = self._root.source if self._root else "not in the file: upright at the origin"
        return (
            f"{self._kind}, arrays as {writer} write them" if writer else f"{self._kind} of arrays",
            self._order[1],
            pelvis,
            f"{self._fps:g} fps, as the file says" if self._fps else "no frame rate in the file",
        )

    @property
    def _guessed(self) -> bool:
        """Whether only the joint limits speak for the order of the joints."""
        return not (self._names or self._asked or self._body_pos)

    @property
    def n_rows(self) -> int:
        return len(self._angles)

    @property
    def n_columns(self) -> int:
        return int(self._angles.shape[1])

    @property
    def columns(self) -> tuple[str, ...]:
        """The joint in each column."""
        return self._order[0]

    @property
    def missing(self) -> list[str]:
        """Joints of the robot that the file does not have."""
        return [name for name in JOINT_NAMES if name not in self.columns]

    @property
    def unknown(self) -> list[str]:
        """Joints of the file that the robot does not have."""
        return [name for name in self.columns if name not in JOINT_NAMES]

    @property
    def quats(self) -> Floats | None:
        """Orientations of the pelvis (T, 4), not normalised; None without them."""
        return self._root.quat_wxyz if self._root else None

    @cached_property
    def _table(self) -> tuple[str, Floats]:
        """Name and content of the array with the angles, (T, 29) or with the pelvis before them."""
        for name in ANGLES:
            if name in self._arrays:
                return name, self._numbers(name, 2)
        found = ", ".join(sorted(self._arrays)) or "nothing"
        human = " It is the motion of a human body model." * bool(HUMAN & self._arrays.keys())
        raise self._error(f"no array has joint angles; it has {found}.{human}".rstrip("."), READ)

    @cached_property
    def _names(self) -> tuple[str, ...]:
        """The joints that the file names, as g1stream names them."""
        for key in NAMES:
            if key in self._arrays:
                names = [str(name) for name in self._array(key).ravel().tolist()]
                return tuple(f"{name.removesuffix('_joint')}_joint" for name in names)
        return ()

    @cached_property
    def _angles(self) -> Floats:
        """(T, n) rad."""
        name, table = self._table
        n_joints = len(self._names) or N_JOINTS
        if table.shape[1] not in (n_joints, ROOT + n_joints):
            raise self._error(
                f"{name} has {table.shape[1]} columns for {n_joints} joints",
                f"Give it a column for each joint, or {ROOT} more before them: the pelvis's "
                "position and quaternion (wxyz).",
            )
        return table[:, -n_joints:]

    @cached_property
    def _order(self) -> tuple[tuple[str, ...], str]:
        """The joint in each column, and how that is known."""
        if self._names:
            return self._names, "named by the file"
        if self._asked:
            return names_in_order(self._asked), f"{self._asked}, as asked for"
        known, root = None, self._root
        if root and self._body_pos:
            pos = self._bodies(self._body_pos, 3)
            known = Bodies(pos, root.pos, quat_normalize(root.quat_wxyz))
        order, why = tell_order(self._angles, known, self.path.name)
        return names_in_order(order), why

    @cached_property
    def _root(self) -> _Root | None:
        """The pelvis's pose, from arrays of its own, before the angles, or from the first body."""
        angles, table = self._table
        position = next((name for name in POSITIONS if name in self._arrays), None)
        rotation = next((name for name in QUATS if name in self._arrays), None)
        if position and rotation:
            quat, order = self._wxyz(self._numbers(rotation, 2), w_first=QUATS[rotation])
            return self._pose(self._numbers(position, 2), quat, f"{position}, {rotation} {order}")
        if table.shape[1] > self._angles.shape[1]:
            return self._pose(table[:, :3], table[:, 3:ROOT], f"in {angles}, quaternion wxyz")
        rotations = next((name for name in BODY_QUATS if name in self._arrays), None)
        if self._body_pos and rotations:
            body, bodies = (
                self._pelvis,
                (self._bodies(self._body_pos, 3), self._bodies(rotations, 4)),
            )
            pos, quat = (values[:, body].astype(np.float64) for values in bodies)
            quat, order = self._wxyz(quat, w_first=BODY_QUATS[rotations])
            return self._pose(pos, quat, f"body {body}, quaternion {order}")
        return None

    @property
    def _body_pos(self) -> str:
        """Name of the array with the bodies' positions; empty without one."""
        return next((name for name in BODY_POSITIONS if name in self._arrays), "")

    def _bodies(self, name: str, width: int) -> NDArray[Any]:
        """(T, B, width) as in the file, in which they are most of the numbers."""
        values = self._checked(name, 3)
        n_frames, n_bodies, n_numbers = values.shape
        if n_frames != self.n_rows or n_numbers != width or n_bodies <= self._pelvis:
            raise self._error(
                f"{name} has the shape {values.shape}",
                f"Give it the shape ({self.n_rows}, bodies, {width}).",
            )
        return values

    @property
    def _pelvis(self) -> int:
        """Which of the bodies is the pelvis: the first one if the file does not name them."""
        names = self._array("body_names").ravel().tolist()
        return names.index("pelvis") if "pelvis" in names else 0

    def _pose(self, pos: Floats, quat: Floats, source: str) -> _Root:
        for what, values, width in (("position", pos, 3), ("quaternion", quat, 4)):
            if values.shape != (self.n_rows, width):
                raise self._error(
                    f"the pelvis's {what} ({source}) has the shape {values.shape}",
                    f"Give it the shape ({self.n_rows}, {width}), a row per frame.",
                )
        return _Root(pos, quat, source)

    def _wxyz(self, quat: Floats, *, w_first: bool) -> tuple[Floats, str]:
        """Quaternions with w first, and the order in which they stood.

        That is the usual one, unless the pelvis then lies and in the other order stands.
        """
        if quat.shape[1] != len("wxyz"):
            return quat, ""
        orders = {"wxyz": quat, "xyzw": wxyz_from_xyzw(quat)}
        usual, other = orders if w_first else reversed(orders)
        if _lean(orders[usual]) > _LYING and _lean(orders[other]) < _UPRIGHT:
            return orders[other], f"{other}, as the pelvis would lie otherwise"
        return orders[usual], usual

    @cached_property
    def _fps(self) -> float | None:
        """Frames per second as the file says; None if it does not."""
        for name in FPS:
            if name in self._arrays:
                values = self._array(name).ravel()
                if values.size == 1 and values.dtype.kind in "iuf" and values[0] > 0:
                    return float(values[0])
                raise self._error(f"{name} is no frame rate", "Give it one number, such as 50.")
        return None

    def _numbers(self, name: str, dimensions: int) -> Floats:
        return self._checked(name, dimensions).astype(np.float64)

    def _checked(self, name: str, dimensions: int) -> NDArray[Any]:
        values = self._array(name)
        if values.dtype.kind not in "iuf" or values.ndim != dimensions or not values.size:
            raise self._error(
                f"{name} is no array of numbers with {dimensions} dimensions",
                "Give it a row for each frame.",
            )
        if values.size > _NUMBERS:
            raise self._error(
                f"{name} has more than {_NUMBERS:,} numbers", "Give a part of the motion."
            )
        return values

    def _array(self, name: str) -> NDArray[Any]:
        try:
            return np.asarray(self._arrays.get(name, []))
        except ValueError:
            raise self._error(
                f"the rows of {name} differ in length", "Give it a row for each frame."
            ) from None

    def _of_one_motion(self, content: Any, member: str | None) -> dict[str, Any]:
        """The arrays; those of the chosen, or only, motion where there is a dict of motions."""
        if not isinstance(content, dict) or not content:
            raise self._error("it has no arrays by name", READ)
        if not all(isinstance(one, dict) for one in content.values()):
            if member is None:
                return content
            raise self._error(f"it is one motion, and has none named {member}", "Leave that out.")
        if member is None and len(content) == 1:
            (member,) = content
        if member not in content:
            count = f"{len(content)} motions" if len(content) > 1 else "one motion"
            has = f"it has {count}" + (f", and none named {member}" if member else "")
            names = list(content)
            more = f" and {len(names) - _NAMED} more" * (len(names) > _NAMED)
            raise self._error(
                f"{has}: {', '.join(names[:_NAMED])}{more}",
                f"Give one by its name: {self.path}:{names[0]}",
            )
        arrays: dict[str, Any] = content[member]
        return arrays

    def _error(self, cause: str, remedy: str) -> MotionError:
        return MotionError(f"{self.path.name}: {cause}.", remedy)


def _lean(quat_wxyz: Floats) -> float:
    """Mean angle of the pelvis's axis from the vertical, rad."""
    quat = quat_wxyz[np.linalg.norm(quat_wxyz, axis=1) > SMALLEST_QUAT]
    up = quat_rotate(quat_normalize(quat), np.array([0.0, 0.0, 1.0]))[:, 2]
    return float(np.arccos(np.clip(up, -1.0, 1.0)).mean()) if len(up) else 0.0
