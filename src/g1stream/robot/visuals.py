"""The shapes of a robot: the <visual> elements of its URDF."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

import numpy as np

from g1stream.errors import RobotError
from g1stream.robot.rotations import quat_from_rpy
from g1stream.robot.urdf import numbers

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

    from g1stream.robot.model import G1

__all__ = ["Visual", "find_mesh", "has_meshes", "mesh_names", "missing_meshes", "read_visuals"]

Kind = Literal["box", "cylinder", "sphere", "mesh"]

_GREY: Final = (0.7, 0.7, 0.7, 1.0)


@dataclass(frozen=True)
class Visual:
    """One shape of a link."""

    link: str
    kind: Kind  # a cylinder's axis is along z
    pos: tuple[float, ...]  # (3,) m, its centre in the link's frame; a mesh's origin
    quat_wxyz: tuple[float, ...]  # (4,) in the link's frame
    size: tuple[float, ...]  # (3,) m, with diameters for round shapes; a mesh's scale
    rgba: tuple[float, ...]  # (4,) each from 0 to 1; grey where the URDF names no colour
    coloured: bool  # the URDF names a colour
    mesh: str = ""  # the file as the URDF names it; empty for other kinds


def read_visuals(robot: G1) -> tuple[Visual, ...]:
    """The shapes of a robot's links, in the order of its URDF.

    Raises:
        RobotError: a number of a shape is missing or wrong, or the kind of shape is unknown.
    """
    materials = {m.get("name", ""): m for m in robot.xml.findall("material")}
    shapes = [
        (link.get("name", ""), visual)
        for link in robot.xml.findall("link")
        for visual in link.findall("visual")
    ]
    # All rotations at once: one by one they would take longer than everything else here.
    rpy = [
        numbers(visual.find("origin"), "rpy", 3, _where(robot, link), "0 0 0")
        for link, visual in shapes
    ]
    quats = quat_from_rpy(np.array(rpy).reshape(-1, 3)).tolist()
    found = []
    for (link, visual), quat in zip(shapes, quats, strict=True):
        where = _where(robot, link)
        kind, size, mesh = _geometry(visual.find("geometry/*"), where)
        pos = numbers(visual.find("origin"), "xyz", 3, where, "0 0 0")
        color = _color(visual.find("material"), materials, where)
        found.append(
            Visual(
                link, kind, tuple(pos), tuple(quat), size, color or _GREY, color is not None, mesh
            )
        )
    return tuple(found)


def find_mesh(robot: G1, name: str) -> Path | None:
    """The file of a mesh, or None where it does not exist.

    Relative names start from the URDF's directory. For `package://NAME/REST` the package is
    searched in that directory and those above it, as a directory called NAME or one that has REST.
    """
    from urllib.parse import unquote, urlparse

    url = urlparse(name)
    rest = unquote(url.path).lstrip("/")
    start = Path(robot.source).resolve().parent
    if url.scheme == "package":
        candidates = [
            up / package / rest for up in (start, *start.parents) for package in (url.netloc, "")
        ]
    elif url.scheme == "file":
        candidates = [Path("/", rest)]
    else:
        candidates = [start / name]
    return next((path for path in candidates if path.is_file()), None)


def missing_meshes(robot: G1) -> tuple[str, ...]:
    """The meshes that the robot's URDF names and that do not exist, each once."""
    return tuple(name for name in mesh_names(robot) if find_mesh(robot, name) is None)


def has_meshes(robot: G1) -> bool:
    """Whether the robot's URDF names meshes, and all of them exist."""
    return bool(mesh_names(robot)) and not missing_meshes(robot)


def mesh_names(robot: G1) -> tuple[str, ...]:
    """The meshes that the robot's URDF names, each once."""
    return tuple(dict.fromkeys(visual.mesh for visual in read_visuals(robot) if visual.mesh))


def _where(robot: G1, link: str) -> str:
    return f"{robot.source}: a shape of the link {link!r}"


def _geometry(shape: Element | None, where: str) -> tuple[Kind, tuple[float, ...], str]:
    """Kind, size and mesh name."""
    kind = "missing" if shape is None else shape.tag
    if kind == "box":
        return "box", tuple(numbers(shape, "size", 3, where)), ""
    if kind == "sphere":
        (radius,) = numbers(shape, "radius", 1, where)
        return "sphere", (2 * radius,) * 3, ""
    if kind == "cylinder":
        (radius,), (length,) = (numbers(shape, key, 1, where) for key in ("radius", "length"))
        return "cylinder", (2 * radius, 2 * radius, length), ""
    mesh = "" if shape is None else shape.get("filename", "")
    if kind == "mesh" and mesh:
        return "mesh", tuple(numbers(shape, "scale", 3, where, "1 1 1")), mesh
    raise RobotError(
        f"{where} is {'a mesh without a file' if kind == 'mesh' else kind}.",
        "Make it a box, a cylinder, a sphere or a mesh with its filename.",
    )


def _color(
    material: Element | None, materials: dict[str, Element], where: str
) -> tuple[float, ...] | None:
    """The colour of a material, its own or that of the URDF's material of the same name."""
    if material is None:
        return None
    color = material.find("color")
    if color is None and material.get("name", "") in materials:
        color = materials[material.get("name", "")].find("color")
    return None if color is None else tuple(numbers(color, "rgba", 4, where))
