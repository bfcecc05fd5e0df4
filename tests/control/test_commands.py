import numpy as np
import pytest

from g1stream.config import SafetyConfig
from g1stream.control.command import Composer
from g1stream.control.gains import Gains
from g1stream.control.limits import MAX_STEP_TIME, CommandLimits, PositionLimit
from g1stream.control.reading import Reading
from g1stream.control.receiver import Receiver
from g1stream.control.targets import Setpoint
from g1stream.dds.messages import LowCmd, LowState, Reference
from g1stream.errors import ConfigError, SafetyError
from g1stream.robot.joints import JOINT_NAMES
from g1stream.types import Phase

PERIOD = 0.002
STILL = np.zeros(29)
KP, KD = np.arange(29) + 40.0, np.arange(29) / 10 + 1.0


@pytest.fixture
def make_limits(robot):
    def make(beyond="refuse", *, in_steps=False, **settings):
        limits = CommandLimits(robot, SafetyConfig(**settings), beyond, in_steps=in_steps)
        limits.begin(np.zeros(29))
        return limits

    return make


def test_command_and_reference_have_their_own_targets(make_limits):
    composer = Composer(
        make_limits(), Gains(KP, KD), Receiver(2_000_000, 0.5), *2 * [np.ones(29, bool)]
    )
    composer.begin(np.zeros(29, np.float32), 5)
    sizes = [29, 29, 29, 29, 3, 4, 3, 3, 3, 3]
    target = Setpoint(1.25, *np.split(np.linspace(-0.01, 0.01, 135), np.cumsum(sizes)[:-1]))
    commanded = target._replace(q=np.full(29, 0.02), dq=np.full(29, 0.3), tau=np.arange(29.0))
    command, reference = LowCmd(), Reference()
    composed = composer.compose(target, commanded, Phase.PLAY, 7, elapsed=PERIOD)
    for message, data in zip((command, reference), composed, strict=True):
        message.load(data)
    assert command.q == pytest.approx(np.full(29, 0.02))
    assert command.dq == pytest.approx(np.full(29, 0.3))
    assert command.tau.tolist() == list(range(29))
    assert command.kp.tolist() == KP.tolist()
    assert command.kd.tolist() == KD.astype(np.float32).tolist()
    assert command.motor_mode.tolist() == [1] * 29
    assert (int(command.mode_machine), int(command.mode_pr)) == (5, 0)
    assert command.crc_matches()
    assert (int(reference.tick), int(reference.phase)) == (7, Phase.PLAY)
    assert float(reference.motion_time) == 1.25
    root = ("root_pos", "root_quat_wxyz", "root_lin_vel", "root_ang_vel")
    for name in ("q", "dq", "ddq", *root):
        expected = getattr(target, name).astype(np.float32)
        assert getattr(reference, name).tolist() == expected.tolist(), name
    assert reference.tau.tolist() == list(range(29))


@pytest.mark.parametrize("torque", [5.0, -5.0])
def test_a_held_target_is_not_driven_on_into_its_limit(make_limits, robot, torque):
    limits, dq, tau = make_limits(), np.full(29, 3.0), np.full(29, torque)
    q = (robot.lower + robot.upper) / 2
    q[3], q[4] = robot.upper[3] + 0.2, robot.lower[4] - 0.2
    limits.begin(q.clip(robot.lower, robot.upper))
    limited, limited_tau = limits.apply(np.stack([q, dq]), tau, elapsed=PERIOD)
    dq[3] = dq[4] = 0.0
    tau[3], tau[4] = min(torque, 0.0), max(torque, 0.0)
    assert limited.tolist() == [q.clip(robot.lower, robot.upper).tolist(), dq.tolist()]
    assert limited_tau.tolist() == tau.tolist()


@pytest.mark.parametrize("side", ["lower", "upper"])
def test_a_ramp_from_beyond_a_limit_is_let_in_with_the_ramp(make_limits, robot, side):
    limit = PositionLimit(robot, 0.1)
    at_stop, inward = getattr(robot, side), 0.1 if side == "lower" else -0.1
    limit.begin(at_stop)
    for ramped, way in ((0.0, 0.0), (0.25, 0.25), (1.0, 1.0)):
        (q, _), _ = limit.apply(np.stack([at_stop, STILL]), STILL, ramped)
        assert q == pytest.approx(at_stop + way * inward, abs=1e-15)


