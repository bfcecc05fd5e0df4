"""The motion in named arrays: those of an NPZ, a pickle or a PyTorch file, the columns of a table.

The names and shapes of arrays tell what they contain. Where a file is not explicit, evidence
decides; if it is ambiguous, an error asks for a flag. All formats have the same checks.
"""

from __future__ import annotations

from collections import Counter
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from g1stream.errors import MotionError
from g1stream.extras.formats.orders import (
    MAY_LACK,
    WRISTS,
    Order,
    in_motor_order,
    layouts,
    names_in_order,
    order_by_bodies,
    order_by_limits,
    set_of,
    some_frames,
)
from g1stream.extras.formats.pickles import Unread
from g1stream.input_limits import NUMBER, UNPACKED
from g1stream.motion.motion import SMALLEST_QUAT
from g1stream.motion.readers import Evidence, Poses
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS
from g1stream.robot.rotations import quat_normalize, quat_rotate, wxyz_from_xyzw
from g1stream.text import listed

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from g1stream.motion.readers import MotionFile
    from g1stream.types import Floats

__all__ = ["READ", "poses_of"]

# Names of arrays in the files of other programs, in lower case and without the suffix `_w`, which
# means the world frame.
#: Joint angles, maybe with poses; True if w is conventionally first in the quaternions of these.
_ANGLES: Final = {
    **dict.fromkeys(("joint_pos", "dof_pos", "dof_positions", "dof", "qpos"), True),
    **dict.fromkeys(("joint_angles", "q"), True),
    "table": False,
}
_NAMES: Final = ("joint_names", "dof_names")
_FPS: Final = (
    *("fps", "framerate", "frame_rate", "mocap_framerate", "mocap_frame_rate"),
    *("sample_rate", "sampling_rate", "frequency", "freq", "hz"),
)
_POSITIONS: Final = (
    *("root_pos", "root_trans", "root_trans_offset", "base_pos", "root_translation"),
    *("root_position", "base_position"),
)
#: Orientations of the pelvis and of all bodies; True if w is conventionally first.
_QUATS: Final = {
    "root_quat_wxyz": True,
    "root_quat_xyzw": False,
    "root_rot": False,
    "root_quat": True,
    "root_rotation": False,
    "base_quat": True,
}
_BODY_POSITIONS: Final = ("body_pos", "body_positions", "rigid_body_pos")
_BODY_QUATS: Final = {"body_quat": True, "body_rotations": True, "rigid_body_rot": False}
#: Parts of array names in known layouts that the motion does not need: no warning.
_NOT_MISSED: Final = ("_vel", "contact", "pose_aa", "smpl", "body_pos", "body_quat")
#: Arrays in motions of human body models.
_HUMAN: Final = {"poses", "pose_aa", "betas"}
#: Numbers of a pose, before the angles, or of an object, behind them.
_POSE: Final = 7
READ: Final = "docs/formats.md lists the supported names and shapes of arrays."
"""Remedy for a file without the arrays of a motion."""
#: Most numbers in an array that is converted to 64 bits.
_NUMBERS: Final = UNPACKED // 8
#: If the pelvis leans by more than the first angle on average, and by less than the second with w
#: at the other end of the quaternion, w is taken from the other end, rad. This does not apply at
#: heights of a robot that lies on the floor, m.
_LYING: Final = 1.05
_UPRIGHT: Final = 0.8
_ON_FLOOR: Final = (0.03, 0.4)
#: Norms within this of 1 count as unit quaternions.
_UNIT: Final = 0.02


class _Root(NamedTuple):
    """The pelvis's pose, (T, 3) m and (T, 4), and the names of its arrays.

    Attributes:
        assumed: there is no evidence for the order of its quaternion.
    """

    pos: Floats
    quat_wxyz: Floats
    source: str
    assumed: bool = False


class _Columns(NamedTuple):
    """The array with the angles: its name, (T, n) rad, (T, 7) or None, and its other columns.

    Attributes:
        quat_first: the quaternion is before the position in a pose.
        rest: number of columns behind the angles.
    """

    name: str
    angles: Floats
    pose: Floats | None = None
    quat_first: bool = False
    rest: int = 0


def poses_of(file: MotionFile, kind: str, arrays: dict[str, Any], first_line: int = 0) -> Poses:
    """Find the motion in named arrays.

    Args:
        file: the source of the arrays.
        kind: kind of file, for messages.
        arrays: the arrays by name.
        first_line: line of frame 0 in a table.

    Raises:
        MotionError: the file has no such motion, an array has a wrong shape, or the joint order is
            ambiguous.
    """
    return _Arrays(file, kind, arrays, first_line).poses()


