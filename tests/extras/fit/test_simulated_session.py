import json
from dataclasses import replace

import numpy as np
import pytest

import g1stream
from g1stream.analysis.signals import signal
from g1stream.app.rollout import rollout
from g1stream.app.session import open_session
from g1stream.cli.main import main
from g1stream.config import load_config
from g1stream.errors import ConfigError, RecordingError
from g1stream.extras.fit.excite import exciting_motion
from g1stream.extras.fit.recorded import Recorded, noise_of
from g1stream.extras.fit.simulated_session import Cause, Gap, JointGap, gap, robot_of
from g1stream.extras.fit.simulation import simulate_commands
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.model import G1
from g1stream.session.source import MemorySource

STATES = "/lowstate"
KNEE = "left_knee_joint"
OTHER = f"""
command_delay = 0.008
[friction]
{KNEE} = 1.2
[damping]
left_elbow_joint = 0.4
"""


@pytest.fixture(scope="module")
def params(tmp_path_factory):
    path = tmp_path_factory.mktemp("fit") / "other.toml"
    path.write_text(OTHER)
    return path


def played(support="bolted", *, params=None, noise=0.0, seconds=2.0):
    over = {"record.channels": "raw", "sim.noise": noise, "params": params}
    stream = {"feedforward": "velocity", "ramp": 0.5, "hold": 0.0, "damp": 0.5}
    config = load_config(over=over | {f"stream.{name}": value for name, value in stream.items()})
    return rollout("demo", config=config, seconds=seconds, support=support)


def copied(session, *topics, leave_out=slice(0, 0)):
    """A session with nothing but some topics, and without some of the LowStates."""
    source = MemorySource("copied")
    for topic in topics:
        messages = list(session.messages(topic))
        if topic == "/lowstate":
            del messages[leave_out]
        for one in messages:
            source.write(topic, one.data, one.log_time, one.publish_time)
    return g1stream.Session(source)


@pytest.fixture(scope="module")
def same():
    return played()


@pytest.fixture(scope="module")
def other(params):
    return played(params=params, seconds=3.0)


def test_the_same_robot_is_the_same_to_single_precision(same):
    recorded = Recorded.of(same)
    simulated = simulate_commands(recorded, G1.default(), support="bolted", window=0.7)
    assert simulated.q == pytest.approx(recorded.q, abs=1e-6)
    assert simulated.dq == pytest.approx(recorded.dq, abs=1e-5)
    assert simulated.tau[1:] == pytest.approx(recorded.tau[1:], abs=1e-4)
    assert {part.stop - part.start for part in simulated.windows[:-1]} == {351}


@pytest.mark.parametrize(("support", "most"), [("hanging", 5e-4), ("follow", 3e-3), ("free", 3e-3)])
def test_however_it_is_held(support, most):
    assert gap(played(support, seconds=0.8)).q_rad < most


def test_noise_is_no_difference():
    found = gap(played(noise=1.0, seconds=1.0))
    assert not any(one.differs for one in found.joints.values())
    noise = [one.q_noise_rad for name, one in found.joints.items() if "waist" not in name]
    assert np.median(noise) == pytest.approx(5e-4, rel=0.2)


@pytest.mark.parametrize("early", [-2e-4, 2.2e-3])
def test_a_command_close_to_a_tick_belongs_to_either(same, early):
    """Taken after the LowState was published, or published in time and not yet there."""
    rephased, states = MemorySource("rephased"), [one.publish_time for one in same.messages(STATES)]
    for topic in ("/lowcmd", STATES):
        for one in same.messages(topic):
            stamp = one.publish_time
            if topic == "/lowcmd":
                used = np.searchsorted(states, stamp)
                stamp = states[min(used, len(states) - 1)] - round(early * 1e9)
            rephased.write(topic, one.data, stamp, stamp)
    session = g1stream.Session(rephased)
    recorded = Recorded.of(session)
    plain = simulate_commands(recorded, G1.default(), support="bolted", repeats=False)
    assert np.abs(plain.q - recorded.q).max() > 1e-4
    found = gap(session, support="bolted")
    assert max(one.q_rad for one in found.joints.values()) < 1e-6
    assert not any(one.differs for one in found.joints.values())
    assert found.delay_low_s is found.delay_high_s is None  # of less than five seconds


