"""The meshes of a robot: found, read, simplified, and taken from the real G1 if it has none."""

from __future__ import annotations

import sysconfig
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from g1stream.errors import RobotError
from g1stream.files import read_file
from g1stream.input_limits import MESHES
from g1stream.optional import import_extra, not_installed
from g1stream.robot.model import G1
from g1stream.robot.shapes import GHOST_INSET, read_visuals

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

__all__ = [
    "Mesh",
    "decimate",
    "find_mesh",
    "has_meshes",
    "missing_meshes",
    "read_stl",
    "real_g1",
    "robot_with_meshes",
    "with_shapes",
]

_PURPOSE: Final = "Meshes need"
#: Path of the G1 in the package example-robot-data, of the extra `meshes`.
_REAL_G1: Final = (
    "cmeel.prefix/share/example-robot-data/robots/g1_description/urdf/g1_29dof_rev_1_0.urdf"
)
#: A triangle of a binary STL file: normal, corners, and two unused bytes.
_TRIANGLE: Final = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")])
_STL_HEADER: Final = 84
#: Target number of triangles of a mesh. More remain if fewer would deform its surface too much.
_TRIANGLES: Final = 700
#: Aggressiveness of the decimation, 0 to 10. At 2 the size of every mesh of the G1 changes by at
#: most 0.6 mm, at 3 by 4 mm, at the library's default of 7 by 11 mm.
_AGGRESSION: Final = 2.0


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
        inset = min(GHOST_INSET, float(np.ptp(self.points, axis=0).min()) / 4)
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
    """Reduce a mesh to about 700 triangles by quadric edge collapse; a smaller one is unchanged.

    Raises:
        ConfigError: the extra `meshes` is not installed.
    """
    if len(mesh.triangles) <= _TRIANGLES:
        return mesh
    library = import_extra("fast_simplification", "meshes", _PURPOSE)
    points, triangles = library.simplify(*mesh, target_count=_TRIANGLES, agg=_AGGRESSION)
    return Mesh(points.astype(np.float32), triangles.astype(np.int32))
