import logging

import numpy as np
import pytest

from g1stream.app.sim import make_world
from g1stream.config import SimConfig
from g1stream.dds.messages import LowState, SecondaryImu, SportModeState
from g1stream.robot.rotations import quat_to_rpy
from g1stream.sim.robot import MODE_MACHINE_29, SimulatedRobot
from g1stream.sim.world import World

KNEE = 3
PERIOD = 2_000_000


@pytest.fixture
def world(robot):
    return World(robot)


@pytest.fixture
def simulated(world):
    return SimulatedRobot(world, SimConfig())


def run(simulated, ticks, data=None):
    """Simulate, with the same LowCmd at every tick."""
    for tick in ticks:
        if data is not None:
            simulated.receive_command(data, tick * PERIOD)
        simulated.step(tick * PERIOD)


def test_low_state_has_tick_crc_attitude_and_mode(simulated):
    ticks, state = [], LowState()
    for tick in range(20):
        state.load(simulated.publish().low_state)
        assert state.crc_matches()
        ticks.append(int(state.tick))
        run(simulated, range(tick, tick + 1))
    assert np.unique(np.diff(ticks)).tolist() == [2]
    assert int(state.mode_machine) == MODE_MACHINE_29
    assert state.quaternion == pytest.approx([1, 0, 0, 0], abs=1e-6)
    assert state.accelerometer == pytest.approx([0, 0, 9.81], abs=1e-3)
    assert simulated.report.states == 20


def test_base_and_torso(simulated, world):
    run(simulated, range(19))
    published = simulated.publish()
    sport, torso = SportModeState(), SecondaryImu()
    sport.load(published.sport_mode_state)
    torso.load(published.secondary_imu)
    assert sport.position == pytest.approx(world.state().base_pos, abs=1e-6)
    assert int(sport.nanosec) == 38_000_000
    assert np.linalg.norm(torso.quaternion) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("rate", [300, 1000])
def test_simulated_time_is_a_multiple_of_the_period(robot, rate):
    settings = SimConfig(rate=rate, support="bolted")
    simulated = SimulatedRobot(make_world(robot, settings), settings)
    run(simulated, range(30))
    assert simulated.report.simulated == pytest.approx(30 / rate)


def test_noise_has_the_size_of_the_settings_and_is_in_what_is_published_only(world):
    quiet, noisy = SimulatedRobot(world, SimConfig()), SimulatedRobot(world, SimConfig(noise=2.0))
    state, samples = LowState(), []
    state.load(quiet.publish().low_state)
    assert not state.q.any()
    for _ in range(200):
        state.load(noisy.publish().low_state)
        quat = state.quaternion.astype(np.float64)
        assert np.linalg.norm(quat) == pytest.approx(1.0, abs=1e-6)
        assert state.rpy == pytest.approx(quat_to_rpy(quat), abs=1e-5)
        assert state.crc_matches()
        samples.append([*state.q, *state.dq, *state.gyroscope, *state.accelerometer, *state.rpy])
    sizes = np.repeat([1e-3, 0.1, 0.02, 0.2, 2e-3], [29, 29, 3, 3, 3])
    assert np.std(samples, axis=0) == pytest.approx(sizes, rel=0.25)
    means = np.mean(samples, axis=0) / sizes
    means[63] -= 9.81 / sizes[63]  # the accelerometer, upward
    assert np.abs(means).max() < 6.0 / np.sqrt(200)
    assert not world.state().q.any()


def test_commands_are_obeyed_later(world, command):
    simulated = SimulatedRobot(world, SimConfig(command_delay=0.02))
    run(simulated, range(10), command.seal())
    assert simulated.report.commands == 0
    assert world.state().q[KNEE] < 0.01
    run(simulated, range(10, 20))
    assert simulated.report.commands == 10
    assert world.state().q[KNEE] > 0.05


@pytest.mark.parametrize(("late", "obeyed"), [(0.49, 1), (0.51, 0)])
def test_a_delayed_command_is_obeyed_at_the_nearest_tick(world, command, late, obeyed):
    simulated = SimulatedRobot(world, SimConfig(command_delay=0.02))
    simulated.receive_command(command.seal(), round(late * PERIOD))
    simulated.step(10 * PERIOD)
    assert simulated.report.commands == obeyed


@pytest.mark.parametrize(("periods", "ticks"), [(0.9, 0), (1.0, 1), (1.9, 1), (2.0, 2)])
def test_a_delay_is_whole_periods(world, command, periods, ticks):
    """A command has waited for half a period on average when it is received."""
    simulated = SimulatedRobot(world, SimConfig(command_delay=periods * PERIOD / 1e9))
    simulated.receive_command(command.seal(), 0)
    obeyed = []
    for tick in range(4):
        simulated.step(tick * PERIOD)
        obeyed.append(simulated.report.commands)
    assert obeyed.index(1) == ticks


def test_a_valid_command_moves_the_joint(simulated, world, command, caplog):
    caplog.set_level(logging.INFO)
    run(simulated, range(400), command.seal())
    assert world.state().q[KNEE] == pytest.approx(0.5, abs=0.2)
    assert simulated.report.commands == 400
    assert not simulated.report.refused
    assert [record.levelname for record in caplog.records] == ["INFO"]


@pytest.mark.parametrize(
    ("reason", "field", "value"),
    [
        ("CRC", "mode_pr", 0),
        ("mode_pr", "mode_pr", 1),
        ("mode_machine", "mode_machine", 4),
        ("not finite", "q", np.nan),
    ],
)
def test_an_invalid_command_is_refused_and_logged(
    simulated, world, command, caplog, reason, field, value
):
    getattr(command, field)[...] = value
    run(simulated, (*range(49), 500), command.tobytes() if reason == "CRC" else command.seal())
    assert simulated.report.commands == 0
    ((refusal, count),) = simulated.report.refused.items()
    assert reason in refusal
    assert count == 50
    assert world.state().q[KNEE] == pytest.approx(0.0, abs=0.1)
    assert len(caplog.records) == 2  # once a second, not at every command
    assert all(record.levelno == logging.WARNING for record in caplog.records)


def test_disabled_motors_give_no_torque(simulated, world, command, caplog):
    command.motor_mode = 0
    run(simulated, range(100), command.seal())
    assert not world.state().tau_est.any()
    assert "29 of 29" in caplog.records[0].message


@pytest.mark.parametrize(("kp", "level"), [(60.0, logging.WARNING), (0.0, logging.INFO)])
def test_without_commands_the_motors_only_damp(world, command, caplog, kp, level):
    """Which is no fault after commands that only damp."""
    caplog.set_level(logging.INFO)
    simulated = SimulatedRobot(world, SimConfig())
    command.kp[:] = kp
    run(simulated, range(150), command.seal())
    run(simulated, range(150, 500))
    state = world.state()
    assert simulated.report.timeouts == 1
    assert caplog.records[-1].levelno == level
    assert "timeout" in caplog.records[-1].message
    # Gravity alone moves it now: the motor resists speed and nothing else.
    assert state.tau_est[KNEE] == pytest.approx(-3.0 * state.dq[KNEE], abs=0.3)


def test_another_seed_has_other_noise(world):
    def first(seed):
        simulated = SimulatedRobot(world, SimConfig(noise=1.0, seed=seed))
        state = LowState()
        state.load(simulated.publish().low_state)
        return state.q.tolist()

    assert first(1) == first(1) != first(2)
