import re
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import trapezoid

import g1stream
from g1stream.analysis.metrics import NAMED_METRICS
from g1stream.app.session import Session
from g1stream.config import Config
from g1stream.robot.joints import JOINT_GROUPS, JOINT_NAMES
from g1stream.robot.rotations import quat_mul
from g1stream.session.source import MemorySource
from g1stream.testing import SyntheticSession

SAG = np.linspace(-0.2, 0.1, 29)


CONFIG = Config.model_validate({"stream": {"ramp": 0.5, "hold": 0.1, "damp": 0.5}})


@pytest.fixture(scope="module")
def rollout():
    return g1stream.rollout("demo", seconds=1.0, config=CONFIG)


@pytest.fixture(scope="module")
def followed():
    return g1stream.rollout("demo", seconds=1.0, support="follow", config=CONFIG)


def synthetic(seconds=1.0, reason="", support="free", **settings):
    source = MemorySource()
    metadata = {"stream": {"support": support, "reason": reason}}
    SyntheticSession(seconds, metadata=metadata, **settings).write(source)
    return Session(source)


def test_tracking_is_that_of_the_summary(rollout):
    metrics, summary = rollout.metrics().tracking, rollout.summary().tracking
    assert metrics.compared_states == summary.compared_states
    assert metrics.all_joints.rmse_rad == summary.all_joints.rmse_rad
    assert metrics.all_joints.delay_s == summary.all_joints.delay_s
    for found, told in ((metrics.limbs, summary.limbs), (metrics.joints, summary.joints)):
        assert {name: (one.rmse_rad, one.max_abs_rad) for name, one in found.items()} == {
            name: (one.rmse_rad, one.max_abs_rad) for name, one in told.items()
        }


def test_the_docs_list_the_short_names():
    text = (Path(__file__).parents[2] / "docs" / "metrics.md").read_text()
    rows = re.findall(r"^\| `(\w+)` \| `([\w.]+)` \| (.*)\|$", text, re.MULTILINE)
    assert {name: (unit.strip(), place) for name, place, unit in rows} == NAMED_METRICS


def test_joints_limbs_and_all(play, write_session):
    session = g1stream.open_session(write_session(*play(0.04, -SAG)))
    size, found = np.abs(session.tracking().error), session.metrics().tracking
    for i, name in enumerate(JOINT_NAMES):
        joint = found.joints[name]
        assert joint.bias_rad == pytest.approx(SAG[i], abs=1e-4)
        assert joint.mae_rad == pytest.approx(size[:, i].mean())
        assert joint.p99_rad == pytest.approx(np.percentile(size[:, i], 99))
        if i in {13, 27}:  # they stand still
            assert joint.delay_s is None
        else:
            assert joint.delay_s == pytest.approx(0.04, abs=1e-4)
            assert joint.correlation > 0.999
    for name, members in JOINT_GROUPS.items():
        limb, columns = found.limbs[name], list(members)
        assert limb.p99_rad == pytest.approx(np.percentile(size[:, columns], 99))
        assert limb.bias_rad == pytest.approx(np.sqrt(np.mean(SAG[columns] ** 2)), abs=1e-4)
        assert limb.max_abs_rad == pytest.approx(size[:, columns].max())
        assert limb.delay_s == pytest.approx(0.04, abs=1e-4)


def test_a_killed_recorder_of_a_robot_without_imu_and_velocities(play, write_session):
    reference, measured = play(0.04)
    measured.imu_quat_wxyz[:] = 0.0
    metrics = g1stream.open_session(write_session(reference, measured, close=False)).metrics()
    assert metrics.tracking.all_joints.delay_s == pytest.approx(0.04, abs=1e-4)
    assert metrics.tracking.all_joints.velocity_rmse_rad_s is None
    assert metrics.body.root_relative is metrics.body.world is metrics.body.pelvis is None
    assert metrics.body.pelvis_frame.mpjpe_mm > 1.0
    assert metrics.torque is None
    assert "torque" in metrics.missing
    assert metrics.timing.lateness_us is metrics.success.completed is None


def test_somebody_elses_recording(play, write_session):
    session = g1stream.open_session(write_session(None, play().measured))
    metrics = session.metrics()
    assert metrics.tracking is metrics.body is None
    assert {"tracking", "body"} <= metrics.missing.keys()
    assert metrics.timing.topics["/lowstate"].rate_hz == pytest.approx(500.0)
    assert metrics.success.success is None


def test_a_converted_motion(tmp_path):
    g1stream.convert("demo", tmp_path / "motion.mcap")
    session = g1stream.open_session(tmp_path / "motion.mcap")
    metrics = session.metrics()
    assert metrics.tracking is metrics.body is metrics.torque is metrics.timing.rate_hz is None
    assert metrics.missing.keys() == {"tracking", "body", "torque"}
    assert session.summary().motion.name == "demo"
    assert session.phases == []


