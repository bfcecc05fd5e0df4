"""The scene and the description, decoded by the official classes and by a ROS 2 decoder."""

from dataclasses import replace

import pytest
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory

from g1stream.errors import RobotError
from g1stream.foxglove.encoders import MEASURED_PREFIX
from g1stream.foxglove.scene import _model, encode_robot_description, encode_scene
from g1stream.robot.model import G1
from g1stream.robot.visuals import read_visuals
from g1stream.session.format import CHANNELS

T0 = 1_700_000_000_000_000_000


@pytest.fixture(scope="module")
def robot():
    return G1.default()


def shapes(entity):
    return [*entity.cubes, *entity.cylinders, *entity.spheres, *entity.models]


def test_every_visual_is_an_entity_locked_to_the_frame_of_its_link(robot):
    entities = SceneUpdate.FromString(encode_scene(T0, robot, {"": 1.0})).entities
    visuals = read_visuals(robot)
    assert {entity.frame_id for entity in entities} == {visual.link for visual in visuals}
    assert len({entity.id for entity in entities}) == len(entities)
    assert sum(len(shapes(entity)) for entity in entities) == len(visuals)
    for entity in entities:
        assert entity.frame_locked
        assert entity.timestamp.ToNanoseconds() == T0
        assert not entity.HasField("lifetime") or entity.lifetime.ToNanoseconds() == 0


def test_pose_size_and_colour_are_those_of_the_urdf(robot):
    entities = SceneUpdate.FromString(encode_scene(T0, robot, {"": 1.0})).entities
    by_frame = {entity.frame_id: entity for entity in entities}
    for kind, field in (("box", "cubes"), ("cylinder", "cylinders"), ("sphere", "spheres")):
        visual = next(v for v in read_visuals(robot) if v.kind == kind)
        shape = getattr(by_frame[visual.link], field)[0]
        p, q, size, colour = shape.pose.position, shape.pose.orientation, shape.size, shape.color
        assert (p.x, p.y, p.z) == visual.pos
        assert (q.w, q.x, q.y, q.z) == visual.quat_wxyz
        assert (size.x, size.y, size.z) == visual.size
        assert (colour.r, colour.g, colour.b, colour.a) == visual.rgba
    for entity in entities:
        assert all(c.top_scale == c.bottom_scale == 1 for c in entity.cylinders)


def test_each_prefix_is_one_robot_with_its_opacity(robot):
    opacities = {"": 0.3, MEASURED_PREFIX: 1.0}
    entities = SceneUpdate.FromString(encode_scene(T0, robot, opacities)).entities
    ghost = [e for e in entities if not e.frame_id.startswith(MEASURED_PREFIX)]
    assert 2 * len(ghost) == len(entities)
    assert {s.color.a for e in ghost for s in shapes(e)} == {0.3}
    assert {s.color.a for e in entities if e not in ghost for s in shapes(e)} == {1.0}


def test_a_mesh_is_embedded_if_its_file_is_found_and_named_otherwise(robot, tmp_path):
    (tmp_path / "here.STL").write_bytes(b"solid")
    xml = "".join(
        f"<link name='{name}'><visual><geometry><mesh filename='{name}.STL' scale='2 2 2'/>"
        "</geometry></visual></link>"
        for name in ("here", "gone")
    )
    made = replace(robot, urdf=f"<robot>{xml}</robot>", source=str(tmp_path / "g1.urdf"))
    update = SceneUpdate.FromString(encode_scene(T0, made, {"": 1.0}))
    here, gone = (entity.models[0] for entity in update.entities)
    assert (here.data, here.media_type, here.url) == (b"solid", "model/stl", "")
    assert (gone.data, gone.url) == (b"", "gone.STL")
    assert here.scale.x == 2
    assert not here.override_color


@pytest.mark.parametrize("text", ["<robot/>", "<robot name='é'/>"])
def test_the_description_is_a_ros_string(robot, text):
    made = replace(robot, urdf=text)
    channel = CHANNELS["/robot_description"]
    schema = Schema(
        id=1,
        name=channel.schema_name,
        encoding=channel.schema_encoding,
        data=channel.build_schema(),
    )
    decode = DecoderFactory().decoder_for(channel.message_encoding, schema)
    assert decode(encode_robot_description(made)).data == text


def test_a_mesh_that_cannot_be_read_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr("g1stream.foxglove.scene.find_mesh", lambda robot, name: tmp_path)
    robot = G1.load()
    with pytest.raises(RobotError, match=str(tmp_path)):
        _model(robot, "torso.stl")
