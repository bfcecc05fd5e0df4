import numpy as np
import pytest

import g1stream
from g1stream.errors import MotionError
from g1stream.extras.formats.orders import names_in_order
from g1stream.robot.joints import JOINT_NAMES
from known_arrays import arrays, close, written


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
