import sys
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from g1stream.errors import ConfigError, RobotError
from g1stream.extras.meshes.meshes import (
    decimate,
    find_mesh,
    missing_meshes,
    read_stl,
    robot_with_meshes,
)
from g1stream.robot.model import G1
from g1stream.robot.shapes import read_visuals


def with_urdf(robot, xml, source="made.urdf"):
    """A robot with these shapes; its joints do not matter here."""
    return replace(robot, urdf=f"<robot>{xml}</robot>", source=str(source))


def shape(geometry):
    return f"<link name='a'><visual><geometry>{geometry}</geometry></visual></link>"


@pytest.mark.parametrize(
    "name",
    [
        "../meshes/a b.stl",
        "package://g1_description/meshes/a b.stl",
        "package://g1_description/meshes/a%20b.stl",
        "package://elsewhere/meshes/a b.stl",
    ],
)
def test_meshes_are_found_from_the_urdf_and_by_package(robot, tmp_path, name):
    package = tmp_path / "g1_description"
    mesh = package / "meshes" / "a b.stl"
    mesh.parent.mkdir(parents=True)
    mesh.touch()
    (package / "urdf").mkdir()
    made = with_urdf(robot, "", package / "urdf" / "g1.urdf")
    assert find_mesh(made, name).resolve() == mesh
    assert find_mesh(made, f"file://{mesh}") == mesh


def test_missing_meshes_are_named_once(robot, tmp_path):
    xml = shape("<mesh filename='a.stl'/>") + shape("<mesh filename='a.stl'/>")
    assert missing_meshes(with_urdf(robot, xml, tmp_path / "g1.urdf")) == ("a.stl",)
    (tmp_path / "a.stl").touch()
    assert missing_meshes(with_urdf(robot, xml, tmp_path / "g1.urdf")) == ()


def test_the_meshes_of_unitrees_robot_are_found_where_its_package_has_them(reference_urdf):
    theirs = G1.load(reference_urdf("g1_29dof_rev_1_0.urdf"))
    meshes = [visual.mesh for visual in read_visuals(theirs) if visual.kind == "mesh"]
    assert len(meshes) == 35
    assert missing_meshes(theirs) == ()


@pytest.fixture
def sphere(tmp_path):
    path = tmp_path / "sphere.stl"
    trimesh.creation.icosphere(subdivisions=4, radius=0.1).export(path)
    return path


def test_a_file_is_read_as_trimesh_reads_it(sphere):
    mesh, theirs = read_stl(sphere), trimesh.load(sphere)
    assert mesh.points.shape == theirs.vertices.shape  # corners at one place are one point
    ours = np.sort(mesh.points[mesh.triangles].reshape(-1, 9), axis=0)
    np.testing.assert_array_equal(ours, np.sort(theirs.triangles.reshape(-1, 9), axis=0))


def test_a_decimated_mesh_has_few_triangles_and_the_same_shape(sphere):
    pytest.importorskip("fast_simplification")
    mesh = read_stl(sphere)
    few = decimate(mesh)
    assert len(mesh.triangles) == 5120
    assert len(few.triangles) == pytest.approx(700, rel=0.1)
    assert np.linalg.norm(few.points, axis=1) == pytest.approx(0.1, rel=0.01)
    made = trimesh.Trimesh(few.points, few.triangles, process=False)
    assert made.is_watertight
    assert made.volume == pytest.approx(4 / 3 * np.pi * 0.1**3, rel=0.02)


def test_a_small_mesh_stays_as_it_is(tmp_path):
    trimesh.creation.icosphere(subdivisions=2).export(tmp_path / "small.stl")
    mesh = read_stl(tmp_path / "small.stl")
    assert decimate(mesh) is mesh


@pytest.mark.parametrize(
    "content",
    [b"", b"solid ascii\nendsolid\n", bytes(84), bytes(80) + b"\x02\0\0\0" + bytes(50)],
    ids=["empty", "text", "no triangle", "cut"],
)
def test_what_is_no_binary_stl_is_refused(tmp_path, content):
    path = tmp_path / "bad.stl"
    path.write_bytes(content)
    with pytest.raises(RobotError, match=str(path)):
        read_stl(path)


def test_a_corner_that_is_no_number_is_refused(sphere):
    data = bytearray(sphere.read_bytes())
    data[96:100] = np.float32(np.nan).tobytes()
    sphere.write_bytes(data)
    with pytest.raises(RobotError, match="not a finite number"):
        read_stl(sphere)


def test_without_the_extra_the_error_says_how_to_install_it(sphere, monkeypatch):
    monkeypatch.setitem(sys.modules, "fast_simplification", None)
    with pytest.raises(ConfigError, match=r"fast-simplification.*g1stream\[meshes\]"):
        decimate(read_stl(sphere))
    monkeypatch.setattr("g1stream.extras.meshes.meshes.real_g1", lambda: None)
    with pytest.raises(ConfigError, match=r"example-robot-data.*g1stream\[meshes\]"):
        robot_with_meshes(G1.default())


def test_a_robot_has_its_own_meshes_or_those_of_the_real_g1(reference_urdf):
    real = G1.load(reference_urdf("g1_29dof_rev_1_0.urdf"), own_limits=True)
    assert robot_with_meshes(real) is real
    for name in (None, "g1_29dof"):
        shown = robot_with_meshes(G1.load(name))
        assert find_mesh(shown, "meshes/pelvis.STL") or find_mesh(shown, "../meshes/pelvis.STL")
    other = replace(G1.default(), link_names=("torso",))
    with pytest.raises(RobotError, match="other links"):
        robot_with_meshes(other)
