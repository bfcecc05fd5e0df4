import io
import os
import pickle
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple, get_args
from xml.etree import ElementTree as ET

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import g1stream
from g1stream.errors import ConfigError, MotionError, RecordingError, RobotError
from g1stream.extras.formats.decimals import write_rows
from g1stream.extras.formats.orders import names_in_order
from g1stream.extras.formats.table import WRITTEN
from g1stream.motion.trajectory import Trajectory
from g1stream.optional import load_object
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.kinematics import forward_kinematics
from g1stream.robot.model import G1
from g1stream.types import MotionFormat

OUTPUTS = {name: load_object(where) for name, where in WRITTEN.items()}
SUFFIX = {name: one.suffix for name, one in OUTPUTS.items()}


class Body(NamedTuple):
    pos: np.ndarray
    quat: np.ndarray
    lin_vel: np.ndarray
    centre_vel: np.ndarray
    ang_vel: np.ndarray


class Oracle:
    """MuJoCo's kinematics of the default URDF, its fixed links merged, at samples of the spline."""

    def __init__(self, robot):
        root = ET.fromstring(robot.urdf)
        for link in root.iter("link"):
            for shape in [*link.findall("visual"), *link.findall("collision")]:
                link.remove(shape)
        spec = mujoco.MjSpec.from_string(ET.tostring(root, encoding="unicode"))
        spec.compiler.fusestatic = True
        spec.worldbody.first_body().add_freejoint()
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self.names = [self.model.body(i).name for i in range(1, self.model.nbody)]
        self.joints = [self.model.joint(i).name for i in range(1, self.model.njnt)]

    def breadth_first(self):
        """The bodies as Isaac Lab numbers them: a level of the tree at a time."""
        order, level = [], [1]
        while level:
            order += level
            level = [
                i for above in level for i in np.flatnonzero(self.model.body_parentid == above)
            ]
        return [self.model.body(i).name for i in order]

    def bodies(self, point):
        """Of each body by name, and `qpos` and `qvel`."""
        order = [g1stream.JOINT_NAMES.index(name) for name in self.joints]
        self.data.qpos[:] = [*point.root_pos, *point.root_quat_wxyz, *point.joint_pos[order]]
        self.data.qvel[:] = [*point.root_lin_vel, *point.root_ang_vel, *point.joint_vel[order]]
        mujoco.mj_forward(self.model, self.data)
        found = {}
        for name in self.names:
            i, velocity = self.model.body(name).id, np.zeros((2, 6))
            kinds = mujoco.mjtObj.mjOBJ_XBODY, mujoco.mjtObj.mjOBJ_BODY
            for kind, row in zip(kinds, velocity, strict=True):
                mujoco.mj_objectVelocity(self.model, self.data, kind, i, row, 0)
            pose = self.data.xpos[i].copy(), self.data.xquat[i].copy()
            found[name] = Body(*pose, velocity[0, 3:], velocity[1, 3:], velocity[0, :3])
        return found


@pytest.fixture(scope="module")
def oracle():
    return Oracle(G1.default())


def written(motion, name, directory, **how):
    path = directory / f"written{SUFFIX[name]}"
    return motion.save(path, format=name, force=True, **how)


def arrays(*arguments, **how):
    with np.load(written(*arguments, **how)) as file:
        return {key: file[key] for key in file}


def test_the_formats_of_others_are_those_that_the_flag_takes():
    assert set(get_args(MotionFormat)) == WRITTEN.keys()


