"""Foxglove scenes of the robot and of its path."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from g1stream.optional import extension
from g1stream.robot.shapes import ghost_size, read_visuals
from g1stream.types import Floats, Ints
from g1stream.view.encoders import WORLD_FRAME

if TYPE_CHECKING:
    from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity

    from g1stream.robot.model import G1
    from g1stream.robot.shapes import Visual

__all__ = ["PathEncoder", "Rgba", "encode_scene", "meshes_of"]

Rgba = tuple[float, float, float, float]


def meshes_of(robot: G1, *, simplified: bool) -> Any:
    """The meshes of a robot for `encode_scene`; None if its URDF has none.

    With `simplified` they are triangles, and those of the real G1 if the URDF has none.

    Raises:
        ConfigError: the extra `meshes` is needed and not installed.
        RobotError: a mesh cannot be read or is too large, or the real G1 has other links.
    """
    if simplified or any(visual.mesh for visual in read_visuals(robot)):
        return extension("scene_meshes")(robot, simplified=simplified)
    return None


def encode_scene(
    timestamp_ns: int,
    robot: G1,
    meshes: Any,
    prefix: str = "",
    tint: Rgba | None = None,
    *,
    ghost: bool = False,
) -> bytes:
    """Encode the shapes of a robot as foxglove.SceneUpdate, locked to the frames of its links.

    Args:
        timestamp_ns: ns since the epoch.
        robot: the robot.
        meshes: what `meshes_of` returned for it.
        prefix: prefix of the frames of its links.
        tint: red, green, blue and opacity of all shapes, 0 to 1; None: the URDF's colours.
        ghost: whether it is drawn over the robot; then its shapes are smaller, except meshes that
            are not simplified.

    Raises:
        RobotError: the URDF has a shape that cannot be read.
    """
    update = SceneUpdate()
    entities: dict[str, SceneEntity] = {}
    for visual in read_visuals(meshes.robot if meshes else robot):
        frame = prefix + visual.link
        if frame not in entities:
            entities[frame] = update.entities.add(id=frame, frame_id=frame, frame_locked=True)
            entities[frame].timestamp.FromNanoseconds(timestamp_ns)
        entity = entities[frame]
        if visual.kind == "mesh":
            shape = meshes.add(entity, visual, tinted=tint is not None, ghost=ghost)
        else:
            shape = _add_primitive(entity, visual, ghost=ghost)
        pose, colour = shape.pose, shape.color
        pose.position.x, pose.position.y, pose.position.z = visual.pos
        q = pose.orientation
        q.w, q.x, q.y, q.z = visual.quat_wxyz
        colour.r, colour.g, colour.b, colour.a = tint or visual.rgba
    data: bytes = update.SerializeToString()
    return data


def _add_primitive(entity: SceneEntity, visual: Visual, *, ghost: bool) -> Any:
    """Add a box, a sphere or a cylinder to the entity of its link, without pose and colour."""
    if visual.kind == "box":
        shape: Any = entity.cubes.add()
    elif visual.kind == "sphere":
        shape = entity.spheres.add()
    else:
        shape = entity.cylinders.add(bottom_scale=1.0, top_scale=1.0)
    size = ghost_size(visual.size) if ghost else visual.size
    shape.size.x, shape.size.y, shape.size.z = size
    return shape


class PathEncoder:
    """Draws the path of a frame in the last seconds, as foxglove.SceneUpdate with one line.

    Its colour is red, green, blue and opacity, 0 to 1.
    """

    def __init__(self, entity_id: str, seconds: float, color: Rgba) -> None:
        self._id, self._color, self._length = entity_id, color, round(seconds * 1e9)
        self._times: Ints = np.empty(0, dtype=np.int64)
        self._points: Floats = np.empty((0, 3))

    def encode(self, times: Ints, points: Floats, instants: Ints) -> list[bytes]:
        """Add points (T, 3) m, world, at times (T,) ns since the epoch.

        A line is drawn at each of some of these times, (K,).
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