def test_targets_beyond_a_limit_are_held_and_counted(make_limits, robot):
    limit = PositionLimit(robot, 0.1)
    q = (robot.lower + robot.upper) / 2
    q[3] = robot.upper[3] - 0.1 + 1e-5
    q[4] = robot.lower[4] + 0.1 - 1e-5
    q[5] = robot.upper[5] - 0.1 + 1e-9  # a rounding error: held as well, but not counted
    q[6], q[7] = robot.upper[6] - 0.1, robot.lower[7] + 0.1
    for _ in range(3):
        (limited, _), _ = limit.apply(np.stack([q, STILL]), STILL)
        assert limited[3] == robot.upper[3] - 0.1
        assert limited[4] == robot.lower[4] + 0.1
        assert limited[5] == robot.upper[5] - 0.1
    assert np.delete(limited, [3, 4, 5]).tolist() == np.delete(q, [3, 4, 5]).tolist()
    assert limit.clamped.tolist() == [3 if i in (3, 4) else 0 for i in range(29)]


def test_margin_that_leaves_no_range_is_refused(make_limits, robot):
    narrowest = np.argmin(robot.upper - robot.lower)
    half = (robot.upper - robot.lower)[narrowest] / 2
    make_limits(position_margin=half - 1e-9)
    with pytest.raises(ConfigError, match=r"position_margin.*" + JOINT_NAMES[narrowest]):
        make_limits(position_margin=half + 1e-9)


@pytest.mark.parametrize(
    ("row", "what", "bad"),
    [(0, "q", [np.nan]), (1, "dq", [np.inf]), (2, "tau", [-np.inf]), (0, "q", [np.inf, -np.inf])],
)
@pytest.mark.filterwarnings("ignore:invalid value")
def test_a_target_that_is_not_finite_is_refused(make_limits, row, what, bad):
    """Opposite infinities do not hide each other."""
    asked = np.ones((3, 29), np.float32)
    make_limits().require_finite(asked)
    asked[row, 11 : 11 + len(bad)] = bad
    with pytest.raises(SafetyError, match=f"{JOINT_NAMES[11]} has {what} = {bad[0]}"):
        make_limits().require_finite(asked)


KNEE, WRIST = JOINT_NAMES.index("left_knee_joint"), JOINT_NAMES.index("left_wrist_yaw_joint")


def played(limits, asked):
    """What is sent when one joint is asked for these positions, with the velocity of each step."""
    sent = []
    for k, q in enumerate(asked):
        q_dq = np.zeros((2, 29))
        q_dq[0, KNEE], q_dq[1, KNEE] = q, (q - asked[max(0, k - 1)]) / PERIOD
        limited, _ = limits.apply(q_dq, np.zeros(29), elapsed=PERIOD)
        limits.sent()
        sent.append(limited[:, KNEE])
    return np.array(sent)


def test_a_motion_at_its_highest_speed_is_left_alone(make_limits, robot):
    limits = make_limits()
    asked = robot.velocity[KNEE] * PERIOD * np.arange(1, 60)
    sent = played(limits, asked)
    assert sent[:, 0].tolist() == asked.tolist()
    assert not limits.speed.limited.any()


def test_a_joint_that_is_asked_for_too_much_comes_as_near_as_it_can(make_limits, robot):
    """A spike of one command: 0.3 rad, for which the knee needs 15 ms."""
    limits, speed = make_limits(), robot.velocity[KNEE]
    asked = np.zeros(40)
    asked[10] = 0.3
    sent = played(limits, asked)
    assert np.abs(np.diff(sent[:, 0])).max() == pytest.approx(speed * PERIOD, rel=2e-3)
    assert np.abs(sent[:, 1]).max() <= speed * 1.001
    assert sent[12:, 0] == pytest.approx(0.0, abs=1e-6)
    assert limits.speed.limited.tolist() == [2 if joint == KNEE else 0 for joint in range(29)]
    assert limits.speed.fault == ""


@pytest.mark.parametrize(("beyond", "ends"), [("refuse", True), ("clamp", False)])
def test_a_joint_that_would_be_more_than_20_ms_late_ends_the_session(
    make_limits, robot, beyond, ends
):
    limits = make_limits(beyond)
    sent = played(limits, np.full(200, 2.4))
    assert np.abs(np.diff(sent[:, 0])).max() <= robot.velocity[KNEE] * PERIOD * 1.002
    assert sent[-1, 0] == pytest.approx(2.4)
    assert (JOINT_NAMES[KNEE] in limits.speed.fault) is ends