@pytest.mark.parametrize(
    ("name", "fps"), [("beyondmimic", np.int64), ("mjlab", np.float64), ("holosoma", np.int64)]
)
def test_states_are_those_of_mujoco(wild_motion, tmp_path, oracle, name, fps):
    """As the motion loaders of whole_body_tracking, mjlab and holosoma index them.

    Linear velocities are of centres of mass, as PhysX has them, but of origins in mjlab.
    """
    found = arrays(wild_motion, name, tmp_path)
    bodies, names = found.pop("body_names").tolist(), found.pop("joint_names").tolist()
    assert (found["fps"].dtype, found.pop("fps").tolist()) == (fps, [50])
    times = np.arange(int(wild_motion.duration * 50 + 1e-9) + 1) / 50
    pose, rate = (7, 6) if name == "holosoma" else (0, 0)
    assert {values.dtype for values in found.values()} == {np.dtype(np.float32)}
    assert {key: values.shape for key, values in found.items()} == {
        "joint_pos": (len(times), pose + 29),
        "joint_vel": (len(times), rate + 29),
        "body_pos_w": (len(times), len(bodies), 3),
        "body_quat_w": (len(times), len(bodies), 4),
        "body_lin_vel_w": (len(times), len(bodies), 3),
        "body_ang_vel_w": (len(times), len(bodies), 3),
    }
    if name == "beyondmimic":
        assert bodies == oracle.breadth_first()
        assert [oracle.model.body(body).jntadr[0] for body in bodies[1:]] == [
            oracle.model.joint(joint).id for joint in names
        ]
    else:
        assert bodies == ["world"] * (name == "holosoma") + oracle.names
        assert names == oracle.joints
    joints = [JOINT_NAMES.index(one) for one in names]
    for i in range(0, len(times), 7):
        point = Trajectory(wild_motion).sample(times[i])
        expected = oracle.bodies(point)
        expected["world"] = Body(np.zeros(3), np.array([1.0, 0, 0, 0]), *np.zeros((3, 3)))
        root = [*point.root_pos, *point.root_quat_wxyz], [*point.root_lin_vel, *point.root_ang_vel]
        close(found["joint_pos"][i], [*root[0][:pose], *point.joint_pos[joints]], 1e-6)
        close(found["joint_vel"][i], [*root[1][:rate], *point.joint_vel[joints]], 1e-5)
        for b, body in enumerate(bodies):
            of = expected[body]
            lin_vel = of.lin_vel if name == "mjlab" else of.centre_vel
            close(found["body_pos_w"][i, b], of.pos, 1e-6)
            close(abs(found["body_quat_w"][i, b] @ of.quat), 1.0, 1e-6)
            close(found["body_lin_vel_w"][i, b], lin_vel, 1e-5)
            close(found["body_ang_vel_w"][i, b], of.ang_vel, 1e-5)


def close(found, expected, tolerance):
    np.testing.assert_allclose(found, expected, rtol=0, atol=tolerance)


def test_finite_velocities_are_differences_of_the_frames_in_the_file(wild_motion, tmp_path):
    found = arrays(wild_motion, "mjlab", tmp_path, velocities="finite")
    for pos, vel, n in (("joint_pos", "joint_vel", 29), ("body_pos_w", "body_lin_vel_w", 1)):
        steps = np.gradient(found[pos][:, :n].astype(float), 1 / 50, axis=0)
        close(found[vel][:, :n], steps, 1e-4)
    turned = Rotation.from_quat(found["body_quat_w"][:, 0], scalar_first=True)
    turn = (turned[2:] * turned[:-2].inv()).as_rotvec() * 25
    close(found["body_ang_vel_w"][1:-1, 0], turn, 1e-4)
    assert (found["body_ang_vel_w"][[0, -1], 0] == found["body_ang_vel_w"][[1, -2], 0]).all()
    spline = arrays(wild_motion, "mjlab", tmp_path)
    assert np.abs(spline["joint_vel"] - found["joint_vel"]).max() > 0.1


def test_a_half_turn_between_frames_has_a_velocity(make_motion, tmp_path):
    """And none of a robot that stands is none, not 0 / 0."""
    quat = np.tile([[1.0, 0, 0, 0], [0, 0, 0, 1.0]], (4, 1))
    motion = make_motion(np.zeros((8, 29)), quat=quat, fps=25)
    for one, speed in ((motion, 0.1), (make_motion(np.zeros((8, 29)), fps=25), 0.0)):
        found = arrays(one, "mjlab", tmp_path, velocities="finite")["body_ang_vel_w"]
        assert np.isfinite(found).all()
        assert np.abs(found).max() > speed if speed else not found.any()


def test_quaternions_are_continuous(make_motion, tmp_path):
    t = np.linspace(0.0, 3.0, 91)
    quat = np.stack([np.cos(3 * t), 0 * t, 0 * t, np.sin(3 * t)], axis=1)  # nearly three turns
    joints = np.zeros((91, 29))
    joints[:, 3] = 2.0 * np.sin(2 * t)
    found = arrays(make_motion(joints, quat=quat), "mjlab", tmp_path)["body_quat_w"]
    assert ((found[1:] * found[:-1]).sum(axis=-1) > 0.9).all()