def test_a_part_of_a_session(rollout):
    part = rollout.sel(time=slice(0.5, 1.0)).metrics()
    assert 0 < part.tracking.compared_states < rollout.metrics().tracking.compared_states
    assert rollout.sel("RAMP").metrics().tracking is None
    assert rollout.sel(time=slice(100.0, None)).metrics().torque is None


def test_a_rollout_succeeds_and_did_work(rollout):
    metrics = rollout.metrics()
    success, torque = metrics.success, metrics.torque
    assert (success.completed, success.progress, success.success) == (True, 1.0, True)
    assert success.links == "pelvis_frame"
    assert torque.in_play
    assert 0 < abs(torque.net_work_j) < torque.work_j
    power = rollout.sel("PLAY").measured
    work = trapezoid(np.abs(power.tau * power.dq), power.time, axis=0).sum()
    assert torque.work_j == pytest.approx(work, rel=1e-2)


def test_a_base_or_a_gyroscope_that_is_not_finite(rollout, monkeypatch):
    part = rollout.sel(time=slice(0.0, 1.0))
    nan = np.full_like(part.base.position, np.nan)
    monkeypatch.setitem(vars(part.base), "position", nan)
    assert part.metrics().body.world is None
    assert part.metrics().body.root_relative is not None
    monkeypatch.setitem(vars(part.measured), "gyroscope", np.full_like(nan, np.inf))
    assert part.metrics().body.root_relative is None


@pytest.mark.parametrize(
    ("stream", "column", "tracked"),
    [
        ("measured", "q", True),
        ("measured", "dq", False),
        ("measured", "tau", True),
        ("command", "kp", False),
    ],
)
def test_a_sample_that_is_not_finite_is_left_out(rollout, monkeypatch, stream, column, tracked):
    part = rollout.sel(time=slice(0.5, 1.0))
    if not tracked:
        part.topics = {name: n for name, n in part.topics.items() if name != "/reference"}
    expected = part.metrics().torque
    values = getattr(getattr(part, stream), column).copy()
    values[20, 3] = np.nan
    monkeypatch.setitem(vars(getattr(part, stream)), column, values)
    found = part.metrics().torque
    assert found.in_play is tracked
    assert found.commanded_rmse_nm == pytest.approx(expected.commanded_rmse_nm, rel=0.05)
    assert found.work_j == pytest.approx(expected.work_j, rel=0.05)


def test_a_robot_that_cannot_be_used_is_not_replaced(rollout, monkeypatch):
    part = rollout.sel(time=slice(0.5, 1.0))
    monkeypatch.setitem(vars(part), "attachments", {"robot.urdf": b"<robot/>"})
    metrics = part.metrics()
    assert metrics.torque is metrics.body is None
    assert metrics.missing.keys() == {"body", "torque"}
    assert metrics.tracking.all_joints.rmse_rad == part.tracking().overall


def test_timing_is_that_of_what_the_arms_were_sent():
    """Beside it, /lowcmd has the commands of the robot's own controller, at 500 Hz."""
    source = synthetic().source
    _, sent = next(source.batches({"/lowcmd"}))
    few = slice(None, None, 5)
    source.write_batch("/arm_sdk", sent.data[few], sent.log_times[few], sent.publish_times[few])
    timing = Session(source).metrics().timing
    assert timing.rate_hz == pytest.approx(100.0)
    assert timing.interval_us.p50 == pytest.approx(10_000.0)
    assert timing.state_age_us.p50 == pytest.approx(1000.0)


@pytest.mark.parametrize(("latency", "expected_us"), [(900e-6, 3000.0), (1500e-6, 5000.0)])
def test_the_state_of_a_command_is_the_newest_at_the_one_before(latency, expected_us):
    metrics = synthetic(latency=latency).metrics()
    assert metrics.timing.state_to_command_us.p50 == pytest.approx(expected_us)
    assert metrics.timing.state_to_command_us.max == pytest.approx(expected_us)
    assert metrics.named()["delay_p99"] == pytest.approx(expected_us / 1e6)
    assert metrics.timing.state_age_us.p50 == pytest.approx(1000.0)


def test_after_ticks_left_out_the_state_is_a_new_one():
    source = MemorySource()
    for topic, sent in synthetic().source.batches({"/lowcmd", "/lowstate", "/reference"}):
        parts = [slice(None)] if topic == "/lowstate" else [slice(40), slice(60, None)]
        for part in parts:
            columns = (one[part] for one in (sent.data, sent.log_times, sent.publish_times))
            source.write_batch(topic, *columns)
    found = Session(source).metrics().timing.state_to_command_us
    assert (found.p50, found.max) == (pytest.approx(3000.0), pytest.approx(3000.0))


