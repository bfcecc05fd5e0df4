"""Foxglove scenes of the robot and of its path."""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from g1stream.errors import RobotError
from g1stream.files import read_file
from g1stream.input_limits import MESHES
from g1stream.robot.shapes import Mesh, decimate, find_mesh, ghost_size, read_stl, read_visuals
from g1stream.types import Floats, Ints
from g1stream.view.encoders import WORLD_FRAME

if TYPE_CHECKING:
    from collections.abc import Mapping

    from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
    from foxglove_schemas_protobuf.TriangleListPrimitive_pb2 import TriangleListPrimitive

    from g1stream.robot.model import G1
    from g1stream.robot.shapes import Visual

__all__ = [
    "PathEncoder",
    "Rgba",
    "Shape",
    "draw_meshes",
    "encode_scene",
    "load_mesh",
]

Rgba = tuple[float, float, float, float]

_MEDIA_TYPES: Final = {
    ".stl": "model/stl",
    ".dae": "model/vnd.collada+xml",
    ".obj": "model/obj",
    ".glb": "model/gltf-binary",
}
#: Resolution of the points of a mesh, 0.12 mm; a power of two, so that most of their bits are zero.
_POINTS_PER_M: Final = 2.0**13


class Shape(NamedTuple):
    """A mesh of a URDF with its name and its scale (3,)."""

    mesh: str
    scale: tuple[float, ...]


def draw_meshes(robot: G1) -> dict[Shape, Mesh]:
    """Read the STL meshes of a robot for `encode_scene`, decimated, and scaled to m.

    Triangles look the same in all viewers. Viewers differ in the up axis and the tint of mesh
    files.

    Raises:
        RobotError: a mesh cannot be read.
        ConfigError: the extra `meshes` is not installed.
    """
    visuals = (visual for visual in read_visuals(robot) if visual.kind == "mesh")
    shapes = {Shape(visual.mesh, visual.size) for visual in visuals}
    files = {name: find_mesh(robot, name) for name, _ in shapes}
    meshes = {
        name: decimate(read_stl(path))
        for name, path in files.items()
        if path and path.suffix.lower() == ".stl"
    }
    return {
        shape: meshes[shape.mesh].scaled(shape.scale) for shape in shapes if shape.mesh in meshes
    }


def encode_scene(
    timestamp_ns: int,
    robot: G1,
    prefix: str = "",
    tint: Rgba | None = None,
    drawn: Mapping[Shape, Mesh] = MappingProxyType({}),
    *,
    ghost: bool = False,
) -> bytes:
    """Encode the shapes of a robot as foxglove.SceneUpdate, locked to the frames of its links.

    Meshes that are not in `drawn` are embedded completely if their files are found and have the
    suffix of a mesh. Others are referenced by name, so that a URDF cannot bring another file into a
    session.

    Args:
        timestamp_ns: ns since the epoch.
        robot: the robot.
        prefix: prefix of the frames of its links.
        tint: red, green, blue and opacity of all shapes, 0 to 1; None: the URDF's colours.
        drawn: the robot's meshes from `draw_meshes`.
        ghost: whether it is drawn over the robot; then its shapes are smaller, except meshes that
            are not in `drawn`.

    Raises:
        RobotError: the URDF has a shape that cannot be read, or its meshes are too large.
    """
    update = SceneUpdate()
    visuals = read_visuals(robot)
    others = {v.mesh for v in visuals if v.mesh and Shape(v.mesh, v.size) not in drawn}
    models = {name: load_mesh(robot, name) for name in others}
    size = sum(len(models.get(v.mesh, {}).get("data", b"")) for v in visuals)
    if size > MESHES:
        raise RobotError(
            f"The meshes of {robot.source} have {size / 2**20:.0f} MiB.",
            f"Use simpler ones, with at most {MESHES / 2**20:.0f} MiB, or move them away, so that "
            "they are referenced by name only.",
        )
    entities: dict[str, SceneEntity] = {}
    for visual in visuals:
        frame = prefix + visual.link
        if frame not in entities:
            entities[frame] = update.entities.add(id=frame, frame_id=frame, frame_locked=True)
            entities[frame].timestamp.FromNanoseconds(timestamp_ns)
        _add(entities[frame], visual, tint, drawn, models, ghost=ghost)
    data: bytes = update.SerializeToString()
    return data


