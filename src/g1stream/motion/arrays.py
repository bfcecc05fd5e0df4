"""Motion files of named arrays: NPZ, NPY, pickles of arrays, and what PyTorch saves.

What the arrays are is told by their names and shapes, and the frame rate by the file. Where joints
are not named, their order is told by evidence, and asked for if that leaves a choice.
"""

from __future__ import annotations

import io
import warnings
import zipfile
import zlib
from dataclasses import replace
from functools import cache, cached_property
from typing import TYPE_CHECKING, Any, Final, NamedTuple, get_args

import numpy as np

from g1stream.errors import MotionError
from g1stream.input_limits import UNPACKED
from g1stream.motion.motion import DEFAULT_FPS, SMALLEST_QUAT, Motion, norm_warnings
from g1stream.motion.pickles import read_pickle, read_torch
from g1stream.motion.readers import Evidence
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS
from g1stream.robot.kinematics import forward_kinematics
from g1stream.robot.model import G1, REVISIONS
from g1stream.robot.rotations import quat_normalize, quat_rotate, wxyz_from_xyzw
from g1stream.types import JointOrder

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from g1stream.motion.readers import MotionFile
    from g1stream.types import Floats

__all__ = ["ArrayFile", "names_in_order", "read_arrays"]

# The names that arrays have in the files of those who write them.
#: Joint angles, maybe with the pelvis's pose in the first `_ROOT` columns.
_ANGLES: Final = ("joint_pos", "dof_pos", "dof_positions", "dof", "qpos", "joint_angles", "q")
_ROOT: Final = 7
_NAMES: Final = ("joint_names", "dof_names")
_FPS: Final = ("fps", "framerate", "frame_rate", "mocap_framerate", "mocap_frame_rate")
_POSITIONS: Final = ("root_pos", "root_trans", "root_trans_offset", "base_pos", "root_translation")
#: Orientations of the pelvis and of all bodies, and whether w is first in them by convention.
_QUATS: Final = {
    "root_quat_wxyz": True,
    "root_quat_xyzw": False,
    "root_rot": False,
    "root_quat": True,
    "root_rotation": False,
    "base_quat": True,
}
_BODY_POSITIONS: Final = ("body_pos_w", "body_positions", "rigid_body_pos")
_BODY_QUATS: Final = {"body_quat_w": True, "body_rotations": True, "rigid_body_rot": False}
#: Arrays of the motions of human body models.
_HUMAN: Final = {"poses", "pose_aa", "betas"}


def _any_of(names: Iterable[str]) -> str:
    *others, last = names
    return f"{', '.join(others)} or {last}"


_READ: Final = (
    f"Read are joint angles as {_any_of(_ANGLES)}, (T, {N_JOINTS}), or (T, {_ROOT + N_JOINTS}) "
    f"with the pelvis's position and quaternion before them; the pelvis as {_any_of(_POSITIONS)} "
    f"with {_any_of(_QUATS)}, or as the first body of {_any_of(_BODY_POSITIONS)} with "
    f"{_any_of(_BODY_QUATS)}; {_any_of(_FPS)}; {_any_of(_NAMES)}."
)
#: Numbers in an array that is converted to 64 bits.
_NUMBERS: Final = UNPACKED // 8
#: Motions of a file that an error names.
_NAMED: Final = 20
#: A pelvis that leans by more than the first on average, by less than the second if w is at the
#: other end, is taken to have it there, rad.
_LYING: Final = 1.05
_UPRIGHT: Final = 0.8
#: Frames that bodies are compared in.
_FRAMES: Final = 50
#: An order is told by the bodies if it puts the links this near to them, mm, and at most at this
#: share of the distance in the other order.
_NEAR: Final = 50.0
_NEARER: Final = 0.5
#: It is told by the limits if the other has more than this share of the angles beyond them, and
#: more than so many times as many.
_BEYOND: Final = 1e-2
_TIMES: Final = 10.0
#: An angle counts as beyond a limit by more than this, rad; retargeting tools differ by as much.
_EXCESS: Final = 0.02


