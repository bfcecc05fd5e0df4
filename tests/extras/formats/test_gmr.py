import io
import pickle

import numpy as np
from scipy.spatial.transform import Rotation

import g1stream
from g1stream.motion.trajectory import Trajectory
from known_arrays import (
    close,
    written,
)

#: The bodies of GMR's `g1_mocap_29dof.xml` in the order of the file.
BODIES = """
    pelvis left_hip_pitch_link left_hip_roll_link left_hip_yaw_link left_knee_link
    left_ankle_pitch_link left_ankle_roll_link left_toe_link pelvis_contour_link
    right_hip_pitch_link right_hip_roll_link right_hip_yaw_link right_knee_link
    right_ankle_pitch_link right_ankle_roll_link right_toe_link waist_yaw_link waist_roll_link
    torso_link head_link head_mocap imu_in_torso left_shoulder_pitch_link left_shoulder_roll_link
    left_shoulder_yaw_link left_elbow_link left_wrist_roll_link left_wrist_pitch_link
    left_wrist_yaw_link left_rubber_hand right_shoulder_pitch_link right_shoulder_roll_link
    right_shoulder_yaw_link right_elbow_link right_wrist_roll_link right_wrist_pitch_link
    right_wrist_yaw_link right_rubber_hand
"""


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
    assert names == BODIES.split()
    assert local.shape == (40, 38, 3)
    trajectory = Trajectory(g1stream.Motion.from_arrays(wild_motion.joint_pos, fps=30))
    for frame in (0, 17, 39):
        bodies = oracle.bodies(trajectory.sample(frame / wild_motion.fps))
        moving = [name for name in names if name in bodies]
        assert len(moving) == 30
        for name in moving:
            close(local[frame, names.index(name)], bodies[name].pos, 1e-6)
        for name, parent, offset in (
            ("left_toe_link", "left_ankle_roll_link", [0.1, 0, -0.02]),
            ("right_toe_link", "right_ankle_roll_link", [0.1, 0, -0.02]),
            ("head_mocap", "torso_link", [0, 0, 0.4]),
            ("head_link", "torso_link", [0.0039635, 0, -0.044]),
            ("imu_in_torso", "torso_link", [-0.03959, -0.00224, 0.14792]),
            ("left_rubber_hand", "left_wrist_yaw_link", [0.0415, 0.003, 0]),
            ("right_rubber_hand", "right_wrist_yaw_link", [0.0415, -0.003, 0]),
            ("pelvis_contour_link", "pelvis", [0, 0, 0]),
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
