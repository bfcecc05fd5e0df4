import enum
import gzip
import os
import pickle
import struct
import tracemalloc
import zipfile
import zlib
from collections import Counter, OrderedDict
from dataclasses import replace
from pathlib import Path

import joblib
import numpy as np
import pytest

import g1stream
from g1stream.errors import MotionError
from g1stream.extras.formats.arrays import read_arrays
from g1stream.extras.formats.orders import names_in_order
from g1stream.motion.readers import find_motion
from g1stream.robot.kinematics import forward_kinematics
from g1stream.robot.model import G1
from g1stream.robot.rotations import xyzw_from_wxyz

DATA = Path(__file__).parents[2] / "data"

#: Column of each motor in an array of Isaac Lab.
ISAACLAB = [
    *(0, 3, 6, 9, 13, 17),
    *(1, 4, 7, 10, 14, 18),
    *(2, 5, 8),
    *(11, 15, 19, 21, 23, 25, 27),
    *(12, 16, 20, 22, 24, 26, 28),
]


@pytest.fixture(scope="module")
def motion():
    """The bundled motion, with the pelvis on its way and turning."""
    demo = g1stream.load_motion("demo")
    t = np.arange(demo.n_frames) / demo.fps
    quat = np.stack([np.cos(0.3 * t), 0.05 * np.sin(t), 0 * t, np.sin(0.3 * t)], axis=1)
    return g1stream.Motion.from_arrays(
        demo.joint_pos, demo.root_pos + t[:, None] * [0.1, 0.2, 0.0], quat, fps=50
    )


@pytest.fixture(scope="module")
def isaac_angles(motion):
    columns = np.empty_like(motion.joint_pos)
    columns[:, ISAACLAB] = motion.joint_pos
    return columns


def bodies(motion, robot="g1_29dof"):
    """Poses of the 30 moving links, as the tools of Isaac Lab and MuJoCo write them."""
    model = G1.load(robot)
    links = [0, *np.flatnonzero(model.joint_of_link >= 0)]
    found = forward_kinematics(model, motion.joint_pos, motion.root_pos, motion.root_quat_wxyz)
    return {
        "body_pos_w": found.pos[:, links].astype(np.float32),
        "body_quat_w": found.quat_wxyz[:, links].astype(np.float32),
    }


def opened(path):
    return find_motion(path).open()


@pytest.fixture
def npz(tmp_path):
    """Write arrays at 50 fps; gives the path."""

    def write(**arrays):
        np.savez(tmp_path / "motion.npz", **({"fps": 50} | arrays))
        return tmp_path / "motion.npz"

    return write


@pytest.fixture
def pkl(tmp_path):
    """Write the bytes of a pickle; gives the path."""

    def write(content):
        (tmp_path / "motion.pkl").write_bytes(content)
        return tmp_path / "motion.pkl"

    return write


def assert_same(found, motion, *, tolerance=0.0, root=True):
    assert found.fps == motion.fps
    np.testing.assert_array_equal(found.joint_pos, motion.joint_pos)
    if root:
        np.testing.assert_allclose(found.root_pos, motion.root_pos, rtol=0, atol=tolerance)
        alike = np.abs(np.sum(found.root_quat_wxyz * motion.root_quat_wxyz, axis=1))
        np.testing.assert_allclose(alike, 1.0, rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("order", "robot"), [("motor", "g1_29dof_rev_1_0"), ("isaaclab", "g1_29dof")]
)
def test_order_told_by_bodies(npz, motion, isaac_angles, order, robot):
    """BeyondMimic and mjlab write the same arrays, in different orders."""
    angles = motion.joint_pos if order == "motor" else isaac_angles
    file = opened(npz(fps=[50], joint_pos=angles, joint_vel=0 * angles, **bodies(motion, robot)))
    assert file.evidence.used["joint order"].startswith(f"{order}: bodies are 0.0 mm")
    assert f"links of {robot}," in file.evidence.used["joint order"]
    assert file.evidence.not_used == ("joint_vel",)
    assert_same(file.motion(), motion, tolerance=1e-6)


