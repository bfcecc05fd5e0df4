"""Balance controller: joint torques that track a reference without falling.

In each tick, feedback on the centre of mass and the pelvis gives desired accelerations. A quadratic
program finds the contact forces closest to them under these constraints: the soles can only push,
they do not slip, the centre of pressure stays within each sole, and no leg joint exceeds its torque
limit. The forces give the torques (`g1stream.extras.feet.standing`). Servos move waist and arms.
docs/feet.md has the formulas.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from g1stream.control.reading import Reading
from g1stream.control.targets import Setpoint
from g1stream.extras.feet.base_estimate import BaseEstimate
from g1stream.extras.feet.standing import BodyState, Movement, StandingDynamics, Terms
from g1stream.extras.physics.ground import TRUSTED_FRICTION, beyond_hull
from g1stream.optional import import_extra
from g1stream.robot.dynamics import GRAVITY
from g1stream.robot.joints import LEGS
from g1stream.robot.model import G1
from g1stream.robot.rotations import (
    quat_conj,
    quat_mul,
    quat_normalize,
    quat_rotate,
    rotation_matrices,
    rotation_vector,
    tilt_of,
)
from g1stream.robot.soles import OFF_FLOOR
from g1stream.types import Floats

#: Feedback gains on position, 1/s², and velocity, 1/s: of the centre of mass along x, y and z, and
#: of the pelvis's attitude.
_CENTRE: Final = np.array([25.0, 25.0, 60.0]), np.array([10.0, 10.0, 12.0])
_TURN: Final = 60.0, 12.0
#: Weights of the errors of the centre of mass's acceleration and the pelvis's angular acceleration,
#: along x, y and z of the world. The friction that turns the pelvis about z is proportional to the
#: vertical force. With an equal weight for the heading, fast arm swings would make the robot hop.
_COUNTS: Final = np.array([1.0, 1.0, 4.0, 0.2, 0.2, 0.01])
#: The acceleration (3, 12) per wrench over the weight, without gravity, m/s².
_LIFT: Final = GRAVITY * np.tile(np.eye(3, 6), 2)
#: Weights of the squared wrenches, force and moment over the weight, so that symmetric feet share
#: the load equally. Moments have a higher weight than forces.
_EVEN: Final = np.diag(1e-3 * np.tile([10.0, 10.0, 1.0, 200.0, 200.0, 200.0], 2))
#: Weight of the difference of the feet's horizontal forces, which push the feet apart. With the
#: centre of pressure at an edge they would help slightly, but the soles would slip.
_APART: Final = 3.0 * np.kron([[1.0, -1.0], [-1.0, 1.0]], np.diag([1.0, 1.0, 0.0, 0.0, 0.0, 0.0]))
#: Further contact limits, beside the friction along each axis of a foot: least force on a foot over
#: the weight, and distance of the centre of pressure from the edge of a sole, m.
_LEAST: Final = 0.03
_EDGE: Final = 0.01
#: Radius of a circle with the area of a sole, m, for the friction against turning.
_RADIUS: Final = 0.05
#: Used fraction of a leg's torque limits.
_TORQUE: Final = 0.95

#: No bound, and the solver's code for a solution.
_UNBOUNDED: Final = 1e30
_OPTIMAL: Final = 1
#: Most iterations of the solver in a tick; a few are usual.
_ITERATIONS: Final = 100

#: Time constants, s: of the external force, and of each foot's load.
_OTHER_FORCE: Final = 0.3
_LOAD: Final = 0.02

#: A robot falls if its tilt against the reference exceeds this, rad; or if for longer than a time,
#: s, its capture point is outside of the soles, m, its pelvis is below the reference's, m, or its
#: feet carry less than this fraction of its weight. A slipping sole looks like a velocity of the
#: mass, which moves the capture point for about 0.04 s.
_TILTED: Final = 0.5
_OUTSIDE: Final = 0.01, 0.1
_BELOW: Final = 0.1, 0.1
_UNLOADED: Final = 0.25, 0.15
#: Time without a solution after which the torque fades out, s.
_UNSOLVED: Final = 0.05


class Balance:
    """Computes the torques of a robot that stands on its feet, or on one while the other is lifted.

    Attributes:
        base: estimate of the pelvis's pose.
        carried: measured fraction of the weight on the feet.
        fall: why the robot falls; "" if it does not.
        worst: fields of `BalanceSummary` over the watched ticks; empty before `watch`.
        wrench: (12,) force, N, and moment, N·m, of the floor on each sole, world; None before the
            first solution.
        terms: terms of the last state; None before the first.
    """

    def __init__(self, robot: G1, period: float) -> None:
        self._solve: Any = import_extra("daqp", "feet", "Support feet needs").solve
        self._dynamics = StandingDynamics(robot)
        self._period = period
        self._limit: Floats = _TORQUE * robot.torque_limit[:LEGS]
        self._cone, self._cone_least = _cone(self._dynamics.sole)
        #: Lower bounds, rows times the wrenches, upper bounds; kinds of bounds: inequalities.
        n_rows = 2 * len(self._cone) + LEGS
        self._rows, self._least = np.zeros((n_rows, 12)), np.zeros(n_rows)
        self._most, self._kinds = np.full(n_rows, _UNBOUNDED), np.zeros(n_rows, np.int32)
        self._least[: 2 * len(self._cone)] = np.tile(self._cone_least, 2)
        self.base = BaseEstimate()
        self.terms: Terms | None = None
        self._restart(np.zeros(3), np.zeros((2, 3)), np.zeros(2))

    def _restart(self, root_pos: Floats, soles: Floats, headings: Floats) -> None:
        self._root_pos = root_pos
        self._planted = soles, headings  # of the reference's start
        self._stood = soles.copy()  # last place of each standing foot of the reference
        self._stands = self._stood_before = True, True
        self.wrench: Floats | None = None
        self.fall, self.carried = "", 0.0
        self._other = np.zeros(3)
        self._lasted = dict.fromkeys(("below", "unloaded", "outside", "unsolved"), 0.0)
        self.worst: dict[str, float] = {}

    def begin(self, first: Setpoint) -> None:
        """Start the reference with a target, on whose soles the robot will stand."""
        pos, headings = self._dynamics.soles(_state_of(first))
        self._restart(first.root_pos, pos + first.root_pos, headings)
        self.base.begin(*self._planted)

    def torque(
        self,
        target: Setpoint,
        measured: Reading,
        age: float,
        *,
        share: float | None = None,
        planted: bool = True,
    ) -> Floats:
        """The feed-forward torque (29,) of a command, N·m, which is added to that of the servos.

        Args:
            target: reference at the time when the command takes effect.
            measured: the newest LowState, received `age` s ago.
            age: age of `measured`, s.
            share: fraction of the weight for the feet while something else holds the robot; None:
                the external force is estimated from the measured torques.
            planted: the feet stand; otherwise they are still moving to their place.
        """
        ahead = age + 0.5 * self._period  # to the middle of the command's period
        imu, base = measured.imu, self.base
        dq = measured.steady_dq.astype(np.float64)
        q = measured.q + ahead * dq
        ang_vel = measured.steady_rate.astype(np.float64)
        turned = np.concatenate([[1.0], 0.5 * ahead * ang_vel])
        quat = quat_normalize(quat_mul(base.turn(imu), turned))
        state = BodyState(quat, ang_vel, q, dq)
        if share is not None:
            self._other = np.array([0.0, 0.0, (1.0 - share) * self._dynamics.weight])
        if not planted:
            base.begin(*self._planted)
            target = target._replace(root_pos=self._root_pos)  # the target's may be raised
        acc = target.root_lin_acc, target.root_ang_acc, target.ddq
        pose = _state_of(target), target.root_pos, target.root_lin_vel
        reference = self._dynamics.movement(*pose, acc)
        lifted = reference.soles[:, 2] > self._planted[0][:, 2] + OFF_FLOOR
        self._stands = tuple(~lifted) if planted else (True, True)
        self._stood[~lifted] = reference.soles[~lifted]
        terms = self._dynamics.terms(state, target.ddq, target.dq, self._other, self._stands)
        self.terms = terms
        base.update(terms, imu, self._load(), self._period)
        self._find_other_force(terms, measured, found=share is None)
        if share == 0.0:
            return terms.gravity_tau
        wanted_force, wanted_turn = self._wanted(target, reference, state, terms)
        wrench = self._distribute(terms, wanted_force, wanted_turn)
        legs, others = terms.leg_tau, terms.other_tau
        return np.concatenate([legs[0] @ wrench + legs[1], others[0] @ wrench + others[1]])

    @property
    def fault(self) -> str:
        """That there has been no solution for too long, or ""."""
        unsolved = self._lasted["unsolved"] > _UNSOLVED
        return "no forces of the floor keep the robot on its feet" if unsolved else ""

    def watch(self, target: Setpoint) -> None:
        """Detect a fall of a robot without external support."""
        if self.terms is None:
            raise RuntimeError("there is no state yet: call torque() first")
        tilt = tilt_of(quat_mul(self.base.quat_wxyz, quat_conj(target.root_quat_wxyz)))
        outside = self._capture_point_outside(self.terms)
        below = float(target.root_pos[2] - self.base.pos[2])
        self._keep_worst(-outside, tilt, abs(below))
        falls = ""
        if tilt > _TILTED:
            falls = f"the pelvis is tilted by {tilt:.2f} rad against the reference"
        elif self._last("outside", outside > _OUTSIDE[0]) > _OUTSIDE[1]:
            falls = f"the capture point is {1e3 * outside:.0f} mm outside of the soles"
        elif self._last("below", below > _BELOW[0]) > _BELOW[1]:
            falls = f"the pelvis is {1e3 * below:.0f} mm below the reference"
        elif self._last("unloaded", self.carried < _UNLOADED[0]) > _UNLOADED[1]:
            falls = f"the feet carry {100 * self.carried:.0f} % of the weight"
        if falls and not self.fall:
            self.fall = f"the robot falls: {falls}"

    def _keep_worst(self, margin: float, tilt: float, height_error: float) -> None:
        """Add a watched tick to `worst`."""
        # Distance of a foot from its place relative to the other foot.
        apart = np.diff(self.base.soles - self._stood, axis=0)[0, :2] * all(self._stands)
        now = {
            "capture_margin_m": (min, margin),
            "tilt_rad": (max, tilt),
            "height_error_m": (max, height_error),
            "feet_error_m": (max, float(np.hypot(*apart))),
            "carried": (min, self.carried),
        }
        feet = zip(self._stood_before, self._stands, strict=True)
        counts = {
            "lifts": sum(stood and not stands for stood, stands in feet),
            "unsolved_ticks": int(self._lasted["unsolved"] > 0.0),
        }
        worst = self.worst
        self.worst = {name: of(worst.get(name, one), one) for name, (of, one) in now.items()}
        self.worst |= {name: worst.get(name, 0) + one for name, one in counts.items()}
        self._stood_before = self._stands

    def _capture_point_outside(self, terms: Terms) -> float:
        """Distance of the capture point outside of the soles, m; negative inside.

        The capture point is c + c' / sqrt(g / h), with h the height of the centre of mass c. If the
        centre of pressure is moved there, the mass comes to rest above it (J. Pratt et al.,
        "Capture point: a step toward humanoid push recovery", 2006). It moves away from the centre
        of pressure, so once it is outside of the soles it cannot be brought back. A lifted foot
        counts where it stood, turned as it is now.
        """
        height = max(0.0, float(terms.centre[2] - terms.soles[:, 2].min()))
        vel = terms.centre_vel + self.base.vel
        point = (terms.centre + vel * np.sqrt(height / GRAVITY))[:2]
        turns = terms.turns[:, :2, :2].transpose(0, 2, 1)
        stood = self._stood - self.base.pos
        soles = np.where(np.array(self._stands)[:, np.newaxis], terms.soles, stood)
        corners = soles[:, np.newaxis, :2] + self._dynamics.sole @ turns
        x, y = (corners.reshape(-1, 2) - point).T[..., np.newaxis]
        return float(beyond_hull(x, y)[0])

    def _load(self) -> Floats:
        """Fraction of the load on each foot (2,), sum 1; 0 for a lifted foot."""
        force = np.full(2, 0.5) if self.wrench is None else self.wrench[[2, 8]]
        force = np.maximum(force, 1e-3 * self._dynamics.weight) * self._stands
        load: Floats = force / force.sum()
        return load

    def _find_other_force(self, terms: Terms, measured: Reading, *, found: bool) -> None:
        """Estimate the external force, and the load on the feet.

        The accelerometer measures the sum of external and contact forces, and the legs' torques
        give the contact force. The legs' own acceleration is neglected.
        """
        pushed = (terms.gravity_tau - measured.tau)[:LEGS].reshape(2, 6, 1)
        wrenches = terms.by_sole.transpose(0, 2, 1) @ pushed
        floor = wrenches[list(self._stands), :3, 0].sum(axis=0)
        carried = float(floor[2]) / self._dynamics.weight
        self.carried += (carried - self.carried) * self._period / _LOAD
        if not found:
            return
        specific = quat_rotate(self.base.quat_wxyz, measured.imu.accelerometer.astype(np.float64))
        other = self._dynamics.mass * specific - floor
        rate = self._period / _OTHER_FORCE
        self._other = self._other + (other - self._other) * rate

    def _wanted(
        self, target: Setpoint, reference: Movement, state: BodyState, terms: Terms
    ) -> tuple[Floats, Floats]:
        """The desired contact force, N, world, and angular acceleration of the pelvis.

        The latter is in rad/s², in the pelvis's frame.
        """
        vel = terms.centre_vel + self.base.vel
        pos = terms.centre + self.base.pos
        stiff, damp = _CENTRE
        acc = stiff * (reference.pos - pos) + damp * (reference.vel - vel)
        force = reference.force + self._dynamics.mass * acc - self._other
        turn = rotation_vector(quat_mul(quat_conj(state.quat_wxyz), target.root_quat_wxyz))
        wanted = target.root_ang_acc + _TURN[0] * turn
        return force, wanted + _TURN[1] * (target.root_ang_vel - state.ang_vel)

    def _distribute(self, terms: Terms, force: Floats, turn: Floats) -> Floats:
        """The wrenches (12,) that best approximate a force and an angular acceleration.

        The program uses wrenches over the weight, so that its numbers have a magnitude of about 1.
        """
        weight = self._dynamics.weight
        to_world = rotation_matrices(self.base.quat_wxyz)
        goal = np.concatenate([_LIFT, weight * to_world @ terms.base_acc[0][3:]])
        turn_acc = to_world @ (turn - terms.base_acc[1][3:])
        wanted = np.concatenate([force / self._dynamics.mass, turn_acc])
        counted = goal.T * _COUNTS
        square = counted @ goal + _EVEN
        rows, n = self._rows, len(self._cone)
        for foot, turned in enumerate(terms.turns):
            own = slice(foot * n, foot * n + n)
            rows[own, 6 * foot : 6 * foot + 3] = self._cone[:, :3] @ turned.T
            rows[own, 6 * foot + 3 : 6 * foot + 6] = self._cone[:, 3:] @ turned.T
        leg, constant = terms.leg_tau
        rows[2 * n :] = leg * (weight / self._limit[:, np.newaxis])
        idle = constant / self._limit
        self._least[2 * n :], self._most[2 * n :] = -1.0 - idle, 1.0 - idle
        linear, least, most, kinds = -(counted @ wanted), self._least, self._most, self._kinds
        found, free = np.zeros(12), np.repeat(self._stands, 6)
        if free.all():
            square += _APART
        else:  # without the wrench of the lifted foot
            used = np.concatenate([np.repeat(self._stands, n), np.ones(LEGS, np.bool_)])
            square, linear = np.ascontiguousarray(square[np.ix_(free, free)]), linear[free]
            rows = np.ascontiguousarray(rows[np.ix_(used, free)])
            least, most, kinds = least[used], most[used], kinds[used]
        solved, _, flag, _ = self._solve(
            square, linear, rows, most, least, kinds, iter_limit=_ITERATIONS
        )
        found[free] = solved
        wrench: Floats = weight * found
        if flag != _OPTIMAL or not np.isfinite(wrench).all():
            self._last("unsolved", True)
            return np.zeros(12) if self.wrench is None else self.wrench * free
        self._last("unsolved", False)
        self.wrench = wrench
        return wrench

    def _last(self, what: str, is_so: bool) -> float:
        """How long a condition has held, s, including this tick."""
        self._lasted[what] = self._lasted[what] + self._period if is_so else 0.0
        return self._lasted[what]


def _cone(sole: Floats) -> tuple[Floats, Floats]:
    """The contact constraints of a sole: rows (11, 6) times its wrench >= numbers (11,).

    In the foot's frame, about the middle of the sole: the least force, the friction pyramid, the
    centre of pressure (x = -m_y / f_z, y = m_x / f_z), and friction against turning.
    """
    mu, twist = TRUSTED_FRICTION, TRUSTED_FRICTION * _RADIUS
    along = np.roll(sole, -1, axis=0) - sole  # corners are clockwise, seen from above
    x, y = np.stack([-along[:, 1], along[:, 0]]) / np.linalg.norm(along, axis=1)  # outward
    within = x * sole[:, 0] + y * sole[:, 1] - _EDGE
    none = np.zeros(len(sole))
    rows = np.concatenate(
        [
            [
                (0, 0, 1, 0, 0, 0),
                (1, 0, mu, 0, 0, 0),
                (-1, 0, mu, 0, 0, 0),
                (0, 1, mu, 0, 0, 0),
                (0, -1, mu, 0, 0, 0),
                (0, 0, twist, 0, 0, 1),
                (0, 0, twist, 0, 0, -1),
            ],
            np.column_stack([none, none, within, -y, x, none]),
        ]
    )
    least = np.zeros(len(rows))
    least[0] = _LEAST
    return rows, least


def _state_of(target: Setpoint) -> BodyState:
    return BodyState(target.root_quat_wxyz, target.root_ang_vel, target.q, target.dq)
