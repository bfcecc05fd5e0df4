"""The age of the commands that motors follow, which make their torque as unitree_mujoco does."""

from collections import deque
from dataclasses import replace

import numpy as np
import pytest

from g1stream.control.command_delay import CommandDelay
from g1stream.control.reading import ImuReading, Reading
from g1stream.dds.messages import LowCmd
from g1stream.robot.joints import TORQUE_LIMIT

IMU = ImuReading(*(np.zeros(n, np.float32) for n in (4, 3, 3)))


def found(
    delay,
    seconds=5.0,
    rate=500.0,
    noise=0.0,
    bias=0.0,
    moving=True,
    away=0.0,
    shaken=0.0,
    seed=3,
    until=np.inf,
    balanced=True,
):
    """What is found of motors whose commands wait for so many s in a queue, `until` it is empty.

    Each is within its limits, and one is `away` from its target, rad. Commands are `shaken` by a
    force on the robot, N, as a balance makes them of sensor noise.
    """
    rng = np.random.default_rng(seed)
    arms = rng.uniform(-0.5, 0.5, 29)  # m
    found, queue, command = CommandDelay(balanced=balanced), deque(), LowCmd()
    command.kp[:], command.kd[:] = 60.0, 1.0
    q, dq = np.zeros((2, 29), np.float32)
    frequency = rng.uniform(3.0, 9.0, 29)  # different ones, so that no period is taken for a delay
    for k in range(round(seconds * rate)):
        time = k / rate
        command.tau[:] = 5.0 * np.sin(moving * frequency * time) + shaken * rng.normal() * arms
        command.q[:] = command.tau / 100.0
        command.dq[:] = moving * frequency * np.cos(frequency * time) / 20.0
        found.sent(time, command.tobytes())
        queue.append(command.tau + 60.0 * command.q + command.dq)
        q[:] = moving * 0.3 * np.cos(2.0 * time)
        q[18] += away
        dq[:] = moving * 8.0 * np.sin(2.0 * time)
        tau = None
        while len(queue) > (delay * rate if time < until else 0):
            tau = queue.popleft()
        if tau is not None:
            tau = (tau - 60.0 * q - dq).clip(-TORQUE_LIMIT, TORQUE_LIMIT)
            tau = (tau + bias + noise * rng.normal(size=29)).astype(np.float32)
            received, content = round(1e9 * time), tau.tobytes()
            found.add(Reading(q, dq, tau, IMU, received=received, content=content))
    return found


@pytest.mark.parametrize(("delay", "rate"), [(0.15, 200), (0.15, 500), (0.4, 90), (1.6, 60)])
def test_commands_that_wait_in_a_queue(delay, rate):
    result = found(delay, rate=rate, noise=0.5, bias=0.5)
    assert result.longest == pytest.approx(delay, abs=0.03)
    assert result.stop_reason()


@pytest.mark.parametrize(("delay", "noise"), [(0.0, 0.0), (0.01, 3.0), (0.08, 0.5)])
def test_commands_that_do_not(delay, noise):
    result = found(delay, noise=noise, bias=0.3)
    assert result.longest == 0.0
    assert not result.stop_reason()


@pytest.mark.parametrize("seed", range(4))
def test_commands_that_sensor_noise_changes_are_not_late(seed):
    """Those in between are not kept, and an old one may be nearer to them than the new ones."""
    result = found(0.01, seconds=3.0, moving=False, shaken=10.0, seed=seed)
    assert result.longest == 0.0


def test_nothing_is_said_before_commands_and_readings_are_enough():
    assert found(0.4, seconds=2.2).longest is None


@pytest.mark.parametrize(
    ("delay", "disturbed"),
    [(0.0, {"noise": 0.5, "away": 1.5}), (0.4, {"noise": 0.5}), (0.4, {"shaken": 0.02})],
    ids=["a motor at its limit", "noise", "a force"],
)
def test_nothing_is_found_of_a_robot_at_rest(delay, disturbed):
    assert found(delay, moving=False, **disturbed).longest == 0.0


@pytest.mark.parametrize("balanced", [True, False])
def test_a_delay_is_warned_of_once_and_remembered_after_its_end(balanced, caplog):
    during = found(0.4, balanced=balanced)
    assert bool(during.stop_reason()) == balanced
    caplog.clear()
    after = found(0.4, seconds=8.0, until=4.0, balanced=balanced)
    assert after.longest == pytest.approx(0.4, abs=0.03)
    assert not after.stop_reason()
    assert [record.levelname for record in caplog.records] == ["WARNING"]


def test_readings_after_a_stall_of_the_loop_are_not_compared():
    result = found(0.0)
    result.add(Reading(*np.ones((3, 29), np.float32), IMU, received=8 * 10**9, content=b"new"))
    assert result.longest == 0.0


def test_a_state_that_stands_still_is_not_compared():
    """It may match some old command; that its robot is frozen is for the checks of LowState."""
    delay, command, rng = CommandDelay(), LowCmd(), np.random.default_rng(1)
    measured = Reading(*np.zeros((3, 29), np.float32), IMU, content=b"frozen")
    for tick in range(2000):
        command.tau[:] = rng.normal(size=29) if tick < 1200 else 5.0 + tick / 100
        delay.sent(0.002 * tick, command.seal())
        delay.add(replace(measured, received=round(2e6 * tick)))
    assert delay.longest is None