@pytest.mark.parametrize("name", OUTPUTS)
def test_what_is_written_is_read_back(wild_motion, tmp_path, robot, name):
    """Angles within 1e-6 rad, bodies within 0.01 mm, the height as it was."""
    form = OUTPUTS[name]
    motion = replace(wild_motion, fps=60.0)
    expected = motion.resample(form.fps) if form.fps else motion
    found = g1stream.load_motion(
        written(motion, name, tmp_path), fps=60.0 if name == "csv" else None
    )
    assert found.fps == expected.fps
    assert len(found.warnings) == 3 * (name == "lafan1")  # joint order, pelvis, frame rate
    close(found.joint_pos, expected.joint_pos, 1e-6)
    close(found.root_pos, expected.root_pos, 1e-6)
    ours, theirs = (
        forward_kinematics(robot, one.joint_pos, one.root_pos, one.root_quat_wxyz).pos
        for one in (found, expected)
    )
    assert np.linalg.norm(ours - theirs, axis=-1).max() < 1e-5
    if form.fps is None:
        for part in ("joint_pos", "root_pos", "root_quat_wxyz"):
            np.testing.assert_array_equal(getattr(found, part), getattr(motion, part))


def table(directory, name):
    return np.loadtxt(directory / f"{name}.csv", delimiter=",", skiprows=1)


def test_sonic(wild_motion, tmp_path):
    """As motion_reference.md of GR00T-WholeBodyControl says, with the body numbers of its clips."""
    path = written(wild_motion, "sonic", tmp_path)
    whole = arrays(wild_motion, "beyondmimic", tmp_path)
    numbers = [0, 4, 10, 18, 5, 11, 19, 9, 16, 22, 28, 17, 23, 29]
    metadata = (path / "metadata.txt").read_text()
    n_frames = len(whole["joint_pos"])
    assert f"\nBody part indexes:\n[{' '.join(map(str, numbers))}]\n" in metadata
    assert f"\nTotal timesteps: {n_frames}\n" in metadata
    for name in ("joint_pos", "joint_vel", "body_pos", "body_quat", "body_lin_vel", "body_ang_vel"):
        expected = whole[name] if name.startswith("joint") else whole[f"{name}_w"][:, numbers]
        close(table(path, name), expected.reshape(n_frames, -1), 2e-6)
    headers = {one.stem: one.read_text().split("\n", 1)[0].split(",") for one in path.glob("*.csv")}
    assert headers["joint_vel"][::28] == ["joint_vel_0", "joint_vel_28"]
    assert headers["body_quat"][:5] == ["body_0_w", "body_0_x", "body_0_y", "body_0_z", "body_1_w"]
    assert headers["body_pos"][-1] == "body_13_z"
    assert headers["body_lin_vel"][3] == "body_1_vel_x"
    assert headers["body_ang_vel"][-1] == "body_13_angvel_z"


