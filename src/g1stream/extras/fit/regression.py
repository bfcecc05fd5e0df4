"""Least squares on the inverse dynamics: parameters from movements and torques.

A joint's torque is linear in its viscous friction, dry friction and armature, and in masses that
are added to links (W. Khalil and E. Dombre, "Modeling, Identification and Control of Robots",
2002, chapter 12):

    scale (tau - delay dfeed/dt) = RNE(q, dq, ddq) + damping dq + friction sign(dq) + armature ddq
          + sum(mass_l RNE_l)

tau is the torque of the servo law, and feed the commands' part of it, see `Recorded.servo`. The
delay is a correction of the one with which they were computed, the same for all joints. Without
this term it would appear as friction. Velocities and accelerations are derivatives of
positions after a zero-phase low-pass, and both sides of the equation have the same low-pass. The
bias from noise, sampling and low-pass is not corrected here: `identify` does this by simulation.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from g1stream.extras.fit.recorded import smoothed
from g1stream.robot.dynamics import GRAVITY, compiled_dynamics
from g1stream.robot.joints import ARMATURE, DAMPING, FRICTION, JOINT_NAMES, N_JOINTS
from g1stream.robot.model import G1
from g1stream.robot.rotations import quat_rotate
from g1stream.types import Floats, Support

__all__ = ["AXES", "LINKS", "OF_JOINTS", "Estimate", "Movement", "Regression", "names_of"]

LINKS: Final = (
    "torso_link",
    *(
        f"{side}_{part}_link"
        for side in ("left", "right")
        for part in ("hip_yaw", "knee", "ankle_roll", "shoulder_yaw", "elbow", "wrist_yaw")
    ),
)
"""The links to which masses are added, because people mount things on them: trunk, thighs, shanks,
feet, upper arms, forearms and hands."""

OF_JOINTS: Final = ("damping", "friction", "armature", "torque_scale")
"""The parameters of a joint."""

AXES: Final = ("com_x", "com_y", "com_z")
"""The parameters of a centre of mass: its shift, m, in the link's frame."""

_CUTOFF: Final = 10.0
"""Cutoff of the low-pass, Hz."""
_ROWS: Final = 50.0
"""Equations per second that are used; neighbouring ones are correlated."""
#: Time at the ends of a window in which the low-pass has not settled, s.
_MARGIN: Final = 0.1
#: Below this speed, rad/s, dry friction is unknown. Its full value is used from about half of it.
_STILL: Final = 0.1
#: Closer than this to a limit a joint may press against its stop, rad.
_STOP: Final = 0.03
#: Length of a block of equations, s. Errors of different blocks count as independent.
_BLOCK: Final = 1.0
#: Prior standard deviations of the parameters, as multiples of the default; of added masses, kg,
#: shifts, m, and the delay, s. They only matter if a session has no information.
_PRIOR, _PRIOR_MASS, _PRIOR_COM, _PRIOR_DELAY = 5.0, 3.0, 0.05, 0.02
#: Shift of a centre of mass for its equations, m.
_SHIFT: Final = 0.01
_BASE: Final = 6


class Movement(NamedTuple):
    """Measurements of a robot at N instants, evenly sampled within each window.

    Attributes:
        q: (N, 29) rad.
        tau: (N, 29) N·m of the servo law.
        feed: (N, 29) N·m, the commands' part of it.
        base: (N, 10) of the pelvis's IMU: quaternion wxyz, gyroscope, accelerometer.
        period: sampling period, s.
        windows: parts without a gap.
        support: how the base is held.
    """

    q: Floats
    tau: Floats
    feed: Floats
    base: Floats
    period: float
    windows: Sequence[slice]
    support: Support


class Estimate(NamedTuple):
    """The result of least squares.

    Attributes:
        values: (P,) parameters in the order of `names_of`.
        covariance: (P, P) from blocks of equations, for any distribution of their errors.
        blocks: number of blocks.
        residual: (29,) mean square of the equations' residuals, (N·m)².
        independent: (29,) number of equations that are independent under the low-pass.
        pulled: (29, P) change of the values by what a joint alone would change in those that joints
            share; their sum is 0 but for the priors.
    """

    values: Floats
    covariance: Floats
    blocks: int
    residual: Floats
    independent: Floats
    pulled: Floats


def names_of(added: Sequence[tuple[str, str]]) -> list[tuple[str, str]]:
    """All parameters as pairs of kind and joint or link."""
    motors = [(kind, name) for kind in OF_JOINTS for name in JOINT_NAMES]
    return [*motors, *added, ("command_delay", "")]