def test_another_simulator(foreign):
    motion = exciting_motion(seconds=6.0, seed=1)
    friction = np.where(np.array(JOINT_NAMES) == KNEE, 1.0, foreign().friction)
    same, other, late = (
        gap(robot.play(motion, seed=1), support="bolted")
        for robot in (
            foreign(delay=1e-3),
            foreign(delay=1e-3, friction=friction),
            foreign(delay=5e-3),
        )
    )
    assert sum(one.differs for one in same.joints.values()) < 3  # it has no ticks
    assert same.delay_low_s < 0.0 < same.delay_high_s
    assert next(iter(other.joints)) == KNEE
    assert other.joints[KNEE].causes[0].name == "dry friction"
    assert other.joints[KNEE].causes[0].amount == pytest.approx(0.8, abs=0.3)
    assert late.delay_low_s > 0.0
    assert sum(one.differs for one in late.joints.values()) > 10


@pytest.mark.parametrize(("support", "said"), [("bolted", "hanging"), ("hanging", "bolted")])
def test_a_support_that_the_gyroscope_contradicts(foreign, support, said):
    session = foreign().play(exciting_motion(seconds=6.0, seed=1), support)
    assert gap(session, support=said).doubt
    assert not gap(session, support=support).doubt


def test_noise_is_measured_beside_a_movement():
    rng = np.random.default_rng(0)
    time = np.arange(2000) / 500.0
    moving = np.sin(2 * np.pi * 2.0 * time)[:, np.newaxis] * [0.5, 0.0]
    assert noise_of(moving + 1e-3 * rng.standard_normal((2000, 2))) == pytest.approx(
        [1e-3, 1e-3], rel=0.1
    )
    assert noise_of(moving).max() < 1e-5


@pytest.fixture(scope="module")
def written(other, tmp_path_factory):
    """The gap of the other robot, and the session in which it is written."""
    out = tmp_path_factory.mktemp("gap") / "gap.mcap"
    return gap(other, out=out), open_session(out)


def test_joints_that_differ_and_why(written):
    found, _ = written
    assert KNEE in list(found.joints)[:6]
    assert found.joints[KNEE].differs
    first = found.joints[KNEE].causes[0]
    assert first.name == "dry friction"
    assert first.amount == pytest.approx(1.0, abs=0.35)
    (viscous,) = (one for one in found.joints["left_elbow_joint"].causes if "viscous" in one.name)
    assert viscous.amount == pytest.approx(0.35, abs=0.15)
    assert 0.0 < found.delay_low_s < 0.008 < found.delay_high_s
    assert found.delay_s == pytest.approx(0.008, abs=1e-3)  # a physics step


def test_with_its_parameters_it_does_not_differ(other, params):
    found = gap(other, robot=robot_of(other, params=params))
    assert found.q_rad < 1e-5
    assert found.params.sha256
    assert found.delay_low_s < 0.0 < found.delay_high_s


def test_the_session_that_is_written(other, written):
    found, written = written
    assert written.topics.keys() == other.topics.keys() | {"/simulated/joint_states"}
    assert other.topics.items() <= written.topics.items()
    assert written.metadata["gap"]["q_rad"] == found.q_rad
    lines = {line.name: line for line in signal(written, "tau").lines}
    assert list(lines) == ["commanded", "simulated", "estimated"]
    (simulated,) = (line for line in signal(written, "q").lines if line.name == "simulated")
    knee = JOINT_NAMES.index(KNEE)
    shown = np.radians(simulated.values[:, knee])
    measured = np.interp(simulated.time, written.measured.time, written.measured.q[:, knee])
    rms = np.sqrt(np.nanmean((measured - shown)[1:] ** 2))
    assert rms == pytest.approx(found.joints[KNEE].q_rad, rel=0.05)


