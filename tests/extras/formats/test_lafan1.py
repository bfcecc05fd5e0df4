from dataclasses import replace

import numpy as np

from known_arrays import close, written


def test_lafan1_has_36_columns_at_30_fps_and_no_header(wild_motion, tmp_path):
    motion = replace(wild_motion, fps=30.0)
    found = np.loadtxt(written(motion, "lafan1", tmp_path), delimiter=",")
    assert found.shape == (40, 36)
    close(found[:, :3], motion.root_pos, 1e-6)
    close(found[:, 3:7], motion.root_quat_wxyz[:, [1, 2, 3, 0]], 1e-6)
    close(found[:, 7:], motion.joint_pos, 1e-6)
