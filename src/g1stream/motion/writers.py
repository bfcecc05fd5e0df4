"""Writers of motion files for other programs, and their layouts.

To add a format, add one function and one row to `FORMATS`. docs/formats.md describes the layouts,
which the programs that read the files define.
"""

from __future__ import annotations

import pickle
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, get_args

import numpy as np

from g1stream.errors import MotionError, RobotError
from g1stream.files import check_not_input, check_suffix, complete_directory, complete_file
from g1stream.motion.arrays import SONIC_FILES, names_in_order
from g1stream.motion.motion import ROOT_COLUMNS, Motion
from g1stream.robot.dynamics import centres_of_mass
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS
from g1stream.robot.kinematics import BLOCK, forward_kinematics, link_velocities, pose_blocks
from g1stream.robot.model import G1
from g1stream.robot.rotations import (
    quat_conj,
    quat_mul,
    quat_rotate,
    quat_rotate_inverse,
    xyzw_from_wxyz,
)
from g1stream.text import counted, listed
from g1stream.types import Velocities

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from g1stream.types import Floats, JointOrder

__all__ = ["FORMATS", "Format", "Take", "write_motion"]

#: Central differences need one frame on either side.
_FEWEST_FRAMES: Final = 3
#: Numbers in text have six decimals, as in LAFAN1 and SONIC.
_DECIMALS: Final = 6
_LARGEST_IN_TEXT: Final = 10_000
#: Links of GMR's robot that a URDF lacks: the link that each is fixed to, and its origin there, m.
#: The values are from `g1_mocap_29dof.xml` of GMR.
_OF_GMR: Final = {
    "left_toe_link": ("left_ankle_roll_link", (0.1, 0.0, -0.02)),
    "right_toe_link": ("right_ankle_roll_link", (0.1, 0.0, -0.02)),
    "head_mocap": ("torso_link", (0.0, 0.0, 0.4)),
}
_SONIC_LEG: Final = ("hip_roll", "knee", "ankle_roll")
_SONIC_ARM: Final = ("shoulder_roll", "elbow", "wrist_yaw")


class Layout(NamedTuple):
    """The joints and bodies of a file, their order, and the reference point of body velocities.

    Attributes:
        order: joint order. The bodies are the pelvis and the link of each joint, in this order.
        of_centre: linear velocities are those of the bodies' centres of mass, as in PhysX;
            otherwise those of the origins of their frames.
        bodies: names of the bodies in the file's order, if it has only some; otherwise empty.
    """

    order: JointOrder
    of_centre: bool
    bodies: tuple[str, ...] = ()


class Format(NamedTuple):
    """A format of motion files.

    Attributes:
        write: writes a file, or a directory's content, at a path.
        suffix: suffix of a file; "" for a directory.
        fps: frame rate that its readers expect; None keeps the frames of the motion.
        layout: joints and bodies; None if a file has only joints and the pelvis.
    """

    write: Callable[[Take, Path], None]
    suffix: str
    fps: float | None = None
    layout: Layout | None = None


class Frames(NamedTuple):
    """The frames of a file in double precision. The fields are those of `TrajectoryPoint`.

    There are no accelerations, because no format has them.
    """

    joint_pos: Floats
    joint_vel: Floats
    root_pos: Floats
    root_lin_vel: Floats
    root_quat_wxyz: Floats
    root_ang_vel: Floats


#: Numbers in a row of each field.
_WIDTHS: Final = (N_JOINTS, N_JOINTS, 3, 3, 4, 3)


class States(NamedTuple):
    """The motion of joints and bodies in single precision, to which all readers convert.

    Attributes:
        joint_pos: (T, 29) rad, in the order of the layout.
        joint_vel: (T, 29) rad/s.
        root_lin_vel: (T, 3) m/s, pelvis's origin, world frame.
        root_ang_vel: (T, 3) rad/s, pelvis frame.
        body_pos_w: (T, B, 3) m, world frame, origins.
        body_quat_w: (T, B, 4) wxyz, of continuous sign.
        body_lin_vel_w: (T, B, 3) m/s, world frame.
        body_ang_vel_w: (T, B, 3) rad/s, world frame.
    """

    joint_pos: NDArray[np.float32]
    joint_vel: NDArray[np.float32]
    root_lin_vel: NDArray[np.float32]
    root_ang_vel: NDArray[np.float32]
    body_pos_w: NDArray[np.float32]
    body_quat_w: NDArray[np.float32]
    body_lin_vel_w: NDArray[np.float32]
    body_ang_vel_w: NDArray[np.float32]


