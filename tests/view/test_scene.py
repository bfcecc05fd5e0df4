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


def shapes(entity):
    return [*entity.cubes, *entity.cylinders, *entity.spheres, *entity.models]


def test_every_visual_is_an_entity_locked_to_the_frame_of_its_link(robot):
    entities = SceneUpdate.FromString(encode_scene(T0, robot)).entities
    visuals = read_visuals(robot)
    assert {entity.frame_id for entity in entities} == {visual.link for visual in visuals}
    assert len({entity.id for entity in entities}) == len(entities)
    assert sum(len(shapes(entity)) for entity in entities) == len(visuals)
    for entity in entities:
        assert entity.frame_locked
        assert entity.timestamp.ToNanoseconds() == T0
        assert not entity.HasField("lifetime") or entity.lifetime.ToNanoseconds() == 0


def test_pose_size_and_colour_are_those_of_the_urdf(robot):
    entities = SceneUpdate.FromString(encode_scene(T0, robot)).entities
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


def test_a_ghost_has_its_own_frames_and_one_colour(robot):
    tint = (0.0, 0.5, 1.0, 0.25)
    ghost = SceneUpdate.FromString(encode_scene(T0, robot, GHOST_PREFIX, tint)).entities
    solid = SceneUpdate.FromString(encode_scene(T0, robot)).entities
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
    xml = "".join(
        f"<link name='{name}'><visual><geometry><mesh filename='{name}.STL' scale='2 2 2'/>"
        "</geometry></visual></link>"
        for name in ("here", "gone")
    )
    made = replace(robot, urdf=f"<robot>{xml}</robot>", source=str(tmp_path / "g1.urdf"))
    update = SceneUpdate.FromString(encode_scene(T0, made))
    here, gone = (entity.models[0] for entity in update.entities)
    assert (here.data, here.media_type, here.url) == (b"solid", "model/stl", "")
    assert (gone.data, gone.url) == (b"", "gone.STL")
    assert here.scale.x == 2
    assert not here.override_color


@pytest.mark.parametrize("text", ["<robot/>", "<robot name='é'/>"])
def test_the_description_is_a_ros_string(text):
    channel = CHANNELS["/robot_description"]
    schema = Schema(
        id=1,
        name=channel.schema_name,
        encoding=channel.schema_encoding,
        data=channel.build_schema(),
    )
    decode = DecoderFactory().decoder_for(channel.message_encoding, schema)
    assert decode(encode_string(text)).data == text


def test_a_mesh_that_cannot_be_read_is_named(tmp_path, monkeypatch):
    mesh = tmp_path / "torso.stl"
    mesh.mkdir()
    monkeypatch.setattr("g1stream.view.scene.find_mesh", lambda robot, name: mesh)
    robot = G1.load()
    with pytest.raises(RobotError, match=str(mesh)):
        load_mesh(robot, "torso.stl")


def test_a_file_that_is_no_mesh_is_not_embedded(robot, tmp_path):
    secret, link = tmp_path / "secret.txt", tmp_path / "link.stl"
    secret.write_bytes(b"secret")
    link.symlink_to(secret)
    for name in (f"file://{secret}", f"file://{link}", "secret.txt"):
        made = replace(robot, source=str(tmp_path / "g1.urdf"))
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


def test_scenes_have_the_meshes_of_every_link_with_their_extent(real, drawn):
    entities = SceneUpdate.FromString(encode_scene(T0, real, drawn=drawn)).entities
    visuals = read_visuals(real)
    assert {entity.frame_id for entity in entities} == {visual.link for visual in visuals}
    shown = [(entity.frame_id, one) for entity in entities for one in entity.triangles]
    for visual, (frame, triangles) in zip(visuals, shown, strict=True):
        assert frame == visual.link
        p, q, colour = triangles.pose.position, triangles.pose.orientation, triangles.color
        assert (p.x, p.y, p.z) == visual.pos
        assert (q.w, q.x, q.y, q.z) == visual.quat_wxyz
        assert (colour.r, colour.g, colour.b, colour.a) == visual.rgba
        whole = read_stl(find_mesh(real, visual.mesh))
        found = points(triangles)[triangles.indices]
        assert 100 < len(found) / 3 <= max(len(whole.triangles), 100)
        for extreme in (np.min, np.max):
            np.testing.assert_allclose(
                extreme(found, axis=0), extreme(whole.points, axis=0), atol=0.002
            )


def test_the_scale_of_a_visual_is_in_the_points(robot, tmp_path):
    trimesh.creation.box((0.25, 0.5, 1.0)).export(tmp_path / "box.stl")
    xml = "<link name='a'><visual><geometry><mesh filename='box.stl' scale='2 -1 0.5'/>"
    made = replace(
        robot,
        urdf=f"<robot>{xml}</geometry></visual></link></robot>",
        source=str(tmp_path / "g1.urdf"),
    )
    ((shape, mesh),) = draw_meshes(made).items()
    assert shape.scale == (2, -1, 0.5)
    assert np.ptp(mesh.points, axis=0).tolist() == [0.5, 0.5, 0.5]
    assert mesh.triangles.shape == (12, 3)
    (entity,) = SceneUpdate.FromString(encode_scene(T0, made, drawn={shape: mesh})).entities
    assert np.ptp(points(entity.triangles[0]), axis=0).tolist() == [0.5, 0.5, 0.5]
    volume = trimesh.Trimesh(mesh.points, mesh.triangles, process=False).volume
    assert volume == pytest.approx(0.125)  # its outside is outside, though it is mirrored


def test_a_ghost_is_inside_the_robot(robot, real, drawn):
    for one, meshes in ((robot, {}), (real, drawn)):
        shown, ghost = (
            SceneUpdate.FromString(encode_scene(T0, one, drawn=meshes, ghost=ghost)).entities
            for ghost in (False, True)
        )
        for whole, smaller in zip(shown, ghost, strict=True):
            for a, b in zip(shapes(whole), shapes(smaller), strict=True):
                assert a.pose == b.pose
                sizes = np.array([[s.size.x, s.size.y, s.size.z] for s in (a, b)])
                inset = np.minimum(0.004, sizes[0] / 2)
                assert sizes[0] - sizes[1] == pytest.approx(inset)
            for a, b in zip(whole.triangles, smaller.triangles, strict=True):
                assert a.pose == b.pose
                assert a.indices == b.indices
                moved = np.linalg.norm(points(a) - points(b), axis=1)
                assert np.median(moved) == pytest.approx(0.002, abs=2e-4)
                volumes = [
                    trimesh.Trimesh(points(m), np.reshape(m.indices, (-1, 3)), process=False).volume
                    for m in (a, b)
                ]
                assert volumes[1] < volumes[0]


def test_a_session_has_a_ghost_that_is_smaller(robot):
    header = {one.topic: one.payloads[0] for one in MessagePipeline(robot).file_header(T0)}
    assert header["/ghost/scene"] == encode_scene(
        T0, robot, GHOST_PREFIX, (0.1, 0.6, 1.0, 0.3), ghost=True
    )


def test_meshes_without_scenes_are_refused(robot):
    with pytest.raises(ConfigError, match="raw"):
        MessagePipeline(robot, RecordConfig(meshes=True, channels="raw"))
