"""Check of a motion against a robot: the report of `g1stream motion`."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.errors import RobotError
from g1stream.motion.limits import JointPeak, LimitReport, frame_peaks, measure_limits
from g1stream.motion.motion import height_of_floor
from g1stream.motion.trajectory import Trajectory
from g1stream.robot.joints import JOINT_GROUPS, JOINT_NAMES
from g1stream.robot.model import G1
from g1stream.robot.rotations import tilt_of
from g1stream.types import STREAM_RATE

if TYPE_CHECKING:
    from g1stream.motion.limits import Interval
    from g1stream.motion.motion import Motion
    from g1stream.types import Floats

__all__ = [
    "Dropped",
    "JointStep",
    "MotionReport",
    "RootTravel",
    "check_motion",
    "dropped_joints",
]

#: Two turns, rad. No joint of a G1 moves so far, but angles in degrees soon do.
_LARGEST_ANGLE: Final = 4.0 * np.pi
#: Larger numbers are not degrees either.
_LARGEST_DEGREES: Final = 720.0
#: No pelvis is higher than this for most of a motion, m; above the second, the unit is mm.
_HIGHEST: Final = 10.0
_MILLIMETRES: Final = 300.0
#: A larger step between frames is no movement of a joint, rad; a LAFAN1 dance has 1.08.
_LARGE_STEP: Final = 0.5


@dataclass(frozen=True)
class JointStep:
    """Change of a joint from one frame to the next: `value` rad, after `frame`."""

    joint: str
    frame: int
    value: float


@dataclass(frozen=True)
class RootTravel:
    """Travel of the root, m, and its largest tilt."""

    path: float  # length of the path along the ground
    displacement: float  # from start to end along the ground
    lowest: float
    highest: float
    tilt: float  # largest tilt of the pelvis from upright, rad
    tilt_frame: int


@dataclass(frozen=True)
class Dropped:
    """Joints of a motion that a robot does not have.

    Attributes:
        robot: name of the robot.
        joints: names of the joints.
        moved: names of those that are not 0 throughout the motion.
    """

    robot: str
    joints: tuple[str, ...]
    moved: tuple[str, ...]

    def __str__(self) -> str:
        lacks = f"{self.robot} lacks {_short(self.joints)}, which stay at 0"
        if not self.moved:
            return f"{lacks}, as in the motion"
        which = "all" if self.moved == self.joints else _short(self.moved)
        return f"{lacks}; the motion moves {which} of them"


@dataclass(frozen=True)
class MotionReport:
    """A motion's size, its joint speeds, and the limits that it exceeds."""

    name: str
    n_frames: int
    fps: float
    duration: float  # s
    frames_beyond: tuple[JointPeak, ...]  # beyond a position limit in the frames, furthest first
    fastest: JointPeak  # at the frames, by central differences as most tools compute it
    streamed: LimitReport  # of the spline through the frames
    largest_step: JointStep
    root: RootTravel
    groups: dict[str, tuple[float, float]]  # lowest and highest angle by limb, rad
    warnings: tuple[str, ...]  # from the reader
    operations: tuple[str, ...] = ()  # changes to the motion in the file
    floor: float | None = None  # height of the standing feet, m; None: none stands, or unknown
    dropped: Dropped | None = None  # joints that the robot lacks
    in_si_units: bool = True  # plausible as rad and m
    suspicion: str = ""  # likely fault, such as "frame 7 is a spike of 2.4 rad"

    @property
    def within_limits(self) -> bool:
        """Whether all frames keep the position limits and the spline keeps the speed limits.

        Targets that are clamped to a position limit between frames do not count: they are safe.
        """
        return not self.frames_beyond and not self.streamed.too_fast

    @property
    def passed(self) -> bool:
        """Whether it is within the limits, and in radians and metres, despite any warnings."""
        return self.within_limits and self.in_si_units


def _short(joints: tuple[str, ...]) -> str:
    return ", ".join(name.removesuffix("_joint") for name in joints)


def dropped_joints(motion: Motion, robot: G1) -> Dropped | None:
    """The joints of a motion that the robot lacks; None if it has all joints."""
    absent = ~robot.present
    if not absent.any():
        return None
    moved = absent & (motion.joint_pos != 0.0).any(axis=0)
    joints, missed = (tuple(JOINT_NAMES[i] for i in np.flatnonzero(one)) for one in (absent, moved))
    return Dropped(robot.joint_set.name, joints, missed)