@dataclass(frozen=True)
class Take:
    """A motion and the options with which it is written.

    Attributes:
        motion: the motion in its own frames.
        format: the format to write.
        robot: the robot whose bodies the file has.
        velocities: derivatives of the spline, or differences of the frames.
        on_progress: called with the fraction done.
    """

    motion: Motion
    format: Format
    robot: G1
    velocities: Velocities
    on_progress: Callable[[float], None]

    @cached_property
    def frames(self) -> Frames:
        """The frames of the file, sampled from the spline through the motion's frames."""
        motion, fps = self.motion, self.format.fps
        assert fps
        n_at_most = int(motion.duration * fps) + 2
        frames = Frames(*(np.empty((n_at_most, width)) for width in _WIDTHS))
        last = 0
        for numbers, point in motion.samples(fps, 0, motion.n_frames):
            for name, values in frames._asdict().items():
                values[numbers.start : numbers.stop] = getattr(point, name)
            last = numbers.stop
            self.on_progress(0.0)
        return Frames(*(values[:last] for values in frames))

    @property
    def n_frames(self) -> int:
        """Number of frames in the file."""
        return len(self.frames.joint_pos) if self.format.fps else self.motion.n_frames

    @property
    def layout(self) -> Layout:
        """The layout of the format. It must have one."""
        assert self.format.layout
        return self.format.layout

    @cached_property
    def joints(self) -> list[int]:
        """The motor index of each joint of the layout."""
        return [JOINT_NAMES.index(name) for name in names_in_order(self.layout.order)]

    @cached_property
    def links(self) -> list[int]:
        """The robot's link of each body of the layout.

        Raises:
            RobotError: the robot lacks a link.
        """
        if self.layout.bodies:
            return [self.robot.link_index(name) for name in self.layout.bodies]
        link_of = self.robot.joint_of_link.tolist()
        return [0, *(link_of.index(joint) for joint in self.joints)]

    @property
    def body_names(self) -> list[str]:
        """The names of the bodies."""
        return [self.robot.link_names[link] for link in self.links]

    def states(self) -> States:
        """The joints and bodies of each frame."""
        frames, links, n_frames = self.frames, self.links, self.n_frames
        joint_vel, root_lin_vel, root_ang_vel = self._rates()
        points = centres_of_mass(self.robot) if self.layout.of_centre else None
        bodies = [np.empty((n_frames, len(links), n), np.float32) for n in (3, 4, 3, 3)]
        poses = pose_blocks(
            self.robot, frames.joint_pos, frames.root_pos, frames.root_quat_wxyz, links
        )
        for part, pose in poses:
            ang_vel = quat_rotate(frames.root_quat_wxyz[part], root_ang_vel[part])
            rates = joint_vel[part], root_lin_vel[part], ang_vel
            velocities = link_velocities(self.robot, pose, *rates, links, points)
            for values, block in zip(bodies, (*pose, *velocities), strict=True):
                # The arrays have the links on their first axis.
                values[part] = block.transpose(1, 2, 0)[links].transpose(2, 0, 1)
            self.on_progress(part.stop / n_frames)
        single = (frames.joint_pos[:, self.joints], joint_vel[:, self.joints])
        others = (*single, root_lin_vel, root_ang_vel)
        return States(*(one.astype(np.float32) for one in others), *bodies)

    def _rates(self) -> tuple[Floats, Floats, Floats]:
        """Velocities of joints and pelvis (world frame), and angular velocity (pelvis frame)."""
        frames, fps = self.frames, self.format.fps
        quat = frames.root_quat_wxyz
        if self.velocities == "spline":
            return frames.joint_vel, frames.root_lin_vel, frames.root_ang_vel
        assert fps
        if self.n_frames < _FEWEST_FRAMES:
            raise MotionError(
                f"{self.motion.name} has {counted(self.n_frames, 'frame')} at {fps:g} fps.",
                f"Give {_FEWEST_FRAMES} frames or more, or remove --velocities finite.",
            )
        joints, root = (
            np.gradient(one, axis=0) * fps for one in (frames.joint_pos, frames.root_pos)
        )
        turn = quat_mul(quat[2:], quat_conj(quat[:-2]))  # over two frames, about the world's axes
        w, vector = turn[:, :1], turn[:, 1:]
        sine = np.linalg.norm(vector, axis=1, keepdims=True)
        angle = np.copysign(2.0 * np.arctan2(sine, np.abs(w)), w)
        ang_vel = angle * (vector / np.maximum(sine, 1e-300)) * (fps / 2.0)
        ang_vel = np.concatenate([ang_vel[:1], ang_vel, ang_vel[-1:]])
        return joints, root, quat_rotate_inverse(quat, ang_vel)