def test_from_the_command_line(other, tmp_path, capsys):
    session, out = tmp_path / "session.mcap", tmp_path / "gap.mcap"
    other.save(session)
    assert main(["simulate", str(session), "-o", str(out), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["joints"][KNEE]["differs"] is True
    assert main(["simulate", str(session), "-o", str(out)]) == 2  # it is there
    assert main(["simulate", str(session), "-o", str(session), "--force"]) == 2
    assert main(["simulate", str(session), "--support", "glued"]) == 2


@pytest.mark.parametrize("n_explained", [0, 1, 29])
def test_a_joint_has_a_line_of_its_own_only_if_its_difference_has_a_cause(n_explained):
    values = dict.fromkeys(("q_rad", "dq_rad_s", "tau_nm"), 1.0)
    values |= dict.fromkeys(("q_noise_rad", "dq_noise_rad_s", "tau_noise_nm"), 0.0)
    joint = JointGap(**values, differs=True)
    known = joint.model_copy(update={"causes": [Cause(name="inertia", amount=1.0, unit="kg")]})
    joints = {name: known if i < n_explained else joint for i, name in enumerate(JOINT_NAMES)}
    about = {"session": "a.mcap", "robot": "g1", "support": "bolted"}
    text = str(Gap(**about, window_s=1.0, simulated_s=9.0, q_rad=1.0, joints=joints))
    for i, name in enumerate(JOINT_NAMES):
        told = [line for line in text.splitlines() if line.split()[:1] == [name[:-6]]]
        assert len(told) == 1 + (i < n_explained)  # in the table, and why
    assert text.count("simple cause") == (n_explained < 29)


def test_who_was_held_in_no_known_way_is_asked_for(same):
    stranger = copied(same, "/lowcmd", "/lowstate")
    with pytest.raises(ConfigError):
        gap(stranger)
    with pytest.raises(ConfigError):  # where was the pelvis?
        gap(stranger, support="free")
    assert gap(stranger, support="bolted").q_rad < 1e-5


def test_a_session_without_commands_is_refused(same):
    with pytest.raises(RecordingError):
        gap(copied(same, "/lowstate"), support="bolted")


def test_windows_do_not_reach_over_a_gap(same):
    states = list(same.messages("/lowstate"))
    gapped = copied(same, "/lowcmd", "/lowstate", leave_out=slice(600, 700))
    recorded = Recorded.of(gapped)
    starts = [recorded.published[part.start] for part in recorded.windows(1.0)]
    ends = [recorded.published[part.stop - 1] for part in recorded.windows(1.0)]
    assert states[700].publish_time in starts
    assert states[599].publish_time in ends
    assert gap(gapped, support="bolted").q_rad < 1e-5


@pytest.fixture
def short_parts(monkeypatch):
    monkeypatch.setattr("g1stream.extras.fit.recorded._PART", 0.2)


def test_an_excerpt_has_whole_parts_from_the_beginning_to_the_end(same, short_parts):
    recorded = Recorded.of(same)
    assert recorded.excerpt(recorded.seconds) is recorded
    some = recorded.excerpt(recorded.seconds / 2.0)
    windows = some.windows(0.1)
    assert 0.4 * recorded.seconds < some.seconds <= 0.51 * recorded.seconds
    assert {part.stop - part.start for part in windows[:-2]} == {51}
    assert some.time[0] == recorded.time[0]
    assert some.time[-1] > recorded.time[-1] - 0.4


@pytest.mark.parametrize("delay", [0.0, 0.003, 0.012])
def test_in_an_excerpt_the_same_commands_are_in_force(same, short_parts, delay):
    recorded = Recorded.of(same)
    some = recorded.excerpt(recorded.seconds / 4.0)
    assert some.begins.sum() > 2
    rows = np.searchsorted(recorded.time, some.time)
    after = rows >= 10  # before that the recording itself does not have them
    whole, part = recorded.in_force(delay)[rows], some.in_force(delay)
    assert part[after].tolist() == whole[after].tolist()
    torque, _ = some.servo(delay)
    expected, _ = recorded.servo(delay)
    # The clock of the commands is interpolated between states.
    assert torque[after] == pytest.approx(expected[rows][after], abs=1e-6)


def test_a_base_is_smoothed_within_its_parts(same, short_parts):
    recorded = Recorded.of(same)
    turning = np.sin(5.0 * recorded.time)[:, np.newaxis] * np.ones(3)
    turning = replace(recorded, gyroscope=turning)
    some = turning.excerpt(recorded.seconds / 4.0)
    np.testing.assert_allclose(some.smooth_base()[1], some.gyroscope, atol=0.02)
