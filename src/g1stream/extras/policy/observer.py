"""Computes a policy's observations in a run, step by step."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.extras.policy.observation import TERMS, Inputs, Pose, ReferenceFrame, RobotState
from g1stream.robot.kinematics import forward_kinematics
from g1stream.robot.rotations import (
    quat_conj,
    quat_from_yaw,
    quat_mul,
    quat_rotate,
    quat_rotate_inverse,
    yaw_of,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from g1stream.extras.policy.contract import PolicyContract
    from g1stream.robot.model import G1
    from g1stream.types import Floats

__all__ = ["Observer", "anchor_poses", "frame_of", "pelvis_poses", "state_of"]

_ORIGIN: Final = np.zeros(3)
_UPRIGHT: Final = np.array([1.0, 0.0, 0.0, 0.0])
_ON_FLOOR: Final = np.array([1.0, 1.0, 0.0])
#: Inputs of a robot without a walking command: velocities, and the phases of its legs.
_STANDS: Final = np.zeros(3), np.full(2, np.pi)


class Observer:
    """Computes the observation of each step, and the targets of its action.

    Args:
        contract: the policy's contract.

    Attributes:
        last_action: (joints,) action of the step before, in the policy's order.
    """

    def __init__(self, contract: PolicyContract) -> None:
        self._contract = contract
        self._limits = [np.array(one.clip) if one.clip else None for one in contract.terms]
        self._scales = [np.array(one.scale) for one in contract.terms]
        self._order, self._default = contract.order, np.array(contract.default_pos)
        self._frames: deque[ReferenceFrame | None] = deque(maxlen=contract.lag + 1)
        self._histories: list[deque[Floats]] = [
            deque(maxlen=one.history + one.behind) for one in contract.terms
        ]
        # Terms that repeat values of others follow them.
        indices = range(len(contract.terms))
        self._own_first = sorted(indices, key=lambda at: len(contract.terms[at].of) > 0)
        self._yaw0, self._origin = _UPRIGHT, (_ORIGIN, _ORIGIN)
        self.last_action = self._smoothed = np.zeros(len(self._default))

    def begin(self, state: RobotState, frame: ReferenceFrame) -> None:
        """Align heading and place of the motion's anchor with the robot's at the start."""
        own, its = (quat_from_yaw(yaw_of(one.anchor.quat_wxyz)) for one in (state, frame))
        self._yaw0 = quat_mul(own, quat_conj(its))
        self._origin = frame.anchor.pos * _ON_FLOOR, state.anchor.pos * _ON_FLOOR
        self._frames.clear()
        for history in self._histories:
            history.clear()
        self.last_action = self._smoothed = np.zeros(len(self._default))

    def observe(self, state: RobotState, frame: ReferenceFrame | None) -> Floats:
        """The observation (width,) of the next step. The reference is that of `lag` steps ago.

        `frame` is None for a policy that tracks no motion.
        """
        contract, parts = self._contract, [_ORIGIN] * len(self._histories)
        self._frames.append(frame)
        inputs = Inputs(
            state,
            self._frames[0],
            self._yaw0,
            self._origin,
            self._order,
            self._default,
            self.last_action,
            *_STANDS,
        )
        now: dict[str, Floats] = {}
        for at in self._own_first:
            term, history, limits = contract.terms[at], self._histories[at], self._limits[at]
            repeated = [now[name] for name in term.of]
            values = np.concatenate(repeated) if term.of else TERMS[term.value].value(inputs)
            values = self._scales[at] * values
            if limits is not None:
                values = np.clip(values, *limits)
            now[term.name] = values
            if not history:
                before = np.zeros_like(values) if contract.history_start == "zeros" else values
                history.extend([before] * (term.history + term.behind))
            history.append(values)
            steps = list(history)[: term.history]
            parts[at] = np.concatenate(steps[::-1] if term.newest_first else steps)
        observation, most = np.concatenate(parts), contract.clip
        return np.clip(observation, -most, most) if most else observation

    def act(self, action: Floats) -> Floats:
        """The targets (29,), rad, motor order, of the action of a step (joints,), which follows."""
        self.last_action, share = action, self._contract.action_smoothing
        self._smoothed = share * self._smoothed + (1.0 - share) * action if share else action
        return self._contract.targets(self._smoothed)


def anchor_poses(
    contract: PolicyContract, robot: G1, joint_pos: Floats, pos: Floats, quat_wxyz: Floats
) -> list[Pose]:
    """Poses of the anchor link from joint_pos (T, 29), pelvis pos (T, 3) and quat_wxyz (T, 4)."""
    link = robot.link_names.index(contract.anchor or robot.link_names[0])
    poses = forward_kinematics(robot, joint_pos, pos, quat_wxyz, [link])
    return [Pose(*one) for one in zip(poses.pos[:, link], poses.quat_wxyz[:, link], strict=True)]


def pelvis_poses(
    contract: PolicyContract, robot: G1, joint_pos: Floats, anchors: Sequence[Pose]
) -> tuple[Floats, Floats]:
    """Pelvis pos (T, 3) and quat_wxyz (T, 4) from joint_pos (T, 29) and poses of the anchor."""
    below = anchor_poses(contract, robot, joint_pos, _ORIGIN, _UPRIGHT)
    offset, turn = (np.array(values) for values in zip(*below, strict=True))
    pos, anchor_quat = (np.array(values) for values in zip(*anchors, strict=True))
    quat = quat_mul(anchor_quat, quat_conj(turn))
    return pos - quat_rotate(quat, offset), quat


def state_of(
    contract: PolicyContract,
    robot: G1,
    joint_pos: NDArray[np.floating],
    joint_vel: NDArray[np.floating],
    quat_wxyz: NDArray[np.floating],
    gyroscope: NDArray[np.floating],
) -> RobotState:
    """The robot's state from a LowState, without a place: joints (29,) rad and rad/s."""
    q, quat = joint_pos.astype(np.float64), quat_wxyz.astype(np.float64)
    quat /= np.sqrt(quat @ quat)
    return RobotState(
        q,
        joint_vel.astype(np.float64),
        quat,
        gyroscope.astype(np.float64),
        _ORIGIN,
        anchor_poses(contract, robot, q[None], _ORIGIN, quat)[0],
    )


def frame_of(
    contract: PolicyContract,
    robot: G1,
    joint_pos: Floats,
    joint_vel: Floats,
    pelvis: Pose,
    lin_vel: Floats,
    ang_vel: Floats,
) -> ReferenceFrame:
    """The reference of one step: joints (29,) rad, rad/s, and the pelvis.

    Its velocities are lin_vel (3,) m/s, world, and ang_vel (3,) rad/s, pelvis frame.
    """
    anchor = anchor_poses(contract, robot, joint_pos[None], *pelvis)[0]
    own = quat_rotate_inverse(pelvis.quat_wxyz, lin_vel)
    return ReferenceFrame(joint_pos, joint_vel, anchor, 0.0, pelvis, own, ang_vel)