def test_a_target_in_steps_moves_at_once_by_what_its_joint_does_in_20_ms(make_limits, robot):
    """Ten ticks of rest, a step of 50 ms, and one of 5 ms as soon as that is reached."""
    limits = make_limits(in_steps=True)
    reach = robot.velocity[KNEE] * PERIOD
    sent = played(limits, [0.0] * 10 + [25.0 * reach] * 30 + [27.5 * reach] * 10)[:, 0] / reach
    moved = np.diff(sent)
    assert moved[9] == pytest.approx(10.0, rel=0.002)
    assert moved[10:24] == pytest.approx(np.ones(14), rel=0.002)
    assert moved[39] == pytest.approx(2.5, rel=0.002)
    assert sent[-1] == pytest.approx(27.5)
    assert limits.speed.fault == ""


def test_a_motion_played_anyway_keeps_its_speed_but_not_its_positions(make_limits, robot):
    sent = played(make_limits("anyway"), [0.0, 2.4, 9.0])
    assert sent[:, 0].tolist() == [0.0, 2.4, robot.upper[KNEE]]


def measured_at(q, dq=0.0):
    state = LowState()
    state.q[:], state.dq[:] = q, dq
    return Reading.from_low_state(state, 0)


def test_only_joints_beyond_their_torque_are_moved_and_counted(make_limits, robot):
    random = np.random.default_rng(0)
    limits, gains = make_limits(), np.stack([np.full(29, 60.0), np.full(29, 2.0)])
    asked = np.stack([random.uniform(robot.lower, robot.upper), random.uniform(-8, 8, 29)])
    tau = random.uniform(-0.9, 0.9, 29) * robot.torque_limit
    q = (asked[0] + random.normal(0.0, 0.5, 29)).clip(robot.lower + 0.1, robot.upper - 0.1)
    measured = measured_at(q, random.uniform(-8, 8, 29))
    limits.begin(asked[0])
    limited, same = limits.apply(
        asked, tau, elapsed=MAX_STEP_TIME, gains=gains, measured=measured, age=0.003
    )
    state = np.stack([measured.q + 0.003 * measured.dq, measured.dq]).astype(np.float64)
    fine = np.abs((gains * (asked - state)).sum(axis=0) + tau) <= robot.torque_limit
    assert same is tau
    assert (limited == asked).all(axis=0).tolist() == fine.tolist()
    assert limits.torque.limited.tolist() == (~fine).astype(int).tolist()
    assert 0 < fine.sum() < 29


def test_a_joint_that_is_held_fast_is_pushed_no_harder_than_its_motor_can(make_limits, robot):
    """And released without a leap, when it follows again."""
    limits, gains = make_limits(), np.stack([np.full(29, 40.0), np.ones(29)])
    still, sent = np.zeros(29), []
    for k in range(400):
        asked = np.zeros((2, 29))
        asked[0, WRIST] = min(k * 0.01, 1.0)
        measured = measured_at(still if k < 300 else asked[0])
        limited, _ = limits.apply(
            asked, still, elapsed=PERIOD, gains=gains, measured=measured, age=PERIOD
        )
        limits.sent()
        sent.append(limited[0, WRIST])
    assert sent[299] == pytest.approx(robot.torque_limit[WRIST] / 40.0)
    assert sent[-1] == 1.0
    assert np.abs(np.diff(sent)).max() <= robot.velocity[WRIST] * PERIOD * 1.002
    assert limits.speed.fault == ""


@pytest.mark.parametrize(("states", "commands"), [(1, 0), (2, 2)])
def test_a_velocity_that_one_state_alone_has_is_not_commanded(make_limits, states, commands):
    limits, gains = make_limits(), np.stack([np.full(29, 40.0), np.ones(29)])
    asked, still, state, measured = np.zeros((2, 29)), np.zeros(29), LowState(), None
    for k in range(10):
        state.gyroscope[0] = 0.001 * k  # as noise, so that each has another content
        state.dq[WRIST] = 9.9 if 5 <= k < 5 + states else 0.0
        measured = Reading.from_low_state(state, 0, measured)
        limited, _ = limits.apply(
            asked, still, elapsed=PERIOD, gains=gains, measured=measured, age=PERIOD
        )
        limits.sent()
        if k == 5:
            assert limited is asked
    assert limits.torque.limited[WRIST] == commands


def test_an_old_measurement_says_nothing_of_the_torque(make_limits):
    gains, far = np.stack([np.full(29, 100.0), np.ones(29)]), measured_at(np.full(29, 9.0))
    asked = np.zeros((2, 29))
    limited, _ = make_limits().apply(
        asked, np.zeros(29), elapsed=PERIOD, gains=gains, measured=far, age=0.021 + PERIOD
    )
    assert limited is asked
