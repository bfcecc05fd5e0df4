"""Meshes in the Foxglove scene of a robot."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from g1stream.errors import RobotError
from g1stream.extras.meshes.meshes import (
    Mesh,
    decimate,
    find_mesh,
    missing_meshes,
    read_stl,
    robot_with_meshes,
)
from g1stream.files import read_file
from g1stream.input_limits import MESHES
from g1stream.robot.shapes import read_visuals

if TYPE_CHECKING:
    from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
    from foxglove_schemas_protobuf.TriangleListPrimitive_pb2 import TriangleListPrimitive

    from g1stream.robot.model import G1
    from g1stream.robot.shapes import Visual

__all__ = ["SceneMeshes"]

_MEDIA_TYPES: Final = {
    ".stl": "model/stl",
    ".dae": "model/vnd.collada+xml",
    ".obj": "model/obj",
    ".glb": "model/gltf-binary",
}
#: Resolution of the points of a mesh, 0.12 mm; a power of two, so that most of their bits are zero.
_POINTS_PER_M: Final = 2.0**13


class SceneMeshes:
    """The meshes of a robot, for `view.scene.encode_scene`.

    Simplified, an STL file is drawn as triangles, which look the same in all viewers; these differ
    in the up axis and the tint of mesh files. Another file is embedded completely if it is found
    and has the suffix of a mesh. What is left is referenced by name, so that a URDF cannot bring
    another file into a session.

    Args:
        robot: the robot.
        simplified: simplify STL files, and take the real G1 if the robot lacks meshes.

    Attributes:
        robot: the robot whose shapes are drawn.
        missing: names of its meshes that do not exist.

    Raises:
        RobotError: a mesh cannot be read, the meshes are too large, or the real G1 is needed, but
            the robot has other links.
        ConfigError: simplified, and the extra `meshes` is not installed.
    """

    def __init__(self, robot: G1, *, simplified: bool) -> None:
        self.robot = robot_with_meshes(robot) if simplified else robot
        self.missing = missing_meshes(self.robot)
        visuals = [visual for visual in read_visuals(self.robot) if visual.mesh]
        files = {visual.mesh: find_mesh(self.robot, visual.mesh) for visual in visuals}
        self._triangles = {
            name: decimate(read_stl(path))
            for name, path in files.items()
            if simplified and path and path.suffix.lower() == ".stl"
        }
        self._models = {name: self._model(name) for name in files.keys() - self._triangles.keys()}
        size = sum(len(self._models.get(v.mesh, {}).get("data", b"")) for v in visuals)
        if size > MESHES:
            raise RobotError(
                f"The meshes of {robot.source} have {size / 2**20:.0f} MiB.",
                f"Use simpler ones, with at most {MESHES / 2**20:.0f} MiB, or move them away, so "
                "that they are referenced by name only.",
            )

    def add(self, entity: SceneEntity, visual: Visual, *, tinted: bool, ghost: bool) -> Any:
        """Add a mesh to the entity of its link, without pose and colour, and return it."""
        if visual.mesh in self._triangles:
            mesh = self._triangles[visual.mesh].scaled(visual.size)
            return _add_triangles(entity, mesh.of_ghost() if ghost else mesh)
        # Viewers tint a mesh only if its colours are overridden.
        override = visual.coloured or tinted
        model = entity.models.add(override_color=override, **self._models[visual.mesh])
        model.scale.x, model.scale.y, model.scale.z = visual.size
        return model

    def _model(self, name: str) -> dict[str, Any]:
        """A mesh as fields of foxglove.ModelPrimitive.

        `data` and `media_type` if its file is found, otherwise `url`, its name, which the viewer
        resolves.
        """
        path = find_mesh(self.robot, name)
        media_type = _MEDIA_TYPES.get(path.resolve().suffix.lower()) if path else None
        if path is None or media_type is None:
            return {"url": name}
        try:
            return {"data": read_file(path, MESHES), "media_type": media_type}
        except OSError as error:
            raise RobotError(
                f"The mesh {path} of {self.robot.name} cannot be read: {error.strerror}.",
                "Make it readable, or move it away, so that it is referenced by name only.",
            ) from error


def _add_triangles(entity: SceneEntity, mesh: Mesh) -> TriangleListPrimitive:
    """Add a mesh with rounded points, which compress better."""
    added: TriangleListPrimitive = entity.triangles.add(indices=mesh.triangles.ravel().tolist())
    points = np.round(np.float64(mesh.points) * _POINTS_PER_M) / _POINTS_PER_M
    for x, y, z in points.tolist():
        added.points.add(x=x, y=y, z=z)
    return added