class _Root(NamedTuple):
    """The pelvis's pose, (T, 3) m and (T, 4), and where it is from."""

    pos: Floats
    quat_wxyz: Floats
    source: str


class _Order(NamedTuple):
    """The joint in each column, how that is known, and whether only joint limits say it."""

    columns: tuple[str, ...]
    why: str
    by_limits: bool = False


class ArrayFile:
    """A motion file of named arrays.

    Args:
        file: an NPZ, an NPY, a file of PyTorch, or a pickle, plain or of joblib.

    Raises:
        MotionError: it cannot be read, or has no such motion. Anything else wrong in it is an error
            only when `evidence` or `motion` is asked for.
    """

    def __init__(self, file: MotionFile) -> None:
        self._file = file
        try:
            self._kind, content = read_arrays(file.content)
        except ValueError as error:
            raise self._error(str(error), _READ) from error
        self._arrays = self._of_one_motion(content, file.member)
        self._read: dict[str, None] = {}  # the names of those that were looked at, in order

    def motion(self) -> Motion:
        """The motion in the file, its joints in motor order.

        Raises:
            MotionError: an array is missing or has a wrong shape, or the order of the joints cannot
                be told.
        """
        order, root = self._order, self._root
        if missing := self._missing:
            raise self._error(
                f"it lacks the joints {', '.join(missing)}", "Give a motion of all 29 joints."
            )
        motion = Motion.from_arrays(
            _in_motor_order(self._angles, order.columns),
            root and root.pos,
            root and root.quat_wxyz,
            fps=self._file.fps or self._fps or DEFAULT_FPS,
            name=self._file.member or self._file.path.stem,
        )
        warned = []
        if unknown := self._unknown:
            warned.append(f"Joints that no G1 has are left out: {', '.join(unknown)}.")
        if order.by_limits:
            warned.append(f"The order of the joints was told by their limits. {order.why}.")
        if root:
            norms = np.linalg.norm(root.quat_wxyz, axis=1)
            warned += norm_warnings(norms, self._file.path.name, lambda frame: f"frame {frame}")
        return replace(
            motion, source=self._file.path, sha256=self._file.sha256, warnings=tuple(warned)
        )

    @cached_property
    def evidence(self) -> Evidence:
        """What the arrays were taken for, and why.

        Raises:
            MotionError: as `motion`.
        """
        order, root = self._order, self._root
        used, assumed = {"joint order": order.why}, {}
        if root:
            used["pelvis"] = root.source
        else:
            assumed["pelvis"] = "upright at the origin"
        if self._fps:
            used["frame rate"] = f"{self._fps:g} fps, as the file says"
        elif self._file.fps is None:
            assumed["frame rate"] = f"{DEFAULT_FPS:g} fps"
        read = [name for name in self._read if name in self._arrays]
        rest = [name for name in self._arrays if name not in read]
        norms = np.linalg.norm(root.quat_wxyz, axis=1) if root else None
        return Evidence(
            {"file": f"{self._kind} with {', '.join(read)}", **used},
            assumed,
            (*self._unknown, *rest),
            tuple(self._missing),
            None if norms is None else (float(norms.min()), float(norms.max())),
        )

    @property
    def _missing(self) -> list[str]:
        return [name for name in JOINT_NAMES if name not in self._order.columns]

    @property
    def _unknown(self) -> list[str]:
        return [name for name in self._order.columns if name not in JOINT_NAMES]

    @cached_property
    def _table(self) -> tuple[str, Floats]:
        """Name and content of the array with the angles, (T, 29) or with the pelvis before them."""
        if name := self._first(_ANGLES):
            return name, self._numbers(name, 2).astype(np.float64)
        found = ", ".join(sorted(self._arrays)) or "nothing"
        human = " It is the motion of a human body model." * bool(_HUMAN & self._arrays.keys())
        raise self._error(f"no array has joint angles; it has {found}.{human}".rstrip("."), _READ)

    @cached_property
    def _names(self) -> tuple[str, ...]:
        """The joints that the file names, as g1stream names them."""
        if key := self._first(_NAMES):
            return tuple(f"{one.removesuffix('_joint')}_joint" for one in self._texts(key))
        return ()

    @cached_property
    def _angles(self) -> Floats:
        """(T, n) rad."""
        name, table = self._table
        n_joints = len(self._names) or N_JOINTS
        if table.shape[1] not in (n_joints, _ROOT + n_joints):
            raise self._error(
                f"{name} has {table.shape[1]} columns for {n_joints} joints",
                f"Give it a column for each joint, or {_ROOT} more before them: the pelvis's "
                "position and quaternion (wxyz).",
            )
        return table[:, -n_joints:]

    @cached_property
    def _order(self) -> _Order:
        """By the names in the file, as asked for, or by evidence.

        Positions of bodies decide: forward kinematics in the right order puts the links where the
        bodies are. Otherwise the joint limits do, which the wrong order passes.
        """
        angles, asked = self._angles, self._file.joint_order
        if self._names:
            return _Order(self._names, "named by the file")
        if asked:
            return _Order(names_in_order(asked), f"{asked}, as asked for")
        orders: tuple[JointOrder, ...] = get_args(JointOrder)
        poses = {order: _in_motor_order(angles, names_in_order(order)) for order in orders}
        root, bodies = self._root, self._first(_BODY_POSITIONS)
        if root and bodies:
            found = self._bodies(bodies, 3)
            near = {order: _distance(pose, found, root) for order, pose in poses.items()}
            best, other = sorted(orders, key=lambda order: near[order])
            # The pelvis alone is as near in both.
            if near[best][0] < min(_NEAR, _NEARER * near[other][0]):
                return _Order(
                    names_in_order(best),
                    f"{best}: the bodies are {near[best][0]:.1f} mm from the links of "
                    f"{near[best][1]}, in {other} order {near[other][0]:.0f} mm",
                )
        beyond = {order: _share_beyond_limits(pose) for order, pose in poses.items()}
        best, other = sorted(orders, key=lambda order: beyond[order])
        if beyond[other] > max(_BEYOND, _TIMES * beyond[best]):
            return _Order(
                names_in_order(best),
                f"{best}: {beyond[best]:.2%} of the angles are beyond the joint limits, in {other} "
                f"order {beyond[other]:.2%}",
                by_limits=True,
            )
        shares = " and ".join(f"{beyond[order]:.2%} in {order} order" for order in orders)
        raise MotionError(
            f"The order of the joints in {self._file.path.name} cannot be told: {shares} are "
            "beyond the joint limits.",
            "Say it: --joint-order motor (as LowCmd, the URDF and MuJoCo) or --joint-order "
            "isaaclab.",
        )

    @cached_property
    def _root(self) -> _Root | None:
        """The pelvis's pose, from arrays of its own, before the angles, or from the first body."""
        angles, table = self._table
        position, rotation = self._first(_POSITIONS), self._first(_QUATS)
        if position and rotation:
            pos, quat = self._numbers(position, 2), self._numbers(rotation, 2)
            return self._pose(pos, quat, f"{position}, {rotation}", w_first=_QUATS[rotation])
        if table.shape[1] > self._angles.shape[1]:
            return _Root(table[:, :3], table[:, 3:_ROOT], f"in {angles}, quaternion wxyz")
        position, rotation = self._first(_BODY_POSITIONS), self._first(_BODY_QUATS)
        if position and rotation:
            names = self._texts("body_names")
            body = names.index("pelvis") if "pelvis" in names else 0
            pos, quat = self._bodies(position, 3), self._bodies(rotation, 4)
            if body >= min(pos.shape[1], quat.shape[1]):
                raise self._error(f"{position} has no body {body}", "Name as many as there are.")
            where = f"body {body}, quaternion"
            return self._pose(pos[:, body], quat[:, body], where, w_first=_BODY_QUATS[rotation])
        return None

    def _pose(self, pos: NDArray[Any], quat: NDArray[Any], source: str, *, w_first: bool) -> _Root:
        """The pose of these arrays, its quaternions with w first.

        w is where it usually is in such an array, unless the pelvis then lies and in the other
        order stands.
        """
        for what, values, width in (("position", pos, 3), ("quaternion", quat, 4)):
            if values.shape != (len(self._angles), width):
                raise self._error(
                    f"the pelvis's {what} ({source}) has the shape {values.shape}",
                    f"Give it the shape ({len(self._angles)}, {width}), a row per frame.",
                )
        quat = quat.astype(np.float64)
        orders = {"wxyz": quat, "xyzw": wxyz_from_xyzw(quat)}
        usual, other = orders if w_first else reversed(orders)
        why = ""
        if _lean(orders[usual]) > _LYING and _lean(orders[other]) < _UPRIGHT:
            usual, why = other, ", as the pelvis would lie otherwise"
        return _Root(pos.astype(np.float64), orders[usual], f"{source} {usual}{why}")

    def _bodies(self, name: str, width: int) -> NDArray[Any]:
        """(T, B, width) as in the file, in which they are most of the numbers."""
        values = self._numbers(name, 3)
        if values.shape[0] != len(self._angles) or values.shape[2] != width:
            raise self._error(
                f"{name} has the shape {values.shape}",
                f"Give it the shape ({len(self._angles)}, bodies, {width}).",
            )
        return values

    @cached_property
    def _fps(self) -> float | None:
        """Frames per second as the file says; None if it does not."""
        name = self._first(_FPS)
        if not name:
            return None
        values = self._array(name).ravel()
        if values.size == 1 and values.dtype.kind in "iuf" and values[0] > 0:
            return float(values[0])
        raise self._error(f"{name} is no frame rate", "Give it one number, such as 50.")

    def _first(self, names: Iterable[str]) -> str:
        """The first of these names that an array has; empty if none has."""
        return next((name for name in names if name in self._arrays), "")

    def _numbers(self, name: str, dimensions: int) -> NDArray[Any]:
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

    def _texts(self, name: str) -> list[str]:
        """The texts in an array; none without it."""
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

    def _of_one_motion(self, content: Any, member: str | None) -> dict[str, Any]:
        """The arrays; those of the chosen, or only, motion where there is a dict of motions."""
        if not isinstance(content, dict) or not content:
            raise self._error("it has no arrays by name", _READ)
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
                f"Give one by its name: {self._file.path}:{names[0]}",
            )
        arrays: dict[str, Any] = content[member]
        return arrays

    def _error(self, cause: str, remedy: str) -> MotionError:
        return MotionError(f"{self._file.path.name}: {cause}.", remedy)