class PathEncoder:
    """Draws the path of a frame in the last seconds, as foxglove.SceneUpdate with one line.

    Args:
        entity_id: entity id of the line.
        seconds: duration of the path, s.
        color: red, green, blue and opacity, 0 to 1.
    """

    def __init__(self, entity_id: str, seconds: float, color: Rgba) -> None:
        self._id, self._color, self._length = entity_id, color, round(seconds * 1e9)
        self._times: Ints = np.empty(0, dtype=np.int64)
        self._points: Floats = np.empty((0, 3))

    def encode(self, times: Ints, points: Floats, instants: Ints) -> list[bytes]:
        """Add points, and draw the line at some of their times.

        Args:
            times: (T,) ns since the epoch.
            points: (T, 3) m, world.
            instants: (K,) the times at which a line is drawn.
        """
        self._times = np.append(self._times, times)
        self._points = np.concatenate([self._points, points])
        lines = [self._line(int(instant)) for instant in instants]
        recent = self._times >= self._times[-1:].max(initial=0) - self._length
        self._times, self._points = self._times[recent], self._points[recent]
        return lines

    def _line(self, instant: int) -> bytes:
        update = SceneUpdate()
        entity = update.entities.add(id=self._id, frame_id=WORLD_FRAME)
        entity.timestamp.FromNanoseconds(instant)
        line = entity.lines.add(type=LinePrimitive.LINE_STRIP, thickness=3.0, scale_invariant=True)
        line.pose.orientation.w = 1.0
        line.color.r, line.color.g, line.color.b, line.color.a = self._color
        drawn = (self._times <= instant) & (self._times > instant - self._length)
        for x, y, z in self._points[drawn].tolist():
            line.points.add(x=x, y=y, z=z)
        data: bytes = update.SerializeToString()
        return data


def load_mesh(robot: G1, name: str) -> dict[str, Any]:
    """Load a mesh as fields of foxglove.ModelPrimitive.

    Returns:
        `data` and `media_type` if its file is found, otherwise `url`, its name, which the viewer
        resolves.

    Raises:
        RobotError: the file exists but cannot be read.
    """
    path = find_mesh(robot, name)
    media_type = _MEDIA_TYPES.get(path.resolve().suffix.lower()) if path else None
    if path is None or media_type is None:
        return {"url": name}
    try:
        return {"data": read_file(path, MESHES), "media_type": media_type}
    except OSError as error:
        raise RobotError(
            f"The mesh {path} of {robot.name} cannot be read: {error.strerror}.",
            "Make it readable, or move it away, so that it is referenced by name only.",
        ) from error


def _add(
    entity: SceneEntity,
    visual: Visual,
    tint: Rgba | None,
    drawn: Mapping[Shape, Mesh],
    models: Mapping[str, Mapping[str, Any]],
    *,
    ghost: bool,
) -> None:
    """Add a shape to the entity of its link."""
    mesh = drawn.get(Shape(visual.mesh, visual.size))
    size = visual.size
    if mesh is not None:
        shape: Any = _add_triangles(entity, mesh.of_ghost() if ghost else mesh)
    elif visual.kind == "box":
        shape = entity.cubes.add()
    elif visual.kind == "sphere":
        shape = entity.spheres.add()
    elif visual.kind == "cylinder":
        shape = entity.cylinders.add(bottom_scale=1.0, top_scale=1.0)
    else:
        # Viewers tint a mesh only if its colours are overridden.
        override = visual.coloured or tint is not None
        shape = entity.models.add(override_color=override, **models[visual.mesh])
    if mesh is None:
        extent = shape.scale if visual.kind == "mesh" else shape.size
        if ghost and visual.kind != "mesh":
            size = ghost_size(size)
        extent.x, extent.y, extent.z = size
    pose, colour = shape.pose, shape.color
    pose.position.x, pose.position.y, pose.position.z = visual.pos
    q = pose.orientation
    q.w, q.x, q.y, q.z = visual.quat_wxyz
    colour.r, colour.g, colour.b, colour.a = tint or visual.rgba


def _add_triangles(entity: SceneEntity, mesh: Mesh) -> TriangleListPrimitive:
    """Add a mesh with rounded points, which compress better."""
    added: TriangleListPrimitive = entity.triangles.add(indices=mesh.triangles.ravel().tolist())
    points = np.round(np.float64(mesh.points) * _POINTS_PER_M) / _POINTS_PER_M
    for x, y, z in points.tolist():
        added.points.add(x=x, y=y, z=z)
    return added
