"""What holds the robot's base."""

from __future__ import annotations

from math import sqrt
from typing import TYPE_CHECKING, Any, ClassVar, Final, Protocol

import numpy as np

from g1stream.errors import SimError
from g1stream.sim.model import BASE_BODY

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["BaseSupport", "Bolted", "Hanging", "find_support"]


class BaseSupport(Protocol):
    """One way to hold the base, made for a compiled model and its data.

    Attributes:
        floating: whether the base needs a free joint.
        height: where the base starts unless told, m.
    """

    floating: ClassVar[bool]
    height: float

    def __init__(self, model: Any, data: Any) -> None: ...

    def place(self, height: float) -> None:
        """Put the base, upright, at x = y = 0 and this height, m."""

    def hold(self) -> None:
        """Set the outer forces of the next physics step."""


class Bolted:
    """The base is part of the world and never moves."""

    floating: ClassVar[bool] = False
    height = 1.0  # a stretched leg and its foot reach 0.8 m down, so the feet stay off the floor

    def __init__(self, model: Any, data: Any) -> None:
        del data
        self._base_pos = model.body_pos[BASE_BODY]

    def place(self, height: float) -> None:
        """Bolt the base at this height, m."""
        self._base_pos[:] = 0.0, 0.0, height

    def hold(self) -> None:
        """Nothing: the world holds it."""


class Hanging:
    """The base floats, and an elastic band carries the torso, as in unitree_mujoco.

    The band runs from the point (0, 0, 3) to the base: along that line it pulls with 200 N/m times
    its length (its rest length is 0) less 100 N·s/m times the base's speed along it. That force
    acts on the torso, at the centre of mass of the torso and what is fixed to it. Nothing damps a
    swing. The base starts where the band carries the robot's weight.
    """

    floating: ClassVar[bool] = True
    _TOP: Final = 3.0
    _STIFFNESS: Final = 200.0
    _DAMPING: Final = 100.0

    def __init__(self, model: Any, data: Any) -> None:
        weight = -model.opt.gravity[2] * model.body_subtreemass[BASE_BODY]
        self.height = float(self._TOP - weight / self._STIFFNESS)
        self._base_pos, self._base_vel = data.qpos[:3], data.qvel[:3]
        torso = model.body_weldid == model.joint("waist_pitch_joint").bodyid
        # Pulling each body of the torso in proportion to its mass pulls at their common centre.
        self._torso = np.flatnonzero(torso)
        self._share = (model.body_mass[torso] / model.body_mass[torso].sum())[:, None]
        self._forces = data.xfrc_applied
        self._force = np.zeros(3)

    def place(self, height: float) -> None:
        """Let the base start at this height, m, at rest."""
        self._base_pos[:] = 0.0, 0.0, height
        self._base_vel[:] = 0.0

    def hold(self) -> None:
        """Pull at the torso for where the base is now."""
        x, y, z = self._base_pos.tolist()
        vx, vy, vz = self._base_vel.tolist()
        dx, dy, dz = -x, -y, self._TOP - z
        length = max(sqrt(dx * dx + dy * dy + dz * dz), 1e-9)
        speed = (vx * dx + vy * dy + vz * dz) / length
        pull = self._STIFFNESS - self._DAMPING * speed / length
        self._force[:] = pull * dx, pull * dy, pull * dz
        self._forces[self._torso, :3] = self._share * self._force


_SUPPORTS: Final[Mapping[str, type[BaseSupport]]] = {"bolted": Bolted, "hanging": Hanging}


def find_support(name: str) -> type[BaseSupport]:
    """The class of a support.

    Raises:
        SimError: there is no support of this name.
    """
    if name not in _SUPPORTS:
        raise SimError(
            f"The base cannot be supported {name!r}.", f"Choose from {', '.join(_SUPPORTS)}."
        )
    return _SUPPORTS[name]
