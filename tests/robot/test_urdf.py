from dataclasses import replace

import pytest

from g1stream.errors import RobotError
from g1stream.robot.dynamics import InverseDynamics
from g1stream.robot.model import G1
from g1stream.robot.shapes import read_visuals
from g1stream.robot.urdf import with_prefixed_links

KNEE_LIMIT = '<limit lower="-0.087267" upper="2.8798" effort="139" velocity="20" />'
END = "</robot>"


def below(parent, child):
    """A fixed joint, instead of the end of the URDF."""
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{parent}{child}" type="fixed">{ends}</joint></robot>'


def kinds(joint, *types):
    return [f'name="{joint}_joint" type="{one}"' for one in types]


# what is wrong: (old text, new text, the cause that must be named)
EDITS = {
    "an end that is missing": (END, "", "not XML: line "),
    "another format": ("robot", "mujoco", "<mujoco>"),
    "text in a number": ('"0 -0.000094445 -0.30001"', '"0 0 low"', "_ankle_pitch_joint' has xyz"),
    "a joint without a parent": ('<parent link="left_hip_yaw_link" />', "", "'left_knee_link'"),
    "an unknown link": ('parent link="left_hip_yaw_link"', 'parent link="thigh"', "'thigh'"),
    "a link twice": (END, '<link name="head_link"/></robot>', "'head_link'"),
    "no root": (END, below("head_link", "pelvis"), "'pelvis'"),
    "two parents": (END, below("pelvis", "head_link"), "'head_link'"),
    "a ring beside the tree": (
        END,
        f'<link name="a"/><link name="b"/>{below("a", "b")}'.replace(END, below("b", "a")),
        "'a', 'b'",
    ),
    "a ring in the tree": (END, below("head_link", "torso_link"), "'torso_link'"),
    "a joint that slides": (*kinds("left_knee", "revolute", "prismatic"), "left_knee_joint"),
    "a floating base": (*kinds("logo", "fixed", "floating"), "is floating"),
    "a joint without limits": (*kinds("waist_yaw", "revolute", "continuous"), "is continuous"),
    "a long axis": ('<axis xyz="1 0 0"', '<axis xyz="1 1 0"', "[1. 1. 0.]"),
    "half a limit": (KNEE_LIMIT, KNEE_LIMIT.replace("velocity", "speed"), "no limit velocity"),
    "an endless limit": (KNEE_LIMIT, KNEE_LIMIT.replace("2.8798", "inf"), "upper='inf'"),
    "a wrong range": (KNEE_LIMIT, KNEE_LIMIT.replace("-0.087267", "3"), "lower 3.0, upper 2.8798"),
    "a motor without torque": (KNEE_LIMIT, KNEE_LIMIT.replace("139", "0"), "effort 0.0"),
}


@pytest.mark.parametrize(("old", "new", "cause"), EDITS.values(), ids=EDITS)
def test_one_defect_one_error(robot, load, old, new, cause):
    assert old in robot.urdf
    with pytest.raises(RobotError) as caught:
        load(robot.urdf.replace(old, new))
    assert cause in caught.value.cause
    assert "some.urdf" in caught.value.cause
    assert caught.value.remedy


def test_all_missing_joints_of_a_robot_of_no_known_kind_are_named(robot, load):
    urdf = robot.urdf
    missing = ["waist_roll_joint", "left_elbow_joint"]
    missing += [f"{s}_wrist_{a}_joint" for s in ("left", "right") for a in ("pitch", "yaw")]
    for name in missing:
        urdf = urdf.replace(f'name="{name}" type="revolute"', f'name="{name}" type="fixed"')
    with pytest.raises(RobotError, match="lacks 6 of the G1's 29") as caught:
        load(urdf)
    assert all(name in caught.value.cause for name in missing)


def test_axes_rounded_to_four_digits_are_unit(robot, load):
    rounded = load(robot.urdf.replace('<axis xyz="0 1 0"', '<axis xyz="0.5774 0.5773 0.5774"'))
    knee = rounded.link_index("left_knee_link")
    assert (rounded.axis[knee] ** 2).sum() == pytest.approx(1, abs=1e-15)


def test_other_elements_are_ignored(robot, load):
    odd = robot.urdf.replace('<sphere radius="0.005" />', '<capsule radius="x" />')
    odd = odd.replace("</robot>", "<gazebo><plugin/></gazebo><link_group/></robot>")
    odd = odd.replace(KNEE_LIMIT, KNEE_LIMIT + "<mimic/><safety_controller/>")
    assert load(odd).link_names == robot.link_names


@pytest.mark.parametrize(
    ("content", "cause"),
    [
        (None, "cannot be read: No such file"),
        (b"PXR-USDC\x00\xff\xfe", "byte 9 is not UTF-8"),
        (b"", "not XML: line 1, column 1"),
        (b'<robot name="g1">\n  <link < name="pelvis"/>\n</robot>', "not XML: line 2, column 9"),
    ],
)
def test_what_is_no_urdf_is_named(tmp_path, content, cause):
    path = tmp_path / "some.urdf"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(RobotError, match=f"some.urdf.*{cause}"):
        G1.load(path)


def test_links_for_a_viewer_have_the_names_of_their_frames_and_nothing_else_changes():
    robot = G1.default()
    shown = G1.from_urdf(with_prefixed_links(robot.xml, "measured/"), "shown")
    assert shown.link_names == tuple(f"measured/{name}" for name in robot.link_names)
    assert shown.joint_names == robot.joint_names
    assert shown.parent.tolist() == robot.parent.tolist()
    visuals = tuple(replace(one, link=f"measured/{one.link}") for one in read_visuals(robot))
    assert read_visuals(shown) == visuals
    assert "<collision" in robot.urdf
    assert "<collision" not in shown.urdf


WORLD = """<link name="world"/><joint name="world_joint" type="{}">
<origin xyz="0 0 0.8"/><parent link="world"/><child link="{}"/></joint>"""


@pytest.mark.parametrize(
    "above",
    [
        WORLD.format("fixed", "pelvis"),
        WORLD.format("floating", "pelvis"),
        WORLD.format("fixed", "base") + WORLD.replace("world", "base").format("fixed", "pelvis"),
    ],
    ids=["fixed", "floating", "two"],
)
def test_links_that_only_place_the_pelvis_are_left_out(robot, load, above):
    placed = load(robot.urdf.replace('<link name="pelvis"', f'{above}<link name="pelvis"'))
    assert placed.link_names == robot.link_names
    assert placed.origin_pos.tolist() == robot.origin_pos.tolist()
    assert "world" not in placed.urdf
    assert InverseDynamics(placed).mass == pytest.approx(InverseDynamics(robot).mass)