def test_the_pelvis_alone_says_nothing_of_the_order_and_a_hand_does(npz, motion, isaac_angles):
    pelvis = {name: values[:, :1] for name, values in bodies(motion).items()}
    path = npz(joint_pos=isaac_angles, **pelvis)
    assert_same(g1stream.load_motion(path), motion, tolerance=1e-6)
    calm = replace(motion, joint_pos=0.05 * motion.joint_pos)
    some = {name: values[:, [0, -1]] for name, values in bodies(calm).items()}
    npz(joint_pos=0.05 * isaac_angles, **some)
    assert_same(g1stream.load_motion(path), calm, tolerance=1e-6)
    npz(joint_pos=0.05 * isaac_angles, **pelvis)
    with pytest.raises(MotionError) as refused:
        g1stream.load_motion(path)
    assert "--joint-order" in refused.value.remedy


def test_order_told_by_limits(npz, motion, isaac_angles):
    file = opened(npz(q=isaac_angles))
    assert file.evidence.assumed.keys() == {"pelvis"}
    found = file.motion()
    assert_same(found, motion, root=False)
    assert not found.root_pos.any()


@pytest.mark.parametrize(
    ("order", "asked"), [("motor", False), ("isaaclab", False), ("isaaclab", True)]
)
def test_order_of_csv_without_header(tmp_path, motion, isaac_angles, order, asked):
    """Limits tell it; in calm motions it is taken to be motor order."""
    path = tmp_path / "motion.csv"
    angles = motion.joint_pos if order == "motor" else isaac_angles
    pose = np.hstack([motion.root_pos, xyzw_from_wxyz(motion.root_quat_wxyz)])
    np.savetxt(path, np.hstack([pose, angles]), "%.17g", delimiter=",")
    found = g1stream.load_motion(path, fps=50, joint_order=order if asked else None)
    assert_same(found, motion)
    told = {text.split(": ")[1] for text in found.warnings}
    hint = {"the joint order was detected only by joint limits; isaaclab"}
    assert told == {"pelvis"} | (hint if order == "isaaclab" and not asked else set())
    np.savetxt(path, np.hstack([pose, 0 * angles]), "%.17g", delimiter=",")
    assert opened(path).evidence.assumed.keys() == {"joint order", "pelvis", "frame rate"}


def test_named_joints_behind_the_pelvis(npz, motion, isaac_angles):
    """As holosoma writes them; the names may be objects."""
    pose = np.hstack([motion.root_pos, motion.root_quat_wxyz, isaac_angles])
    names = np.array(names_in_order("isaaclab"), dtype=object)
    file = opened(npz(joint_pos=pose, joint_names=names, **bodies(motion)))
    assert file.evidence.used["joint order"] == "named by the file"
    assert_same(file.motion(), motion)


def gmr(motion, *, xyzw=True):
    quat = motion.root_quat_wxyz
    return {
        "fps": 50,
        "root_pos": motion.root_pos,
        "root_rot": quat[:, [1, 2, 3, 0]] if xyzw else quat,
        "dof_pos": motion.joint_pos,
        "local_body_pos": None,
        "link_body_list": ["pelvis", "torso_link"],
    }


@pytest.mark.parametrize(("protocol", "xyzw"), [(2, True), (4, False), (5, True)])
def test_gmr_pickle(pkl, motion, protocol, xyzw):
    """The quaternion order is told by how the pelvis stands."""
    path = pkl(pickle.dumps(gmr(motion, xyzw=xyzw), protocol=protocol))
    assert_same(g1stream.load_motion(path), motion)


@pytest.mark.parametrize("compress", [zlib.compress, gzip.compress])
def test_compressed_pickle_of_one_named_motion(pkl, motion, compress):
    arrays = gmr(motion)
    arrays["dof"] = arrays.pop("dof_pos").tolist()
    path = pkl(compress(pickle.dumps({"dance": arrays})))
    assert_same(g1stream.load_motion(path), motion)


@pytest.mark.parametrize("compress", [0, 3])
def test_joblib(tmp_path, motion, compress):
    path = tmp_path / "motion.pkl"
    joblib.dump({"dance": gmr(motion)}, path, compress=compress)
    assert_same(g1stream.load_motion(path), motion)


