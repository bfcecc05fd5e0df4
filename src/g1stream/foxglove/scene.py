"""What viewers draw of the robot: a Foxglove scene of its shapes, and its URDF as ROS sends it."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Any, Final

from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from g1stream.dds.layout import CDR_HEADER
from g1stream.errors import RobotError
from g1stream.robot.visuals import find_mesh, read_visuals

if TYPE_CHECKING:
    from collections.abc import Mapping

    from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity

    from g1stream.robot.model import G1
    from g1stream.robot.visuals import Visual

__all__ = ["encode_robot_description", "encode_scene"]

_MEDIA_TYPES: Final = {
    ".stl": "model/stl",
    ".dae": "model/vnd.collada+xml",
    ".obj": "model/obj",
    ".glb": "model/gltf-binary",
}


def encode_scene(timestamp_ns: int, robot: G1, opacities: Mapping[str, float]) -> bytes:
    """A foxglove.SceneUpdate with the shapes of a robot, locked to the frames of its links.

    Meshes whose files are found are embedded; others are referred to by name.

    Args:
        timestamp_ns: ns since the epoch.
        robot: whose URDF has the shapes.
        opacities: for each robot to show, the prefix of its frames and how opaque it is, 0 to 1.

    Raises:
        RobotError: the URDF has a shape that cannot be read.
    """
    update = SceneUpdate()
    visuals = read_visuals(robot)
    models = {name: _model(robot, name) for name in {v.mesh for v in visuals if v.mesh}}
    for prefix, opacity in opacities.items():
        entities: dict[str, SceneEntity] = {}
        for visual in visuals:
            frame = prefix + visual.link
            if frame not in entities:
                entities[frame] = update.entities.add(id=frame, frame_id=frame, frame_locked=True)
                entities[frame].timestamp.FromNanoseconds(timestamp_ns)
            _add(entities[frame], visual, opacity, models)
    data: bytes = update.SerializeToString()
    return data


def encode_robot_description(robot: G1) -> bytes:
    """The URDF as a std_msgs/msg/String in CDR: length including the final zero, then text."""
    text = robot.urdf.encode() + b"\0"
    return CDR_HEADER + struct.pack("<I", len(text)) + text


def _add(
    entity: SceneEntity, visual: Visual, opacity: float, models: Mapping[str, Mapping[str, Any]]
) -> None:
    """Add a shape to its link's entity."""
    if visual.kind == "box":
        shape: Any = entity.cubes.add()
    elif visual.kind == "sphere":
        shape = entity.spheres.add()
    elif visual.kind == "cylinder":
        shape = entity.cylinders.add(bottom_scale=1.0, top_scale=1.0)
    else:
        # Viewers make a mesh translucent only by overriding its colours with one.
        override = visual.coloured or opacity < 1.0
        shape = entity.models.add(override_color=override, **models[visual.mesh])
    extent = shape.scale if visual.kind == "mesh" else shape.size
    extent.x, extent.y, extent.z = visual.size
    pose, colour = shape.pose, shape.color
    pose.position.x, pose.position.y, pose.position.z = visual.pos
    q = pose.orientation
    q.w, q.x, q.y, q.z = visual.quat_wxyz
    colour.r, colour.g, colour.b, alpha = visual.rgba
    colour.a = alpha * opacity


def _model(robot: G1, name: str) -> dict[str, Any]:
    """A mesh's content where its file is found, else its name for the viewer to look up."""
    path = find_mesh(robot, name)
    if path is None:
        return {"url": name}
    media_type = _MEDIA_TYPES.get(path.suffix.lower(), "application/octet-stream")
    try:
        return {"data": path.read_bytes(), "media_type": media_type}
    except OSError as error:
        raise RobotError(
            f"The mesh {path} of {robot.name} cannot be read: {error.strerror}.",
            "Make it readable, or move it away to be shown by its name only.",
        ) from error