@cache
def names_in_order(order: JointOrder) -> tuple[str, ...]:
    """The names of the 29 joints in an order; that of Isaac Lab is breadth first."""
    if order == "motor":
        return JOINT_NAMES
    robot = G1.default()
    link_of = {int(joint): link for link, joint in enumerate(robot.joint_of_link) if joint >= 0}
    moving = [0] * len(robot.link_names)  # joints from the pelvis to a link
    for link in np.concatenate(robot.levels).tolist():
        moving[link] = moving[robot.parent[link]] + int(robot.joint_of_link[link] >= 0)
    ranked = sorted(range(N_JOINTS), key=lambda joint: (moving[link_of[joint]], joint))
    return tuple(JOINT_NAMES[joint] for joint in ranked)


def _in_motor_order(angles: Floats, names: tuple[str, ...]) -> Floats:
    """(T, 29) angles of the joints `names`, in motor order."""
    return angles[:, [names.index(name) for name in JOINT_NAMES]]


def _distance(joint_pos: Floats, bodies: NDArray[Any], root: _Root) -> tuple[float, str]:
    """Mean distance, mm, from each body (T, B, 3) to the nearest link of the robot that fits best.

    Returns:
        The distance, and the name of that robot.
    """
    few = np.linspace(0, len(joint_pos) - 1, min(_FRAMES, len(joint_pos))).astype(int)
    found, quat = bodies[few][:, :, np.newaxis], quat_normalize(root.quat_wxyz[few])
    distances = []
    for name in REVISIONS:
        links = forward_kinematics(G1.load(name), joint_pos[few], root.pos[few], quat).pos
        nearest = np.linalg.norm(found - links[:, np.newaxis], axis=-1).min(axis=-1)
        distances.append((float(nearest.mean() * 1e3), name))
    return min(distances)