def test_one_of_several_motions_is_taken_by_its_name(pkl, motion):
    arrays = {"dof": motion.joint_pos, "fps": motion.fps, "root_trans_offset": motion.root_pos}
    arrays["root_rot"] = xyzw_from_wxyz(motion.root_quat_wxyz)
    other = {**arrays, "dof": np.zeros_like(motion.joint_pos)}
    path = pkl(pickle.dumps({"walk/0:1": arrays, "stand": other}))
    found = g1stream.load_motion(f"{path}:stand", joint_order="motor")
    assert found.name == "stand"
    assert found.source == path
    assert not found.joint_pos.any()
    for wrong in ("run", "", "dof"):
        with pytest.raises(MotionError):
            g1stream.load_motion(f"{path}:{wrong}")
    with pytest.raises(MotionError) as refused:
        g1stream.load_motion(path)
    assert refused.value.remedy.endswith(f"{path}:walk/0:1")
    assert_same(g1stream.load_motion(f"{path}:walk/0:1", joint_order="motor"), motion)


def test_a_file_of_one_motion_has_no_other(tmp_path, motion):
    for path in (motion.save(tmp_path / "m.npz"), motion.save(tmp_path / "m.csv")):
        with pytest.raises(MotionError):
            g1stream.load_motion(f"{path}:m")


class Command:
    """Runs a command where it is unpickled."""

    def __init__(self, mark):
        self.mark = mark

    def __reduce__(self):
        return os.system, (f"touch {self.mark}",)


class Mode(enum.Enum):
    FAST = "fast"


def test_a_pickle_runs_nothing_and_other_objects_are_left_out(pkl, tmp_path, motion):
    mark = tmp_path / "mark"
    more = {"mode": Mode.FAST, "command": Command(mark), "counts": Counter("aab"), "set": {1}}
    path = pkl(pickle.dumps(gmr(motion) | more))
    assert_same(g1stream.load_motion(path), motion)
    assert set(more) <= set(opened(path).evidence.not_used)
    pkl(pickle.dumps({"dof": Command(mark)}))
    with pytest.raises(MotionError, match="system"):
        g1stream.load_motion(path)
    assert not mark.exists()


def with_root(pos, quat):
    return {"dof": np.zeros((9, 29)), "root_pos": pos, "root_rot": quat}


@pytest.mark.parametrize(
    ("arrays", "reason"),
    [
        ({"poses": np.zeros((9, 72)), "trans": np.zeros((9, 3))}, "human"),
        ({"dof": np.zeros((9, 12))}, "12 columns"),
        ({"dof": np.zeros(9)}, "dof"),
        ({"dof": ["a", "b"]}, "dof"),
        ({"dof": np.zeros((9, 29)), "fps": "fast"}, "fps"),
        (with_root(np.zeros((8, 3)), np.ones((9, 4))), "8"),
        (with_root(np.zeros((9, 3)), np.ones((9, 3))), "3"),
        ({"dof": np.zeros((9, 2)), "dof_names": ["left_knee", "right_knee"]}, "lacks"),
        ({"a": {}, "b": {}}, "2 motions.*: a, b"),
        ([1, 2, 3], "no named arrays"),
        ({"dof": {1, 2}}, "set"),
        ({"dof": np.zeros((9, 71))}, "71 columns"),
        ({"dof": np.full((9, 36), 1e308)}, "finite"),
        (with_root(np.zeros((9, 3)), np.full((9, 4), np.nan)), "root_rot .* finite"),
        ({"dof": np.zeros((9, 2)), "dof_names": ["left_knee", "left_knee_joint"]}, "twice"),
        (
            {
                "dof": np.zeros((9, 29)),
                "body_pos": np.zeros((8, 1, 3)),
                "body_quat": np.ones((9, 1, 4)),
            },
            "8, 1, 3",
        ),
    ],
)
def test_what_is_no_motion(pkl, arrays, reason):
    with pytest.raises(MotionError, match=reason):
        g1stream.load_motion(pkl(pickle.dumps(arrays)), joint_order="motor")


def test_lists_that_share_lists_are_not_unfolded(pkl, monkeypatch):
    value = [0.0] * 100
    for _ in range(8):
        value = [value] * 100
    monkeypatch.setattr("g1stream.extras.formats.pickles.UNPACKED", 2**20)
    with pytest.raises(MotionError, match="1 MiB"):
        opened(pkl(pickle.dumps({"dof": value})))


def many_encodings():
    """A small pickle that asks for the same large text to be encoded again and again."""
    text = b"X" + struct.pack("<I", 1_000_000) + b"a" * 1_000_000
    start = b"\x80\x02c_codecs\nencode\nq\0" + text + b"q\1X\6\0\0\0latin1q\2"
    return start + b"](" + b"h\0h\1h\2\x86R" * 2_000 + b"e."


class Call:
    """Pickled as a call of a function, which may have state after it."""

    def __init__(self, *call):
        self.call = call

    def __reduce__(self):
        return self.call


