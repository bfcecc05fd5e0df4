import numpy as np
import pytest
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory

from g1stream.config import RecordConfig
from g1stream.errors import ConfigError
from g1stream.robot.model import G1
from g1stream.robot.shapes import read_visuals
from g1stream.session.format import CHANNELS, encode_string
from g1stream.view.encoders import GHOST_PREFIX
from g1stream.view.pipeline import MessagePipeline
from g1stream.view.scene import PathEncoder, encode_scene

T0 = 1_700_000_000_000_000_000


@pytest.fixture(scope="module")
def robot():
    return G1.default()


def entities_of(robot, *args, **options):
    return SceneUpdate.FromString(encode_scene(T0, robot, None, *args, **options)).entities


def shapes(entity):
    return [*entity.cubes, *entity.cylinders, *entity.spheres, *entity.models]


def is_visual(shape, visual):
    p, q, colour = shape.pose.position, shape.pose.orientation, shape.color
    assert (p.x, p.y, p.z) == visual.pos
    assert (q.w, q.x, q.y, q.z) == visual.quat_wxyz
    assert (colour.r, colour.g, colour.b, colour.a) == visual.rgba


def test_every_visual_is_an_entity_locked_to_the_frame_of_its_link(robot):
    entities, visuals = entities_of(robot), read_visuals(robot)
    assert {entity.frame_id for entity in entities} == {visual.link for visual in visuals}
    assert len({entity.id for entity in entities}) == len(entities)
    assert sum(len(shapes(entity)) for entity in entities) == len(visuals)
    for entity in entities:
        assert entity.frame_locked
        assert entity.timestamp.ToNanoseconds() == T0
        assert not entity.HasField("lifetime") or entity.lifetime.ToNanoseconds() == 0
        assert all(c.top_scale == c.bottom_scale == 1 for c in entity.cylinders)
    by_frame = {entity.frame_id: entity for entity in entities}
    for kind, field in (("box", "cubes"), ("cylinder", "cylinders"), ("sphere", "spheres")):
        visual = next(v for v in visuals if v.kind == kind)
        shape = getattr(by_frame[visual.link], field)[0]
        is_visual(shape, visual)
        assert (shape.size.x, shape.size.y, shape.size.z) == visual.size


def test_a_ghost_has_its_own_frames_and_one_colour(robot):
    tint = (0.0, 0.5, 1.0, 0.25)
    ghost, solid = entities_of(robot, GHOST_PREFIX, tint), entities_of(robot)
    assert [e.frame_id for e in ghost] == [GHOST_PREFIX + e.frame_id for e in solid]
    colours = {(s.color.r, s.color.g, s.color.b, s.color.a) for e in ghost for s in shapes(e)}
    assert colours == {tint}


def test_a_path_reaches_back_over_batches_and_no_further():
    path = PathEncoder("path", 1.0, (1.0, 0.0, 0.0, 1.0))
    drawn = []
    for start in (0, 10, 20):
        times = T0 + 100_000_000 * np.arange(start, start + 10)
        points = np.arange(start, start + 10)[:, np.newaxis] * [1.0, 0.0, 0.0]
        drawn += path.encode(times, points, times[[5]])
    (entity,) = SceneUpdate.FromString(drawn[-1]).entities
    assert entity.timestamp.ToNanoseconds() == T0 + 2_500_000_000
    assert [point.x for point in entity.lines[0].points] == list(range(16, 26))
    assert len(SceneUpdate.FromString(drawn[0]).entities[0].lines[0].points) == 6


def test_the_description_is_a_ros_string():
    channel = CHANNELS["/robot_description"]
    schema = Schema(1, channel.build_schema(), channel.schema_encoding, channel.schema_name)
    decode = DecoderFactory().decoder_for(channel.message_encoding, schema)
    assert decode(encode_string("<robot name='é'/>")).data == "<robot name='é'/>"


def test_a_ghost_is_inside_the_robot(robot):
    shown, ghost = (entities_of(robot, ghost=ghost) for ghost in (False, True))
    for whole, smaller in zip(shown, ghost, strict=True):
        for a, b in zip(shapes(whole), shapes(smaller), strict=True):
            assert a.pose == b.pose
            sizes = np.array([[s.size.x, s.size.y, s.size.z] for s in (a, b)])
            assert sizes[0] - sizes[1] == pytest.approx(np.minimum(0.004, sizes[0] / 2))


def test_meshes_without_scenes_are_refused(robot):
    with pytest.raises(ConfigError, match="raw"):
        MessagePipeline(robot, RecordConfig(meshes=True, channels="raw"))