class _Arrays:
    """The arrays of a file, and what they are; arguments as of `poses_of`."""

    def __init__(
        self, file: MotionFile, kind: str, arrays: dict[str, Any], first_line: int
    ) -> None:
        self._file, self._kind, self._first_line = file, kind, first_line
        self._arrays = arrays
        self._by_name = {_plain(name): name for name in reversed(self._arrays)}
        self._read: dict[str, None] = {}  # names of the arrays that were used, in order

    def poses(self) -> Poses:
        """The poses in the file, its joints in motor order, and the evidence."""
        order, root = self._order, self._root
        used: dict[str, str] = {}
        assumed: dict[str, str] = {}
        (assumed if order.assumed else used)["joint order"] = order.why
        if root:
            (assumed if root.assumed else used)["pelvis"] = root.source
        else:
            assumed["pelvis"] = "upright at the origin"
        fps, kind = self._fps if self._file.fps is None else None, self._kind
        if not self._first_line:
            kind += f" with {listed([name for name in self._read if name in self._arrays])}"
        if lacking := [name for name in self._absent if name not in MAY_LACK]:
            unused = f"; these are not used: {listed(self._not_used)}" * bool(self._not_used)
            raise self._error(
                f"it lacks the joints {', '.join(lacking)}{unused}",
                "Give a motion of all joints; only wrists, waist roll and pitch may be missing.",
            )
        return Poses(
            self._file,
            Evidence({"file": kind, **used}, assumed, self._not_used, self._absent),
            in_motor_order(self._columns.angles, order.columns),
            root and root.pos,
            root and root.quat_wxyz,
            fps,
            tuple(self._warnings()),
            self._first_line,
        )

    def _warnings(self) -> Iterable[str]:
        """What was not used or filled in, a sentence each."""
        robot, absent = self._file.robot, self._absent
        missing = [JOINT_NAMES.index(name) for name in absent]
        if absent and (robot is None or robot.present[missing].all()):
            yield f"the file lacks the joints {', '.join(absent)}, which stay at 0."
        if missed := [name for name in self._not_used if self._is_missed(name)]:
            yield f"not used: {listed(missed)}."
        if self._order.other:
            how = "is assumed" if self._order.assumed else "was detected only by joint limits"
            yield (
                f"the joint order {how}; {self._order.why}. Give --joint-order {self._order.other} "
                "if that is the order."
            )

    @cached_property
    def _absent(self) -> tuple[str, ...]:
        return tuple(name for name in JOINT_NAMES if name not in self._order.columns)

    @cached_property
    def _not_used(self) -> tuple[str, ...]:
        """Unused joints, columns and arrays, after all arrays were read."""
        columns, _ = self._columns, (self._root, self._fps)
        last = f"the last {columns.rest} columns of {columns.name}"
        return (
            *(name for name in self._order.columns if name not in JOINT_NAMES),
            *([last] * bool(columns.rest)),
            *(name for name in self._arrays if name not in self._read),
        )

    def _is_missed(self, name: str) -> bool:
        """Whether an unused array may describe the motion: a row per frame, or one number."""
        if name not in self._arrays:  # it is the name of a joint or of columns
            return True
        try:
            values = np.asarray(self._arrays[name])
        except ValueError:  # its rows differ in length
            return False
        says = values.size == 1 or values.shape[:1] == (len(self._columns.angles),)
        known = any(word in _plain(name) for word in _NOT_MISSED)
        return says and values.dtype.kind in "biuf" and not known

    @cached_property
    def _names(self) -> tuple[str, ...]:
        """The joint names in the file, as g1stream names them."""
        key = self._first(_NAMES)
        names = tuple(f"{one.removesuffix('_joint')}_joint" for one in self._texts(key))
        if twice := [name for name, n in Counter(names).items() if n > 1]:
            raise self._error(f"{key} has {listed(twice)} twice", "Give each joint once.")
        return names

    @cached_property
    def _columns(self) -> _Columns:
        """Find joint angles, poses and other columns in the array with the angles.

        If there are 7 more columns, a pose is before the angles. Poses of objects are behind the
        angles if all of them have unit quaternions.
        """
        name = self._first(_ANGLES)
        if not name:
            human = " It is a motion of a human body model." * bool(_HUMAN & self._arrays.keys())
            raise self._error(
                f"no array has joint angles; it has {listed(sorted(self._arrays))}.{human}", READ
            )
        table = self._numbers(name, 2)
        width = table.shape[1]
        counts = [len(self._names)] if self._names else [N_JOINTS, N_JOINTS - len(WRISTS)]
        for n_joints in counts:
            if width == n_joints:
                return _Columns(name, table)
            behind = _POSE + n_joints
            poses = [table[:, i : i + _POSE] for i in (0, *range(behind, width, _POSE))]
            if width < behind or poses[-1].shape[1] != _POSE:
                continue
            unit = [_unit_columns(pose) for pose in poses]
            if width == behind or all(unit):
                angles = table[:, _POSE:behind]
                return _Columns(name, angles, poses[0], unit[0] == [0], width - behind)
        joints = " or ".join(map(str, counts))
        raise self._error(
            f"{name} has {width} columns for {joints} joints",
            f"Give it a column for each joint, or {_POSE} more before them: the pelvis's position "
            f"and quaternion ({'wxyz' if _ANGLES[_plain(name)] else 'xyzw'}).",
            1 if self._first_line else 0,
        )

    @cached_property
    def _order(self) -> Order:
        """The joint order by the names in the file, by the flag, by bodies, or by joint limits."""
        if self._names:
            return Order(self._names, "named by the file")
        angles, asked = self._columns.angles, self._file.joint_order
        names = layouts(angles.shape[1])
        if asked and asked not in names:
            raise self._error(
                f"--joint-order {asked} is for {len(names_in_order(asked))} joints, and "
                f"{self._columns.name} has {angles.shape[1]}",
                f"Give one of {', '.join(names)}.",
            )
        if asked:
            return Order(names[asked], f"{asked}{set_of(names[asked])}, as requested")
        root, bodies = self._root, self._first(_BODY_POSITIONS)
        if root and bodies:
            found = self._bodies(bodies, 3)
            if order := order_by_bodies(angles, found, root.pos, root.quat_wxyz):
                return order
        # A table without a header is taken to be in motor order, as LAFAN1 is.
        limited = order_by_limits(angles, self._file.robot, motor_assumed=bool(self._first_line))
        if isinstance(limited, Order):
            return limited
        raise self._error(
            f"the joint order is ambiguous: {limited}",
            f"Give --joint-order {' or '.join(names)}; motor order is that of LowCmd, the URDF and "
            "MuJoCo.",
        )

    @cached_property
    def _root(self) -> _Root | None:
        """The pelvis's pose: its own arrays, columns before the angles, or the first body."""
        columns = self._columns
        position, rotation = self._first(_POSITIONS), self._first(_QUATS)
        if position and rotation:
            pos, quat = self._numbers(position, 2), self._numbers(rotation, 2)
            return self._pose(pos, quat, f"{position}, {rotation}", rotation, _QUATS)
        if columns.pose is not None:
            cut = 4 if columns.quat_first else 3
            parts = columns.pose[:, :cut], columns.pose[:, cut:]
            quat, pos = parts if columns.quat_first else reversed(parts)
            where = "the columns before the joints"
            if columns.quat_first:
                where += ", quaternion first because those columns have norm 1"
            return self._pose(pos, quat, where, columns.name, _ANGLES)
        position, rotation = self._first(_BODY_POSITIONS), self._first(_BODY_QUATS)
        if position and rotation:
            names = self._texts("body_names")
            body = names.index("pelvis") if "pelvis" in names else 0
            pos, quat = self._bodies(position, 3), self._bodies(rotation, 4)
            if body >= min(pos.shape[1], quat.shape[1]):
                raise self._error(f"{position} has no body {body}", "Give as many names as bodies.")
            where = f"body {body} of {position}, {rotation}"
            return self._pose(pos[:, body], quat[:, body], where, rotation, _BODY_QUATS)
        return None

    def _pose(
        self,
        pos: NDArray[Any],
        quat: NDArray[Any],
        source: str,
        name: str,
        w_first: dict[str, bool],
    ) -> _Root:
        """The pose in two arrays, with w first in its quaternions.

        The place of w follows from the array's name or from the convention. It is the other end if
        the pelvis would lie with the usual order and stands with the other one.
        """
        for what, values, width in (("position", pos, 3), ("quaternion", quat, 4)):
            if values.shape != (len(self._columns.angles), width):
                raise self._error(
                    f"the pelvis's {what} ({source}) has the shape {values.shape}",
                    f"Give it the shape ({len(self._columns.angles)}, {width}), a row per frame.",
                )
        quat = quat.astype(np.float64)
        orders = {"wxyz": quat, "xyzw": wxyz_from_xyzw(quat)}
        usual, other = orders if w_first[_plain(name)] else reversed(orders)
        why = ""
        few = some_frames(len(quat))
        if (
            not _plain(name).endswith(tuple(orders))
            and not _ON_FLOOR[0] < np.median(pos[:, 2]) < _ON_FLOOR[1]
            and _lean(orders[usual][few]) > _LYING
            and _lean(orders[other][few]) < _UPRIGHT
        ):
            usual, why = other, ", because the pelvis would lie otherwise"
        assumed = name == "table" and not why  # a CSV without a header
        return _Root(pos, orders[usual], f"{source}, {usual}{why}", assumed)

    def _bodies(self, name: str, width: int) -> NDArray[Any]:
        """(T, B, width) in the file's own type, because it has most of the file's numbers."""
        values, n_frames = self._numbers(name, 3), len(self._columns.angles)
        if values.shape[0] != n_frames or values.shape[2] != width:
            raise self._error(
                f"{name} has the shape {values.shape}",
                f"Give it the shape ({n_frames}, bodies, {width}).",
            )
        return values

    @cached_property
    def _fps(self) -> float | None:
        """Frame rate in the file; None if it has none."""
        name = self._first((*_FPS, "dt"))
        if not name:
            return None
        values = self._array(name).ravel()
        if values.size == 1 and values.dtype.kind in "iuf" and values[0] > 0:
            return float(1.0 / values[0] if _plain(name) == "dt" else values[0])
        raise self._error(f"{name} is not a frame rate", "Give it one number, such as 50.")

    def _first(self, names: Iterable[str]) -> str:
        """The first of these names that is an array in the file; "" if there is none."""
        return next((self._by_name[name] for name in names if name in self._by_name), "")

    def _numbers(self, name: str, dimensions: int) -> NDArray[Any]:
        if isinstance(unread := self._arrays[name], Unread):
            raise self._error(f"{name} is a {unread.name}, not an array", "Make it an array.")
        values = self._array(name)
        if values.dtype.kind not in "iuf" or values.ndim != dimensions or not values.size:
            raise self._error(
                f"{name} is not an array of numbers with {dimensions} dimensions",
                "Give it a row for each frame.",
            )
        if values.size > _NUMBERS:
            raise self._error(
                f"{name} has more than {_NUMBERS:,} numbers", "Give a part of the motion."
            )
        if not (float(values.min()) >= -NUMBER and float(values.max()) <= NUMBER):  # False for NaN
            raise self._error(
                f"{name} has a number that is not finite, or beyond {NUMBER:g}", "Correct it."
            )
        return values

    def _texts(self, name: str) -> list[str]:
        """The strings in an array; empty if it does not exist."""
        self._read[name] = None
        values = self._arrays.get(name, [])
        texts = values if isinstance(values, list) else np.ravel(values).tolist()
        return [
            one.decode("utf-8", "replace") if isinstance(one, bytes) else str(one) for one in texts
        ]

    def _array(self, name: str) -> NDArray[Any]:
        self._read[name] = None
        try:
            return np.asarray(self._arrays[name])
        except ValueError:
            raise self._error(
                f"the rows of {name} differ in length", "Give it a row for each frame."
            ) from None

    def _error(self, cause: str, remedy: str, line: int = 0) -> MotionError:
        where = f", line {line}" * bool(line)
        return MotionError(f"{self._file.path.name}{where}: {cause}.", remedy)


def _plain(name: str) -> str:
    """The name of an array in the form of the tables above."""
    return name.lower().removesuffix("_w")


def _unit_columns(pose: NDArray[Any]) -> list[int]:
    """First columns that a quaternion in a pose (T, 7) may have, 3 or 0: its norm is 1."""
    some = pose[some_frames(len(pose))]
    norms = {first: np.linalg.norm(some[:, first : first + 4], axis=1) for first in (3, 0)}
    return [first for first, norm in norms.items() if (np.abs(norm - 1.0) < _UNIT).all()]


def _lean(quat_wxyz: Floats) -> float:
    """Mean angle of the pelvis's axis from the vertical, rad."""
    quat = quat_wxyz[np.linalg.norm(quat_wxyz, axis=1) > SMALLEST_QUAT]
    up = quat_rotate(quat_normalize(quat), np.array([0.0, 0.0, 1.0]))[:, 2]
    return float(np.arccos(np.clip(up, -1.0, 1.0)).mean()) if len(up) else 0.0
