from dataclasses import replace

import numpy as np
import pytest
import trimesh
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from g1stream.app.convert import convert
from g1stream.app.session import open_session
from g1stream.errors import RobotError
from g1stream.extras.meshes.meshes import find_mesh, read_stl, real_g1
from g1stream.extras.meshes.scene import SceneMeshes
from g1stream.robot.model import G1
from g1stream.robot.shapes import read_visuals
from g1stream.view.scene import encode_scene, meshes_of


def entities_of(robot, *, simplified=False, ghost=False):
    meshes = meshes_of(robot, simplified=simplified)
    return SceneUpdate.FromString(encode_scene(1, robot, meshes, ghost=ghost)).entities


def made_of(robot, directory, visuals):
    """A robot with these links and meshes, whose files are in a directory."""
    links = "".join(
        f"<link name='{link}'><visual><geometry><mesh filename='{mesh}' scale='{scale}'/>"
        "</geometry></visual></link>"
        for link, mesh, scale in visuals
    )
    return replace(robot, urdf=f"<robot>{links}</robot>", source=str(directory / "g1.urdf"))


def test_a_mesh_is_embedded_if_its_file_is_found_and_named_otherwise(robot, tmp_path):
    (tmp_path / "here.STL").write_bytes(b"solid")
    visuals = [(name, f"{name}.STL", "2 2 2") for name in ("here", "gone")]
    here, gone = (e.models[0] for e in entities_of(made_of(robot, tmp_path, visuals)))
    assert (here.data, here.media_type, here.url) == (b"solid", "model/stl", "")
    assert (gone.data, gone.url) == (b"", "gone.STL")
    assert here.scale.x == 2
    assert not here.override_color


def test_a_mesh_that_cannot_be_read_is_named(robot, tmp_path, monkeypatch):
    there = tmp_path / "a.stl"
    there.mkdir()
    monkeypatch.setattr("g1stream.extras.meshes.scene.find_mesh", lambda robot, name: there)
    with pytest.raises(RobotError, match=r"a\.stl"):
        SceneMeshes(made_of(robot, tmp_path, [("a", "torso.stl", "1 1 1")]), simplified=False)


def test_a_file_that_is_no_mesh_is_not_embedded(robot, tmp_path):
    secret, link = tmp_path / "secret.txt", tmp_path / "link.stl"
    secret.write_bytes(b"secret")
    link.symlink_to(secret)
    names = (f"file://{secret}", f"file://{link}", "secret.txt")
    made = made_of(robot, tmp_path, [(f"l{i}", name, "1 1 1") for i, name in enumerate(names)])
    models = [entity.models[0] for entity in entities_of(made)]
    assert [(model.data, model.url) for model in models] == [(b"", name) for name in names]


@pytest.fixture(scope="module")
def real():
    found = real_g1()
    if found is None:
        pytest.skip("needs the extra `meshes`")
    return found


def points(triangles):
    return np.array([(p.x, p.y, p.z) for p in triangles.points])


def volume_of(triangles):
    faces = np.reshape(triangles.indices, (-1, 3))
    return trimesh.Trimesh(points(triangles), faces, process=False).volume


def test_scenes_have_the_meshes_of_every_link_with_their_extent(real):
    shown = [(e.frame_id, one) for e in entities_of(real, simplified=True) for one in e.triangles]
    for visual, (frame, triangles) in zip(read_visuals(real), shown, strict=True):
        assert frame == visual.link
        p, q, colour = triangles.pose.position, triangles.pose.orientation, triangles.color
        assert (p.x, p.y, p.z, q.w, q.x, q.y, q.z) == visual.pos + visual.quat_wxyz
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
    made = made_of(robot, tmp_path, [("a", "box.stl", "2 -1 0.5")])
    (entity,) = entities_of(made, simplified=True)
    (shown,) = entity.triangles
    assert np.ptp(points(shown), axis=0).tolist() == [0.5, 0.5, 0.5]
    assert volume_of(shown) == pytest.approx(0.125)  # its outside is outside, though it is mirrored


def test_a_ghost_is_inside_the_robot(real):
    shown, ghost = (entities_of(real, simplified=True, ghost=one) for one in (False, True))
    for whole, smaller in zip(shown, ghost, strict=True):
        for a, b in zip(whole.triangles, smaller.triangles, strict=True):
            assert (a.pose, a.indices) == (b.pose, b.indices)
            moved = np.linalg.norm(points(a) - points(b), axis=1)
            assert np.median(moved) == pytest.approx(0.002, abs=2e-4)
            assert volume_of(b) < volume_of(a)


def test_without_meshes_there_are_none(robot):
    assert meshes_of(robot, simplified=False) is None


@pytest.mark.slow
def test_a_conversion_has_the_triangles_of_the_real_robot(real, robot, tmp_path):
    out = tmp_path / "out.mcap"
    report = convert("demo", out, meshes=True, frames=(0, 2))
    (data,) = (message.data for message in open_session(out).messages("/scene"))
    entities = SceneUpdate.FromString(data).entities
    assert {entity.frame_id for entity in entities} < set(robot.link_names)
    assert sum(len(one.indices) for entity in entities for one in entity.triangles) > 3 * 40e3
    assert not any(entity.cubes or entity.models for entity in entities)
    assert report.size < 2e6


def test_a_conversion_warns_of_meshes_that_are_only_named(robot, tmp_path):
    urdf = tmp_path / "g1.urdf"
    mesh = "<visual><geometry><mesh filename='gone.stl'/></geometry></visual></link>"
    urdf.write_text(robot.urdf.replace("</link>", mesh, 1))
    frames = {"frames": (0, 2), "force": True}
    for options, told in ((frames, 1), ({"only_tf": True} | frames, 0)):
        report = convert("demo", tmp_path / "out.mcap", robot=G1.load(urdf), **options)
        assert sum("gone.stl" in warning for warning in report.warnings) == told