@pytest.mark.parametrize("told", [{}, {"repaired": True}, {"recorder": {"stopped": "disk full"}}])
def test_states_that_a_broken_recorder_lost_do_not_make_commands_late(told):
    source = MemorySource()
    for topic, sent in synthetic().source.batches({"/lowcmd", "/lowstate", "/reference"}):
        part = slice(-100 if topic == "/lowstate" else None)
        source.write_batch(topic, sent.data[part], sent.log_times[part], sent.publish_times[part])
    source.add_metadata(told)
    age = Session(source).metrics().timing.state_age_us
    assert age.p50 == pytest.approx(1000.0)
    assert (age.max > 100_000.0) is (not told)


def test_another_programs_commands_are_as_old_as_the_newest_state():
    session = synthetic()
    session.topics = {name: n for name, n in session.topics.items() if name != "/reference"}
    timing = session.metrics().timing
    assert timing.state_to_command_us == timing.state_age_us
    assert timing.state_to_command_p99_s == pytest.approx(1e-3)


@pytest.mark.parametrize(("shift", "excess"), [(0.24, False), (0.26, True)])
def test_the_first_height_beyond_sonics_limit(followed, monkeypatch, shift, excess):
    part = followed.sel("PLAY")
    higher = np.where(part.base.time[:, np.newaxis] > 0.5, [0.0, 0.0, shift], 0.0)
    monkeypatch.setitem(vars(part.base), "position", part.base.position + higher)
    metrics = part.metrics()
    assert metrics.success.success_sonic is not excess
    first = metrics.body.terminations.sonic
    assert (first is not None) is excess
    if first:
        assert first.at_s == pytest.approx(0.51, abs=0.02)
        assert first.height_mm == pytest.approx(1e3 * shift, abs=15.0)
        assert first.rotation_rad is None
        assert first.link.endswith(("pelvis", "ankle_roll_link", "wrist_yaw_link"))


@pytest.mark.parametrize("axis", [1, 3])
def test_the_first_rotation_beyond_sonics_limit(followed, monkeypatch, axis):
    part = followed.sel("PLAY")
    turn = np.zeros((len(part.measured), 4))
    angle = np.where(part.measured.time > 0.5, 1.1, 0.0)
    turn[:, 0], turn[:, axis] = np.cos(angle / 2), np.sin(angle / 2)
    quat = quat_mul(part.measured.imu_quat_wxyz, turn)
    monkeypatch.setitem(vars(part.measured), "imu_quat_wxyz", quat)
    first = part.metrics().body.terminations.sonic
    assert part.metrics().success.success_sonic is False
    assert first.at_s == pytest.approx(0.51, abs=0.02)
    if axis == 3:  # about the vertical no height changes
        assert (first.link, first.height_mm) == ("pelvis", None)
        assert first.rotation_rad == pytest.approx(1.1, abs=0.05)


@pytest.mark.parametrize(
    ("support", "length", "spoilt", "reason"),
    [
        ("free", 0.06, True, "the pelvis tilts"),
        ("free", 0.03, False, "the pelvis tilts"),
        ("bolted", 0.06, False, "the pelvis tilts"),
        ("free", 0.06, True, ""),  # succeeds in spite of it
    ],
)
def test_a_simulator_that_stalls_spoils_a_run_on_free_feet(support, length, spoilt, reason):
    session = synthetic(3.0, reason, support, gaps=((1.0, length),))
    success, problems = session.metrics().success, session.summary().problems
    assert success.completed is (not reason)
    assert success.success is (not reason or (None if spoilt else False))
    assert success.spoilt_by_ms == (pytest.approx(1e3 * length + 2.0, abs=0.1) if spoilt else None)
    assert sum("time stopped" in one for one in problems) == spoilt


@pytest.mark.parametrize(
    ("gaps", "spoilt"),
    [
        (((-0.4, 0.06), (3.1, 0.06)), None),  # outside of PLAY
        (((2.9, 10.0),), pytest.approx(98.0, abs=3.0)),  # the states end in it
    ],
)
def test_a_stall_counts_as_far_as_it_is_in_play(gaps, spoilt):
    assert synthetic(3.0, gaps=gaps).summary().spoilt_by_ms == spoilt


@pytest.mark.parametrize(("leap", "spoilt"), [(94, 94.0), (30, None), (2**31, None)])
def test_ticks_that_leap_spoil_a_run(monkeypatch, leap, spoilt):
    session = synthetic(3.0)
    ticks = session.measured.tick.astype(np.uint64)
    ticks[900:] += leap - 1
    monkeypatch.setitem(vars(session.measured), "tick", ticks.astype(np.uint32))
    assert session.summary().spoilt_by_ms == spoilt
