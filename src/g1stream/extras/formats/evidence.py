"""The motion in named arrays: those of an NPZ, a pickle or a PyTorch file, the columns of a table.

The names and shapes of arrays tell what they contain. Where a file is not explicit, evidence
decides; if it is ambiguous, an error asks for a flag. All formats have the same checks.
"""

from __future__ import annotations

from collections import Counter
from contextlib import suppress
from functools import cached_property
from math import prod
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from g1stream.errors import MotionError
from g1stream.extras.formats.columns import POSE, Columns, is_quaternion, readings
from g1stream.extras.formats.orders import (
    MAY_LACK,
    WRISTS,
    Order,
    in_motor_order,
    layouts,
    names_in_order,
    order_by_bodies,
    order_by_limits,
    order_by_links,
    set_of,
    share_beyond_limits,
    some_frames,
    told_by_limits,
)
from g1stream.extras.formats.pickles import Unread
from g1stream.extras.formats.rates import rate_of_speeds, rate_of_times
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

__all__ = ["BESIDE", "READ", "TIMES", "poses_of"]

BESIDE: Final = "meta.json"
"""The file that says the rate and the names of an NPZ in the same directory, as of HDMI."""

TIMES: Final = ("time", "times", "time_s", "t", "timestamp", "timestamps", "timestamp_ns")
"""Names of the times of the frames."""

# Names of arrays in the files of other programs, in lower case and without the suffix `_w`, which
# means the world frame.
#: Those of MimicKit: position, exponential map, and joints.
_FRAMES: Final = "frames"
#: Joint angles, maybe with poses; True if w is conventionally first in the quaternions of these.
_ANGLES: Final = {
    **dict.fromkeys(("joint_pos", "dof_pos", "dof_positions", "dof", "qpos"), True),
    **dict.fromkeys(("joint_angles", "q"), True),
    "table": False,
    _FRAMES: True,
}
_NAMES: Final = ("joint_names", "dof_names")
_BODY_NAMES: Final = ("body_names", "link_body_list", "link_names")
_FPS: Final = (
    *("fps", "framerate", "frame_rate", "mocap_framerate", "mocap_frame_rate"),
    *("sample_rate", "sampling_rate", "frequency", "freq", "hz"),
)
_SPEEDS: Final = ("joint_vel", "dof_vel", "dof_velocities", "joint_velocities", "qvel")
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
_LOCAL_POSITIONS: Final = ("local_body_pos",)
_BODY_QUATS: Final = {"body_quat": True, "body_rotations": True, "rigid_body_rot": False}
#: Parts of array names in known layouts that the motion does not need: no warning.
_NOT_MISSED: Final = ("_vel", "contact", "pose_aa", "smpl", "body_pos", "body_quat", "loop_mode")
#: Arrays in motions of human body models.
_HUMAN: Final = {"poses", "pose_aa", "betas"}
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
_FIRST_COLUMN: Final = "from the times in the first column"
#: Frames whose speeds tell the rate.
_FRAMES_OF_SPEEDS: Final = 5000
#: Rates that differ by less than this fraction agree.
_SAME_RATE: Final = 0.05


class _Root(NamedTuple):
    """The pelvis's pose, (T, 3) m and (T, 4), and the names of its arrays.

    Attributes:
        assumed: there is no evidence for the order of its quaternion.
    """

    pos: Floats
    quat_wxyz: Floats
    source: str
    assumed: bool = False


def poses_of(
    file: MotionFile,
    kind: str,
    arrays: dict[str, Any],
    first_line: int = 0,
    beside: dict[str, Any] | None = None,
) -> Poses:
    """Find the motion in named arrays.

    Args:
        file: the source of the arrays.
        kind: kind of file, for messages.
        arrays: the arrays by name.
        first_line: line of frame 0 in a table.
        beside: what `meta.json` beside the file says, by the names of arrays that the file lacks.

    Raises:
        MotionError: the file has no such motion, an array has a wrong shape, or the joint order is
            ambiguous.
    """
    return _Arrays(file, kind, arrays, first_line, beside or {}).poses()


