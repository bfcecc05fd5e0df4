"""Motions in named arrays as other programs write them, and what they are written to."""

from __future__ import annotations

from typing import NamedTuple
from xml.etree import ElementTree as ET

import mujoco
import numpy as np

import g1stream
from g1stream.extras.formats.table import WRITTEN
from g1stream.motion.readers import find_motion
from g1stream.optional import load_object
from g1stream.robot.kinematics import forward_kinematics
from g1stream.robot.model import G1

OUTPUTS = {name: load_object(where) for name, where in WRITTEN.items()}
SUFFIX = {name: one.suffix for name, one in OUTPUTS.items()}

#: Column of each motor in an array of Isaac Lab.
ISAACLAB = [
    *(0, 3, 6, 9, 13, 17),
    *(1, 4, 7, 10, 14, 18),
    *(2, 5, 8),
    *(11, 15, 19, 21, 23, 25, 27),
    *(12, 16, 20, 22, 24, 26, 28),
]
WRISTS = [i for i, name in enumerate(g1stream.JOINT_NAMES) if "wrist" in name]
WITHOUT_WRISTS = [i for i in range(29) if i not in WRISTS]


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


def assert_motion(found, motion, *, tolerance=0.0, root=True):
    assert found.fps == motion.fps
    np.testing.assert_array_equal(found.joint_pos, motion.joint_pos)
    if root:
        np.testing.assert_allclose(found.root_pos, motion.root_pos, rtol=0, atol=tolerance)
        alike = np.abs(np.sum(found.root_quat_wxyz * motion.root_quat_wxyz, axis=1))
        np.testing.assert_allclose(alike, 1.0, rtol=0, atol=1e-6)


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


def written(motion, name, directory, **how):
    path = directory / f"written{SUFFIX[name]}"
    return motion.save(path, format=name, force=True, **how)


def arrays(*arguments, **how):
    with np.load(written(*arguments, **how)) as file:
        return {key: file[key] for key in file}


def close(found, expected, tolerance):
    np.testing.assert_allclose(found, expected, rtol=0, atol=tolerance)


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