def write_motion(
    motion: Motion,
    path: Path,
    name: str,
    *,
    robot: G1 | None = None,
    velocities: Velocities = "spline",
    force: bool = False,
    on_progress: Callable[[float], None] = lambda _: None,
) -> Take:
    """Write a motion in a format; the other arguments are those of `Motion.save`.

    Returns:
        The motion and options that were written.
    """
    form = FORMATS.get(name)
    if form is None:
        raise MotionError(
            f"There is no format {name!r} to write.", f"Choose from {', '.join(FORMATS)}."
        )
    take = Take(motion, form, robot or G1.default(), velocities, on_progress)
    _check(take, name)
    check_not_input(path, motion.source, *(part.source for part in motion.parts))
    if form.suffix:
        check_suffix(path, f"a file of the format {name}", form.suffix)
        place = complete_file(path, force=force)
    else:
        place = complete_directory(path, SONIC_FILES, force=force)
    with place as temporary:
        form.write(take, temporary)
        take.on_progress(1.0)  # raises if the program was told to stop
    return take


def _check(take: Take, name: str) -> None:
    """Check that a format supports a motion and the options."""
    form, robot = take.format, take.robot
    if take.velocities not in get_args(Velocities):
        raise MotionError(
            f"There is no kind of velocities {take.velocities!r}.",
            f"Choose from {', '.join(get_args(Velocities))}.",
        )
    if take.velocities != "spline" and form.layout is None:
        raise MotionError(f"The format {name} has no velocities.", "Remove --velocities.")
    if name not in _OWN and not robot.present.all():
        raise RobotError(
            f"The format {name} has {N_JOINTS} joints, and {robot.source} has "
            f"{int(robot.present.sum())}.",
            "Give a robot that has all of them, or remove --urdf.",
        )
    if form.layout and robot.ignored_joints:
        raise RobotError(
            f"The format {name} has {N_JOINTS} joints, and {robot.source} has "
            f"{len(robot.ignored_joints)} more: "
            f"{listed(robot.ignored_joints, 3)}.",
            "Give a URDF in which these joints are fixed.",
        )


