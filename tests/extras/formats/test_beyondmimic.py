import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

from g1stream.motion.trajectory import Trajectory
from g1stream.robot.joints import JOINT_NAMES
from known_arrays import (
    Body,
    arrays,
    close,
    written,
)


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
