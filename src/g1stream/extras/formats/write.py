"""Motion files for other programs: what is checked, and the joints and bodies of their frames.

docs/formats.md describes the layouts, which the programs that read the files define.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple, get_args

import numpy as np

from g1stream.errors import MotionError, RobotError
from g1stream.extras.formats.orders import names_in_order
from g1stream.extras.formats.table import WRITTEN
from g1stream.files import check_not_input, check_suffix, complete_directory, complete_file
from g1stream.motion.motion import Motion
from g1stream.optional import load_object
from g1stream.robot.dynamics import GRAVITY, compiled_dynamics
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS
from g1stream.robot.kinematics import link_velocities, pose_blocks
from g1stream.robot.model import G1
from g1stream.robot.rotations import (
    quat_conj,
    quat_mul,
    quat_rotate,
    quat_rotate_inverse,
)
from g1stream.robot.urdf import KEPT_ROBOTS
from g1stream.text import counted, listed
from g1stream.types import Velocities

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from g1stream.types import Floats, JointOrder

__all__ = ["Layout", "Output", "Take", "write_motion"]

#: Central differences need one frame on either side.
_FEWEST_FRAMES: Final = 3


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


class Output(NamedTuple):
    """A format that is written.

    Attributes:
        write: writes a file, or a directory's content, at a path.
        suffix: suffix of a file; "" for a directory.
        fps: frame rate that its readers expect; None keeps the frames of the motion.
        layout: joints and bodies; None if a file has only joints and the pelvis.
        files: names of the files that a directory may have.
    """

    write: Callable[[Take, Path], None]
    suffix: str
    fps: float | None = None
    layout: Layout | None = None
    files: tuple[str, ...] = ()


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
    format: Output
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
        points = _centres_of_mass(self.robot) if self.layout.of_centre else None
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
    if name not in WRITTEN:
        raise MotionError(
            f"There is no format {name!r} to write.", f"Choose from {', '.join(WRITTEN)}."
        )
    form: Output = load_object(WRITTEN[name])
    take = Take(motion, form, robot or G1.default(), velocities, on_progress)
    _check(take, name)
    check_not_input(path, motion.source, *(part.source for part in motion.parts))
    if form.suffix:
        check_suffix(path, f"a file of the format {name}", form.suffix)
        place = complete_file(path, force=force)
    else:
        place = complete_directory(path, form.files, force=force)
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
    if not robot.present.all():
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


@lru_cache(maxsize=KEPT_ROBOTS)
def _centres_of_mass(robot: G1) -> Floats:
    """(L, 3) centre of mass of each link and the links fixed to it, m, in the link's frame.

    These are the bodies in simulators that merge the links of fixed joints. Zero for a link that is
    fixed to another one.

    Raises:
        RobotError: MuJoCo does not accept the URDF.
    """
    import mujoco

    model = compiled_dynamics(robot, GRAVITY)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    centres = np.zeros((len(robot.link_names), 3))
    for link in np.flatnonzero((robot.joint_of_link >= 0) | (robot.parent < 0)):
        body = model.body(robot.link_names[link]).id
        merged = model.body_weldid == body
        centre = np.average(data.xipos[merged], axis=0, weights=model.body_mass[merged])
        centres[link] = data.xmat[body].reshape(3, 3).T @ (centre - data.xpos[body])
    centres.setflags(write=False)
    return centres
