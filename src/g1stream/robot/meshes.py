"""The meshes of a robot, read and reduced to what a viewer needs."""

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
from g1stream.robot.visuals import has_meshes, mesh_names

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = [
    "Mesh",
    "decimate",
    "read_stl",
    "real_g1",
    "robot_with_meshes",
    "with_shapes",
]


_PURPOSE: Final = "Meshes need"
#: Where the package example-robot-data, of the extra `meshes`, has the G1.
_REAL_G1: Final = (
    "cmeel.prefix/share/example-robot-data/robots/g1_description/urdf/g1_29dof_rev_1_0.urdf"
)
#: A triangle of a binary STL file: its normal, its corners, and two bytes without a meaning.
_TRIANGLE: Final = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")])
_STL_HEADER: Final = 84
#: Triangles that a mesh is reduced to. More stay where fewer would bend its surface too far.
_TRIANGLES: Final = 2000
#: How far the decimation goes beyond the flattest edges, 0 to 10. At 2 the extent of every mesh of
#: the G1 is kept to 0.6 mm, at 3 to 4 mm, at the library's 7 to 11 mm.
_AGGRESSION: Final = 2.0


class Mesh(NamedTuple):
    """Triangles in the coordinates of their file: points (V, 3), and indices of corners (T, 3)."""

    points: NDArray[np.float32]
    triangles: NDArray[np.int32]


def real_g1() -> G1 | None:
    """Unitree's URDF and its meshes, g1_29dof_rev_1_0; None without the extra `meshes`."""
    path = Path(sysconfig.get_path("purelib"), _REAL_G1)
    return G1.load(path, own_limits=True) if path.is_file() else None


def robot_with_meshes(robot: G1) -> G1:
    """The robot itself where its URDF has meshes and all are found, else the real G1.

    Raises:
        ConfigError: neither, as the extra `meshes` is not installed.
        RobotError: neither, as the robot has other links than the real G1.
    """
    if has_meshes(robot):
        return robot
    real = real_g1()
    if real is None:
        raise not_installed("example-robot-data", "meshes", _PURPOSE)
    if set(real.link_names) != set(robot.link_names):
        raise RobotError(
            f"The G1's meshes do not fit {robot.source}, which has other links.",
            "Leave out --meshes, or give a URDF whose own meshes are found.",
        )
    return real


def with_shapes(robot: G1) -> G1:
    """The robot whose shapes stand for a robot's: itself where its URDF's meshes are found.

    Else the real G1 with meshes where they are installed, or instead of missing meshes the default
    robot, if it has links of the same names.
    """
    if has_meshes(robot):
        return robot
    others = (real_g1(), G1.default() if mesh_names(robot) else None)
    same = (one for one in others if one and set(one.link_names) == set(robot.link_names))
    return next(same, robot)


def read_stl(path: Path) -> Mesh:
    """The triangles of a binary STL file; corners at the same place become one point.

    Raises:
        RobotError: it cannot be read, or is no binary STL.
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
            "Export it as binary STL, or leave out --meshes.",
        )
    corners = np.frombuffer(data, _TRIANGLE, offset=_STL_HEADER)["corners"].reshape(-1, 3)
    if not np.isfinite(corners).all():
        raise RobotError(f"The mesh {path} has a corner that is no number.", "Export it again.")
    # As bytes, which sort much faster than rows; + 0.0 makes -0.0 the same as 0.0.
    rows = np.ascontiguousarray(corners + np.float32(0.0)).view("V12").ravel()
    points, index = np.unique(rows, return_inverse=True)
    triangles = index.reshape(-1, 3).astype(np.int32)
    return Mesh(points.view(np.float32).reshape(-1, 3), triangles)


def decimate(mesh: Mesh) -> Mesh:
    """The mesh with 2000 triangles or some more, by quadric edge collapse; a smaller one as it is.

    Raises:
        ConfigError: the extra `meshes` is not installed.
    """
    if len(mesh.triangles) <= _TRIANGLES:
        return mesh
    library = import_extra("fast_simplification", "meshes", _PURPOSE)
    points, triangles = library.simplify(*mesh, target_count=_TRIANGLES, agg=_AGGRESSION)
    return Mesh(points.astype(np.float32), triangles.astype(np.int32))
