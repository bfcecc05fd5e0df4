"""The ways in which the simulated robot's base is held."""

from __future__ import annotations

from math import inf, sqrt
from typing import TYPE_CHECKING, Any, ClassVar, Final, NamedTuple

import numpy as np

from g1stream.robot.rotations import quat_mul, quat_normalize
from g1stream.sim.model import BASE_BODY, BASE_TARGET

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from g1stream.types import Support

__all__ = ["SUPPORTS", "BaseSupport", "Bolted", "Follow", "Free", "Hanging", "Root"]


class Root(NamedTuple):
    """The base pose and velocity of a reference."""

    pos: NDArray[np.float64]  # (3,) m, world
    quat_wxyz: NDArray[np.float64]  # (4,) base to world
    lin_vel: NDArray[np.float64]  # (3,) m/s, world
    ang_vel: NDArray[np.float64]  # (3,) rad/s, base frame
    playing: bool  # the motion is being played; False before that


class BaseSupport:
    """One way to hold the base, made for a compiled model and its data."""

    floating: ClassVar = True  # the base needs a free joint
    driven: ClassVar = False  # the base is welded to a mocap body
    # Where the base starts by default, m: a stretched leg and its foot reach 0.8 m down.
    height = 1.0

    def __init__(self, model: Any, data: Any) -> None:
        self._base_pose, self._base_vel = data.qpos[:7], data.qvel[:6]

    def place(self, height: float) -> None:
        """Put the base, upright and at rest, at x = y = 0 and this height, m."""
        self._base_pose[:] = 0.0, 0.0, height, 1.0, 0.0, 0.0, 0.0
        self._base_vel[:] = 0.0

    def hold(self) -> None:
        """Set the outer forces of the next physics step."""

    def set_reference(self, root: Root) -> None:
        """Take the base pose of a reference."""


class Bolted(BaseSupport):
    """The base is part of the world and never moves."""

    floating = False

    def __init__(self, model: Any, data: Any) -> None:
        self._base_pos = model.body_pos[BASE_BODY]

    def place(self, height: float) -> None:
        self._base_pos[:] = 0.0, 0.0, height


class Hanging(BaseSupport):
    """The base floats, and an elastic band carries the torso, as in unitree_mujoco.

    The band runs from the point (0, 0, 3) to the base: along that line it pulls with 200 N/m times
    its length (its rest length is 0) less 100 N·s/m times the base's speed along it. That force
    acts on the torso, at the centre of mass of the torso and what is fixed to it. Nothing damps a
    swing. The base starts where the band carries the robot's weight.
    """

    _TOP: Final = 3.0
    _STIFFNESS: Final = 200.0
    _DAMPING: Final = 100.0

    def __init__(self, model: Any, data: Any) -> None:
        weight = -model.opt.gravity[2] * model.body_subtreemass[BASE_BODY]
        self.height = float(self._TOP - weight / self._STIFFNESS)
        super().__init__(model, data)
        torso = model.body_weldid == model.body_weldid[model.site("secondary_imu").bodyid[0]]
        # Pulling each body of the torso in proportion to its mass pulls at their common centre.
        self._torso = np.flatnonzero(torso)
        self._share = (model.body_mass[torso] / model.body_mass[torso].sum())[:, None]
        self._forces = data.xfrc_applied
        self._force = np.zeros(3)

    def hold(self) -> None:
        x, y, z = self._base_pose[:3].tolist()
        vx, vy, vz = self._base_vel[:3].tolist()
        dx, dy, dz = -x, -y, self._TOP - z
        length = max(sqrt(dx * dx + dy * dy + dz * dz), 1e-9)
        speed = (vx * dx + vy * dy + vz * dz) / length
        pull = self._STIFFNESS - self._DAMPING * speed / length
        self._force[:] = pull * dx, pull * dy, pull * dz
        self._forces[self._torso, :3] = self._share * self._force


class Follow(BaseSupport):
    """The base is driven along the reference's root pose.

    There is no contact with the floor, which the feet of retargeted motions go through. Without a
    reference the base stays where it was put. At the first one, and at a leap, the whole robot is
    moved there at once. When references stop coming it stands still.
    """

    driven = True
    _LEAP: Final = 0.2  # m between two references, beyond any speed
    _TIMEOUT: Final = 0.1  # s without a reference, after which the base stands still

    def __init__(self, model: Any, data: Any) -> None:
        super().__init__(model, data)
        target = model.body_mocapid[model.body(BASE_TARGET).id]
        self._pos, self._quat = data.mocap_pos[target], data.mocap_quat[target]
        self._timestep = model.opt.timestep
        self._vel, self._ang_vel = np.zeros(3), np.zeros(3)
        self._reference_age = inf
        floor = model.geom("floor").id
        model.geom_contype[floor] = model.geom_conaffinity[floor] = 0

    def place(self, height: float) -> None:
        super().place(height)
        self._pos[:], self._quat[:] = self._base_pose[:3], self._base_pose[3:]

    def hold(self) -> None:
        self._reference_age += self._timestep
        if self._reference_age > self._TIMEOUT:
            return
        self._pos += self._timestep * self._vel
        turn = self._timestep * self._ang_vel
        self._quat[:] = quat_normalize(quat_mul(self._quat, np.array([1.0, *(turn / 2)])))

    def set_reference(self, root: Root) -> None:
        first = self._reference_age > self._TIMEOUT
        if first or np.abs(root.pos - self._pos).max() > self._LEAP:
            self._move_base(root)
        self._pos[:], self._quat[:] = root.pos, root.quat_wxyz
        self._vel[:], self._ang_vel[:] = root.lin_vel, root.ang_vel
        self._reference_age = 0.0

    def _move_base(self, root: Root) -> None:
        self._base_pose[:3], self._base_pose[3:] = root.pos, root.quat_wxyz
        self._base_vel[:3], self._base_vel[3:] = root.lin_vel, root.ang_vel


class Free(Follow):
    """Nothing holds the base once the motion is played: the robot stands, or falls.

    Until then it is held at the reference's first frame, and again when another session begins.
    """

    def __init__(self, model: Any, data: Any) -> None:
        floor = model.geom("floor").id
        solid = model.geom_contype[floor], model.geom_conaffinity[floor]
        super().__init__(model, data)
        model.geom_contype[floor], model.geom_conaffinity[floor] = solid
        self._weld = data.eq_active[model.equality(BASE_TARGET).id :][:1]

    def hold(self) -> None:
        if self._weld[0]:
            super().hold()

    def set_reference(self, root: Root) -> None:
        if root.playing:
            self._weld[0] = False
            return
        if not self._weld[0]:
            self._weld[0] = True
            self._move_base(root)
        super().set_reference(root)


SUPPORTS: Final[Mapping[Support, type[BaseSupport]]] = {
    "bolted": Bolted,
    "hanging": Hanging,
    "follow": Follow,
    "free": Free,
}
