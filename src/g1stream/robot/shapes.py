"""Shapes of a robot: the <visual> elements of its URDF."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Final, Literal
from xml.etree import ElementTree

from g1stream.errors import RobotError
from g1stream.robot.urdf import (
    KEPT_ROBOTS,
    check_numbers,
    known_robot,
    parse_with_yourdfpy,
    poses_of,
)

if TYPE_CHECKING:
    from collections.abc import Sequence
    from xml.etree.ElementTree import Element

    from g1stream.robot.model import G1

__all__ = ["GHOST_INSET", "Visual", "ghost_size", "parse_visuals", "read_visuals"]

Kind = Literal["box", "cylinder", "sphere", "mesh"]

GHOST_INSET: Final = 0.002
"""Distance by which a ghost is smaller on every side, m, because coinciding surfaces flicker in
viewers. A smaller tracking error leaves the ghost inside the robot."""
_GREY: Final = (0.7, 0.7, 0.7, 1.0)
#: Attributes that a shape of each kind needs.
_NEEDED: Final = {
    "box": ("size",),
    "cylinder": ("radius", "length"),
    "sphere": ("radius",),
    "mesh": ("filename",),
}


@dataclass(frozen=True)
class Visual:
    """One shape of a link."""

    link: str
    kind: Kind  # the axis of a cylinder is z
    pos: tuple[float, ...]  # (3,) centre, or origin of a mesh, in the link's frame, m
    quat_wxyz: tuple[float, ...]  # (4,) in the link's frame
    size: tuple[float, ...]  # (3,) m, with diameters for round shapes; the scale of a mesh
    rgba: tuple[float, ...]  # (4,) each from 0 to 1; grey if the URDF has no colour
    coloured: bool  # whether the URDF has a colour
    mesh: str = ""  # file name in the URDF; empty for other kinds


def ghost_size(size: Sequence[float]) -> tuple[float, ...]:
    """Size (3,) of a ghost's box, sphere or cylinder, from that of the robot's, m."""
    return tuple(max(one - 2.0 * GHOST_INSET, one / 2) for one in size)


@lru_cache(maxsize=KEPT_ROBOTS)
def read_visuals(robot: G1) -> tuple[Visual, ...]:
    """Read the shapes of a robot's links, in the order of its URDF.

    Raises:
        RobotError: a number of a shape is missing or wrong, or the kind of shape is unknown.
    """
    if known := known_robot(robot.urdf):
        return tuple(
            Visual(link, kind, tuple(pos), tuple(quat), tuple(size), tuple(rgba), coloured, mesh)
            for link, kind, pos, quat, size, rgba, coloured, mesh in known["visuals"]
        )
    return parse_visuals(robot)


def parse_visuals(robot: G1) -> tuple[Visual, ...]:
    """As `read_visuals`, for any URDF, with yourdfpy."""
    materials = robot.xml.findall("material")
    for material in materials:
        check_numbers(material, f"{robot.source}: a material")
    links = [_shapes_alone(link, robot.source) for link in robot.xml.findall("link")]
    parsed = parse_with_yourdfpy([*materials, *links], "shapes", robot.source)
    colors = {one.name: one.color for one in parsed.materials}
    shapes = [(link.name, visual) for link in parsed.links for visual in link.visuals]
    pos, quat = poses_of(visual.origin for _, visual in shapes)
    found = []
    for (link, visual), xyz, wxyz in zip(shapes, pos.tolist(), quat.tolist(), strict=True):
        material = visual.material
        color = material and (material.color or colors.get(material.name))
        rgba = tuple(color.rgba.tolist()) if color else _GREY
        kind, size, mesh = _size_of(visual.geometry)
        pose = tuple(xyz), tuple(wxyz)
        found.append(Visual(link, kind, *pose, size, rgba, bool(color), mesh))
    return tuple(found)


def _shapes_alone(link: Element, source: str) -> Element:
    """A copy of a link with only its shapes, after checking these."""
    name = link.get("name", "")
    alone = ElementTree.Element("link", name=name)
    alone.extend(link.findall("visual"))
    where = f"{source}: a shape of the link {name!r}"
    for visual in alone:
        shape = visual.find("geometry/*")
        kind = "missing" if shape is None else shape.tag
        if shape is None or kind not in _NEEDED:
            raise RobotError(
                f"{where} is {kind}.",
                "Make it a box, a cylinder, a sphere or a mesh with its filename.",
            )
        if lacking := [key for key in _NEEDED[kind] if not shape.get(key)]:
            raise RobotError(
                f"{where} is a {kind} without {lacking[0]}.", f"Add the attribute {lacking[0]}."
            )
    check_numbers(alone, where)
    return alone


def _size_of(geometry: Any) -> tuple[Kind, tuple[float, ...], str]:
    """Kind, size and mesh name of a geometry of yourdfpy."""
    if geometry.box is not None:
        return "box", tuple(geometry.box.size.tolist()), ""
    if geometry.sphere is not None:
        return "sphere", (2 * geometry.sphere.radius,) * 3, ""
    if geometry.cylinder is not None:
        diameter = 2 * geometry.cylinder.radius
        return "cylinder", (diameter, diameter, geometry.cylinder.length), ""
    scale = geometry.mesh.scale
    return "mesh", (1.0,) * 3 if scale is None else tuple(scale.tolist()), geometry.mesh.filename
