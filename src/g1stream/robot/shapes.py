"""Shapes of a robot: the <visual> elements of its URDF, and its meshes for viewers."""

from __future__ import annotations

import sysconfig
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, NamedTuple
from xml.etree import ElementTree

import numpy as np

from g1stream.errors import RobotError
from g1stream.files import read_file
from g1stream.input_limits import MESHES
from g1stream.optional import import_extra, not_installed
from g1stream.robot.model import G1
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

    from numpy.typing import NDArray

__all__ = [
    "Mesh",
    "Visual",
    "decimate",
    "find_mesh",
    "ghost_size",
    "has_meshes",
    "missing_meshes",
    "parse_visuals",
    "read_stl",
    "read_visuals",
    "real_g1",
    "robot_with_meshes",
    "with_shapes",
]

Kind = Literal["box", "cylinder", "sphere", "mesh"]

#: Distance by which a ghost is smaller on every side, m, because coinciding surfaces flicker in
#: viewers. A smaller tracking error leaves the ghost inside the robot.
_GHOST_INSET: Final = 0.002
_GREY: Final = (0.7, 0.7, 0.7, 1.0)
#: Attributes that a shape of each kind needs.
_NEEDED: Final = {
    "box": ("size",),
    "cylinder": ("radius", "length"),
    "sphere": ("radius",),
    "mesh": ("filename",),
}
_PURPOSE: Final = "Meshes need"
#: Path of the G1 in the package example-robot-data, of the extra `meshes`.
_REAL_G1: Final = (
    "cmeel.prefix/share/example-robot-data/robots/g1_description/urdf/g1_29dof_rev_1_0.urdf"
)
#: A triangle of a binary STL file: normal, corners, and two unused bytes.
_TRIANGLE: Final = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")])
_STL_HEADER: Final = 84
#: Target number of triangles of a mesh. More remain if fewer would deform its surface too much.
_TRIANGLES: Final = 2000
#: Aggressiveness of the decimation, 0 to 10. At 2 the size of every mesh of the G1 changes by at
#: most 0.6 mm, at 3 by 4 mm, at the library's default of 7 by 11 mm.
_AGGRESSION: Final = 2.0


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
    return tuple(max(one - 2.0 * _GHOST_INSET, one / 2) for one in size)


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


def find_mesh(robot: G1, name: str) -> Path | None:
    """Find the file of a mesh; None if it does not exist.

    Relative names are relative to the URDF's directory. For `package://NAME/REST`, NAME/REST and
    REST are searched in that directory and its parents.
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
    """Names of the meshes in the robot's URDF that do not exist, each once."""
    return tuple(name for name in mesh_names(robot) if find_mesh(robot, name) is None)


def has_meshes(robot: G1) -> bool:
    """Return whether the robot's URDF has meshes, and all of them exist."""
    return bool(mesh_names(robot)) and not missing_meshes(robot)


def mesh_names(robot: G1) -> tuple[str, ...]:
    """Names of the meshes in the robot's URDF, each once."""
    return tuple(dict.fromkeys(visual.mesh for visual in read_visuals(robot) if visual.mesh))


class Mesh(NamedTuple):
    """A triangle mesh with points (V, 3) in the coordinates of its file, and triangles (T, 3)."""

    points: NDArray[np.float32]
    triangles: NDArray[np.int32]

    def scaled(self, scale: Sequence[float]) -> Mesh:
        """The mesh scaled along its axes (3,); mirroring keeps the outside of the surface."""
        points = self.points * np.array(scale, np.float32)
        return Mesh(points, self.triangles[:, ::-1] if np.prod(scale) < 0.0 else self.triangles)

    def of_ghost(self) -> Mesh:
        """The mesh for a ghost, with each point moved inward; points are in m.

        A thin mesh is moved less, so that its sides do not intersect.
        """
        corners = self.points[self.triangles].astype(np.float64)
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        if np.einsum("ij,ij->", normals, corners.mean(axis=1) - self.points.mean(axis=0)) < 0.0:
            normals = -normals  # the faces point inward
        inset = min(_GHOST_INSET, float(np.ptp(self.points, axis=0).min()) / 4)
        outward = np.zeros(self.points.shape)
        for corner in self.triangles.T:
            np.add.at(outward, corner, normals)
        length = np.linalg.norm(outward, axis=1, keepdims=True)
        outward = np.divide(outward, length, out=outward, where=length > 0.0)
        return Mesh((self.points - inset * outward).astype(np.float32), self.triangles)