def many_copies(kind):
    """A small pickle that asks for the same large value to be copied again and again."""
    if kind == "dict":
        call = OrderedDict, (dict.fromkeys(range(20_000)),)
    elif kind == "text":
        scalar, _ = np.float64(0.0).__reduce__()
        call = scalar, (np.dtype("<U99999"), "".ljust(99_999).encode("utf-32-le"))
    else:
        array, arguments, _ = np.zeros(1).__reduce__()
        call = array, arguments, (1, (1000,), np.dtype("O"), False, [" " * 1000] * 1000)
    return pickle.dumps([Call(*call) for _ in range(12_000)])


@pytest.mark.parametrize(
    "content",
    [
        b"\x80\x05\x96" + struct.pack("<Q", 2**40),  # a bytearray of a terabyte
        b"\x80\x04\x8e" + struct.pack("<Q", 2**60) + b"abc",
        b"\x80\x04cos\nsystem\n.",
        b"\x80\x02(S'x'\nios\nsystem\n.",
        many_encodings(),
        *map(many_copies, ("dict", "text", "texts")),
    ],
    ids=["bytearray", "bytes", "global", "instance", "encodings", "dict", "text", "texts"],
)
def test_hostile_pickles(pkl, content):
    path = pkl(content)
    tracemalloc.start()
    try:
        with pytest.raises(MotionError):
            opened(path)
        assert tracemalloc.get_traced_memory()[1] < 2**30
    finally:
        tracemalloc.stop()


def test_a_file_of_pytorch(motion):
    """Written by PyTorch 2.13, with the arrays of ProtoMotions: frames 60 to 63 of the demo."""
    file = opened(DATA / "protomotions.pt")
    assert file.evidence.used["joint order"].startswith("motor")
    found = file.motion()
    assert found.fps == 50.0
    np.testing.assert_array_equal(found.joint_pos, motion.joint_pos[60:64].astype(np.float32))
    half = 0.3 * np.arange(4) / 50.0
    expected = np.stack([np.cos(half), 0 * half, 0 * half, np.sin(half)], axis=1)
    np.testing.assert_allclose(found.root_quat_wxyz, expected, rtol=0, atol=1e-6)
    _, tensors = read_arrays((DATA / "protomotions.pt").read_bytes())
    np.testing.assert_array_equal(tensors["transposed"], np.arange(6.0).reshape(2, 3).T)
    assert tensors["contacts"].dtype == np.bool_
    assert tensors["fps_tensor"] == 50.0


def tensor_file(path, offset, shape, strides, numbers=bytes(16)):
    """A tensor as PyTorch pickles it, in a storage of four numbers."""
    shape, strides = (b"(%bt" % b"".join(b"I%d\n" % n for n in one) for one in (shape, strides))
    storage = b"(Vstorage\nctorch\nFloatStorage\nV0\nVcpu\nI4\ntQ"
    arguments = b"(%bI%d\n%b%bI00\n}t" % (storage, offset, shape, strides)
    pickled = b"}Vq\nctorch._utils\n_rebuild_tensor_v2\n%bRs." % arguments
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("a/data.pkl", pickled)
        archive.writestr("a/data/0", numbers)
    return path


def test_tensors_are_within_their_storage(tmp_path):
    path = tensor_file(tmp_path / "a.pt", 0, (2, 2), (2, 1))
    assert read_arrays(path.read_bytes())[1]["q"].shape == (2, 2)
    for arguments in (
        (1, (2, 2), (2, 1)),
        (0, (3, 2), (2, 1)),
        (-1, (2, 2), (2, 1)),
        (0, (2, 2), (-2, 1)),
        (0, (10**9, 2), (0, 0)),
        (0, (-2, 2), (2, 1)),
    ):
        with pytest.raises(MotionError, match="tensor"):
            opened(tensor_file(path, *arguments))
    with pytest.raises(MotionError):
        opened(tensor_file(path, 0, (2, 2), (2, 1), b"abc"))


@pytest.mark.parametrize("suffix", ["npz", "npy"])
def test_a_file_that_is_cut_off_is_said_to_be(tmp_path, motion, suffix):
    path = tmp_path / f"motion.{suffix}"
    if suffix == "npy":
        np.save(path, np.zeros((30, 36)))
    else:
        motion.save(path)
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(MotionError, match=rf"^motion.{suffix}: .*damaged or incomplete"):
        opened(path)


