from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from g1stream.errors import G1StreamError, MotionError
from g1stream.motion.motion import Motion, height_of_floor
from g1stream.motion.readers import load_motion
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.kinematics import forward_kinematics
from g1stream.robot.model import G1
from g1stream.robot.rotations import yaw_of

KNEE = JOINT_NAMES.index("left_knee_joint")


def test_arrays_are_read_only_copies(make_motion):
    root_pos = np.zeros((2, 3))
    motion = make_motion([[0.0], [1.0]], root_pos)
    root_pos[0, 0] = 5.0
    assert motion.root_pos[0, 0] == 0.0
    for array in (motion.joint_pos, motion.root_pos, motion.root_quat_wxyz):
        with pytest.raises(ValueError, match="read-only"):
            array[0, 0] = 1.0


def test_quaternions_become_unit_and_sign_continuous(make_motion):
    angles = np.linspace(0.0, 6.0, 20)
    true = np.stack([np.cos(angles / 2), 0 * angles, 0 * angles, np.sin(angles / 2)], axis=1)
    signs = np.where(np.arange(20) % 3 == 1, -1.0, 1.0)
    motion = make_motion(np.zeros((20, 1)), quat=true * signs[:, None] * 1.7)
    np.testing.assert_allclose(motion.root_quat_wxyz, true, atol=1e-15)


@pytest.mark.parametrize(("start", "stop"), [(-1, 5), (5, 6), (30, 41)])
def test_invalid_parts(wild_motion, start, stop):
    with pytest.raises(MotionError, match=f"{start} to {stop}.*40 frames"):
        wild_motion.frames(start, stop)


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ({"fps": 0.0}, "0.0 frames per second"),
        ({"fps": float("nan")}, "nan frames per second"),
        ({"joint_pos": np.zeros((3, 1))}, r"joint_pos.*\(3, 1\).*\(3, 29\)"),
        ({"joint_pos": 1.0}, "1 frame"),
        ({"root_pos": np.zeros((2, 3))}, r"root_pos.*\(2, 3\).*\(3, 3\)"),
        ({"root_quat_wxyz": np.ones((3, 3))}, r"root_quat_wxyz.*\(3, 3\).*\(3, 4\)"),
        ({"root_pos": [[0, 0, 0], [0, np.inf, 0], [0, 0, 0]]}, "root_pos, frame 1"),
        ({"root_quat_wxyz": [[1, 0, 0, 0], [1, 0, 0, 0], [0, 0, 0, 0]]}, "zero .* frame 2"),
    ],
)
def test_invalid_arrays(fault, message):
    fields = {
        "name": "odd",
        "fps": 30.0,
        "joint_pos": np.zeros((3, 29)),
        "root_pos": np.zeros((3, 3)),
        "root_quat_wxyz": [[1, 0, 0, 0]] * 3,
    }
    with pytest.raises(MotionError, match=message):
        Motion(**(fields | fault))


def test_from_arrays_without_a_root_stays_at_the_origin():
    joint_pos = np.arange(58.0).reshape(2, 29)
    motion = Motion.from_arrays(joint_pos, fps=50)
    assert (motion.name, motion.fps, motion.joint_names) == ("motion", 50.0, JOINT_NAMES)
    np.testing.assert_array_equal(motion.joint_pos, joint_pos)
    assert motion.root_pos.tolist() == [[0.0, 0.0, 0.0]] * 2
    assert motion.root_quat_wxyz.tolist() == [[1.0, 0.0, 0.0, 0.0]] * 2


def test_from_arrays_with_a_root_and_names_in_another_order():
    order = JOINT_NAMES[::-1]
    motion = Motion.from_arrays(
        np.arange(58).reshape(2, 29),
        [[0, 0, 0.8], [0.1, 0, 0.8]],
        [[0, 0, 0, 2], [0, 0, 0, -2]],
        fps=30,
        joint_names=order,
        name="turned",
    )
    assert motion.joint_names == JOINT_NAMES
    assert motion.joint_pos[0].tolist() == list(range(28, -1, -1))
    assert motion.root_pos[1].tolist() == [0.1, 0.0, 0.8]
    assert motion.root_quat_wxyz.tolist() == [[0.0, 0.0, 0.0, 1.0]] * 2


@pytest.mark.parametrize(
    ("joint_pos", "names", "offender"),
    [
        (np.zeros(29), None, r"\(29,\)"),
        (np.zeros((5, 29)), ("tail_joint", *JOINT_NAMES[1:]), "left_hip_pitch_joint.*tail_joint"),
        (np.zeros((5, 30)), (*JOINT_NAMES, "left_knee_joint"), "30 names"),
        (np.zeros((5, 28)), JOINT_NAMES, r"\(5, 28\)"),
    ],
)
def test_from_arrays_that_do_not_fit(joint_pos, names, offender):
    with pytest.raises(MotionError, match=offender):
        Motion.from_arrays(joint_pos, fps=30, joint_names=names)


