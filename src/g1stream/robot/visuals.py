"""What a robot looks like: the <visual> elements of its URDF."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal
from xml.etree import ElementTree as ET

import numpy as np

from g1stream.errors import RobotError
from g1stream.robot.rotations import quat_from_rpy

if TYPE_CHECKING:
    from g1stream.robot.model import G1

__all__ = ["Visual", "find_mesh", "missing_meshes", "read_visuals"]

Kind = Literal["box", "cylinder", "sphere", "mesh"]
Vector3 = tuple[float, float, float]
Vector4 = tuple[float, float, float, float]

_GREY: Final[Vector4] = (0.7, 0.7, 0.7, 1.0)


@dataclass(frozen=True)
class Visual:
    """One shape of a link.

    Attributes:
        link: whose shape it is.
        kind: box, cylinder (its axis along z), sphere or mesh.
        pos: m, its centre in the link's frame; for a mesh, its origin.
        quat_wxyz: its orientation in the link's frame.
        size: m, along each of its own axes, round ones by their diameter; for a mesh, its scale.
        rgba: each from 0 to 1; grey where the URDF names none.
        coloured: whether the URDF names a colour.
        mesh: the mesh's file as the URDF names it; empty for other kinds.
    """

    link: str
    kind: Kind
    pos: Vector3
    quat_wxyz: Vector4
    size: Vector3
    rgba: Vector4
    coloured: bool
    mesh: str = ""


def read_visuals(robot: G1) -> tuple[Visual, ...]:
    """The shapes of a robot's links, in the order of its URDF.

    Raises:
        RobotError: a figure of a shape is missing or not a number, or the shape is not of a known
            kind.
    """
    root = ET.fromstring(robot.urdf)
    materials = {m.get("name", ""): m for m in root.findall("material")}
    shapes = [
        (link.get("name", ""), element)
        for link in root.findall("link")
        for element in link.findall("visual")
    ]
    # All rotations at once: one by one they would take longer than everything else here.
    turns = [_origin(link, element, "rpy", robot.source) for link, element in shapes]
    quats = quat_from_rpy(np.array(turns).reshape(-1, 3)).tolist()
    return tuple(
        _visual(link, element, materials, tuple(quat), robot.source)
        for (link, element), quat in zip(shapes, quats, strict=True)
    )


def find_mesh(robot: G1, name: str) -> Path | None:
    """The file of a mesh, or None where it is not there.

    Relative names start from the URDF's directory. For `package://NAME/REST` the package is looked
    for in that directory and those above it, as a directory called NAME or one that holds REST.
    """
    from urllib.parse import unquote, urlparse

    url = urlparse(name)
    rest = unquote(url.path).lstrip("/")
    start = Path(robot.source).resolve().parent
    if url.scheme == "package":
        places = [up / tail for up in (start, *start.parents) for tail in (url.netloc, "")]
        candidates = [place / rest for place in places]
    elif url.scheme == "file":
        candidates = [Path("/", rest)]
    else:
        candidates = [start / name]
    return next((path for path in candidates if path.is_file()), None)


def missing_meshes(robot: G1) -> tuple[str, ...]:
    """The meshes that the robot's URDF names and that are not there, each once."""
    names = dict.fromkeys(visual.mesh for visual in read_visuals(robot) if visual.mesh)
    return tuple(name for name in names if find_mesh(robot, name) is None)


def _origin(link: str, element: ET.Element, key: str, source: str) -> Vector3:
    """What a shape's <origin> says: its `xyz` in m or its `rpy` in rad, zero where it is silent."""
    origin = element.find("origin")
    text = "0 0 0" if origin is None else origin.get(key, "0 0 0")
    x, y, z = _numbers(text, 3, _where(link, source))
    return x, y, z


def _visual(
    link: str, element: ET.Element, materials: dict[str, ET.Element], quat: Vector4, source: str
) -> Visual:
    where = _where(link, source)
    pos = _origin(link, element, "xyz", source)
    kind, size, mesh = _geometry(element.find("geometry/*"), where)
    colour = _colour(element.find("material"), materials, where)
    return Visual(link, kind, pos, quat, size, colour or _GREY, colour is not None, mesh)


def _where(link: str, source: str) -> str:
    return f"{source}: a shape of the link {link!r}"


def _geometry(shape: ET.Element | None, where: str) -> tuple[Kind, Vector3, str]:
    """Kind, size and mesh name."""
    kind = "nothing" if shape is None else shape.tag
    get = {} if shape is None else shape.attrib
    if kind == "box":
        x, y, z = _numbers(get.get("size", ""), 3, where)
        return "box", (x, y, z), ""
    if kind == "sphere":
        (radius,) = _numbers(get.get("radius", ""), 1, where)
        return "sphere", (2 * radius, 2 * radius, 2 * radius), ""
    if kind == "cylinder":
        radius, length = _numbers(f"{get.get('radius', '')} {get.get('length', '')}", 2, where)
        return "cylinder", (2 * radius, 2 * radius, length), ""
    if kind == "mesh" and get.get("filename"):
        x, y, z = _numbers(get.get("scale", "1 1 1"), 3, where)
        return "mesh", (x, y, z), get["filename"]
    raise RobotError(
        f"{where} is {'a mesh without a file' if kind == 'mesh' else kind}.",
        "Make it a box, a cylinder, a sphere or a mesh with its filename.",
    )


def _colour(
    material: ET.Element | None, materials: dict[str, ET.Element], where: str
) -> Vector4 | None:
    """What the material says, itself or where the URDF defines the one of that name."""
    if material is None:
        return None
    colour = material.find("color")
    if colour is None:
        named = materials.get(material.get("name", ""))
        colour = None if named is None else named.find("color")
    if colour is None:
        return None
    r, g, b, a = _numbers(colour.get("rgba", ""), 4, where)
    return r, g, b, a


def _numbers(text: str, count: int, where: str) -> list[float]:
    try:
        numbers = [float(word) for word in text.split()]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(map(isfinite, numbers)):
        needed = f"{count} finite number{'s' * (count > 1)}"
        raise RobotError(
            f"{where} has {text.strip()!r} where it needs {needed}.",
            "Correct it in the URDF.",
        )
    return numbers
