"""Check of a policy's first actions with a perfectly tracked reference."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.errors import ConfigError
from g1stream.extras.policy.observation import Pose, ReferenceFrame, RobotState
from g1stream.extras.policy.observer import Observer, anchor_poses, pelvis_poses
from g1stream.robot.rotations import (
    quat_conj,
    quat_mul,
    quat_rotate_inverse,
    rotation_vector,
    wxyz_from_xyzw,
)
from g1stream.session.records import Record

if TYPE_CHECKING:
    from collections.abc import Sequence

    from g1stream.extras.policy.contract import PolicyContract
    from g1stream.extras.policy.network import Network
    from g1stream.motion.motion import Motion
    from g1stream.robot.model import G1
    from g1stream.types import Floats

__all__ = ["FirstActions", "first_actions", "held_frame"]

#: Checked length of the motion, s.
_LENGTH: Final = 5.0
#: Largest RMS difference between the motion in a policy and the given motion, rad.
_SAME: Final = 0.05
#: Largest plausible RMS distance of targets from the reference, rad: at rest, and for each rad/s
#: (RMS) of the reference. In 5 s parts of a dance two published trackers have 0.19 to 0.48 rad, at
#: most 0.95 of this limit. A wrong order, term or scale gives 0.4 to 2.6 rad.
_FAR: Final = 0.35, 0.15


class FirstActions(Record, frozen=True):
    """Targets of the first steps of a perfectly tracked motion.

    Attributes:
        steps: number of policy steps.
        rms_rad: RMS distance of the targets from the reference, over all joints.
        worst_rad: largest distance.
        worst_joint: joint of the largest distance.
        worst_time_s: time of the largest distance.
        beyond_limits: fraction of the targets beyond joint limits.
        problem: reason not to play it; empty without a problem.
    """

    steps: int
    rms_rad: float
    worst_rad: float
    worst_joint: str
    worst_time_s: float
    beyond_limits: float
    problem: str = ""

    def __str__(self) -> str:
        return (
            f"{self.steps} steps of perfect tracking: targets {self.rms_rad:.3f} rad (RMS) from "
            f"the reference, at most {self.worst_rad:.2f} rad ({self.worst_joint} at "
            f"{self.worst_time_s:.2f} s); {self.beyond_limits:.1%} of them beyond limits"
        )


def first_actions(
    contract: PolicyContract, network: Network, robot: G1, motion: Motion | None = None
) -> FirstActions | None:
    """Run the policy for the first five seconds of a motion with the robot at the reference.

    Args:
        contract: the policy's contract.
        network: the policy's network.
        robot: the robot.
        motion: the motion to track; None for the motion in the policy.

    Returns:
        None if there is no motion.

    Raises:
        ConfigError: the policy tracks no motion, or contains another motion; or an action is not
            finite.
        MotionError: the motion has no sample at the policy's rate.
    """
    if contract.reference == "none":
        if motion is None:
            return None
        raise ConfigError(
            f"The policy {contract.path} tracks no motion: it does not observe one.",
            "Give a policy whose observation has motion_command.",
        )
    frames = None
    if motion is not None:
        frames = _given_frames(contract, robot, motion)
    if contract.reference == "in the policy":
        number = len(frames) if frames else round(_LENGTH * contract.rate)
        held = [held_frame(contract, network, step) for step in range(number)]
        if frames:
            _check_same(contract, held, frames)
        frames = held
    if frames is None:
        return None
    return _compared(contract, robot, frames, _targets(contract, network, robot, frames))


def held_frame(contract: PolicyContract, network: Network, step: int) -> ReferenceFrame:
    """The reference of a step from the motion in a policy."""
    out = {
        name: value.astype(np.float64)
        for name, value in network.run(np.zeros(network.width), step).items()
    }
    joint_pos, joint_vel = map(contract.in_motor_order, (out["joint_pos"], out["joint_vel"]))
    if {"ref_pos_xyz", "ref_quat_xyzw"} <= out.keys():  # holosoma
        pose = Pose(out["ref_pos_xyz"], wxyz_from_xyzw(out["ref_quat_xyzw"]))
        return ReferenceFrame(joint_pos, joint_vel, pose)
    bodies = network.metadata.get("body_names", "").split(",")
    link = contract.anchor or "pelvis"
    if not {"body_pos_w", "body_quat_w"} <= out.keys() or link not in bodies:
        raise ConfigError(
            f"The motion in {contract.path} has no pose of {link}.",
            "Export the policy again, with body_names in its metadata.",
        )
    anchor = bodies.index(link)
    pose = Pose(out["body_pos_w"][anchor], out["body_quat_w"][anchor])
    return ReferenceFrame(joint_pos, joint_vel, pose)


def _given_frames(contract: PolicyContract, robot: G1, motion: Motion) -> list[ReferenceFrame]:
    """The first seconds of a motion at the rate of a policy."""
    most, parts = round(_LENGTH * contract.rate), []
    for numbers, part in motion.samples(contract.rate, 0, motion.n_frames):
        parts.append((part.joint_pos, part.joint_vel, part.root_pos, part.root_quat_wxyz))
        if numbers.stop >= most:
            break
    joint_pos, joint_vel, *pelvis = (np.concatenate(one)[:most] for one in zip(*parts, strict=True))
    anchors = anchor_poses(contract, robot, joint_pos, *pelvis)
    shares = np.arange(len(anchors)) / (contract.rate * motion.duration)
    values = zip(joint_pos, joint_vel, anchors, shares.tolist(), strict=True)
    return [ReferenceFrame(*one) for one in values]


def _check_same(
    contract: PolicyContract, held: Sequence[ReferenceFrame], given: Sequence[ReferenceFrame]
) -> None:
    both = ([frame.joint_pos for frame in frames] for frames in (held, given))
    ours, theirs = map(np.array, both)
    difference = float(np.sqrt(np.mean((ours - theirs) ** 2)))
    if difference > _SAME:
        raise ConfigError(
            f"The policy {contract.path} contains another motion: its joint positions differ by "
            f"{difference:.2f} rad (RMS) in the first seconds, more than {_SAME:g}.",
            "Give the motion of the training; the policy's file is one, too.",
        )


def _states(
    contract: PolicyContract, robot: G1, frames: Sequence[ReferenceFrame]
) -> list[RobotState]:
    """The robot at the reference, with velocities from differences."""
    joint_pos = np.array([frame.joint_pos for frame in frames])
    anchors = [frame.anchor for frame in frames]
    poses = pelvis_poses(contract, robot, joint_pos, anchors)
    pelvis = [Pose(*one) for one in zip(*poses, strict=True)]
    states = []
    for i, (frame, here) in enumerate(zip(frames, pelvis, strict=True)):
        low, high = max(0, i - 1), min(i + 1, len(frames) - 1)
        seconds = (high - low) / contract.rate
        turned = quat_mul(quat_conj(pelvis[low].quat_wxyz), pelvis[high].quat_wxyz)
        moved = pelvis[high].pos - pelvis[low].pos
        states.append(
            RobotState(
                frame.joint_pos,
                frame.joint_vel,
                here.quat_wxyz,
                rotation_vector(turned) / seconds,
                quat_rotate_inverse(here.quat_wxyz, moved) / seconds,
                frame.anchor,
            )
        )
    return states


def _targets(
    contract: PolicyContract, network: Network, robot: G1, frames: Sequence[ReferenceFrame]
) -> Floats:
    """Targets (N, 29) rad, motor order."""
    observer, targets = Observer(contract), []
    states = _states(contract, robot, frames)
    observer.begin(states[0], frames[0])
    for step, (state, frame) in enumerate(zip(states, frames, strict=True)):
        action = network.act(observer.observe(state, frame), step, contract.action)
        if not np.isfinite(action).all():
            raise ConfigError(
                f"The policy {contract.path} gives an action that is not finite at step {step}.",
                "The policy cannot be played; check its terms, scales and metadata.",
            )
        targets.append(observer.act(action))
    return np.array(targets)


def _compared(
    contract: PolicyContract, robot: G1, frames: Sequence[ReferenceFrame], targets: Floats
) -> FirstActions:
    distance = np.abs(targets - [frame.joint_pos for frame in frames])
    step, joint = np.unravel_index(distance.argmax(), distance.shape)
    rms = float(np.sqrt(np.mean(distance**2)))
    speed = float(np.sqrt(np.mean(np.square([frame.joint_vel for frame in frames]))))
    most = _FAR[0] + _FAR[1] * speed
    problem = (
        f"targets are {rms:.2f} rad (RMS) from a perfectly tracked reference, more than "
        f"{most:.2f}: the motion is not that of the training, or a term, the joint order, "
        "a scale or the default pose is wrong"
    )
    return FirstActions(
        steps=len(targets),
        rms_rad=rms,
        problem=problem if rms > most else "",
        worst_rad=float(distance.max()),
        worst_joint=robot.joint_names[joint],
        worst_time_s=float(step / contract.rate),
        beyond_limits=float(np.mean((targets < robot.lower) | (targets > robot.upper))),
    )