def _write_csv(take: Take, path: Path) -> None:
    """Write the Foxglove layout, with all digits of every number."""
    motion = take.motion
    table = [motion.root_pos, xyzw_from_wxyz(motion.root_quat_wxyz), motion.joint_pos]
    rows = np.concatenate(table, axis=1).tolist()
    lines = [",".join((*ROOT_COLUMNS, *motion.joint_names))]
    lines += [f"{frame}," + ",".join(map(repr, row)) for frame, row in enumerate(rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _write_npz(take: Take, path: Path) -> None:
    """Write the arrays of `Motion`, in double precision."""
    motion = take.motion
    with path.open("wb") as file:
        np.savez_compressed(
            file,
            fps=motion.fps,
            joint_names=np.array(motion.joint_names),
            joint_pos=motion.joint_pos,
            root_pos=motion.root_pos,
            root_quat_wxyz=motion.root_quat_wxyz,
        )


def _write_tracking(take: Take, path: Path) -> None:
    """Write the format of the motion loaders of whole_body_tracking (BeyondMimic) and mjlab.

    The names are an addition: their own files have none, and the loaders ignore them.
    """
    states = take.states()
    with path.open("wb") as file:
        np.savez(
            file,
            fps=np.array([take.format.fps]),
            joint_pos=states.joint_pos,
            joint_vel=states.joint_vel,
            body_pos_w=states.body_pos_w,
            body_quat_w=states.body_quat_w,
            body_lin_vel_w=states.body_lin_vel_w,
            body_ang_vel_w=states.body_ang_vel_w,
            joint_names=np.array(names_in_order(take.layout.order)),
            body_names=np.array(take.body_names),
        )


def _write_holosoma(take: Take, path: Path) -> None:
    """Write holosoma's format: `qpos` and `qvel` of MuJoCo, with the world as a body."""
    states = take.states()
    world = np.zeros((take.n_frames, 1, 3), np.float32)
    upright = np.concatenate([world[..., :1] + 1, world], axis=2)
    pelvis = states.body_pos_w[:, 0], states.body_quat_w[:, 0]
    with path.open("wb") as file:
        np.savez(
            file,
            fps=np.array([take.format.fps]),
            joint_pos=np.concatenate([*pelvis, states.joint_pos], axis=1),
            joint_vel=np.concatenate(
                [states.root_lin_vel, states.root_ang_vel, states.joint_vel], axis=1
            ),
            body_pos_w=np.concatenate([world, states.body_pos_w], axis=1),
            body_quat_w=np.concatenate([upright, states.body_quat_w], axis=1),
            body_lin_vel_w=np.concatenate([world, states.body_lin_vel_w], axis=1),
            body_ang_vel_w=np.concatenate([world, states.body_ang_vel_w], axis=1),
            joint_names=np.array(names_in_order(take.layout.order)),
            body_names=np.array(["world", *take.body_names]),
        )


def _write_sonic(take: Take, path: Path) -> None:
    """Write the format of SONIC's C++ reader: a table for each array, and a list of the bodies.

    A body's number is its index in Isaac Lab's order of all bodies.
    """
    states, n_bodies = take.states(), len(take.links)
    names = {
        "joint_pos": [f"joint_{i}" for i in range(N_JOINTS)],
        "joint_vel": [f"joint_vel_{i}" for i in range(N_JOINTS)],
        "body_pos": [f"body_{i}_{axis}" for i in range(n_bodies) for axis in "xyz"],
        "body_quat": [f"body_{i}_{axis}" for i in range(n_bodies) for axis in "wxyz"],
        "body_lin_vel": [f"body_{i}_vel_{axis}" for i in range(n_bodies) for axis in "xyz"],
        "body_ang_vel": [f"body_{i}_angvel_{axis}" for i in range(n_bodies) for axis in "xyz"],
    }
    for name, columns in names.items():
        values = getattr(states, name if name.startswith("joint") else f"{name}_w")
        with (path / f"{name}.csv").open("wb") as file:
            file.write((",".join(columns) + "\n").encode())
            _write_rows(file, values.reshape(take.n_frames, -1), take.motion.name)
    joint_of_link = take.robot.joint_of_link[take.links].tolist()
    numbers = [0 if joint < 0 else 1 + take.joints.index(joint) for joint in joint_of_link]
    (path / "metadata.txt").write_text(
        f"Metadata for: {take.motion.name}\n{'=' * 30}\n\nBody part indexes:\n"
        f"[{' '.join(map(str, numbers))}]\n\nTotal timesteps: {take.n_frames}\n",
        encoding="utf-8",
    )


def _write_lafan1(take: Take, path: Path) -> None:
    """Write 36 columns without a header: position, quaternion (xyzw), joints in motor order."""
    frames = take.frames
    table = [frames.root_pos, xyzw_from_wxyz(frames.root_quat_wxyz), frames.joint_pos]
    with path.open("wb") as file:
        _write_rows(file, np.concatenate(table, axis=1), take.motion.name)


def _write_gmr(take: Take, path: Path) -> None:
    """Write GMR's pickled dict with joint names; `local_body_pos` is in the pelvis's frame."""
    motion, robot = take.motion, take.robot
    names = dict.fromkeys((*robot.link_names, *_OF_GMR))
    local = np.empty((motion.n_frames, len(names), 3), np.float32)
    for first in range(0, motion.n_frames, BLOCK):
        part = slice(first, first + BLOCK)
        pose = forward_kinematics(
            robot, motion.joint_pos[part], np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
        )
        local[part, : len(robot.link_names)] = pose.pos
        for body, name in enumerate(names):
            if name not in robot.link_names:
                parent, origin = _OF_GMR[name]
                link = robot.link_index(parent)
                offset = quat_rotate(pose.quat_wxyz[:, link], np.array(origin))
                local[part, body] = pose.pos[:, link] + offset
        take.on_progress(min(1.0, part.stop / motion.n_frames))
    content = {
        "fps": motion.fps,
        "root_pos": motion.root_pos,
        "root_rot": xyzw_from_wxyz(motion.root_quat_wxyz),
        "dof_pos": motion.joint_pos,
        "local_body_pos": local,
        "link_body_list": list(names),
        "joint_names": list(JOINT_NAMES),
    }
    with path.open("wb") as file:
        _Pickler(file, protocol=4).dump(content)


class _Pickler(pickle.Pickler):
    """Pickles arrays so that every numpy version reads them.

    numpy 2 itself would name a module that numpy 1 lacks.
    """

    def reducer_override(self, value: Any) -> Any:
        if type(value) is not np.ndarray:
            return NotImplemented
        return np.ndarray, ((0,), "b"), np.ascontiguousarray(value).__reduce__()[2]


def _write_rows(file: Any, values: NDArray[Any], name: str) -> None:
    """Write numbers (T, N) as lines of text with six decimals.

    Python formats two million numbers a second; this function is twenty times as fast. The integer
    part, four decimals, and two decimals with the separator are looked up in tables of 8, 4 and 4
    bytes. The zero bytes of padding are removed at the end.

    Raises:
        MotionError: a number is 10,000 or more.
    """
    if np.abs(values).max() >= _LARGEST_IN_TEXT:
        raise MotionError(
            f"{name} has a position or a velocity of {np.abs(values).max():.0f}, but text in this "
            f"format has numbers below {_LARGEST_IN_TEXT:,}.",
            "Check its units and its frame rate.",
        )
    n_columns = values.shape[1]
    wholes = [f"{sign}{n}." for sign in ("", "-") for n in range(_LARGEST_IN_TEXT + 1)]
    before = np.array(wholes, "S8").view(np.uint64)
    middle = np.array([f"{n:04}" for n in range(10_000)], "S4").view(np.uint32)
    after = np.array([f"{n:02}{end}" for end in ",\n" for n in range(100)], "S4").view(np.uint32)
    last = np.zeros(n_columns, np.int64)
    last[-1] = 100
    cells = np.empty(
        (BLOCK, n_columns), [("before", np.uint64), ("middle", np.uint32), ("after", np.uint32)]
    )
    for first in range(0, len(values), BLOCK):
        block = values[first : first + BLOCK].astype(np.float64)
        scaled = np.rint(np.abs(block) * 10**_DECIMALS).astype(np.int64)
        hundreds, final = np.divmod(scaled, 100)
        whole, decimals = np.divmod(hundreds, 10_000)
        rows = cells[: len(block)]
        rows["before"] = before[whole + (block < 0) * (_LARGEST_IN_TEXT + 1)]
        rows["middle"], rows["after"] = middle[decimals], after[final + last]
        file.write(rows.tobytes().translate(None, b"\0"))


_ISAACLAB: Final = Layout("isaaclab", of_centre=True)
_SONIC: Final = (
    "pelvis",
    *(f"{side}_{part}_link" for side in ("left", "right") for part in _SONIC_LEG),
    "torso_link",
    *(f"{side}_{part}_link" for side in ("left", "right") for part in _SONIC_ARM),
)
#: g1stream's own formats, read back to the last bit, for any joints of a robot.
_OWN: Final = ("csv", "npz")

# `fps` is an array of integers or floats, as in the files of the format's own script.
FORMATS: Final = {
    "csv": Format(_write_csv, ".csv"),
    "npz": Format(_write_npz, ".npz"),
    "beyondmimic": Format(_write_tracking, ".npz", 50, _ISAACLAB),
    "mjlab": Format(_write_tracking, ".npz", 50.0, Layout("motor", of_centre=False)),
    "holosoma": Format(_write_holosoma, ".npz", 50, Layout("motor", of_centre=True)),
    "sonic": Format(_write_sonic, "", 50, _ISAACLAB._replace(bodies=_SONIC)),
    "lafan1": Format(_write_lafan1, ".csv", 30),
    "gmr": Format(_write_gmr, ".pkl"),
}
"""The supported formats for writing, by name. The first two are chosen by the suffix alone."""