def _share_beyond_limits(joint_pos: Floats) -> float:
    robot = G1.default()
    excess = np.maximum(robot.lower - joint_pos, joint_pos - robot.upper)
    return float((excess > _EXCESS).mean())


def _lean(quat_wxyz: Floats) -> float:
    """Mean angle of the pelvis's axis from the vertical, rad."""
    quat = quat_wxyz[np.linalg.norm(quat_wxyz, axis=1) > SMALLEST_QUAT]
    up = quat_rotate(quat_normalize(quat), np.array([0.0, 0.0, 1.0]))[:, 2]
    return float(np.arccos(np.clip(up, -1.0, 1.0)).mean()) if len(up) else 0.0


def read_arrays(data: bytes) -> tuple[str, Any]:
    """What kind of file it is, and what is in it, without running anything.

    Raises:
        ValueError: it is damaged, or larger than 512 MiB unpacked.
    """
    if data.startswith(b"\x93NUMPY"):
        return "NPY", {"qpos": _npy(data)}
    if not data.startswith(b"PK"):
        return "pickle", read_pickle(data)
    members = _zip_members(data)
    if any(name.endswith("/data.pkl") for name in members):
        return "file of PyTorch", read_torch(members)
    return "NPZ", {name.removesuffix(".npy"): _npy(content) for name, content in members.items()}