def test_one_array(tmp_path, motion):
    path = tmp_path / "motion.npy"
    np.save(path, np.hstack([motion.root_pos, motion.root_quat_wxyz, motion.joint_pos]))
    assert_same(g1stream.load_motion(path, fps=50, joint_order="motor"), motion)


def test_bodies_under_other_names(npz, motion):
    pos, quat = bodies(motion).values()
    arrays = {"dof_positions": motion.joint_pos, "dof_names": motion.joint_names}
    path = npz(body_positions=pos, body_rotations=quat, **arrays)
    assert_same(g1stream.load_motion(path), motion, tolerance=1e-6)


WRISTS = [i for i, name in enumerate(g1stream.JOINT_NAMES) if "wrist" in name]
WITHOUT_WRISTS = [i for i in range(29) if i not in WRISTS]


@pytest.mark.parametrize("layout", ["names", "no names", "table", "CSV"])
def test_wrists_that_a_file_leaves_out_stay_at_zero(npz, tmp_path, motion, layout):
    angles, quat = motion.joint_pos[:, WITHOUT_WRISTS], motion.root_quat_wxyz
    if layout == "CSV":
        table = np.hstack([motion.root_pos, xyzw_from_wxyz(quat), angles])
        path = tmp_path / "motion.csv"
        np.savetxt(path, table, "%.17g", delimiter=",")
    elif layout == "table":
        path = npz(qpos=np.hstack([motion.root_pos, quat, angles]))
    else:
        names = [g1stream.JOINT_NAMES[i] for i in WITHOUT_WRISTS]
        named = {"joint_names": names} if layout == "names" else {}
        path = npz(dof=angles, root_pos=motion.root_pos, root_quat=quat, **named)
    found = g1stream.load_motion(path, fps=50)
    expected = motion.joint_pos.copy()
    expected[:, WRISTS] = 0.0
    assert_same(found, replace(motion, joint_pos=expected))
    (warning,) = (text for text in found.warnings if "assumed" not in text)
    assert all(g1stream.JOINT_NAMES[i] in warning for i in WRISTS)
    assert opened(path).evidence.missing == tuple(g1stream.JOINT_NAMES[i] for i in WRISTS)
    smaller = G1.load("g1_23dof")
    on_smaller = g1stream.load_motion(path, fps=50, robot=smaller)
    assert len(on_smaller.warnings) == len(found.warnings) - 1


def test_the_joints_of_a_g1_with_23_are_read(npz, motion):
    present = G1.load("g1_23dof").present
    names = np.array(g1stream.JOINT_NAMES)[present]
    path = npz(joint_pos=motion.joint_pos[:, present], joint_names=names)
    expected = replace(motion, joint_pos=motion.joint_pos * present)
    assert_same(g1stream.load_motion(path), expected, root=False)


#: The joints in 23 columns without names.
OF_23 = {
    "motor": np.delete(np.arange(29), WRISTS),
    "motor-23dof": np.flatnonzero(G1.load("g1_23dof").present),
    "isaaclab": np.array([i for i in np.argsort(ISAACLAB) if i not in WRISTS]),
}


def without_names(path, motion, order, scale):
    """Write the joints of an order as a CSV without header; returns the motion in the file."""
    pose = np.hstack([motion.root_pos, xyzw_from_wxyz(motion.root_quat_wxyz)])
    columns = scale * motion.joint_pos[:, OF_23[order]]
    np.savetxt(path, np.hstack([pose, columns]), "%.17g", delimiter=",")
    expected = np.zeros_like(motion.joint_pos)
    expected[:, OF_23[order]] = columns
    return replace(motion, joint_pos=expected)