class _Arrays:
    """The arrays of a file, and what they are; arguments as of `poses_of`."""

    def __init__(
        self,
        file: MotionFile,
        kind: str,
        arrays: dict[str, Any],
        first_line: int,
        beside: dict[str, Any],
    ) -> None:
        self._file, self._kind, self._first_line = file, kind, first_line
        self._arrays, self._beside = beside | arrays, beside.keys() - arrays.keys()
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
        fps, kind = None, self._kind
        if self._file.fps is None and self._rate:
            fps, why = self._rate
            used["frame rate"] = f"{fps:g} fps, {why}"
        if not self._first_line:
            own = [one for one in self._read if one in self._arrays and one not in self._beside]
            kind += f" with {listed(own)}"
        if lacking := [name for name in self._absent if name not in MAY_LACK]:
            unused = f"; these are not used: {listed(self._not_used)}" * bool(self._not_used)
            raise self._error(
                f"it lacks the joints {', '.join(lacking)}{unused}",
                "Give a motion of all joints; only wrists, waist roll and pitch may be missing.",
            )
        return Poses(
            self._file,
            Evidence(
                {"file": kind, **used}, assumed, self._not_used, self._absent, usual=self._is_lafan1
            ),
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
        stated, told = self._file.fps or self._rate, self._rate_of_speeds
        if told and isinstance(stated, tuple) and abs(told - stated[0]) > _SAME_RATE * told:
            yield (
                f"its frame rate is {stated[0]:g} fps, but {self._first(_SPEEDS)} has the speeds "
                f"of the angles at {told:g} fps. Give --fps {told:g} if that is the rate."
            )
        if self._order.other:
            how = "is assumed" if self._order.assumed else "was detected only by joint limits"
            yield (
                f"the joint order {how}; {self._order.why}. Give --joint-order {self._order.other} "
                "if that is the order."
            )

    @property
    def _is_lafan1(self) -> bool:
        """Whether a table has LAFAN1's layout: the pelvis, its quaternion xyzw, and the motors."""
        (name, table), root, order = self._angles, self._root, self._order
        if name != "table" or table.shape[1] != POSE + N_JOINTS or order.assumed:
            return False
        return root is not None and root.assumed and order.columns == JOINT_NAMES

    @cached_property
    def _absent(self) -> tuple[str, ...]:
        return tuple(name for name in JOINT_NAMES if name not in self._order.columns)

    @cached_property
    def _not_used(self) -> tuple[str, ...]:
        """Unused joints, columns and arrays, after all arrays were read."""
        columns, rate, _ = self._columns, self._rate, self._root
        name, rest = self._angles[0], columns.rest
        last = f"the last {rest} columns" if rest > 1 else "the last column"
        tells = rate is not None and rate[1] == _FIRST_COLUMN
        return (
            *(one for one in self._order.columns if one not in JOINT_NAMES),
            *([f"the first column of {name}"] * (columns.extra is not None and not tells)),
            *([f"{last} of {name}"] * bool(rest)),
            *(one for one in self._arrays if one not in self._read and one not in self._beside),
        )

    def _is_missed(self, name: str) -> bool:
        """Whether an unused array may describe the motion: a row per frame, or one number."""
        if name not in self._arrays:  # it is the name of a joint or of columns
            return True
        shape = self._shape(name)
        says = prod(shape) == 1 or shape[:1] == (len(self._angles[1]),)
        return says and not any(word in _plain(name) for word in _NOT_MISSED)

    @cached_property
    def _names(self) -> tuple[str, ...]:
        """The joint names in the file, as g1stream names them."""
        key = self._first(_NAMES)
        names = tuple(f"{one.removesuffix('_joint')}_joint" for one in self._texts(key))
        if twice := [name for name, n in Counter(names).items() if n > 1]:
            raise self._error(f"{key} has {listed(twice)} twice", "Give each joint once.")
        return names

    @cached_property
    def _angles(self) -> tuple[str, NDArray[Any]]:
        """The name of the array with the angles, and its numbers (T, N)."""
        name = self._first(_ANGLES)
        if not name:
            human = " It is a motion of a human body model." * bool(_HUMAN & self._arrays.keys())
            raise self._error(
                f"no array has joint angles; it has {listed(sorted(self._arrays))}.{human}", READ
            )
        return name, self._numbers(name, 2)

    @cached_property
    def _columns(self) -> Columns:
        """Joint angles, poses and other columns in the array with the angles."""
        name, table = self._angles
        n_joints = [len(self._names)] if self._names else [N_JOINTS, N_JOINTS - len(WRISTS)]
        found = readings(table, n_joints, mapped=_plain(name) == _FRAMES)
        likely = [one for one in found if one.pose is None or self._has_quaternion(one)]
        if len(likely) > 1:
            likely = self._nearest(likely)
        if len(likely) == 1:
            return likely[0]
        joints, width = " or ".join(map(str, n_joints)), table.shape[1]
        if found:
            cause = f"{name} has {width} columns: " + ", or ".join(map(str, found))
            remedy = "Give it the joints alone, or name all columns in joint_names."
            raise self._error(cause, remedy, 1 if self._first_line else 0)
        order = "wxyz" if _ANGLES[_plain(name)] else "xyzw"
        remedy = (
            f"Give it a column for each joint, or {POSE} more before them: the pelvis's position "
        )
        remedy += f"and quaternion ({order})."
        if _plain(name) == _FRAMES:
            remedy = "Give it position (3), exponential map (3) and the joints, as MimicKit does."
        line = 1 if self._first_line else 0
        raise self._error(f"{name} has {width} columns for {joints} joints", remedy, line)

    def _has_quaternion(self, columns: Columns) -> bool:
        pose = columns.pose
        return pose is not None and (
            pose.shape[1] < POSE or columns.quat_first or is_quaternion(pose[:, 3:])
        )

    def _nearest(self, found: list[Columns]) -> list[Columns]:
        """The readings whose links are at the bodies, or whose joints keep their limits."""
        if near := [one for one in found if self._order_by_bodies(one.angles)]:
            return near
        beyond = []
        for one in found:
            few = one.angles[some_frames(len(one.angles))]
            orders = [self._names] if self._names else layouts(few.shape[1]).values()
            beyond.append(min(share_beyond_limits(few, names) for names in orders))
        ranked = sorted(range(len(found)), key=lambda i: beyond[i])
        return [found[ranked[0]]] if told_by_limits([beyond[i] for i in ranked]) else found

    @cached_property
    def _order(self) -> Order:
        """The joint order by the names in the file, by the flag, by bodies, or by joint limits."""
        if self._names:
            return Order(self._names, f"named by {self._place(self._first(_NAMES))}")
        angles, asked = self._columns.angles, self._file.joint_order
        names = layouts(angles.shape[1])
        if asked and asked not in names:
            raise self._error(
                f"--joint-order {asked} is for {len(names_in_order(asked))} joints, and "
                f"{self._angles[0]} has {angles.shape[1]}",
                f"Give one of {', '.join(names)}.",
            )
        if asked:
            return Order(names[asked], f"{asked}{set_of(names[asked])}, as requested")
        if order := self._order_by_bodies(angles, self._root):
            return order
        # A table without a header is taken to be in motor order, as LAFAN1 is, and so is MimicKit.
        motor = bool(self._first_line) or _plain(self._angles[0]) == _FRAMES
        limited = order_by_limits(angles, self._file.robot, motor_assumed=motor)
        linked = order_by_links(self._texts(self._first(_BODY_NAMES)), angles.shape[1])
        if isinstance(limited, Order) and not (limited.assumed and linked):
            return linked if linked and linked.columns == limited.columns else limited
        if linked:
            return linked
        raise self._error(
            f"the joint order is ambiguous: {limited}",
            f"Give --joint-order {' or '.join(names)}; motor order is that of LowCmd, the URDF and "
            "MuJoCo.",
        )

    def _order_by_bodies(self, angles: Floats, root: _Root | None = None) -> Order | None:
        """The order in which the links are at the bodies, in the world or in the pelvis's frame."""
        local = self._first(_LOCAL_POSITIONS)
        if local and len(self._shape(local)) == 3:  # None in some files of GMR
            at_origin = np.zeros((len(angles), 3)), np.tile([1.0, 0.0, 0.0, 0.0], (len(angles), 1))
            if order := order_by_bodies(angles, self._bodies(local, 3), *at_origin):
                return order
        root, bodies = root or self._apart, self._first(_BODY_POSITIONS)
        if not (root and bodies):
            return None
        return order_by_bodies(angles, self._bodies(bodies, 3), root.pos, root.quat_wxyz)

    @cached_property
    def _root(self) -> _Root | None:
        """The pelvis's pose: its own arrays, columns before the angles, or the first body."""
        columns, name = self._columns, self._angles[0]
        if columns.pose is None or (self._first(_POSITIONS) and self._first(_QUATS)):
            return self._apart
        where = "the columns before the joints"
        if _plain(name) == _FRAMES:
            return _Root(*columns.pose_wxyz(), f"{where}, the rotation as an exponential map")
        cut = 4 if columns.quat_first else 3
        parts = columns.pose[:, :cut], columns.pose[:, cut:]
        quat, pos = parts if columns.quat_first else reversed(parts)
        if columns.quat_first:
            where += ", quaternion first because those columns have norm 1"
        return self._pose(pos, quat, where, name, _ANGLES)

    @cached_property
    def _apart(self) -> _Root | None:
        """The pelvis's pose in arrays of its own, or as the first body."""
        position, rotation = self._first(_POSITIONS), self._first(_QUATS)
        if position and rotation:
            pos, quat = self._numbers(position, 2), self._numbers(rotation, 2)
            return self._pose(pos, quat, f"{position}, {rotation}", rotation, _QUATS)
        position, rotation = self._first(_BODY_POSITIONS), self._first(_BODY_QUATS)
        if position and rotation:
            names = self._texts(self._first(_BODY_NAMES))
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
            if values.shape != (len(self._angles[1]), width):
                raise self._error(
                    f"the pelvis's {what} ({source}) has the shape {values.shape}",
                    f"Give it the shape ({len(self._angles[1])}, {width}), a row per frame.",
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
        values, n_frames = self._numbers(name, 3), len(self._angles[1])
        if values.shape[0] != n_frames or values.shape[2] != width:
            raise self._error(
                f"{name} has the shape {values.shape}",
                f"Give it the shape ({n_frames}, bodies, {width}).",
            )
        return values

    @cached_property
    def _rate(self) -> tuple[float, str] | None:
        """Frame rate of the file, and where it is from; None if nothing says it."""
        if name := self._first((*_FPS, "dt")):
            values = self._array(name).ravel()
            if values.size != 1 or values.dtype.kind not in "iuf" or not values[0] > 0:
                raise self._error(f"{name} is not a frame rate", "Give it one number, such as 50.")
            fps = float(1.0 / values[0] if _plain(name) == "dt" else values[0])
            return fps, f"from {self._place(name)}"
        if self._file.fps:
            return None
        extra, n_frames = self._columns.extra, len(self._angles[1])
        if extra is not None and (rate := rate_of_times(extra)):
            return rate, _FIRST_COLUMN
        name = self._first(TIMES)
        times = np.asarray(self._arrays[name], float) if self._shape(name) == (n_frames,) else None
        if times is not None and (rate := rate_of_times(times)):
            self._read[name] = None
            return rate, f"from the times in {name}"
        if rate := self._rate_of_speeds:
            name = self._first(_SPEEDS)
            self._read[name] = None
            return rate, f"because {name} has the speeds of the angles at this rate"
        return None

    @cached_property
    def _rate_of_speeds(self) -> float | None:
        """The frame rate at which the joint speeds in the file are those of the angles."""
        angles = self._columns.angles
        name = self._first(_SPEEDS)
        if not name or len(shape := self._shape(name)) != 2 or shape[0] != len(angles):
            return None
        speeds = np.asarray(self._arrays[name])
        if speeds.dtype.kind != "f":
            return None
        speeds = speeds.astype(np.float64, copy=False)
        if not (np.abs(speeds) <= NUMBER).all():  # False for NaN
            return None
        first = speeds.shape[1] - self._columns.rest - angles.shape[1]
        if first not in (0, 1, 6):  # of the extra column, or of the pelvis
            return None
        some = slice(_FRAMES_OF_SPEEDS)
        return rate_of_speeds(angles[some], speeds[some, first : first + angles.shape[1]])

    def _place(self, name: str) -> str:
        return BESIDE if name in self._beside else "the file"

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

    def _shape(self, name: str) -> tuple[int, ...]:
        """The shape of an array of numbers; (0,) if there is none."""
        with suppress(KeyError, ValueError):  # its rows differ in length
            values = np.asarray(self._arrays[name])
            return values.shape if values.dtype.kind in "biuf" else (0,)
        return (0,)

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


def _lean(quat_wxyz: Floats) -> float:
    """Mean angle of the pelvis's axis from the vertical, rad."""
    quat = quat_wxyz[np.linalg.norm(quat_wxyz, axis=1) > SMALLEST_QUAT]
    up = quat_rotate(quat_normalize(quat), np.array([0.0, 0.0, 1.0]))[:, 2]
    return float(np.arccos(np.clip(up, -1.0, 1.0)).mean()) if len(up) else 0.0
