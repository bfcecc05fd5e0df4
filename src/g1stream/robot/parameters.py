"""Parameters of one G1 beyond its URDF: motor friction, armature, delay, torque scale and masses.

They come from a TOML file, such as one written by `g1stream fit`, and are stored in the `G1`. The
simulator and the feed-forward torque use them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import numpy as np
from pydantic import Field

from g1stream.config import Table, read_table, setting
from g1stream.errors import ConfigError
from g1stream.files import read_file
from g1stream.robot.joints import ARMATURE, DAMPING, FRICTION, N_JOINTS, matching_joints

if TYPE_CHECKING:
    from collections.abc import Mapping

    from g1stream.types import Floats

__all__ = ["NOMINAL", "Parameters", "load_parameters"]


@dataclass(frozen=True, eq=False)
class Parameters:
    """The parameters of one robot; the defaults are those of unitree_mujoco's model.

    Attributes:
        damping: (29,) viscous friction, N·m·s/rad, motor order.
        friction: (29,) dry (Coulomb) friction, N·m.
        armature: (29,) inertia of the rotor, reflected to the joint, kg·m².
        torque_scale: (29,) ratio of the torque that a motor applies to the commanded torque.
        command_delay: time from the publish time of a LowCmd until the motors apply it, s.
        mass: mass added at the centre of mass of a link, kg, by link.
        com: (3,) shift of the centre of mass of a link, m, in the link's frame, by link.
        robot: name of the robot that masses and centres of mass are relative to; None: any.
        path: path of the file; None without a file.
        sha256: SHA-256 of the file, in hex.
        values: the values in the file.
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
                    f"The parameters {self.path} name {link}, which is not a link of the robot.",
                    "Use a link of the URDF, such as torso_link.",
                )
            mass = float(body.mass) + self.mass.get(link, 0.0)
            if not mass > 0.0:
                raise ConfigError(
                    f"The parameters {self.path} reduce the mass of {link} to {mass:g} kg.",
                    "Use a value with which its mass is above 0.",
                )
            body.mass = mass
            body.ipos = np.asarray(body.ipos) + self.com.get(link, 0.0)


NOMINAL: Final = Parameters()
"""The parameters of unitree_mujoco's model; do not change them."""

_OF_MOTORS: Final = ("damping", "friction", "armature", "torque_scale")


class ParametersFile(Table):
    """The entries of a parameters file, which the setting `params` names.

    The tables of joints map a joint, a limb or a pattern to a value; later entries override earlier
    ones. The tables of links map a link of the URDF to the value that is added to it. Missing
    parameters are as in unitree_mujoco's model and in the URDF.
    """

    robot: str | None = setting(
        None, "robot that masses and centres of mass are relative to", example="g1_29dof"
    )
    command_delay: float = setting(
        0.0, "time from publishing a LowCmd until the motors apply it", "s", ge=0.0, le=0.1
    )
    damping: dict[str, Annotated[float, Field(ge=0.0, le=20.0)]] = setting(
        {}, "viscous friction", "N·m·s/rad"
    )
    friction: dict[str, Annotated[float, Field(ge=0.0, le=20.0)]] = setting(
        {}, "dry (Coulomb) friction", "N·m"
    )
    armature: dict[str, Annotated[float, Field(ge=0.0, le=1.0)]] = setting(
        {}, "inertia of the rotor, reflected to the joint", "kg·m²"
    )
    torque_scale: dict[str, Annotated[float, Field(ge=0.2, le=2.0)]] = setting(
        {}, "ratio of the torque that a motor applies to the commanded torque"
    )
    mass: dict[str, Annotated[float, Field(ge=-20.0, le=20.0)]] = setting(
        {}, "added to a link at its centre of mass", "kg"
    )
    com: dict[
        str,
        Annotated[
            list[Annotated[float, Field(ge=-0.5, le=0.5)]], Field(min_length=3, max_length=3)
        ],
    ] = setting({}, "shift of a link's centre of mass, in the link's frame", "m")


def load_parameters(path: Path) -> Parameters:
    """Load the parameters in a TOML file; missing ones keep their defaults.

    Raises:
        ConfigError: the file cannot be read, a name matches no joint, or a value is out of range.
    """
    remedy = "Correct the value; docs/gap.md lists every entry with its unit."
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
