"""Convex hulls of the robot's links, and self-collision between them.

tools/make_hulls.py makes the hulls in hulls.json from Unitree's meshes. A mesh extends beyond its
hull by at most 0.5 mm. A hull fills the cavities of its link, as MuJoCo does for every collision
mesh.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property, lru_cache
from importlib import resources
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from g1stream.robot.dynamics import mujoco_spec
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.model import REVISIONS
from g1stream.robot.urdf import KEPT_ROBOTS

if TYPE_CHECKING:
    from collections.abc import Iterable

    from g1stream.robot.model import G1
    from g1stream.types import Floats

__all__ = ["Hull", "SelfCollision", "add_hulls", "never_collide", "read_hulls"]


@dataclass(frozen=True, eq=False)
class Hull:
    """The convex hull of a link's mesh, or of a part of it.

    Attributes:
        link: name of the link.
        solid: whether it collides in Unitree's models. The outlines of feet and rubber hands do
            not. A foot collides with four small spheres under the sole, which have one solid hull.
        vertices: (V, 3) m in the link's frame; read-only.
    """

    link: str
    solid: bool
    vertices: Floats

    @cached_property
    def sphere(self) -> tuple[Floats, float]:
        """Centre (3,) and radius of a bounding sphere, m, in the link's frame."""
        centre = self.vertices.mean(axis=0)
        return centre, float(np.linalg.norm(self.vertices - centre, axis=1).max())


@lru_cache(maxsize=KEPT_ROBOTS)
def read_hulls(robot: G1) -> tuple[Hull, ...]:
    """Read the hulls of a robot's links; a link may have none or several.

    The hulls are those of the revision with the URDF's robot name, or of the default revision. They
    are matched by link name, so another URDF gets the hulls of the links that it has.
    """
    revision = robot.name if robot.name in REVISIONS else REVISIONS[0]
    text = resources.files(__package__).joinpath("hulls.json").read_text(encoding="utf-8")
    hulls = []
    for one in json.loads(text):
        if revision in one["revisions"] and one["link"] in robot.link_names:
            vertices = np.array(one["vertices"]).reshape(-1, 3)
            vertices.setflags(write=False)
            hulls.append(Hull(one["link"], one["solid"], vertices))
    return tuple(hulls)


@lru_cache(maxsize=KEPT_ROBOTS)
def never_collide(robot: G1) -> frozenset[tuple[str, str]]:
    """Pairs of links whose contacts are ignored, in the robot's order of links.

    These are links that do not move relative to each other, links with one joint between them,
    whose hulls overlap there, and links whose hulls touch with all joints at 0.
    """
    moved_with = np.arange(len(robot.link_names))
    for link, joint in enumerate(robot.joint_of_link):
        if joint < 0 and robot.parent[link] >= 0:
            moved_with[link] = moved_with[robot.parent[link]]
    carrier = np.where(robot.parent >= 0, moved_with[robot.parent], -1)[moved_with]
    adjacent = frozenset(
        (robot.link_names[one], robot.link_names[other])
        for one, other in combinations(range(len(moved_with)), 2)
        if moved_with[one] in (moved_with[other], carrier[other])
        or carrier[one] == moved_with[other]
    )
    neutral = np.zeros((1, len(JOINT_NAMES)))
    return adjacent.union(SelfCollision(robot, read_hulls(robot), adjacent).depths(neutral))


def add_hulls(
    spec: Any, hulls: Iterable[Hull], apart: Iterable[tuple[str, str]], *, contact_bit: int
) -> None:
    """Add hulls to the bodies of a `mujoco.MjSpec`, as massless geoms that collide with each other.

    Args:
        spec: a spec with a body for each link.
        hulls: the hulls to add.
        apart: pairs of links that do not collide.
        contact_bit: the only bit of their `contype` and `conaffinity`.
    """
    import mujoco

    links = set()
    for number, hull in enumerate(hulls):
        links.add(hull.link)
        name = f"{hull.link}_hull_{number}"
        spec.add_mesh(name=name, uservert=hull.vertices.ravel())
        spec.body(hull.link).add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=name,
            mass=0,
            contype=contact_bit,
            conaffinity=contact_bit,
            group=3,  # the first group that MuJoCo's viewer hides
        )
    for one, other in sorted(apart):
        if one in links and other in links:
            spec.add_exclude(bodyname1=one, bodyname2=other)


@lru_cache(maxsize=KEPT_ROBOTS)
def _compiled(robot: G1, hulls: tuple[Hull, ...], apart: frozenset[tuple[str, str]]) -> Any:
    """A compiled model in which hulls collide; do not change it."""
    spec = mujoco_spec(robot, floating=True, shapes=False)
    add_hulls(spec, hulls, apart, contact_bit=1)
    return spec.compile()


class SelfCollision:
    """Detects contacts between the links of a robot.

    Args:
        robot: the G1.
        hulls: the hulls to check; None: all.
        apart: pairs of links to ignore, in the robot's order; None: `never_collide(robot)`.

    Raises:
        ValueError: MuJoCo does not accept the URDF.
    """

    def __init__(
        self,
        robot: G1,
        hulls: Iterable[Hull] | None = None,
        apart: Iterable[tuple[str, str]] | None = None,
    ) -> None:
        import mujoco

        self._model = _compiled(
            robot,
            read_hulls(robot) if hulls is None else tuple(hulls),
            never_collide(robot) if apart is None else frozenset(apart),
        )
        self._data = mujoco.MjData(self._model)
        self._present = np.flatnonzero(robot.present)
        joints = (self._model.joint(JOINT_NAMES[i]) for i in self._present)
        self._joints = np.array([joint.qposadr[0] for joint in joints])
        bodies = (self._model.body(body).name for body in self._model.geom_bodyid)
        self._links = np.array([robot.link_index(body) for body in bodies])  # of the geoms
        self._names = robot.link_names

    def depths(self, joint_pos: Floats) -> dict[tuple[str, str], Floats]:
        """Penetration depths of links in poses; takes 18 us per pose.

        Args:
            joint_pos: (T, 29) rad, motor order.

        Returns:
            (T,) penetration depth, m, by pair of links that touch in any pose, in the robot's order
            of links; 0 in poses in which they do not touch.
        """
        import mujoco

        model, data = self._model, self._data
        qpos, kinematics, collision = data.qpos, mujoco.mj_kinematics, mujoco.mj_collision
        poses = np.tile(qpos, (len(joint_pos), 1))
        poses[:, self._joints] = joint_pos[:, self._present]
        numbers, geoms, distances = [], [], []  # one item per contact
        for number, pose in enumerate(poses):
            qpos[:] = pose
            kinematics(model, data)
            collision(model, data)
            if n_contacts := data.ncon:
                numbers += [number] * n_contacts
                geoms.append(data.contact.geom.copy())
                distances.append(data.contact.dist.copy())
        if not numbers:
            return {}
        links = np.sort(self._links[np.concatenate(geoms)], axis=1)
        pairs, of = np.unique(links, axis=0, return_inverse=True)
        found = np.zeros((len(pairs), len(poses)))
        np.maximum.at(found, (of, np.array(numbers)), -np.concatenate(distances))
        names = self._names
        return {(names[a], names[b]): depths for (a, b), depths in zip(pairs, found, strict=True)}
