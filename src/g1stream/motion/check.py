"""What a motion asks of a robot: its size, its limits, its speed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.motion.streamed import STREAM_RATE, HeldJoint, JointSpeed, measure_streamed
from g1stream.robot.joints import JOINT_GROUPS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from g1stream.motion.motion import Motion
    from g1stream.robot.model import G1

__all__ = [
    "GroupRange",
    "HeldJoint",
    "JointSpeed",
    "JointStep",
    "LimitViolation",
    "MotionReport",
    "RootTravel",
    "check_motion",
]

#: Files have six decimals, so an angle at a limit may be written this far beyond it.
_ROUNDING: Final = 1e-6


@dataclass(frozen=True)
class LimitViolation:
    """A joint beyond its position limit: the worst frame of that joint on that side.

    Attributes:
        joint: its name.
        frame: where it is furthest out.
        value: rad, there.
        limit: rad, the one that is passed.
        n_frames: in how many frames it is beyond that limit.
    """

    joint: str
    frame: int
    value: float
    limit: float
    n_frames: int


@dataclass(frozen=True)
class JointStep:
    """How far a joint goes from a frame to the next: `value` rad, after `frame`."""

    joint: str
    frame: int
    value: float


@dataclass(frozen=True)
class RootTravel:
    """Where the root goes.

    Attributes:
        path: m, length of its way over the ground.
        displacement: m, from where it begins to where it ends, over the ground.
        lowest: m, its least height.
        highest: m, its greatest height.
    """

    path: float
    displacement: float
    lowest: float
    highest: float


@dataclass(frozen=True)
class GroupRange:
    """The least and the greatest angle, rad, that any joint of a group takes."""

    group: str
    lowest: float
    highest: float


@dataclass(frozen=True)
class MotionReport:
    """What `check_motion` found.

    Attributes:
        name: of the motion.
        n_frames: how many.
        fps: frames a second.
        duration: s.
        limit_violations: joints beyond their position limits, the furthest out first.
        fastest: of the joint velocities at the frames (central differences, as most tools compute
            them), the greatest.
        rate: targets a second with which the next two are measured, Hz.
        position_margin: rad, by which position limits are narrowed for `held`.
        fastest_streamed: the greatest speed of each joint that the spline through the frames asks
            for, largest share of its limit first.
        held: joints that the spline asks beyond a limit, the furthest out first. It overshoots
            between frames, so that there may be some where every frame is within.
        largest_step: between two neighbouring frames.
        root: where the root goes.
        groups: range of angles by limb.
        warnings: of the reader, as the motion has them.
    """

    name: str
    n_frames: int
    fps: float
    duration: float
    limit_violations: tuple[LimitViolation, ...]
    fastest: JointSpeed
    rate: float
    position_margin: float
    fastest_streamed: tuple[JointSpeed, ...]
    held: tuple[HeldJoint, ...]
    largest_step: JointStep
    root: RootTravel
    groups: tuple[GroupRange, ...]
    warnings: tuple[str, ...]

    @property
    def too_fast(self) -> tuple[JointSpeed, ...]:
        """Joints that are asked to move faster than their limit, the worst first."""
        return tuple(speed for speed in self.fastest_streamed if speed.value > speed.limit)

    @property
    def n_held(self) -> int:
        """How many joint targets would be held at a limit."""
        return sum(joint.n_targets for joint in self.held)

    @property
    def within_limits(self) -> bool:
        """Whether every frame is within the position limits, and all that is asked for in speed.

        Targets that are held between frames are not counted against a motion: they are safe.
        """
        return not self.limit_violations and not self.too_fast


def check_motion(
    motion: Motion, robot: G1, *, rate: float = STREAM_RATE, position_margin: float = 0.0
) -> MotionReport:
    """Measure a motion against the robot's limits.

    Args:
        motion: what is asked.
        robot: of whom.
        rate: joint targets a second when it is streamed, Hz.
        position_margin: rad, kept from position limits when it is streamed.

    Raises:
        MotionError: the motion's joints are not the robot's, in the robot's order.
    """
    motion.require_joints_of(robot)
    fastest_streamed, held = measure_streamed(motion, robot, rate, position_margin)
    return MotionReport(
        name=motion.name,
        n_frames=motion.n_frames,
        fps=motion.fps,
        duration=motion.duration,
        limit_violations=_limit_violations(motion, robot),
        fastest=_fastest(motion, robot),
        rate=rate,
        position_margin=position_margin,
        fastest_streamed=fastest_streamed,
        held=held,
        largest_step=_largest_step(motion),
        root=_root_travel(motion.root_pos),
        groups=tuple(
            _group_range(name, motion.joint_pos[:, joints]) for name, joints in JOINT_GROUPS.items()
        ),
        warnings=motion.warnings,
    )


def _limit_violations(motion: Motion, robot: G1) -> tuple[LimitViolation, ...]:
    found = []
    for limit, excess in (
        (robot.lower, robot.lower - motion.joint_pos),
        (robot.upper, motion.joint_pos - robot.upper),
    ):
        for joint in np.flatnonzero(excess.max(axis=0) > _ROUNDING):
            frame = int(excess[:, joint].argmax())
            violation = LimitViolation(
                motion.joint_names[joint],
                frame,
                float(motion.joint_pos[frame, joint]),
                float(limit[joint]),
                int((excess[:, joint] > _ROUNDING).sum()),
            )
            found.append(violation)
    return tuple(sorted(found, key=lambda v: -abs(v.value - v.limit)))


def _fastest(motion: Motion, robot: G1) -> JointSpeed:
    speed = np.abs(np.gradient(motion.joint_pos, axis=0)) * motion.fps
    frame, joint = _argmax(speed)
    return JointSpeed(
        motion.joint_names[joint],
        frame / motion.fps,
        float(speed[frame, joint]),
        float(robot.velocity[joint]),
    )


def _largest_step(motion: Motion) -> JointStep:
    steps = np.abs(np.diff(motion.joint_pos, axis=0))
    frame, joint = _argmax(steps)
    return JointStep(motion.joint_names[joint], frame, float(steps[frame, joint]))


def _root_travel(root_pos: NDArray[np.float64]) -> RootTravel:
    ground, height = root_pos[:, :2], root_pos[:, 2]
    return RootTravel(
        path=float(np.linalg.norm(np.diff(ground, axis=0), axis=1).sum()),
        displacement=float(np.linalg.norm(ground[-1] - ground[0])),
        lowest=float(height.min()),
        highest=float(height.max()),
    )


def _group_range(name: str, angles: NDArray[np.float64]) -> GroupRange:
    return GroupRange(name, float(angles.min()), float(angles.max()))


def _argmax(values: NDArray[np.float64]) -> tuple[int, int]:
    row, column = np.unravel_index(int(values.argmax()), values.shape)
    return int(row), int(column)