@pytest.mark.parametrize("width", [3, 6])
def test_sonic_needs_the_pelvis_only(wild_motion, tmp_path, width):
    """What SONIC calls root-only; and further bodies."""
    path = written(wild_motion, "sonic", tmp_path)
    for name, n in (("body_pos", width), ("body_quat", width * 4 // 3)):
        lines = (path / f"{name}.csv").read_text().splitlines()
        cut = "\n".join(",".join(line.split(",")[:n]) for line in lines)
        (path / f"{name}.csv").write_text(cut)
    found = g1stream.load_motion(path)
    close(found.root_pos, wild_motion.resample(50).root_pos, 1e-6)
    close(found.joint_pos, wild_motion.resample(50).joint_pos, 1e-6)
    before = found.sha256
    text = (path / "body_pos.csv").read_text()
    (path / "body_pos.csv").write_text(text.rstrip("\n") + "\n\n")
    assert g1stream.load_motion(path).sha256 != before


def test_a_broken_table_of_sonic_is_an_error(wild_motion, tmp_path):
    path = written(wild_motion, "sonic", tmp_path)
    table = path / "body_pos.csv"
    columns = (path / "body_quat.csv").read_text()
    for text in ("", "a,b", "a,b\n1,x\n", "a\n" + "1" * 70_000, "a,b\n1,2\n3\n", columns):
        table.write_text(text)
        with pytest.raises(MotionError, match="body_pos"):
            g1stream.load_motion(path)


def test_lafan1_has_36_columns_at_30_fps_and_no_header(wild_motion, tmp_path):
    motion = replace(wild_motion, fps=30.0)
    found = np.loadtxt(written(motion, "lafan1", tmp_path), delimiter=",")
    assert found.shape == (40, 36)
    close(found[:, :3], motion.root_pos, 1e-6)
    close(found[:, 3:7], motion.root_quat_wxyz[:, [1, 2, 3, 0]], 1e-6)
    close(found[:, 7:], motion.joint_pos, 1e-6)


def test_gmr_is_what_its_viewer_indexes(wild_motion, tmp_path, oracle):
    path = written(wild_motion, "gmr", tmp_path)
    content = pickle.loads(path.read_bytes())
    keys = ("fps", "root_pos", "root_rot", "dof_pos", "local_body_pos", "link_body_list")
    assert tuple(content) == (*keys, "joint_names")
    assert content["joint_names"] == oracle.joints
    assert content["fps"] == wild_motion.fps
    np.testing.assert_array_equal(content["root_pos"], wild_motion.root_pos)
    np.testing.assert_array_equal(content["dof_pos"], wild_motion.joint_pos)
    wxyz = content["root_rot"][:, [3, 0, 1, 2]]  # as GMR's data_loader takes it
    np.testing.assert_array_equal(wxyz, wild_motion.root_quat_wxyz)
    assert content["root_pos"].flags.writeable
    names, local = content["link_body_list"], content["local_body_pos"]
    assert local.shape == (40, len(names), 3)
    trajectory = Trajectory(g1stream.Motion.from_arrays(wild_motion.joint_pos, fps=30))
    for frame in (0, 17, 39):
        bodies = oracle.bodies(trajectory.sample(frame / wild_motion.fps))
        for name, body in bodies.items():
            close(local[frame, names.index(name)], body.pos, 1e-6)
        for name, parent, offset in (
            ("left_toe_link", "left_ankle_roll_link", [0.1, 0, -0.02]),
            ("right_toe_link", "right_ankle_roll_link", [0.1, 0, -0.02]),
            ("head_mocap", "torso_link", [0, 0, 0.4]),
        ):
            at = bodies[parent]
            turned = Rotation.from_quat(at.quat[[1, 2, 3, 0]]).apply(offset)
            close(local[frame, names.index(name)], at.pos + turned, 1e-6)


def test_a_pickle_names_nothing_that_an_older_numpy_lacks(wild_motion, tmp_path):
    named = set()

    class Unpickler(pickle.Unpickler):
        def find_class(self, module, name):
            named.add((module, name))
            return super().find_class(module, name)

    content = written(wild_motion, "gmr", tmp_path).read_bytes()
    assert Unpickler(io.BytesIO(content)).load()["fps"] == wild_motion.fps
    assert named == {("numpy", "ndarray"), ("numpy", "dtype")}


def test_numbers_in_text_across_blocks(tmp_path):
    """As Python writes them; but zero has no sign."""
    values = np.arange(-3000, 3000).reshape(2000, 3) / 7
    values[:2] = [-0.0, 0.0, 0.5], [0.9999997, -1e-6, 9998.9999999]
    with (path := tmp_path / "rows.csv").open("wb") as file:
        write_rows(file, values, "motion")
    expected = "".join(",".join(f"{x + 0.0:.6f}" for x in row) + "\n" for row in values.tolist())
    assert path.read_text() == expected


@pytest.mark.parametrize(
    ("name", "how", "error"),
    [
        ("lafan1", {"robot": G1.load("g1_23dof")}, RobotError),
        ("beyondmimic", {"robot": replace(G1.default(), ignored_joints=("thumb",))}, RobotError),
        ("gmr", {"velocities": "finite"}, MotionError),
        ("mjlab", {"velocities": "none"}, MotionError),
        ("Mjlab", {}, MotionError),
    ],
)
def test_what_a_format_cannot_hold_is_refused(wild_motion, tmp_path, name, how, error):
    with pytest.raises(error):
        wild_motion.save(tmp_path / "a.npz", format=name, **how)
    assert list(tmp_path.iterdir()) == []


def test_endings_existing_files_and_short_motions_are_refused(make_motion, wild_motion, tmp_path):
    with pytest.raises(ConfigError, match=r"\.npz"):
        wild_motion.save(tmp_path / "a.csv", format="mjlab")
    with pytest.raises(MotionError, match="frame"):
        written(make_motion(np.zeros((2, 29)), fps=50), "mjlab", tmp_path, velocities="finite")
    assert list(tmp_path.iterdir()) == []
    for name in ("mjlab", "sonic"):
        path = written(wild_motion, name, tmp_path)
        with pytest.raises(RecordingError, match="exists already"):
            wild_motion.save(path, format=name)
    (tmp_path / "written" / "mine.txt").touch()
    with pytest.raises(RecordingError, match=r"mine\.txt"):
        written(wild_motion, "sonic", tmp_path)


def test_a_failure_leaves_what_was_there(wild_motion, tmp_path):
    """A pelvis that is too far away for numbers in text."""
    path = written(wild_motion, "sonic", tmp_path)
    before = {one.name: one.read_bytes() for one in path.iterdir()}
    far = replace(wild_motion, root_pos=wild_motion.root_pos + 10_000)
    for name in ("sonic", "lafan1"):
        with pytest.raises(MotionError, match="10,000"):
            written(far, name, tmp_path)
    assert {one.name: one.read_bytes() for one in path.iterdir()} == before
    assert list(tmp_path.iterdir()) == [path]


MJLAB = """
import sys
import numpy as np
import torch
from mjlab.asset_zoo.robots.unitree_g1.g1_constants import get_spec
from mjlab.tasks.tracking.mdp.commands import MotionLoader

model = get_spec().compile()
bodies = [model.body(i).name for i in range(1, model.nbody)]
joints = [model.joint(i).name for i in range(1, model.njnt)]
loader = MotionLoader(sys.argv[1], torch.arange(len(bodies)))
names = "joint_pos joint_vel body_pos_w body_quat_w body_lin_vel_w body_ang_vel_w".split()
np.savez(
    sys.argv[2],
    bodies=bodies,
    joints=joints,
    steps=loader.time_step_total,
    **{name: getattr(loader, name).numpy() for name in names},
)
"""


@pytest.mark.slow
def test_mjlabs_own_loader_reads_it(wild_motion, tmp_path):
    """In an environment of its own: MJLAB_PYTHON is the Python of one with mjlab installed."""
    python = os.environ.get("MJLAB_PYTHON")
    if not python or not Path(python).exists():
        pytest.skip("set MJLAB_PYTHON to the Python of an environment with mjlab")
    path = written(wild_motion, "mjlab", tmp_path)
    command = [python, "-c", MJLAB, path, tmp_path / "read.npz"]
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    subprocess.run(command, check=True, env=environment, timeout=150, capture_output=True)
    with np.load(path) as ours, np.load(tmp_path / "read.npz") as theirs:
        assert theirs["bodies"].tolist() == ours["body_names"].tolist()
        assert theirs["joints"].tolist() == ours["joint_names"].tolist()
        assert theirs["steps"] == len(ours["joint_pos"])
        for name in theirs.files[3:]:
            np.testing.assert_array_equal(theirs[name], ours[name])


def test_a_motion_never_replaces_its_own_file(wild_motion, tmp_path):
    path = wild_motion.save(tmp_path / "one.npz")
    found = g1stream.load_motion(path)
    for motion in (found, found.then(found)):
        with pytest.raises(RecordingError, match="input"):
            motion.save(path, format="mjlab", force=True)


def test_bodies_tell_the_order_of_joints_in_a_directory_of_sonic(wild_motion, tmp_path):
    path = written(wild_motion, "sonic", tmp_path)
    joints = path / "joint_pos.csv"
    head, *rows = joints.read_text().splitlines()
    numbers = [JOINT_NAMES.index(name) for name in names_in_order("isaaclab")]
    table = np.array([row.split(",") for row in rows])
    rows = [",".join(row) for row in table[:, np.argsort(numbers)]]
    joints.write_text("\n".join([head, *rows]))
    close(g1stream.load_motion(path).joint_pos, wild_motion.resample(50).joint_pos, 1e-6)


def test_a_directory_of_sonic_without_positions_keeps_the_attitude(wild_motion, tmp_path):
    path = written(wild_motion, "sonic", tmp_path)
    (path / "body_pos.csv").unlink()
    found, whole = g1stream.load_motion(path), wild_motion.resample(50)
    assert np.abs((found.root_quat_wxyz * whole.root_quat_wxyz).sum(axis=1)).min() > 1 - 1e-9
    assert not found.root_pos.any()
