import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree as ET

import mujoco
import numpy as np
import pytest

from g1stream.robot.model import G1, REVISIONS, VARIANTS
from g1stream.robot.shapes import parse_visuals, read_visuals
from g1stream.robot.urdf import read_kinematics

TOOL = Path(__file__).parents[2] / "tools/make_robot_urdf.py"
FEET = ("left_ankle_roll_link", "right_ankle_roll_link")


def figures(element):
    """An element's name, attributes and parts without shapes, numbers as numbers."""

    def value(text):
        try:
            return [float(word) for word in text.split()]
        except ValueError:
            return text

    attributes = {key: value(text) for key, text in element.items()}
    parts = [part for part in element if part.tag not in ("visual", "collision")]
    return {**attributes, **{part.tag: figures(part) for part in parts}}


@pytest.mark.parametrize(("tag", "count"), [("link", 39), ("joint", 38)])
def test_masses_frames_and_limits_are_those_of_unitree(robot, reference_urdf, tag, count):
    """Names, types, frames, axes, limits, masses and inertias; in the same order."""
    ours = [figures(item) for item in ET.fromstring(robot.urdf).iter(tag)]
    reference = ET.parse(reference_urdf("g1_29dof_rev_1_0.urdf"))
    theirs = [figures(item) for item in reference.iter(tag)]
    assert len(ours) == count
    assert ours == theirs


def test_the_tool_generates_the_committed_files(reference_urdf, robot, tmp_path):
    reference = reference_urdf("g1_29dof_rev_1_0.urdf")
    command = [sys.executable, str(TOOL), "--reference", str(reference), "--out", str(tmp_path)]
    subprocess.run(command, check=True)
    made = {path.name: path.read_text(encoding="utf-8") for path in tmp_path.iterdir()}
    assert made.keys() == {f"{name}.urdf" for name in (*REVISIONS, "g1_23dof")} | {"robots.jsonl"}
    known = made.pop("robots.jsonl").splitlines()
    assert made == {
        name: (TOOL.parents[1] / "src/g1stream/robot" / name).read_text() for name in made
    }
    assert len(known) == len((*REVISIONS, *VARIANTS))


@pytest.mark.parametrize("name", [*REVISIONS, *VARIANTS])
def test_what_is_known_of_a_robot_is_what_yourdfpy_reads(name):
    robot = G1.load(name)
    read = read_kinematics(robot.xml, name)
    for field, value in read.items():
        found = getattr(robot, field)
        if isinstance(value, np.ndarray):
            assert found.dtype == value.dtype
            np.testing.assert_allclose(found, value, rtol=0, atol=1e-15)
        else:
            assert found == value
    assert len(read) == 13
    assert [one.mesh for one in read_visuals(robot)] == [one.mesh for one in parse_visuals(robot)]
    for one, other in zip(read_visuals(robot), parse_visuals(robot), strict=True):
        assert (one.link, one.kind, one.coloured) == (other.link, other.kind, other.coloured)
        for key in ("pos", "quat_wxyz", "size", "rgba"):
            assert getattr(one, key) == pytest.approx(getattr(other, key), abs=1e-15)


def test_the_other_revision_weighs_what_unitree_mujocos_weighs(compile_mujoco):
    """Its MJCF counts the head and the hands to the links that they are fixed to."""
    model = compile_mujoco(G1.load("g1_29dof").urdf)
    assert model.body_mass.sum() == pytest.approx(35.112142)
    assert model.body("torso_link").mass == pytest.approx(9.598)
    assert model.body("head_link").mass < 1e-6


def test_soles_and_shapes_touch_the_ground_together_and_nothing_else_does(robot, compile_mujoco):
    """In the zero pose, its lowest point 0.1 mm in the ground."""
    model = compile_mujoco(robot.urdf, ground=True)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    soles = np.flatnonzero(np.isin(model.geom_bodyid, [model.body(name).id for name in FEET]))
    sole_height = (data.geom_xpos[soles, 2] - model.geom_size[soles, 0]).min()
    data.qpos[2] -= sole_height + 1e-4
    mujoco.mj_forward(model, data)
    assert data.ncon == len(soles) == 8
    assert {*data.contact.geom.flat} == {*soles, *np.flatnonzero(model.geom_bodyid == 0)}
    spec = mujoco.MjSpec.from_string(robot.urdf)
    spec.compiler.fusestatic = spec.compiler.discardvisual = False
    seen = spec.compile()
    data = mujoco.MjData(seen)
    mujoco.mj_kinematics(seen, data)
    half = np.einsum("gij,gj->gi", np.abs(data.geom_xmat.reshape(-1, 3, 3)), seen.geom_aabb[:, 3:])
    assert (data.geom_xpos - half)[:, 2].min() == pytest.approx(sole_height, abs=1e-6)
