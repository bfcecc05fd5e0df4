from dataclasses import replace
from io import StringIO

import numpy as np
import pytest
import yourdfpy
from scipy.spatial.transform import Rotation

from g1stream.errors import RobotError
from g1stream.robot.shapes import read_visuals


def with_urdf(robot, xml, source="made.urdf"):
    """A robot with these shapes; its joints do not matter here."""
    return replace(robot, urdf=f"<robot>{xml}</robot>", source=str(source))


def shape(geometry, origin="", material=""):
    return (
        f"<link name='a'><visual>{origin}<geometry>{geometry}</geometry>{material}</visual></link>"
    )


def sizes(geometry):
    """Kind and extents of a yourdfpy geometry."""
    if geometry.box is not None:
        return "box", tuple(geometry.box.size)
    if geometry.sphere is not None:
        return "sphere", (2 * geometry.sphere.radius,) * 3
    cylinder = geometry.cylinder
    return "cylinder", (2 * cylinder.radius, 2 * cylinder.radius, cylinder.length)


def test_shapes_of_the_default_robot_are_those_of_yourdfpy(robot):
    theirs = yourdfpy.URDF.load(StringIO(robot.urdf), build_scene_graph=False).robot
    materials = {m.name: tuple(m.color.rgba) for m in theirs.materials}
    expected = [(link.name, visual) for link in theirs.links for visual in link.visuals]
    ours = read_visuals(robot)
    assert len(ours) == len(expected) > 100
    for visual, (link, their) in zip(ours, expected, strict=True):
        assert visual.link == link
        assert (visual.kind, visual.size) == sizes(their.geometry)
        np.testing.assert_allclose(visual.pos, their.origin[:3, 3], atol=1e-12)
        turn = Rotation.from_quat(visual.quat_wxyz, scalar_first=True)
        np.testing.assert_allclose(turn.as_matrix(), their.origin[:3, :3], atol=1e-12)
        assert visual.rgba == materials[their.material.name]
        assert visual.coloured


def test_a_shape_without_origin_and_colour_and_a_mesh_with_a_colour(robot):
    (visual,) = read_visuals(with_urdf(robot, shape("<box size='1 2 3'/>")))
    assert (visual.pos, visual.quat_wxyz) == ((0, 0, 0), (1, 0, 0, 0))
    assert visual.size == (1, 2, 3)
    assert not visual.coloured
    assert visual.rgba[3] == 1
    material = "<material name='red'><color rgba='1 0 0 0.5'/></material>"
    mesh = "<mesh filename='meshes/a.stl' scale='0.001 0.001 0.001'/>"
    (visual,) = read_visuals(with_urdf(robot, shape(mesh, material=material)))
    assert visual.rgba == (1, 0, 0, 0.5)
    assert (visual.kind, visual.mesh, visual.size) == ("mesh", "meshes/a.stl", (0.001,) * 3)


@pytest.mark.parametrize(
    ("geometry", "origin", "offender"),
    [
        ("<box size='1 2'/>", "", "size='1 2'"),
        ("<sphere/>", "", "a sphere without radius"),
        ("<cylinder radius='1'/>", "", "a cylinder without length"),
        ("<box size='1 2 nan'/>", "", "size='1 2 nan'"),
        ("<box size='1 2 3'/>", "<origin xyz='0 x 0'/>", "xyz='0 x 0'"),
        ("<box size='1 2 3'/>", "<origin rpy='0 0'/>", "rpy='0 0'"),
        ("<capsule radius='1'/>", "", "capsule"),
        ("<mesh/>", "", "a mesh without filename"),
        ("", "", "missing"),
    ],
)
def test_a_shape_that_cannot_be_read_is_named(robot, geometry, origin, offender):
    with pytest.raises(RobotError, match=rf"made\.urdf.*'a'.*{offender}"):
        read_visuals(with_urdf(robot, shape(geometry, origin)))