def real_g1() -> G1 | None:
    """Unitree's g1_29dof_rev_1_0 with its meshes; None without the extra `meshes`."""
    path = Path(sysconfig.get_path("purelib"), _REAL_G1)
    return G1.load(path, own_limits=True) if path.is_file() else None


def robot_with_meshes(robot: G1) -> G1:
    """The robot itself if its URDF has meshes and all are found, otherwise the real G1.

    Raises:
        ConfigError: the real G1 is needed, but the extra `meshes` is not installed.
        RobotError: the real G1 is needed, but the robot has other links.
    """
    if has_meshes(robot):
        return robot
    real = real_g1()
    if real is None:
        raise not_installed("example-robot-data", "meshes", _PURPOSE)
    if set(real.link_names) != set(robot.link_names):
        raise RobotError(
            f"The G1's meshes do not fit {robot.source}, which has other links.",
            "Remove --meshes, or use a URDF whose own meshes are found.",
        )
    return real


def with_shapes(robot: G1) -> G1:
    """The robot whose shapes are shown for a robot.

    It is the robot itself if all meshes of its URDF are found. Otherwise it is the real G1 if its
    meshes are installed, or the default robot if meshes are missing; both only if the link names
    are equal.
    """
    if has_meshes(robot):
        return robot
    others = (real_g1(), G1.default() if mesh_names(robot) else None)
    same = (one for one in others if one and set(one.link_names) == set(robot.link_names))
    return next(same, robot)


def read_stl(path: Path) -> Mesh:
    """Read a binary STL file; equal corners become one point.

    Raises:
        RobotError: the file cannot be read, or is not a binary STL file.
    """
    try:
        data = read_file(path, MESHES)
    except OSError as error:
        raise RobotError(
            f"The mesh {path} cannot be read: {error.strerror}.", "Make it readable."
        ) from error
    count = int.from_bytes(data[_STL_HEADER - 4 : _STL_HEADER], "little")
    if not count or len(data) != _STL_HEADER + count * _TRIANGLE.itemsize:
        raise RobotError(
            f"The mesh {path} is not a binary STL file with triangles.",
            "Export it as binary STL, or remove --meshes.",
        )
    corners = np.frombuffer(data, _TRIANGLE, offset=_STL_HEADER)["corners"].reshape(-1, 3)
    if not np.isfinite(corners).all():
        raise RobotError(
            f"The mesh {path} has a corner that is not a finite number.", "Export it again."
        )
    # As bytes, which sort much faster than rows; + 0.0 converts -0.0 to 0.0.
    rows = np.ascontiguousarray(corners + np.float32(0.0)).view("V12").ravel()
    points, index = np.unique(rows, return_inverse=True)
    triangles = index.reshape(-1, 3).astype(np.int32)
    return Mesh(points.view(np.float32).reshape(-1, 3), triangles)


def decimate(mesh: Mesh) -> Mesh:
    """Reduce a mesh to about 2000 triangles by quadric edge collapse; a smaller one is unchanged.

    Raises:
        ConfigError: the extra `meshes` is not installed.
    """
    if len(mesh.triangles) <= _TRIANGLES:
        return mesh
    library = import_extra("fast_simplification", "meshes", _PURPOSE)
    points, triangles = library.simplify(*mesh, target_count=_TRIANGLES, agg=_AGGRESSION)
    return Mesh(points.astype(np.float32), triangles.astype(np.int32))
