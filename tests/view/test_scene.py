from dataclasses import replace

import numpy as np
import pytest
import trimesh
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory

from g1stream.config import RecordConfig
from g1stream.errors import ConfigError, RobotError
from g1stream.robot.model import G1
from g1stream.robot.shapes import find_mesh, read_stl, read_visuals, real_g1
from g1stream.session.format import CHANNELS, encode_string
from g1stream.view.encoders import GHOST_PREFIX
from g1stream.view.pipeline import MessagePipeline
from g1stream.view.scene import (
    PathEncoder,
    draw_meshes,
    encode_scene,
    load_mesh,
)

T0 = 1_700_000_000_000_000_000


@pytest.fixture(scope="module")
def robot():
    return G1.default()


def entities_of(robot, *args, **options):
    return SceneUpdate.FromString(encode_scene(T0, robot, *args, **options)).entities


def shapes(entity):
    return [*entity.cubes, *entity.cylinders, *entity.spheres, *entity.models]


def is_visual(shape, visual):
    p, q, colour = shape.pose.position, shape.pose.orientation, shape.color
    assert (p.x, p.y, p.z) == visual.pos
    assert (q.w, q.x, q.y, q.z) == visual.quat_wxyz
    assert (colour.r, colour.g, colour.b, colour.a) == visual.rgba


def made_of(robot, directory, visuals):
    """A robot with these links and meshes, whose files are in a directory."""
    links = "".join(
        f"<link name='{link}'><visual><geometry><mesh filename='{mesh}' scale='{scale}'/>"
        "</geometry></visual></link>"
        for link, mesh, scale in visuals
    )
    return replace(robot, urdf=f"<robot>{links}</robot>", source=str(directory / "g1.urdf"))


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


def test_a_mesh_is_embedded_if_its_file_is_found_and_named_otherwise(robot, tmp_path):
    (tmp_path / "here.STL").write_bytes(b"solid")
    visuals = [(name, f"{name}.STL", "2 2 2") for name in ("here", "gone")]
    here, gone = (e.models[0] for e in entities_of(made_of(robot, tmp_path, visuals)))
    assert (here.data, here.media_type, here.url) == (b"solid", "model/stl", "")
    assert (gone.data, gone.url) == (b"", "gone.STL")
    assert here.scale.x == 2
    assert not here.override_color


def test_the_description_is_a_ros_string():
    channel = CHANNELS["/robot_description"]
    schema = Schema(1, channel.build_schema(), channel.schema_encoding, channel.schema_name)
    decode = DecoderFactory().decoder_for(channel.message_encoding, schema)
    assert decode(encode_string("<robot name='é'/>")).data == "<robot name='é'/>"


def test_a_mesh_that_cannot_be_read_is_named(robot, tmp_path, monkeypatch):
    monkeypatch.setattr("g1stream.view.scene.find_mesh", lambda robot, name: tmp_path / "a.stl")
    (tmp_path / "a.stl").mkdir()
    with pytest.raises(RobotError, match=r"a\.stl"):
        load_mesh(robot, "torso.stl")


def test_a_file_that_is_no_mesh_is_not_embedded(robot, tmp_path):
    secret, link = tmp_path / "secret.txt", tmp_path / "link.stl"
    secret.write_bytes(b"secret")
    link.symlink_to(secret)
    made = made_of(robot, tmp_path, [])
    for name in (f"file://{secret}", f"file://{link}", "secret.txt"):
        assert load_mesh(made, name) == {"url": name}


@pytest.fixture(scope="module")
def real():
    found = real_g1()
    if found is None:
        pytest.skip("needs the extra `meshes`")
    return found


@pytest.fixture(scope="module")
def drawn(real):
    return draw_meshes(real)


def points(triangles):
    return np.array([(p.x, p.y, p.z) for p in triangles.points])


def volume_of(triangles):
    faces = np.reshape(triangles.indices, (-1, 3))
    return trimesh.Trimesh(points(triangles), faces, process=False).volume


def test_scenes_have_the_meshes_of_every_link_with_their_extent(real, drawn):
    shown = [(e.frame_id, one) for e in entities_of(real, drawn=drawn) for one in e.triangles]
    for visual, (frame, triangles) in zip(read_visuals(real), shown, strict=True):
        assert frame == visual.link
        is_visual(triangles, visual)
        whole = read_stl(find_mesh(real, visual.mesh))
        found = points(triangles)[triangles.indices]
        assert 100 < len(found) / 3 <= max(len(whole.triangles), 100)
        for extreme in (np.min, np.max):
            np.testing.assert_allclose(
                extreme(found, axis=0), extreme(whole.points, axis=0), atol=0.002
            )


def test_the_scale_of_a_visual_is_in_the_points(robot, tmp_path):
    trimesh.creation.box((0.25, 0.5, 1.0)).export(tmp_path / "box.stl")
    made = made_of(robot, tmp_path, [("a", "box.stl", "2 -1 0.5")])
    ((shape, mesh),) = draw_meshes(made).items()
    assert shape.scale == (2, -1, 0.5)
    (entity,) = entities_of(made, drawn={shape: mesh})
    (shown,) = entity.triangles
    assert np.ptp(points(shown), axis=0).tolist() == [0.5, 0.5, 0.5]
    assert volume_of(shown) == pytest.approx(0.125)  # its outside is outside, though it is mirrored


def test_a_ghost_is_inside_the_robot(robot, real, drawn):
    for one, meshes in ((robot, {}), (real, drawn)):
        shown, ghost = (entities_of(one, drawn=meshes, ghost=ghost) for ghost in (False, True))
        for whole, smaller in zip(shown, ghost, strict=True):
            for a, b in zip(shapes(whole), shapes(smaller), strict=True):
                assert a.pose == b.pose
                sizes = np.array([[s.size.x, s.size.y, s.size.z] for s in (a, b)])
                assert sizes[0] - sizes[1] == pytest.approx(np.minimum(0.004, sizes[0] / 2))
            for a, b in zip(whole.triangles, smaller.triangles, strict=True):
                assert (a.pose, a.indices) == (b.pose, b.indices)
                moved = np.linalg.norm(points(a) - points(b), axis=1)
                assert np.median(moved) == pytest.approx(0.002, abs=2e-4)
                assert volume_of(b) < volume_of(a)


def test_meshes_without_scenes_are_refused(robot):
    with pytest.raises(ConfigError, match="raw"):
        MessagePipeline(robot, RecordConfig(meshes=True, channels="raw"))