def check_motion(
    motion: Motion,
    robot: G1,
    *,
    rate: float = STREAM_RATE,
    position_margin: float = 0.0,
    trajectory: Trajectory | None = None,
    interval: Interval | None = None,
) -> MotionReport:
    """Check a motion against the robot's limits.

    Args:
        motion: the motion.
        robot: the robot with the limits.
        rate: joint targets per second when it is streamed, Hz.
        position_margin: distance from position limits when it is streamed, rad.
        trajectory: spline through its frames, which repeats if the motion does; made if None.
        interval: the part whose limits are checked; the whole motion if None.
    """
    frames_beyond, fastest = frame_peaks(motion, robot, interval)
    largest_step, floor = _largest_step(motion), _floor(motion, robot)
    trajectory = trajectory or Trajectory(motion)
    streamed = measure_limits(
        trajectory, robot, interval, rate=rate, position_margin=position_margin
    )
    wrong_unit = _wrong_unit(motion)
    suspicion = wrong_unit
    if not wrong_unit and (frames_beyond or streamed.too_fast):
        suspicion = _suspicion(motion, (*frames_beyond, *streamed.too_fast)[0])
    return MotionReport(
        name=motion.name,
        n_frames=motion.n_frames,
        fps=motion.fps,
        duration=motion.duration,
        frames_beyond=frames_beyond,
        fastest=fastest,
        streamed=streamed,
        largest_step=largest_step,
        root=_root_travel(motion),
        groups={name: _range(motion.joint_pos[:, joints]) for name, joints in JOINT_GROUPS.items()},
        warnings=motion.warnings,
        operations=motion.operations,
        floor=floor,
        dropped=dropped_joints(motion, robot),
        in_si_units=not wrong_unit,
        suspicion=suspicion,
    )


def _wrong_unit(motion: Motion) -> str:
    """The unit that angles or positions seem to have if it is not SI; or ""."""
    angles, height = motion.joint_pos, float(np.median(motion.root_pos[:, 2]))
    row, column = divmod(int(np.abs(angles).argmax()), angles.shape[1])
    largest = f"{motion.joint_names[column]} is at {angles[row, column]:g} in frame {row}"
    if abs(angles[row, column]) > _LARGEST_DEGREES:
        return f"a cell were no angle: {largest}"
    if abs(angles[row, column]) > _LARGEST_ANGLE:
        return f"the angles were in degrees: {largest}"
    if abs(height) > _HIGHEST:
        unit = "millimetres" if abs(height) > _MILLIMETRES else "centimetres"
        return f"the positions were in {unit}: the pelvis is at a height of {height:.0f} m"
    return ""


def _suspicion(motion: Motion, worst: JointPeak) -> str:
    """The likely fault of a motion beyond a limit, if it can be identified; or ""."""
    one = motion.joint_pos[:, motion.joint_names.index(worst.joint)]
    steps = np.diff(one)
    near = max(0, round(worst.time * motion.fps) - 2)
    frame = near + int(np.abs(steps[near : near + 4]).argmax()) if near < len(steps) else near
    if frame >= len(steps) or abs(steps[frame]) < _LARGE_STEP:
        return ""
    for spike in (frame, frame + 1):  # the large step leads to the spike, or away from it
        around = one[[max(0, spike - 1), min(len(one) - 1, spike + 1)]]
        height = np.abs(one[spike] - around).min()
        if height > _LARGE_STEP and abs(around[1] - around[0]) < height / 2:
            return f"frame {spike} were a spike of {height:.2f} rad"
    before, after = steps[max(0, frame - 1)], steps[min(len(steps) - 1, frame + 1)]
    if max(abs(before), abs(after)) > abs(steps[frame]) / 3.0:
        return ""  # a fast movement
    return f"two motions were joined: {steps[frame]:+.2f} rad from frame {frame} to {frame + 1}"


def _largest_step(motion: Motion) -> JointStep:
    steps = np.diff(motion.joint_pos, axis=0)
    np.abs(steps, out=steps)
    frame, joint = divmod(int(steps.argmax()), steps.shape[1])
    return JointStep(motion.joint_names[joint], frame, float(steps[frame, joint]))


def _root_travel(motion: Motion) -> RootTravel:
    ground, height = motion.root_pos[:, :2], motion.root_pos[:, 2]
    furthest = int((motion.root_quat_wxyz[:, 1:3] ** 2).sum(axis=1).argmax())
    return RootTravel(
        path=float(np.linalg.norm(np.diff(ground, axis=0), axis=1).sum()),
        displacement=float(np.linalg.norm(ground[-1] - ground[0])),
        lowest=float(height.min()),
        highest=float(height.max()),
        tilt=tilt_of(motion.root_quat_wxyz[furthest]),
        tilt_frame=furthest,
    )


def _floor(motion: Motion, robot: G1) -> float | None:
    with suppress(RobotError):  # the robot's soles are unknown
        return height_of_floor(motion, robot)
    return None


def _range(values: Floats) -> tuple[float, float]:
    return float(values.min()), float(values.max())