@pytest.mark.parametrize("name", ["walk.bvh", "missing/walk.csv"])
def test_save_to_an_invalid_path(wild_motion, tmp_path, name):
    with pytest.raises(G1StreamError, match=name.split("/")[0]):
        wild_motion.save(tmp_path / name)
    assert list(tmp_path.iterdir()) == []


@pytest.fixture(scope="module")
def demo():
    return load_motion("demo")


@pytest.fixture
def walk(make_motion):
    """Two seconds at 0.5 m/s and 0.8 rad/s of the knee, to the left."""
    t = np.arange(61)[:, None] / 30.0
    joints = np.zeros((61, 29))
    joints[:, KNEE] = 0.3 + 0.8 * t[:, 0]
    half = np.pi / 4
    quat = np.tile([np.cos(half), 0.0, 0.0, np.sin(half)], (61, 1))
    return make_motion(joints, [0.0, 0.0, 0.8] + t * [0.0, 0.5, 0.0], quat)


def test_trim_takes_the_frames_of_that_time(demo):
    part = demo.trim(1.0, 5.0)
    assert part.duration == 4.0
    for name in ("joint_pos", "root_pos", "root_quat_wxyz"):
        np.testing.assert_array_equal(getattr(part, name), getattr(demo, name)[30:151])
    assert demo.trim(2.0).n_frames == demo.n_frames - 60
    assert part.content_sha256 == demo.frames(30, 151).content_sha256 != demo.content_sha256


@pytest.mark.parametrize(("start", "end"), [(-1, 2), (5, 5), (0, 1e3), (np.nan, 1)])
def test_parts_that_there_are_not(demo, start, end):
    with pytest.raises(MotionError, match="has no part"):
        demo.trim(start, end)


def other_side(link):
    sides = {"left": "right", "right": "left"}
    side, _, rest = link.partition("_")
    return f"{sides.get(side, side)}_{rest}" if rest else link


def test_mirrored_bodies_are_the_mirror_image(robot, wild_motion):
    before, after = (
        forward_kinematics(robot, one.joint_pos, one.root_pos, one.root_quat_wxyz).pos
        for one in (wild_motion, wild_motion.mirrored())
    )
    links = [0, *np.flatnonzero(robot.joint_of_link >= 0)]
    assert len(links) == 30
    others = [robot.link_names.index(other_side(robot.link_names[link])) for link in links]
    np.testing.assert_allclose(after[:, links], [1, -1, 1] * before[:, others], rtol=0, atol=1e-4)


def test_speed_changes_the_frame_rate_alone(demo):
    slow = demo.at_speed(0.5)
    assert slow.duration == 2 * demo.duration
    np.testing.assert_array_equal(slow.joint_pos, demo.joint_pos)
    with pytest.raises(MotionError):
        demo.at_speed(0.0)


def test_the_next_motion_goes_on_where_the_last_one_ends(demo, walk):
    both = walk.then(demo, blend=0.5)
    first, start = walk.n_frames, walk.n_frames + 14
    assert both.n_frames == start + demo.n_frames
    assert both.parts == (walk, demo)
    assert both.then(walk.mirrored()).parts[:2] == (walk, demo)
    np.testing.assert_array_equal(both.joint_pos[:first], walk.joint_pos)
    np.testing.assert_array_equal(both.joint_pos[start:], demo.joint_pos)
    np.testing.assert_array_equal(both.root_pos[start:, 2], demo.root_pos[:, 2])
    yaw = yaw_of(both.root_quat_wxyz[[first - 1, start]])
    assert yaw[1] == pytest.approx(yaw[0], abs=1e-9)
    # It walks out of the last step at the mean of 0.5 m/s and no speed.
    ahead = both.root_pos[start, :2] - walk.root_pos[-1, :2]
    np.testing.assert_allclose(ahead, [0.0, 0.125], rtol=0, atol=2e-3)


def test_a_walk_goes_on_through_the_blend_as_it_was(walk):
    both = walk.then(walk, blend=0.5)
    velocity = np.diff(both.root_pos, axis=0) * 30.0
    np.testing.assert_allclose(velocity, np.tile([0.0, 0.5, 0.0], (len(velocity), 1)), atol=1e-9)


def test_other_frame_rates_and_no_blend(demo):
    both = demo.then(demo.resample(60.0), blend=0.0)
    assert both.fps == 60.0
    assert both.duration == pytest.approx(2 * demo.duration + 1 / 60)
    with pytest.raises(MotionError, match="blend"):
        demo.then(demo, blend=-0.1)


