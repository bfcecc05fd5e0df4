import sys

import mujoco
import numpy as np
import pytest

from g1stream.app.sim import follow, open_viewer
from g1stream.errors import SimError
from g1stream.robot.model import G1
from g1stream.sim.world import World


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="displays are looked up otherwise")
def test_a_missing_display_is_an_error_at_once(monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(SimError, match="display"):
        open_viewer(World(G1.default()))


def test_the_whole_robot_is_in_view():
    world = World(G1.default())
    data, model = world.data, world.model
    camera, scene = mujoco.MjvCamera(), mujoco.MjvScene(model, 2000)
    follow(world, camera)
    mujoco.mj_forward(model, data)
    points = data.xpos[1:] + np.array([5.0, 0.0, 0.0])  # as if the robot had walked
    data.subtree_com[:] += [5.0, 0.0, 0.0]
    data.xpos[1:] = points
    options, perturb = mujoco.MjvOption(), mujoco.MjvPerturb()
    for _ in range(300):  # the camera comes after the robot
        mujoco.mjv_updateScene(
            *(model, data, options, perturb, camera, mujoco.mjtCatBit.mjCAT_ALL, scene)
        )
    eye = np.mean([side.pos for side in scene.camera], axis=0)
    forward, up = scene.camera[0].forward, scene.camera[0].up
    depth = (points - eye) @ forward
    across = np.stack([(points - eye) @ up, (points - eye) @ np.cross(forward, up)])
    angles = np.degrees(np.arctan2(np.abs(across), depth))
    assert depth.min() > 0.5
    assert 5.0 < angles[0].max() < model.vis.global_.fovy / 2 - 3.0
    assert angles[1].max() < model.vis.global_.fovy / 2
