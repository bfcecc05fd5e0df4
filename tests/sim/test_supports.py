import numpy as np
import pytest

from g1stream.app.sim import make_world
from g1stream.config import SimConfig
from g1stream.robot.dynamics import InverseDynamics
from g1stream.robot.rotations import quat_rotate
from g1stream.sim.world import Root, World

GRAVITY = 9.81


def base_tilt(quat_wxyz):
    """Angle between the base's z axis and the world's, rad."""
    return float(np.arccos(quat_rotate(quat_wxyz, np.array([0.0, 0.0, 1.0]))[2]))


def test_start_pose_and_height(robot, inner_pose):
    for support in ("bolted", "hanging"):
        state = World(robot, support, joint_pos=inner_pose, base_height=1.2).state()
        assert state.q == pytest.approx(inner_pose, abs=1e-15)
        assert state.base_pos == pytest.approx([0, 0, 1.2])
        assert state.time == 0


def test_hanging_robot_settles_upright_where_the_band_carries_it(robot, servo):
    world = World(robot, "hanging")
    weight = GRAVITY * InverseDynamics(robot).mass
    height, tilt = [], []
    for _ in range(400):
        world.step(servo(), 10)
        state = world.state()
        height.append(state.base_pos[2])
        tilt.append(base_tilt(state.imu.quat_wxyz))
    assert np.mean(height[200:]) == pytest.approx(3 - weight / 200, abs=0.003)
    assert np.ptp(height[200:]) < 0.01
    assert max(tilt) < 0.15


def test_band_pulls_at_the_torso_by_its_law(robot, servo, run):
    world = World(robot, "hanging", base_height=1.1)
    world.data.qpos[0] = 0.5  # so that it pulls sideways too, and turns the robot
    run(world, servo(q=0.2), 0.2)
    model, data, state = world.model, world.data, world.state()
    torso = [model.body(name).id for name in ("torso_link", "head_link", "logo_link")]
    places = data.xipos.copy()
    centre = np.average(places[torso], axis=0, weights=model.body_mass[torso])
    world.step(servo(q=0.2))
    force, moment = data.xfrc_applied[:, :3], data.xfrc_applied[:, 3:]
    to_top = np.array([0.0, 0.0, 3.0]) - state.base_pos
    length = np.linalg.norm(to_top)
    speed = state.base_lin_vel @ to_top / length
    band = (200 * length - 100 * speed) * to_top / length
    assert abs(speed) > 0.1
    assert force.sum(axis=0) == pytest.approx(band)
    assert (moment + np.cross(places, force)).sum(axis=0) == pytest.approx(np.cross(centre, band))


def root_at(time, *, playing=True):
    """A base that runs around a circle of 0.4 m in 4 s, turning with it."""
    rate, angle = np.pi / 2, np.pi / 2 * time
    return Root(
        pos=np.array([0.4 * np.cos(angle), 0.4 * np.sin(angle), 0.9]),
        quat_wxyz=np.array([np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)]),
        lin_vel=0.4 * rate * np.array([-np.sin(angle), np.cos(angle), 0.0]),
        ang_vel=np.array([0.0, 0.0, rate]),
        playing=playing,
    )


def test_a_followed_base_is_where_the_reference_is(robot, servo):
    world = World(robot, "follow")
    before = world.state().q
    for tick in range(400):
        world.set_reference(root_at(tick * 0.002))
        if tick == 0:
            assert world.state().q.tolist() == before.tolist()
        world.step(servo(), 2)
        if tick > 50:
            root, state = root_at((tick + 1) * 0.002), world.state()
            assert state.base_pos == pytest.approx(root.pos, abs=0.003)
            assert state.imu.quat_wxyz == pytest.approx(root.quat_wxyz, abs=0.006)
            assert state.base_lin_vel == pytest.approx(root.lin_vel, abs=0.02)


def test_between_references_a_followed_base_turns_as_fast_as_the_last_one(robot, servo, run):
    world = World(robot, "follow")
    world.set_reference(root_at(0.0)._replace(lin_vel=np.zeros(3)))
    run(world, servo(), 0.08)  # of a quarter turn per second
    quat = world.state().imu.quat_wxyz
    assert 2.0 * np.arctan2(quat[3], quat[0]) == pytest.approx(np.pi / 2 * 0.08, abs=0.02)


