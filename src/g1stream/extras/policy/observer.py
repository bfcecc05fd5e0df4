"""Computes a policy's observations in a run, step by step."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.extras.policy.observation import TERMS, Body, Inputs, Pose
from g1stream.robot.kinematics import forward_kinematics
from g1stream.robot.rotations import quat_conj, quat_from_yaw, quat_mul, quat_rotate, yaw_of

if TYPE_CHECKING:
    from g1stream.extras.policy.contract import PolicyContract
    from g1stream.robot.model import G1
    from g1stream.types import Floats

__all__ = ["Observer", "anchor_poses", "pelvis_poses"]

_ORIGIN: Final = np.zeros(3)
_UPRIGHT: Final = np.array([1.0, 0.0, 0.0, 0.0])
_ON_FLOOR: Final = np.array([1.0, 1.0, 0.0])


class Observer:
    """Computes the observation of each step, and the targets of its action.

    Args:
        contract: the policy's contract.
        robot: the robot.

    Attributes:
        last_action: (joints,) action of the step before, in the policy's order.
    """

    def __init__(self, contract: PolicyContract, robot: G1) -> None:
        self._contract, self._robot = contract, robot
        self._limits = [np.array(one.clip) if one.clip else None for one in contract.terms]
        self._scales = [np.array(one.scale) for one in contract.terms]
        self._order, self._default = contract.order, np.array(contract.default_pos)
        self._frames: deque[Body] = deque(maxlen=contract.lag + 1)
        self._histories: list[deque[Floats]] = [
            deque(maxlen=one.history + one.behind) for one in contract.terms
        ]
        # Terms that repeat values of others follow them.
        indices = range(len(contract.terms))
        self._own_first = sorted(indices, key=lambda at: len(contract.terms[at].of) > 0)
        self._yaw0, self._origin = _UPRIGHT, (_ORIGIN, _ORIGIN)
        self.last_action = self._smoothed = np.zeros(len(self._default))

    def begin(self, state: Body, reference: Body) -> None:
        """Align heading and place of the motion's anchor with the robot's at the start.

        The worlds of both have their floor at height 0.
        """
        own, its = self._anchor(state), self._anchor(reference)
        own_yaw, its_yaw = (quat_from_yaw(yaw_of(one.quat_wxyz)) for one in (own, its))
        self._yaw0 = quat_mul(own_yaw, quat_conj(its_yaw))
        self._origin = its.pos * _ON_FLOOR, own.pos * _ON_FLOOR
        self._frames.clear()
        for history in self._histories:
            history.clear()
        self.last_action = self._smoothed = np.zeros(len(self._default))

    def _anchor(self, of: Body) -> Pose:
        if self._contract.anchor is None:
            return Pose(of.pos, of.quat_wxyz)
        given = of.joint_pos[None], of.pos, of.quat_wxyz
        (pos,), (quat,) = anchor_poses(self._contract.anchor, self._robot, *given)
        return Pose(pos, quat)

    def observe(self, state: Body, reference: Body) -> Floats:
        """The observation (width,) of the next step. The reference is that of `lag` steps ago.

        A policy that tracks no motion does not use it.
        """
        contract, parts = self._contract, [_ORIGIN] * len(self._histories)
        self._frames.append(reference)
        reference = self._frames[0]
        its, (begin, own_begin) = self._anchor(reference), self._origin
        place = own_begin + quat_rotate(self._yaw0, its.pos - begin)
        poses = self._anchor(state), Pose(place, quat_mul(self._yaw0, its.quat_wxyz))
        inputs = Inputs(state, reference, *poses, self._order, self._default, self.last_action)
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
    anchor: str | None, robot: G1, joint_pos: Floats, pos: Floats, quat_wxyz: Floats
) -> tuple[Floats, Floats]:
    """Poses of the anchor link: pos (T, 3) m and quat_wxyz (T, 4), in the world.

    Args:
        anchor: name of the link; the pelvis if None.
        robot: the robot.
        joint_pos: (T, 29) rad.
        pos: (T, 3) or (3,), pelvis in the world, m.
        quat_wxyz: (T, 4) or (4,).
    """
    link = robot.link_names.index(anchor or robot.link_names[0])
    poses = forward_kinematics(robot, joint_pos, pos, quat_wxyz, [link])
    return poses.pos[:, link], poses.quat_wxyz[:, link]


def pelvis_poses(
    anchor: str | None, robot: G1, joint_pos: Floats, pos: Floats, quat_wxyz: Floats
) -> tuple[Floats, Floats]:
    """The inverse of `anchor_poses`: pelvis pos (T, 3) and quat_wxyz (T, 4) from the anchor's."""
    offset, turn = anchor_poses(anchor, robot, joint_pos, _ORIGIN, _UPRIGHT)
    quat = quat_mul(quat_wxyz, quat_conj(turn))
    return pos - quat_rotate(quat, offset), quat