def _zip_members(data: bytes) -> dict[str, bytes]:
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = archive.infolist()
            # zipfile itself reads no more than this size of a member.
            if sum(member.file_size for member in members) > UNPACKED:
                raise ValueError(f"it is larger than {UNPACKED / 2**20:g} MiB unpacked")
            plain = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
            if any(member.compress_type not in plain for member in members):
                raise ValueError("it is compressed in another way than deflate")
            return {member.filename: archive.read(member) for member in members}
    except (zipfile.BadZipFile, zlib.error, EOFError) as error:
        raise ValueError("it is damaged or cut off") from error
    except (NotImplementedError, RuntimeError) as error:  # encrypted, or of a newer ZIP
        raise ValueError(str(error)) from error


def _npy(data: bytes) -> Any:
    """The array in an NPY file, one of Python objects as `read_pickle` reads it."""
    file = io.BytesIO(data)
    if np.lib.format.read_magic(file) != (1, 0):
        raise ValueError("an array has another version than 1.0 of the NPY format")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it warns of headers as Python 2 wrote them
        try:
            shape, column_major, dtype = np.lib.format.read_array_header_1_0(file)
        except Exception as error:  # numpy parses it as Python, which has many ways to fail
            raise ValueError("the header of an array is damaged") from error
    if dtype.hasobject:
        return read_pickle(data[file.tell() :])
    try:
        values = np.frombuffer(data, dtype, offset=file.tell())
        return values.reshape(shape, order="F" if column_major else "C")
    except ValueError as error:
        raise ValueError("an array is damaged or cut off") from error
