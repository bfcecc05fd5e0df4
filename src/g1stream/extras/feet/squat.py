"""The movement from standing into a squat, in which the robot is damped.

The soles do not move. The pelvis keeps its attitude and moves on a minimum-jerk path to where the
centre of mass is above the middle between the soles, at the height of a deep squat. Inverse
kinematics gives the leg joints; waist and arms do not move.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from g1stream.control.targets import Setpoint
from g1stream.extras.feet.standing import BodyState, StandingDynamics
from g1stream.motion.blend import minimum_jerk
from g1stream.robot.joints import N_JOINTS
from g1stream.robot.model import G1
from g1stream.robot.soles import OFF_FLOOR, bent_legs
from g1stream.types import Floats

#: Bend of the legs in the squat, see `bent_legs`, rad.
_BENT: Final = 0.85
#: Steps of Newton's method from standing to the squat, and number of corrections of the centre of
#: mass in between.
_STEPS: Final = 3
_SHIFTS: Final = 3


class Squat:
    """Targets of the movement into a squat in `length` s: a `g1stream.control.targets.WayDown`."""

    def __init__(self, robot: G1) -> None:
        self.length = 2.0
        self._dynamics = StandingDynamics(robot)
        upright = np.array([1.0, 0.0, 0.0, 0.0])
        squatting = BodyState(upright, np.zeros(3), bent_legs(_BENT), np.zeros(N_JOINTS))
        self._height = -float(self._dynamics.soles(squatting)[0][:, 2].mean())

    def possible(self, target: Setpoint) -> bool:
        """Whether both feet stand in a target."""
        heights = self._dynamics.soles(_state_at_rest(target))[0][:, 2]
        return float(np.ptp(heights)) < OFF_FLOOR

    def plan(self, standing: Setpoint) -> Callable[[float, Floats], Setpoint]:
        """The movement from a target at rest, by the time since its start, s, and nearby joints."""
        dynamics, still, length = self._dynamics, np.zeros(3), self.length
        state = _state_at_rest(standing)
        soles, turns = dynamics.sole_poses(state)
        soles = soles + standing.root_pos
        middle = soles.mean(axis=0)
        goal = standing.root_pos.copy()
        goal[2] = min(goal[2], middle[2] + self._height)
        for _ in range(_SHIFTS):
            for _ in range(_STEPS):
                state = state._replace(q=dynamics.towards(state, soles - goal, turns))
            centre = dynamics.movement(state, goal, still, (still, still, state.dq)).pos
            goal[:2] += (middle - centre)[:2]
        start, way = _state_at_rest(standing), goal - standing.root_pos

        def target(elapsed: float, near: Floats) -> Setpoint:
            progress, rate, change = minimum_jerk(elapsed / length)
            pos = standing.root_pos + progress * way
            vel, acc = rate / length * way, change / length**2 * way
            q = dynamics.towards(start._replace(q=near), soles - pos, turns)
            dq, ddq = dynamics.joint_motion(start._replace(q=q), vel, acc)
            moving = {"root_lin_vel": vel, "root_lin_acc": acc}
            return standing._replace(q=q, dq=dq, ddq=ddq, root_pos=pos, **moving)

        return target


def _state_at_rest(target: Setpoint) -> BodyState:
    return BodyState(target.root_quat_wxyz, np.zeros(3), target.q, np.zeros(N_JOINTS))
