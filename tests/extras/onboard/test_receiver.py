"""Commands on rt/arm_sdk: only arms and waist, and a weight that always goes back to 0."""

import itertools

import numpy as np
import pytest

from g1stream.config import load_config
from g1stream.control.combinations import require_combination
from g1stream.control.loop import make_loop
from g1stream.control.plan import plan
from g1stream.control.wire_settings import for_wire
from g1stream.dds.messages import LowCmd
from g1stream.errors import ConfigError
from g1stream.extras.onboard.receiver import OnboardController
from g1stream.motion.motion import Motion
from g1stream.robot.model import G1
from g1stream.testing import FakeClock, FakeLink
from g1stream.types import Phase

PERIOD = 2_000_000  # ns
STEP = 0.001  # of the weight between two commands: 2 ms of 2 s
HANDING_BACK = 2.05  # s
LEGS, ARMS = slice(0, 12), slice(12, 29)

#: What ends a session in RAMP, 600 commands after its first one.
ENDS = {
    "the motion ends": None,
    "a signal": lambda loop, link: loop.request_stop("SIGINT"),
    "LowState stops": lambda loop, link: setattr(link, "silent", True),
    "the loop fails": lambda loop, link: setattr(link, "receive", None),
}


@pytest.fixture
def clock():
    return FakeClock()


@pytest.fixture
def link(clock):
    return FakeLink(clock)


@pytest.fixture
def made(link, clock):
    """A loop that plays half a second, at up to 0.4 rad/s."""
    times = np.arange(26)[:, np.newaxis] / 50.0
    motion = Motion.from_arrays(0.1 * np.sin(4.0 * times + np.linspace(0.1, 1.5, 29)), fps=50.0)

    def make(**settings):
        over = {"stream.via": "arm_sdk", "stream.hold": 0.1, "stream.ramp": 0.5}
        over["safety.state_timeout"] = 0.1
        over |= {f"stream.{name}": value for name, value in settings.items()}
        return make_loop(
            plan(motion, for_wire(load_config(over=over)), simulated=True), link, clock, settle=0
        )

    return make


@pytest.mark.parametrize("end", ENDS)
def test_every_way_out_hands_arms_and_waist_back(made, link, caplog, end):
    caplog.set_level("INFO", logger="g1stream")
    loop = made()
    if act := ENDS[end]:
        link.at_send(600, lambda: act(loop, link))
    try:
        loop.run()
    except TypeError:
        assert end == "the loop fails"
    commands = [sent.command for sent in link.sent]
    assert caplog.messages.count("the stream hands arms and waist back") == 1
    weights = np.array([float(command.weight) for command in commands])
    assert weights[0] == pytest.approx(STEP)
    assert np.abs(np.diff(weights)).max() < STEP * 1.001
    assert weights[-1] == 0.0
    assert (weights == 0.0).sum() > 20  # a best-effort reader may miss some
    falling, last = link.in_phase(Phase.DAMP), [c for c in commands if c.dq.any()][-1]
    assert len(falling) == round(HANDING_BACK * 1e9 / PERIOD)
    if end == "the motion ends":
        assert weights.max() == 1.0
        # RAMP lasts as long as the weight needs.
        assert len(link.in_phase(Phase.RAMP)) == 1000
        assert float(link.in_phase(Phase.PLAY)[0].command.weight) == pytest.approx(1.0)
    else:  # 600 commands, and those until the silence was noticed
        assert 0.6 < weights.max() < 0.7
    for sent in falling:  # neither limp nor moving
        assert sent.command.q.tolist() == falling[0].command.q.tolist()
        assert sent.command.kp.tolist() == commands[0].kp.tolist()
        assert not sent.command.dq.any()
        if end != "the motion ends":
            assert sent.command.tau.tolist() == last.tau.tolist()
    for command in commands:
        assert command.crc_matches()
        assert command.motor_mode.tolist() == [0] * 12 + [1] * 17
        for values in (command.q, command.dq, command.tau, command.kp, command.kd):
            assert not values[LEGS].any()
        assert (command.kp[ARMS] > 0.0).all()


@pytest.mark.parametrize(
    ("flag", "value"),
    [("joints", "legs,arms"), ("joints", "*"), ("others", "free"), ("support", "hanging")],
)
def test_what_cannot_be_is_refused(flag, value):
    config = load_config(over={"stream.via": "arm_sdk", f"stream.{flag}": value})
    with pytest.raises(ConfigError) as refused:
        require_combination(config, G1.default(), simulated=True)
    assert f"stream.{flag}" in refused.value.cause


def test_arms_that_do_not_play_hold_their_pose(made, link):
    made(joints="left_arm").run()
    for sent in link.sent:
        assert (sent.command.kp[ARMS] > 0.0).all()
        assert not sent.command.q[22:].any()


@pytest.mark.parametrize("weight", [0.3, np.nan, 7.0])
def test_what_a_guard_sends_after_a_command(weight):
    last = LowCmd()
    last.q[:], last.dq[:], last.tau[:], last.kp[:] = 0.5, 1.0, 2.0, 40.0
    last.weight[()] = weight
    command, weights = LowCmd(), []
    for frame in OnboardController(PERIOD, HANDING_BACK).end(last):
        command.load(frame)
        assert command.crc_matches()
        assert (command.q == 0.5).all()
        assert (command.kp == 40.0).all()
        assert not command.dq.any()
        assert (command.tau == 2.0).all()
        weights.append(float(command.weight))
    assert all(0.0 <= after <= before for before, after in itertools.pairwise(weights))
    assert weights[-1] == 0.0
    assert weights.count(0.0) > 20
    assert len(weights) == round(HANDING_BACK * 1e9 / PERIOD) + 1


@pytest.mark.parametrize("announced", ["hanging", None])
def test_a_tilt_ends_the_session_whatever_a_simulator_announces(made, link, announced):
    """By 1.2 rad, because the robot's own controller stands."""
    link.support = announced
    turned = np.array([np.cos(0.6), 0.0, np.sin(0.6), 0.0], np.float32)
    link.at_send(20, lambda: link.robot.quaternion.__setitem__(slice(None), turned))
    assert made().run().stop.kind == "tilt"
    assert not link.in_phase(Phase.PLAY)


def test_the_torques_are_those_of_a_robot_that_its_controller_carries(made, link):
    link.support = "follow"
    loop = made()
    loop.run()
    assert loop.report.feedforward.mode[:2] == ("dynamics", None)
    assert any(sent.command.tau.any() for sent in link.sent)
