"""The way down into a squat, in which a robot is damped that stood on its feet; pure.

The soles stay where they are. The pelvis keeps its attitude and goes on a minimum-jerk path to
where the centre of mass is above the middle between the soles, at the height of a deep squat. The
joints of the legs follow by inverse kinematics; waist and arms do not move.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.extras.feet.standing import BodyState, StandingDynamics
from g1stream.motion.blend import minimum_jerk
from g1stream.robot.joints import N_JOINTS
from g1stream.robot.soles import OFF_FLOOR, bent_legs

if TYPE_CHECKING:
    from g1stream.control.targets import Target
    from g1stream.robot.model import G1

__all__ = ["SQUAT_TIME", "Squat"]

SQUAT_TIME: Final = 2.0
"""How long the way down takes, s."""

#: By how much the legs are bent in the squat, see `bent_legs`, rad.
_BENT: Final = 0.85
#: Steps of Newton's method from standing to the squat, and the times that the centre of mass is
#: shifted to where it shall be meanwhile.
_STEPS: Final = 3
_SHIFTS: Final = 3


class Squat:
    """Targets on the way down.

    Args:
        robot: the G1.

    Raises:
        RobotError: the soles of this robot are not known.
    """

    def __init__(self, robot: G1) -> None:
        self._dynamics = StandingDynamics(robot)
        upright = np.array([1.0, 0.0, 0.0, 0.0])
        squatting = BodyState(upright, np.zeros(3), bent_legs(_BENT), np.zeros(N_JOINTS))
        self._height = -float(self._dynamics.soles(squatting)[0][:, 2].mean())
        self._from: Target | None = None
        self._way = np.zeros(3)
        self._q = np.zeros(N_JOINTS)

    def possible(self, target: Target) -> bool:
        """Whether both feet stand in a target."""
        heights = self._dynamics.soles(_state_at_rest(target))[0][:, 2]
        return float(np.ptp(heights)) < OFF_FLOOR

    def begin(self, standing: Target) -> None:
        """Plan the way down from a target at rest."""
        dynamics, still = self._dynamics, np.zeros(3)
        state = _state_at_rest(standing)
        soles, self._turns = dynamics.sole_poses(state)
        self._soles = soles + standing.root_pos
        middle = self._soles.mean(axis=0)
        goal = standing.root_pos.copy()
        goal[2] = min(goal[2], middle[2] + self._height)
        for _ in range(_SHIFTS):
            for _ in range(_STEPS):
                q = dynamics.towards(state, self._soles - goal, self._turns)
                state = state._replace(q=q)
            centre = dynamics.movement(state, goal, still, (still, still, state.dq)).pos
            goal[:2] += (middle - centre)[:2]
        self._from, self._way, self._q = standing, goal - standing.root_pos, standing.q

    def at(self, elapsed: float) -> Target:
        """The target at a time since the way down began, s; near to the one before."""
        start, dynamics = self._from, self._dynamics
        if start is None:
            raise RuntimeError("there is nowhere to squat down from: call begin() first")
        progress, rate, change = minimum_jerk(elapsed / SQUAT_TIME)
        pos = start.root_pos + progress * self._way
        vel, acc = rate / SQUAT_TIME * self._way, change / SQUAT_TIME**2 * self._way
        state = _state_at_rest(start)._replace(q=self._q)
        self._q = q = dynamics.towards(state, self._soles - pos, self._turns)
        dq, ddq = dynamics.joint_motion(state._replace(q=q), vel, acc)
        return start.replace(q=q, dq=dq, ddq=ddq, root_pos=pos, root_lin_vel=vel, root_lin_acc=acc)


def _state_at_rest(target: Target) -> BodyState:
    return BodyState(target.root_quat_wxyz, np.zeros(3), target.q, np.zeros(N_JOINTS))
