"""The LowCmd and the Reference of a tick."""

import numpy as np
import pytest

from g1stream.config import SafetyConfig
from g1stream.control.gains import Gains
from g1stream.control.loop import Composer
from g1stream.control.safety import Envelope, Measured
from g1stream.control.targets import Target
from g1stream.dds.messages import LowCmd, Reference
from g1stream.errors import SafetyError
from g1stream.types import Phase

KP, KD = np.arange(29) + 40.0, np.arange(29) / 10 + 1.0


@pytest.fixture
def composer(robot):
    composer = Composer(Envelope(robot, SafetyConfig()), Gains(KP, KD), damp_kd=3.0)
    at_rest = np.zeros(29, np.float32)
    composer.begin(Measured(at_rest, at_rest, np.array([1, 0, 0, 0], np.float32), 5, 0))
    return composer


@pytest.fixture
def target():
    return Target(1.25, np.linspace(-0.01, 0.01, 135))


def read(command, reference):
    low_cmd, beside = LowCmd(), Reference()
    low_cmd.load(command)
    beside.load(reference)
    return low_cmd, beside


def test_command_and_reference_have_their_own_targets(composer, target):
    commanded = target.replace(q=0.02, dq=0.3, tau=np.arange(29.0))
    command, reference = read(*composer.compose(target, commanded, Phase.PLAY, 7, 1.0))
    assert command.q == pytest.approx(np.full(29, 0.02))
    assert command.dq == pytest.approx(np.full(29, 0.3))
    assert command.tau.tolist() == list(range(29))
    assert (command.kp.tolist(), command.kd.tolist()) == (
        KP.astype(np.float32).tolist(),
        KD.astype(np.float32).tolist(),
    )
    assert command.motor_mode.tolist() == [1] * 29
    assert (int(command.mode_machine), int(command.mode_pr)) == (5, 0)
    assert command.crc_matches()
    assert (int(reference.tick), int(reference.phase)) == (7, Phase.PLAY)
    assert float(reference.motion_time) == 1.25
    assert reference.q.tolist() == target.q.tolist()
    assert reference.root_ang_vel.tolist() == target.root_ang_vel.tolist()
    assert reference.tau.tolist() == list(range(29))


def test_a_clamped_joint_is_not_driven_outward(composer, target, robot):
    commanded = target.replace(q=0.0, dq=1.0, tau=5.0)
    commanded.q[3] = robot.upper[3] + 1.0
    command, _ = read(*composer.compose(target, commanded, Phase.PLAY, 0, 1.0))
    margin = SafetyConfig().position_margin
    assert command.q[3] == pytest.approx(robot.upper[3] - margin)
    assert (command.dq[3], command.tau[3]) == (0.0, 0.0)
    assert (command.dq[4], command.tau[4]) == (1.0, 5.0)


def test_damping_has_kp_0(composer, target):
    composer.damp()
    command, _ = read(*composer.compose(target, target, Phase.DAMP, 0, 1.0))
    assert not command.kp.any()
    assert command.kd.tolist() == [3.0] * 29


def test_a_command_that_is_not_finite_is_refused(composer, target):
    with pytest.raises(SafetyError, match="tau = nan"):
        composer.compose(target, target.replace(tau=np.nan), Phase.PLAY, 0, 1.0)