@pytest.mark.parametrize("support", ["follow", "free"])
def test_a_base_stays_where_it_is_until_a_reference_comes(robot, support, servo, run):
    world = World(robot, support)
    run(world, servo(), 0.3)
    assert world.state().base_pos == pytest.approx([0, 0, 1.0], abs=0.003)
    assert base_tilt(world.state().imu.quat_wxyz) < 0.003


def test_a_free_base_is_let_go_when_the_motion_begins_until_the_next_session(robot, servo, run):
    world = World(robot, "free")
    rest = root_at(0.0, playing=False)._replace(lin_vel=np.zeros(3), ang_vel=np.zeros(3))
    world.set_reference(rest)
    run(world, servo(), 0.2)
    assert world.state().base_pos == pytest.approx([0.4, 0.0, 0.9], abs=0.003)
    world.set_reference(root_at(0.0))
    run(world, servo(), 0.1)
    fallen = GRAVITY * 0.1**2 / 2
    assert 0.9 - world.state().base_pos[2] == pytest.approx(fallen, abs=0.01)
    run(world, servo(enabled=False), 2.0)
    assert 0.03 < world.state().base_pos[2] < 0.4  # it lies on the floor
    world.set_reference(rest)
    run(world, servo(), 0.5)
    assert world.state().base_pos == pytest.approx([0.4, 0.0, 0.9], abs=0.003)
    assert base_tilt(world.state().imu.quat_wxyz) < 0.01


@pytest.mark.parametrize("support", ["follow", "free"])
def test_a_base_stands_still_when_the_reference_has_stopped_coming(robot, support, servo, run):
    world = World(robot, support)
    world.set_reference(root_at(0.0, playing=False))  # at 0.63 m/s
    run(world, servo(), 0.3)
    there = world.state().base_pos.copy()
    run(world, servo(), 1.0)
    assert world.state().base_pos == pytest.approx(there, abs=0.01)
    assert world.state().base_lin_vel == pytest.approx([0, 0, 0], abs=0.01)


def test_only_a_followed_robot_passes_through_the_floor(robot, servo, run):
    world = World(robot, "follow", base_height=0.3)
    run(world, servo(), 0.1)
    assert world.data.ncon == 0
    assert world.state().base_pos[2] == pytest.approx(0.3, abs=0.003)


@pytest.fixture
def falling(robot, servo):
    """Lets a robot fall from high above the floor, and gives its speed after some seconds."""

    def make(push, seed=0, support="free"):
        settings = SimConfig(support=support, push=push, seed=seed)
        world = make_world(robot, settings)
        high, upright = np.array([0.0, 0.0, 900.0]), np.array([1.0, 0.0, 0.0, 0.0])
        still = Root(high, upright, *np.zeros((2, 3)), playing=False)
        world.set_reference(still)
        world.step(servo(), round(0.5 / world.timestep))
        world.set_reference(still._replace(playing=True))

        def after(seconds):
            world.step(servo(), round(seconds / world.timestep))
            return world.state().base_lin_vel

        return after

    return make


def test_a_loose_base_is_pushed_every_five_seconds(falling):
    still, pushed = falling(0.0), falling(0.5)
    assert pushed(4.99) == pytest.approx(still(4.99), abs=1e-12)
    first, both = ((pushed(pause) - still(pause))[:2] for pause in (0.02, 5.0))
    assert 0.0 < np.abs(first).max() <= 0.5
    assert 0.0 < np.abs(both - first).max() <= 0.5
    assert not np.allclose(both, 2.0 * first)


def test_the_pushes_of_a_seed_are_the_same(falling, monkeypatch):
    monkeypatch.setattr("g1stream.sim.world.PUSH_PERIOD", 0.1)
    speeds = [falling(0.5, seed)(0.15) for seed in (3, 3, 4)]
    assert speeds[0].tolist() == speeds[1].tolist()
    assert not np.allclose(speeds[0][:2], speeds[2][:2])


@pytest.mark.parametrize("support", ["bolted", "hanging", "follow"])
def test_a_base_that_is_held_is_not_pushed(falling, support, monkeypatch):
    monkeypatch.setattr("g1stream.sim.world.PUSH_PERIOD", 0.1)
    still, pushed = (falling(push, support=support)(0.15) for push in (0.0, 2.0))
    assert still.tolist() == pushed.tolist()
