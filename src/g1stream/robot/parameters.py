"""The parameters of one G1: what its motors and links have that a URDF does not say.

They come from a TOML file, such as `g1stream fit` writes. A `G1` carries them, and whatever
computes with the robot takes them from there: the simulator, and the torque of the feed-forward.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from g1stream.errors import ConfigError
from g1stream.robot.joints import ARMATURE, DAMPING, FRICTION, N_JOINTS, matching_joints

if TYPE_CHECKING:
    from collections.abc import Mapping

    from g1stream.types import Floats

__all__ = ["NOMINAL", "Parameters", "load_parameters"]


@dataclass(frozen=True, eq=False)
class Parameters:
    """The parameters of one robot; the default ones are those of unitree_mujoco's model.

    Attributes:
        damping: (29,) N·m·s/rad, viscous friction, motor order.
        friction: (29,) N·m, dry (Coulomb) friction.
        armature: (29,) kg·m², inertia of the rotor, reflected to the joint.
        torque_scale: (29,) torque that a motor applies, over the torque that its command asks for.
        command_delay: s, from when a LowCmd is received to when the motors obey it.
        mass: kg that are added to links, by link, each at the link's centre of mass.
        com: (3,) m by which links' centres of mass are shifted, by link, in the link's frame.
        robot: name of the robot that masses and centres of mass are relative to; None: any.
        path: of the file; None where there is none.
        sha256: of that file, in hex.
        values: as the file has them.
    """

    damping: Floats = field(default_factory=DAMPING.copy)
    friction: Floats = field(default_factory=FRICTION.copy)
    armature: Floats = field(default_factory=ARMATURE.copy)
    torque_scale: Floats = field(default_factory=lambda: np.ones(N_JOINTS))
    command_delay: float = 0.0
    mass: Mapping[str, float] = field(default_factory=dict)
    com: Mapping[str, Floats] = field(default_factory=dict)
    robot: str | None = None
    path: Path | None = None
    sha256: str | None = None
    values: Mapping[str, Any] = field(default_factory=dict)

    def apply_to_links(self, spec: Any) -> None:
        """Add masses to the links of a `mujoco.MjSpec`, and shift their centres of mass.

        Raises:
            ConfigError: there is no such link, or its mass would not be positive.
        """
        for link in {**self.mass, **self.com}:
            body = spec.body(link)
            if body is None:
                raise ConfigError(
                    f"The parameters {self.path} name {link}, which is no link of the robot.",
                    "Name a link of the URDF, such as torso_link.",
                )
            mass = float(body.mass) + self.mass.get(link, 0.0)
            if not mass > 0.0:
                raise ConfigError(
                    f"The parameters {self.path} leave {link} a mass of {mass:g} kg.",
                    "Add a mass that leaves it more than 0.",
                )
            body.mass = mass
            body.ipos = np.asarray(body.ipos) + self.com.get(link, 0.0)


NOMINAL: Final = Parameters()
"""Those of unitree_mujoco's model; not to be changed."""

_OF_MOTORS: Final = ("damping", "friction", "armature", "torque_scale")


def load_parameters(path: Path) -> Parameters:
    """The parameters in a TOML file; what it leaves out keeps its default.

    Raises:
        ConfigError: it cannot be read, a name matches no joint, or a value is out of range.
    """
    from g1stream.config import ParametersFile, read_table
    from g1stream.files import read_file

    remedy = "Correct the value; docs/gap.md has every entry with its unit."
    values, _ = read_table(ParametersFile, path, "parameters file", remedy)
    motors: dict[str, Floats] = {}
    for name in _OF_MOTORS:
        array = getattr(NOMINAL, name).copy()
        for pattern, value in getattr(values, name).items():
            where = f"In the parameters file {path}, {name}"
            array[matching_joints(pattern, where)] = value
        motors[name] = array
    return Parameters(
        **motors,
        command_delay=values.command_delay,
        mass=values.mass,
        com={link: np.array(shift) for link, shift in values.com.items()},
        robot=values.robot,
        path=path,
        sha256=sha256(read_file(path)).hexdigest(),
        values=values.model_dump(mode="json", exclude_defaults=True),
    )
