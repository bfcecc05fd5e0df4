"""The robot model: links, joints and limits of a G1, as arrays.

All arrays have 29 joints in motor order, even if a robot has fewer, see `G1.present`.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from difflib import get_close_matches
from functools import cache, cached_property
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Final

import numpy as np

from g1stream.errors import ConfigError, RobotError
from g1stream.files import read_file
from g1stream.robot.joints import JOINT_NAMES, JOINT_SETS, TORQUE_LIMIT, JointSet, select_joints
from g1stream.robot.parameters import NOMINAL, Parameters, load_parameters
from g1stream.robot.urdf import parse_urdf, read_urdf, with_fixed_joints, without_world
from g1stream.text import listed

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

    from numpy.typing import NDArray

    from g1stream.config import Config
    from g1stream.types import Floats

__all__ = ["DEFAULT_URDF", "G1", "REVISIONS", "VARIANTS"]

REVISIONS: Final = ("g1_29dof_rev_1_0", "g1_29dof")
"""The 29-joint robots in this package, the default first; unitree_mujoco simulates the second."""

VARIANTS: Final = tuple(one.name for one in JOINT_SETS if one.absent)
"""Names of the G1s with fewer joints; the default robot with the absent joints fixed at 0."""

DEFAULT_URDF = resources.files(__package__) / f"{REVISIONS[0]}.urdf"

#: Tolerance for rounded limits in URDFs, rad, rad/s, N·m.
_ROUNDING: Final = 1e-3


@dataclass(frozen=True, eq=False, repr=False)
class G1:
    """A G1 as described by its URDF; all arrays are read-only.

    L is the number of links, moving and fixed. The joint of a link connects it to its parent. The
    frame of a link is at the joint's origin, rotated by `joint_pos` about the joint's axis.

    Attributes:
        source: path of the URDF, or "default", or the name of a robot in this package.
        urdf: XML text of the URDF.
        name: robot name in the URDF.
        link_names: (L,) root first, parents before children.
        parent: (L,) index of the parent link, -1 for the root.
        joint_of_link: (L,) index into `joint_names` of the link's joint, -1 for a fixed link.
        origin_pos: (L, 3) position of the joint's origin in the parent link's frame, m.
        origin_quat_wxyz: (L, 4) its orientation in the parent link's frame, at zero joint position.
        axis: (L, 3) unit axis in the link's own frame, zero for a fixed link.
        joint_names: (29,) motor order.
        joint_set: the joints that the robot has; the limits of the others are never exceeded.
        lower: (29,) lower position limit, rad.
        upper: (29,) upper position limit, rad.
        velocity: (29,) maximum speed in either direction, rad/s.
        effort: (29,) maximum torque in either direction, N·m.
        ignored_joints: moving joints that are not the G1's own (fingers); they are held at zero.
        capped: joints whose limits in the URDF are wider than those of every robot in this package,
            and were narrowed to these.
        parameters: parameters of motors and links that are not in the URDF.
    """

    source: str
    urdf: str
    name: str
    link_names: tuple[str, ...]
    parent: NDArray[np.intp]
    joint_of_link: NDArray[np.intp]
    origin_pos: Floats
    origin_quat_wxyz: Floats
    axis: Floats
    lower: Floats
    upper: Floats
    velocity: Floats
    effort: Floats
    ignored_joints: tuple[str, ...]
    joint_set: JointSet = JOINT_SETS[0]
    capped: tuple[str, ...] = ()
    parameters: Parameters = NOMINAL
    joint_names: ClassVar = JOINT_NAMES

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, np.ndarray):
                value.setflags(write=False)

    def __repr__(self) -> str:
        return f"G1(name={self.name!r}, source={self.source!r}, links={len(self.link_names)})"

    @property
    def warning(self) -> str:
        """A warning about limits of the URDF that were narrowed, or ""."""
        if not self.capped:
            return ""
        return (
            f"{self.source} has wider limits than a G1 for {listed(self.capped, 3)}; "
            "the limits of a G1 are used (safety.urdf_limits = true uses the URDF's)"
        )

    @property
    def present(self) -> NDArray[np.bool_]:
        """(29,) the joints that the robot has."""
        return self.joint_set.present

    def select(self, selection: str | None) -> NDArray[np.bool_]:
        """(29,) the robot's joints in a selection such as `arms,waist`; all if None.

        Raises:
            ConfigError: a part of the selection matches no joint, or the robot has none of them.
        """
        chosen = select_joints(selection) & self.present
        if not chosen.any():
            raise ConfigError(
                f"stream.joints = {selection!r} selects joints that a {self.joint_set.name} lacks.",
                "Select joints that it has.",
            )
        return chosen

    @property
    def torque_limit(self) -> Floats:
        """(29,) N·m, the smaller of each motor's limit and the URDF's effort."""
        return np.minimum(TORQUE_LIMIT, self.effort)

    @classmethod
    @cache
    def default(cls) -> G1:
        """The default robot in this package, g1_29dof_rev_1_0 with primitive shapes.

        Every call returns the same object.
        """
        return cls.from_urdf(DEFAULT_URDF.read_text(encoding="utf-8"), "default")

    @classmethod
    @cache
    def _builtin(cls, name: str) -> G1:
        urdf = resources.files(__package__) / f"{name}.urdf"
        if urdf.is_file():
            return cls.from_urdf(urdf.read_text(encoding="utf-8"), name)
        kind = next(one for one in JOINT_SETS if one.name == name)
        absent = [JOINT_NAMES[joint] for joint in kind.absent]
        text = DEFAULT_URDF.read_text(encoding="utf-8")
        return cls.from_urdf(with_fixed_joints(text, name, absent), name)

    @classmethod
    def load(
        cls,
        path: str | Path | None = None,
        *,
        own_limits: bool = False,
        params: Path | None = None,
    ) -> G1:
        """Load the robot of a URDF file, or of a name in `REVISIONS` or `VARIANTS`.

        Mesh files need not exist, because only names, frames and limits are read. Limits that are
        wider than those of every robot in this package are narrowed to these, because a file cannot
        make a motor stronger.

        Args:
            path: path of the URDF, or a name; None: the robot of `params`, or the default one.
            own_limits: keep the URDF's limits even if they are wider.
            params: parameters file of the robot.

        Raises:
            RobotError: the file cannot be read, or does not describe a G1.
            ConfigError: the parameters are not valid, or belong to another robot.
        """
        if params is not None:
            parameters = load_parameters(params)
            robot = cls.load(path or parameters.robot, own_limits=own_limits)
            if parameters.robot not in (None, robot.name):
                raise ConfigError(
                    f"The parameters {params} are for {parameters.robot}, not for {robot.name}.",
                    "Remove --robot, or fit the parameters again with this robot.",
                )
            return replace(robot, parameters=parameters)
        if path is None:
            return cls.default()
        if str(path) in (*REVISIONS, *VARIANTS) and not Path(path).exists():
            return cls._builtin(str(path))
        try:
            urdf = read_file(Path(path)).decode("utf-8")
        except OSError as error:
            raise RobotError(
                f"The URDF {path} cannot be read: {error.strerror}.",
                f"Use the path of a URDF file or one of {', '.join((*REVISIONS, *VARIANTS))}.",
            ) from error
        except UnicodeDecodeError as error:
            raise RobotError(
                f"The URDF {path} is not text: its byte {error.start} is not UTF-8.",
                "Use a URDF in XML, saved as UTF-8.",
            ) from error
        robot = cls.from_urdf(urdf, str(path))
        return robot if own_limits else robot._within_builtin()

    @classmethod
    def of_config(cls, config: Config) -> G1:
        """Load the robot of all settings that describe it; raises what `load` does."""
        return cls.load(config.robot, own_limits=config.safety.urdf_limits, params=config.params)

    def _within_builtin(self) -> G1:
        builtin = [self._builtin(name) for name in REVISIONS]
        limits = {
            "lower": np.maximum(self.lower, np.min([robot.lower for robot in builtin], axis=0)),
            "upper": np.minimum(self.upper, np.max([robot.upper for robot in builtin], axis=0)),
            "velocity": np.minimum(
                self.velocity, np.max([robot.velocity for robot in builtin], axis=0)
            ),
            "effort": np.minimum(self.effort, np.max([robot.effort for robot in builtin], axis=0)),
        }
        wider = np.zeros(len(self.joint_names), dtype=bool)
        for name, limit in limits.items():
            limits[name] = np.where(self.present, limit, getattr(self, name))
            wider |= np.abs(getattr(self, name) - limits[name]) > _ROUNDING
        outside = np.flatnonzero(limits["lower"] > limits["upper"])
        if len(outside):
            names = listed([self.joint_names[joint] for joint in outside])
            raise RobotError(
                f"The range of {names} in {self.source} is outside that of a G1.",
                "Correct the URDF; safety.urdf_limits = true uses its limits unchanged.",
            )
        capped = tuple(name for name, capped in zip(self.joint_names, wider, strict=True) if capped)
        return replace(self, **limits, capped=capped)

    @classmethod
    def from_urdf(cls, urdf: str, source: str) -> G1:
        """Make the robot from the XML text of a URDF; `source` names its origin in errors.

        A link such as `world`, which only positions the pelvis, is left out.

        Raises:
            RobotError: the URDF does not describe a G1.
        """
        urdf = without_world(urdf, source)
        return cls(source, urdf, **read_urdf(urdf, source))

    @property
    def xml(self) -> Element:
        """The root element of the URDF; do not change it."""
        return parse_urdf(self.urdf, self.source)

    def link_index(self, name: str) -> int:
        """Index of a link.

        Raises:
            RobotError: there is no link of this name.
        """
        if name not in self.link_names:
            similar = [link for link in self.link_names if name in link] or get_close_matches(
                name, self.link_names, n=5, cutoff=0.0
            )
            raise RobotError(
                f"The robot {self.name!r} has no link {name!r}.",
                f"Choose one of its {len(self.link_names)} links, such as "
                f"{', '.join(similar[:5])}.",
            )
        return self.link_names.index(name)

    @cached_property
    def levels(self) -> tuple[NDArray[np.intp], ...]:
        """Link indices by distance from the root, nearest first, without the root.

        The links of one level depend only on the previous level, so kinematics computes a level at
        a time.
        """
        depth = np.zeros(len(self.parent), dtype=np.intp)
        for link, parent in enumerate(self.parent[1:], start=1):
            depth[link] = depth[parent] + 1
        return tuple(np.flatnonzero(depth == level) for level in range(1, int(depth.max()) + 1))