def test_again_and_again(demo):
    thrice = demo.looped(3, blend=1.0)
    assert thrice.duration == pytest.approx(3 * demo.duration + 2.0)
    assert (thrice.name, thrice.sha256) == (demo.name, demo.sha256)
    for n in (0, 10**6):
        with pytest.raises(MotionError, match="repeated"):
            demo.looped(n)


def test_each_repetition_goes_on_from_the_one_before(demo):
    """As one after the other: of a motion that walks and turns, and of one that rests."""
    t = np.arange(40) / 20.0
    path = np.stack([t, 0.2 * t**2, 0.7 + 0.1 * np.sin(t)], axis=1)
    quat = np.stack([np.cos(0.7 * t), 0.05 * np.sin(t), 0.0 * t, np.sin(0.7 * t)], axis=1)
    turning = Motion.from_arrays(demo.joint_pos[:40], path, quat, fps=20)
    for motion, blend in ((turning, 0.5), (turning, 0.0), (demo.frames(0, 40), 1.0)):
        expected = motion
        for _ in range(4):
            expected = expected.then(motion, blend=blend)
        found = motion.looped(5, blend=blend)
        np.testing.assert_allclose(found.joint_pos, expected.joint_pos, rtol=0, atol=1e-12)
        np.testing.assert_allclose(found.root_pos, expected.root_pos, rtol=0, atol=1e-9)
        same = np.sum(found.root_quat_wxyz * expected.root_quat_wxyz, axis=1)
        np.testing.assert_allclose(np.abs(same), 1.0, rtol=0, atol=1e-12)
        assert (np.sum(found.root_quat_wxyz[1:] * found.root_quat_wxyz[:-1], axis=1) > 0).all()


def test_a_joined_motion_is_split_where_it_was_joined(demo, walk):
    joined, parts = walk.then(demo.mirrored(), 0.5).looped(2), (walk, demo.mirrored()) * 2
    found = joined.split()
    assert [one.name for one in found] == [walk.name, "demo"] * 2
    assert [one.operations for one in found[:2]] == [(), ("mirrored",)]
    for one, other in zip(found, parts, strict=True):
        np.testing.assert_array_equal(one.joint_pos, other.joint_pos)
    for one, other in zip(joined.resample(60.0).split(), parts, strict=True):
        assert (one.fps, one.duration) == (60.0, pytest.approx(other.duration, abs=1 / 30))
    assert demo.split()[0].content_sha256 == demo.content_sha256
    assert [one.n_frames for one in demo.then(demo, 0.0).trim(0, demo.duration + 1).split()] == [
        demo.n_frames,
        30,
    ]


def test_what_was_done_is_said(demo):
    both = demo.trim(1, 5).mirrored().then(demo.at_speed(2), blend=0.5)
    assert both.name == "demo+demo"
    assert (both.source, both.sha256) == (None, None)
    assert both.operations == (
        "trimmed to 1 to 5 s",
        "mirrored",
        "then demo (at 2 times its speed) after a blend of 0.5 s",
    )


def test_a_fixed_root_stays_as_in_the_first_frame(walk):
    fixed = walk.fixed_root()
    assert (fixed.root_pos == walk.root_pos[0]).all()
    assert (fixed.root_quat_wxyz == walk.root_quat_wxyz[0]).all()
    np.testing.assert_array_equal(fixed.joint_pos, walk.joint_pos)


def test_feet_are_put_on_the_floor(demo, robot):
    stands = height_of_floor(demo, robot)
    assert stands == pytest.approx(0.0, abs=1e-3)
    moved = replace(demo, root_pos=demo.root_pos - [0.0, 0.0, 0.3])
    assert height_of_floor(moved, robot) == pytest.approx(stands - 0.3, abs=1e-9)
    put = moved.on_floor()
    np.testing.assert_allclose(put.root_pos, demo.root_pos - [0.0, 0.0, stands], atol=1e-9)


def test_feet_are_put_on_the_floor_by_the_robot_that_is_given(demo, robot):
    urdf = ElementTree.fromstring(robot.urdf)
    for side in ("left", "right"):
        origin = urdf.find(f"joint[@name='{side}_ankle_pitch_joint']/origin")
        x, y, z = map(float, origin.get("xyz").split())
        origin.set("xyz", f"{x} {y} {z - 0.02}")
    tall = G1.from_urdf(ElementTree.tostring(urdf, encoding="unicode"), "tall")
    put = demo.on_floor(tall)
    assert height_of_floor(put, tall) == pytest.approx(0.0, abs=1e-9)
    assert abs(height_of_floor(put, robot)) > 0.01


def test_a_motion_in_the_air_is_not_put_on_the_floor(make_motion, robot):
    falling = make_motion(np.zeros((10, 1)), np.arange(10)[:, None] * [0.0, 0.0, -0.1])
    assert height_of_floor(falling, robot) is None
    with pytest.raises(MotionError, match="no foot stands"):
        falling.on_floor()