class Regression:
    """The equations of a robot, with the masses of its URDF.

    Args:
        robot: robot without parameters.
        added: parameters of links: `mass` or one of `AXES`, and the link.
    """

    def __init__(self, robot: G1, added: Sequence[tuple[str, str]]) -> None:
        import mujoco

        self.added = tuple(added)
        self._mujoco: Any = mujoco
        model = compiled_dynamics(robot, GRAVITY)
        self._models = [model]
        for kind, link in added:
            other, body = copy(model), model.body(link).id
            if kind == "mass":
                other.body_mass[body] += 1.0
            else:
                other.body_ipos[body, AXES.index(kind)] += _SHIFT
            self._models.append(other)
        steps = [1.0 if kind == "mass" else _SHIFT for kind, _ in added]
        self._steps = np.array(steps).reshape(-1, 1, 1)
        self._data: Any = mujoco.MjData(model)
        torso = model.body("torso_link").id
        self._carrier = np.flatnonzero(model.body_weldid == model.body_weldid[torso])
        weights = model.body_mass[self._carrier]
        self._share = weights / weights.sum()
        self._lower, self._upper = robot.lower, robot.upper
        self._present = np.flatnonzero(robot.present)
        joints = [model.joint(JOINT_NAMES[j]) for j in self._present]
        self._places = np.array([joint.qposadr[0] for joint in joints])
        self._dofs = np.array([joint.dofadr[0] for joint in joints])
        names = robot.link_names
        imu = names.index("imu_in_pelvis") if "imu_in_pelvis" in names else 0
        self._imu_pos = robot.origin_pos[imu] if robot.parent[imu] == 0 else np.zeros(3)

    def estimate(self, movements: Sequence[Movement], scale: Floats) -> Estimate:
        """The parameters that best fit the equations of some movements.

        Args:
            movements: the movements.
            scale: (2, 29) the torque scales of the reported torques, and their standard deviations.

        Equations of a joint are weighted by the variance of their residuals. The covariance is that
        of blocks of a second (H. White 1980, by clusters).
        """
        blocks = [block for one in movements for block in self._blocks(one)]
        products = np.stack([block.products for block in blocks])
        of_joint, rows = products.sum(axis=0), np.sum([block.rows for block in blocks], axis=0)
        n = len(OF_JOINTS)
        shared = slice(n * N_JOINTS, n * N_JOINTS + len(self.added) + 1)
        own = np.arange(n * N_JOINTS).reshape(n, N_JOINTS).T
        of_links = (_PRIOR_MASS if kind == "mass" else _PRIOR_COM for kind, _ in self.added)
        usual = np.concatenate([DAMPING, FRICTION, ARMATURE])
        prior = np.concatenate([usual, scale[0], np.zeros(len(self.added) + 1)])
        loose = np.concatenate([_PRIOR * usual, scale[1], [*of_links, _PRIOR_DELAY]])
        regular = np.diag(1.0 / loose**2)
        normals = np.zeros((len(blocks), shared.stop, shared.stop))
        right = np.zeros((len(blocks), shared.stop))
        variance, values = np.ones(N_JOINTS), prior
        for _ in range(3):
            weighted = products / variance[:, np.newaxis, np.newaxis]
            normals[:, own[:, :, np.newaxis], own[:, np.newaxis]] = weighted[:, :, :n, :n]
            normals[:, own, shared] = weighted[:, :, :n, n:-1]
            normals[:, shared, own] = weighted[:, :, n:-1, :n].transpose(0, 2, 1, 3)
            normals[:, shared, shared] = weighted[:, :, n:-1, n:-1].sum(axis=1)
            right[:, own] = weighted[:, :, :n, -1]
            right[:, shared] = weighted[:, :, n:-1, -1].sum(axis=1)
            total = normals.sum(axis=0) + regular
            values = np.linalg.solve(total, right.sum(axis=0) + regular @ prior)
            residual = np.full((N_JOINTS, 1, products.shape[-1]), -1.0)
            residual[:, 0, :n], residual[:, 0, n:-1] = values[own], values[shared]
            squares = (residual @ of_joint @ residual.transpose(0, 2, 1))[:, 0, 0]
            variance = np.maximum(squares / np.maximum(1, rows), 1e-6)
        scores = right - normals @ values
        inverse = np.linalg.inv(total)
        few = len(blocks) / max(1, len(blocks) - 4)
        spread = few * scores.T @ scores + regular
        pulls = (of_joint[:, n:-1] @ residual.transpose(0, 2, 1))[:, :, 0] / variance[:, np.newaxis]
        pulled = pulls @ -inverse[shared]
        covariance, independent = inverse @ spread @ inverse, rows * (2.0 * _CUTOFF / _ROWS)
        return Estimate(values, covariance, len(blocks), variance, independent, pulled)

    def _blocks(self, movement: Movement) -> list[_Block]:
        """The equations of a movement, block by block."""
        rate = 1.0 / movement.period
        step, margin = max(1, round(rate / _ROWS)), round(_MARGIN * rate)
        told = np.zeros(N_JOINTS, dtype=bool)
        told[self._present] = True
        blocks = []
        for part in movement.windows:
            if part.stop - part.start < 4 * margin:
                continue
            q = smoothed(movement.q[part], rate, _CUTOFF)
            dq = np.gradient(q, movement.period, axis=0)
            ddq = np.gradient(dq, movement.period, axis=0)
            # Both sides have the same low-pass. Positions are smooth enough without it.
            dry = smoothed(np.tanh(dq / (0.5 * _STILL)), rate, _CUTOFF)
            tau = smoothed(movement.tau[part], rate, _CUTOFF)
            feed = smoothed(movement.feed[part], rate, _CUTOFF)
            base = smoothed(movement.base[part], rate, _CUTOFF)
            turning = np.gradient(base[:, 4:7], movement.period, axis=0)
            kept = np.arange(margin, len(q) - margin, step)
            torque, masses = self._inverse(
                q[kept], dq[kept], ddq[kept], base[kept], turning[kept], movement.support
            )
            free = (q[kept] > self._lower + _STOP) & (q[kept] < self._upper - _STOP)
            used = told & free & (np.abs(dq[kept]) > _STILL)
            rising = np.gradient(feed, movement.period, axis=0)[kept]
            own = dq[kept], dry[kept], ddq[kept], -tau[kept]
            columns = np.stack([*own, *masses, rising, -torque])
            columns = np.where(used, columns, 0.0).transpose(2, 0, 1)
            n = max(1, round(len(kept) * step * movement.period / _BLOCK))
            for rows in np.array_split(np.arange(len(kept)), n):
                some = columns[:, :, rows]
                blocks.append(_Block(some @ some.transpose(0, 2, 1), used[rows].sum(axis=0)))
        return blocks

    def _inverse(
        self, q: Floats, dq: Floats, ddq: Floats, base: Floats, turning: Floats, support: Support
    ) -> tuple[Floats, Floats]:
        """Torques (R, 29) without rotors and friction, and (L, R, 29) per kg or m of each `added`.

        The force that carries a hanging robot acts at the torso's mass centre, as in the
        feed-forward. It is the force on the six rows of the base.
        """
        mujoco, data = self._mujoco, self._data
        found = np.zeros((len(self._models), len(q), N_JOINTS))
        jacobian = np.zeros((3, self._models[0].nv))
        quat = base[:, :4] / np.linalg.norm(base[:, :4], axis=1, keepdims=True)
        bolted = support == "bolted"
        acc = np.zeros((len(q), _BASE))
        rates = np.zeros((len(q), 3)) if bolted else base[:, 4:7]
        if bolted:
            quat = np.tile(quat.mean(axis=0), (len(q), 1))
        else:
            swing = np.cross(turning, self._imu_pos) + np.cross(
                rates, np.cross(rates, self._imu_pos)
            )
            acc[:, :3] = quat_rotate(quat, base[:, 7:] - swing) - [0.0, 0.0, GRAVITY]
            acc[:, 3:] = turning
        torques = np.empty((len(self._models), self._models[0].nv))
        for k in range(len(q)):
            data.qpos[3:7] = quat[k]
            data.qpos[self._places] = q[k, self._present]
            data.qvel[3:_BASE] = rates[k]
            data.qvel[self._dofs] = dq[k, self._present]
            data.qacc[:_BASE] = acc[k]
            data.qacc[self._dofs] = ddq[k, self._present]
            for number, model in enumerate(self._models):
                result = torques[number]
                mujoco.mj_kinematics(model, data)
                mujoco.mj_comPos(model, data)
                mujoco.mj_comVel(model, data)
                mujoco.mj_rne(model, data, 1, result)
                if support == "hanging":
                    centre = self._share @ data.xipos[self._carrier]
                    mujoco.mj_jac(model, data, jacobian, None, centre, self._carrier[0])
                    result -= result[:3] @ jacobian
            found[:, k, self._present] = torques[:, self._dofs]
        return found[0], (found[1:] - found[0]) / self._steps


class _Block(NamedTuple):
    """The equations of each joint within a second: y = own columns and shared columns x parameters.

    Attributes:
        products: (29, 4 + L + 2, 4 + L + 2) products of the columns own, shared and y with each
            other, summed over the equations.
        rows: (29,) number of equations.
    """

    products: Floats
    rows: NDArray[np.intp]