@pytest.mark.parametrize(
    ("order", "scale", "asked", "robot", "hints"),
    [
        ("motor", 1.0, None, None, 0),
        ("motor", 1.0, None, "g1_23dof", 0),
        ("motor-23dof", 1.0, None, None, 1),
        ("isaaclab", 1.0, None, None, 1),
        ("motor", 0.1, None, None, 1),
        ("motor-23dof", 0.1, None, "g1_23dof", 1),
        ("motor", 0.1, "motor", "g1_23dof", 0),
        ("motor-23dof", 0.1, "motor-23dof", None, 0),
        ("isaaclab", 0.1, "isaaclab", None, 0),
    ],
)
def test_which_23_joints_a_csv_has(tmp_path, motion, order, scale, asked, robot, hints):
    """Limits tell it; of a calm motion the flag does, or it is assumed to be the robot's."""
    path, assumed = tmp_path / "motion.csv", scale < 1.0 and not asked
    expected = without_names(path, motion, order, scale)
    file = find_motion(path, fps=50, joint_order=asked, robot=robot and G1.load(robot)).open()
    found, evidence = file.motion(), file.evidence
    assert_same(found, expected)
    told = (evidence.assumed if assumed else evidence.used)["joint order"]
    assert told.startswith(order)
    warned = [text for text in found.warnings if "--joint-order" in text]
    assert len(warned) == hints
    if assumed:
        other = "motor" if robot else "motor-23dof"
        assert f"--joint-order {other} " in warned[0]


def test_an_order_of_23_joints_is_none_of_29(npz, motion):
    with pytest.raises(MotionError, match="23 joints"):
        g1stream.load_motion(npz(q=motion.joint_pos), joint_order="motor-23dof")


def test_limits_tell_the_23_joints_of_a_dance(tmp_path, real_clip):
    path = tmp_path / "dance.csv"
    expected = without_names(path, g1stream.load_motion(real_clip), "motor-23dof", 1.0)
    assert_same(g1stream.load_motion(path), expected)


def test_a_quaternion_before_the_position_is_told_by_its_norm(npz, motion):
    path = npz(qpos=np.hstack([motion.root_quat_wxyz, motion.root_pos, motion.joint_pos]))
    found = g1stream.load_motion(path)
    assert_same(found, motion)
    assert found.warnings == ()
    assert "norm" in opened(path).evidence.used["pelvis"]


def test_the_pose_of_an_object_behind_the_joints_is_left_out(npz, motion):
    box = np.tile([0.5, 0.1, 0.4, 1, 0, 0, 0], (motion.n_frames, 1))
    qpos = np.hstack([motion.root_pos, motion.root_quat_wxyz, motion.joint_pos, box])
    found = g1stream.load_motion(npz(qpos=qpos, cost=1.0, boxes=box, notes="none"))
    assert_same(found, motion)
    (warning,) = found.warnings
    assert all(word in warning for word in ("7 columns of qpos", "cost", "boxes"))
    assert "notes" not in warning  # neither a number nor a row a frame


@pytest.mark.parametrize("rate", [{"sample_rate": 50}, {"frequency": 50.0}, {"dt": 0.02}])
def test_root_and_rate_under_other_names(tmp_path, motion, rate):
    path = tmp_path / "motion.npz"
    pose = {"base_pos_w": motion.root_pos, "base_quat_w": motion.root_quat_wxyz}
    names = np.array(motion.joint_names, dtype="S")
    np.savez(path, joint_names=names, Joint_Pos=motion.joint_pos, **pose, **rate)
    assert_same(g1stream.load_motion(path), motion)
    assert g1stream.load_motion(path, fps=25).fps == 25.0
    np.savez(path, joint_names=names, joint_pos=motion.joint_pos, pelvis=motion.root_pos, speed=50)
    found = g1stream.load_motion(path)
    assert all(name in found.warnings[0] for name in ("pelvis", "speed"))
    assert opened(path).evidence.assumed.keys() == {"pelvis", "frame rate"}


@pytest.mark.parametrize(
    ("name", "hinted"), [("take_120hz", True), ("run 60 FPS", True), ("walk_30fps", False)]
)
def test_a_rate_in_the_name_is_a_hint_alone(tmp_path, motion, name, hinted):
    path = motion.save(tmp_path / f"{name}.csv")
    found = g1stream.load_motion(path)
    assert found.fps == 30.0
    assert ("--fps" in found.warnings[0]) == hinted
    assert len(found.warnings) == 1
    assert g1stream.load_motion(path, fps=60).warnings == ()


def test_a_pelvis_that_lies_on_the_floor_is_no_evidence(npz, motion):
    """On its side, it would stand in the other order of the quaternion."""
    side = np.tile([0.5**0.5, 0.5**0.5, 0, 0], (motion.n_frames, 1))
    pose = {"root_pos": motion.root_pos - [0, 0, 0.65], "root_quat": side}
    path = npz(q=motion.joint_pos, joint_names=motion.joint_names, **pose)
    np.testing.assert_allclose(g1stream.load_motion(path).root_quat_wxyz, side, rtol=0, atol=1e-15)
