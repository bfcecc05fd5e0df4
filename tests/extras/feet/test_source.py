import numpy as np
import pytest

from g1stream.config import load_config
from g1stream.control.reading import ImuReading, Reading
from g1stream.control.sources import HeldTorques, Moment
from g1stream.errors import ConfigError
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.model import G1
from g1stream.robot.rotations import quat_from_rpy, quat_mul
from g1stream.types import Phase

pytest.importorskip("daqp")
from g1stream.extras.feet.source import StandingTorques

ROBOT = G1.default()
PERIOD = 0.002
LEFT, RIGHT = (
    [JOINT_NAMES.index(f"{side}_ankle_{axis}_joint") for axis in ("pitch", "roll")]
    for side in ("left", "right")
)


@pytest.fixture
def torques(first):
    torques = StandingTorques(load_config(over={"stream.support": "feet"}), ROBOT)
    torques.begin(first, None, ROBOT.name)
    return torques


def at_rest(first, tau=0.0, quat=None):
    quat = first.root_quat_wxyz if quat is None else quat
    imu = ImuReading(quat, np.zeros(3), np.array([0.0, 0.0, 9.81]))
    return Reading(first.q, np.zeros(29), np.zeros(29) + tau, imu)


def commanded(torques, first, tau, ramped=1.0, phase=Phase.RAMP):
    """The command for a robot that is still in the pose of the target, with these torques."""
    return torques.command(Moment(phase, ramped, first, at_rest(first, tau), 0.0))


@pytest.mark.parametrize("ramped", [0.5, 1.0])
def test_in_the_air_it_has_the_torque_of_a_hanging_robot_and_waits(torques, first, ramped):
    held = HeldTorques(load_config(), ROBOT, simulated=True)
    held.begin(first, "hanging", ROBOT.name)
    expected = held.command(Moment(Phase.RAMP, 0.5, first, at_rest(first), 0.0)).tau
    for _ in range(20):
        command = commanded(torques, first, expected, ramped=ramped)
    assert command.tau == pytest.approx(expected, abs=0.1)
    assert command.q == pytest.approx(first.q, abs=1e-9)
    assert torques.status.awaited


def test_ankles_take_the_tilt_back_whatever_the_heading_of_the_imu(torques, first):
    for heading in (0.0, 1.0):
        pitch = quat_mul(
            quat_from_rpy(np.array([0.0, 0.0, heading])), quat_from_rpy(np.array([0.05, 0.1, 0.0]))
        )
        tilted = first._replace(root_quat_wxyz=np.array([1.0, 0.0, 0.0, 0.0]))
        measured = at_rest(first, quat=pitch)
        change = torques.command(Moment(Phase.RAMP, 0.5, tilted, measured, 0.0)).q - first.q
        for ankle in (LEFT, RIGHT):
            assert change[ankle] == pytest.approx([-0.1, -0.05], abs=2e-3)
        assert np.count_nonzero(change) == 4


@pytest.mark.slow
def test_once_the_feet_carry_the_robot_it_balances_and_play_may_begin(torques, first):
    """At rest, with the torques that it asks for: what the feet carry grows to the weight."""
    standing = torques.balance
    tau = standing.torque(first, at_rest(first), 0.0, share=1.0)
    torques.begin(first, None, ROBOT.name)
    for _ in range(round(0.9 / PERIOD)):
        command = commanded(torques, first, tau)
    assert torques.status.awaited
    for _ in range(round(0.9 / PERIOD)):
        command = commanded(torques, first, tau)
    assert torques.status.awaited == ""
    assert standing.wrench[[2, 8]].sum() == pytest.approx(33.34 * 9.81, rel=0.02)
    assert command.tau == pytest.approx(tau, abs=2.0)
    for _ in range(round(0.5 / PERIOD)):  # the load dips: RAMP ends all the same, without a jump
        commanded(torques, first, 0.5 * tau)
    assert torques.status.awaited == ""
    assert commanded(torques, first, tau, phase=Phase.PLAY).q.tolist() == first.q.tolist()
    assert torques.status.fall == torques.status.fault == ""


def test_a_robot_that_a_simulator_holds_does_not_stand(first):
    torques = StandingTorques(load_config(over={"stream.support": "feet"}), ROBOT)
    with pytest.raises(ConfigError, match="bolted"):
        torques.begin(first, "bolted", ROBOT.name)
