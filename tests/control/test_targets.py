import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from g1stream.control.schedule import PhaseState, Schedule
from g1stream.control.targets import Setpoint, Targets, Timing
from g1stream.robot.joints import JOINT_NAMES
from g1stream.types import Phase

STEP = 1e-5
ALL = np.ones(29, bool)


class Asked:
    """Targets of phases that last so many s, asked for one after the other."""

    def __init__(self, trajectory, *, start, play, ramp, ramp_speed=np.inf, moved=ALL):
        targets = Targets(trajectory, start=start, moved=moved)
        ramp, play = round(1e9 * ramp), None if play is None else round(1e9 * play)
        timing = Timing(wait=0, ramp=ramp, play=play, hold=0, damp=0)
        self._schedule = Schedule(targets, timing, 2_000_000, ramp_speed)
        self.last = self.first.at_rest()

    @property
    def first(self):
        return self._schedule.targets.first

    def begin(self, q):
        self._schedule.begin_ramp(q)
        return self._schedule.ramp

    def at(self, phase, elapsed):
        self._schedule.state = PhaseState(phase, 0)
        self.last = self._schedule.target(round(1e9 * elapsed), self.last)
        return self.last


@pytest.fixture
def targets(trajectory):
    targets = Asked(trajectory, start=0.1, play=0.3, ramp=2.0)
    targets.begin(np.linspace(-0.4, 0.4, 29))
    return targets


def is_at_rest(target):
    moving = (target.dq, target.ddq, target.tau, target.root_lin_vel, target.root_ang_vel)
    return not any(part.any() for part in (*moving, target.root_lin_acc, target.root_ang_acc))


def same_pose(one, other):
    return (
        one.q.tolist() == other.q.tolist()
        and one.root_pos.tolist() == other.root_pos.tolist()
        and one.root_quat_wxyz.tolist() == other.root_quat_wxyz.tolist()
    )


def test_ramp_leads_from_the_measured_pose_to_the_first_frame(targets, trajectory):
    pose, point = np.linspace(-0.4, 0.4, 29), trajectory.sample(0.1)
    targets.begin(pose)
    first = targets.at(Phase.RAMP, 0.0)
    assert first.q.tolist() == pose.tolist()
    assert is_at_rest(first)
    assert first.motion_time == 0.1
    assert first.root_pos.tolist() == point.root_pos.tolist()
    assert first.root_quat_wxyz.tolist() == point.root_quat_wxyz.tolist()
    pose[:] = 9.0  # what it began from is a copy
    last = targets.at(Phase.RAMP, 2.0)
    assert last.q == pytest.approx(point.joint_pos, abs=1e-15)
    assert last.dq == pytest.approx(point.joint_vel, abs=1e-15)
    assert same_pose(targets.at(Phase.RAMP, 2.5), last)
    assert targets.at(Phase.RAMP, 0.0).q.tolist() == first.q.tolist()


def test_no_velocity_leaps_from_ramp_to_play_to_hold_to_rest(targets):
    step, whole = 1e-3, [(Phase.RAMP, 2.0), (Phase.PLAY, 0.3), (Phase.HOLD, 0.5)]
    path = [
        targets.at(phase, elapsed)
        for phase, length in whole
        for elapsed in np.arange(0.0, length, step)
    ]
    for name, rate, fastest in (("q", "dq", 60.0), ("root_pos", "root_lin_vel", 60.0)):
        positions = np.array([getattr(target, name) for target in path])
        velocities = np.array([getattr(target, rate) for target in path])
        assert np.abs(np.diff(velocities, axis=0)).max() < fastest * step
        moved = np.diff(positions, axis=0)
        assert moved == pytest.approx((velocities[:-1] + velocities[1:]) / 2 * step, abs=1e-5)
    assert is_at_rest(path[-1])


def test_the_root_turns_with_its_velocity_while_it_runs_up_and_coasts(targets):
    for phase, elapsed in ((Phase.RAMP, 1.9), (Phase.HOLD, 0.05)):
        before, here, after = (targets.at(phase, elapsed + d) for d in (-STEP, 0.0, STEP))
        turn = Rotation.from_quat(np.roll(before.root_quat_wxyz, -1)).inv() * Rotation.from_quat(
            np.roll(after.root_quat_wxyz, -1)
        )
        assert turn.as_rotvec() / (2 * STEP) == pytest.approx(here.root_ang_vel, abs=1e-6)
        spun = (after.root_ang_vel - before.root_ang_vel) / (2 * STEP)
        assert spun == pytest.approx(here.root_ang_acc, abs=1e-4)
        moved = (after.root_lin_vel - before.root_lin_vel) / (2 * STEP)
        assert moved == pytest.approx(here.root_lin_acc, abs=1e-4)


def test_ramp_velocity_and_acceleration_are_finite_differences(targets):
    for elapsed in (0.2, 0.9, 1.7):
        before, here, after = (targets.at(Phase.RAMP, elapsed + d) for d in (-STEP, 0.0, STEP))
        assert here.dq == pytest.approx((after.q - before.q) / (2 * STEP), abs=1e-8)
        assert here.ddq == pytest.approx((after.dq - before.dq) / (2 * STEP), abs=1e-8)
        assert not here.tau.any()
        assert not here.root_lin_vel.any()
        assert not here.root_ang_vel.any()


@pytest.mark.parametrize("elapsed", [0.0, 0.1234567, 0.3])
def test_play_is_the_trajectory(targets, trajectory, elapsed):
    target, point = targets.at(Phase.PLAY, elapsed), trajectory.sample(0.1 + elapsed)
    assert target.motion_time == 0.1 + elapsed
    of_joints = {"q": "joint_pos", "dq": "joint_vel", "ddq": "joint_acc"}
    for part in (*of_joints, *Setpoint._fields[5:]):
        due = getattr(point, of_joints.get(part, part))
        assert getattr(target, part).tolist() == due.tolist()
    assert not target.tau.any()
    with pytest.raises(ValueError, match="read-only"):
        target.q[:] = 0.0


def test_hold_rests_at_the_end(targets, trajectory):
    ended = targets.at(Phase.PLAY, 0.3)
    assert same_pose(targets.at(Phase.PLAY, 0.35), ended)
    assert same_pose(targets.at(Phase.HOLD, 0.0), ended)
    for elapsed in (0.2, 100.0):
        target = targets.at(Phase.HOLD, elapsed)
        assert target.motion_time == 0.1 + 0.3
        assert target.q.tolist() == trajectory.sample(0.1 + 0.3).joint_pos.tolist()
        assert is_at_rest(target)


def test_damp_keeps_the_last_pose_at_rest(targets):
    last = targets.last = targets.at(Phase.PLAY, 0.15)._replace(tau=np.ones(29))
    target = targets.at(Phase.DAMP, 1.0)
    assert same_pose(target, last)
    assert target.motion_time == last.motion_time
    assert is_at_rest(target)


@pytest.mark.parametrize(("distance", "length", "peak"), [(0.1, 2.0, 0.09375), (-3.2, 4.0, 1.5)])
def test_a_long_way_takes_a_longer_ramp(trajectory, distance, length, peak):
    targets = Asked(trajectory, start=0.1, play=0.3, ramp=2.0, ramp_speed=1.5)
    start = targets.first.q.copy()
    start[7] -= distance
    ramp = targets.begin(start)
    assert ramp.length == pytest.approx(1e9 * length)
    assert ramp.peak_speed == pytest.approx(peak)
    assert (ramp.joint, ramp.distance) == (JOINT_NAMES[7], pytest.approx(distance))
    times = np.linspace(0.0, length, 401)
    q = np.array([targets.at(Phase.RAMP, t).q[7] for t in times])
    speed = np.abs(np.diff(q)).max() / times[1]
    assert speed <= peak + np.abs(targets.first.dq[7])
    assert q[0] == pytest.approx(start[7])
    assert q[-1] == pytest.approx(targets.first.q[7])
    assert targets.begin(targets.first.q).length == 2_000_000_000  # it begins nearer


def test_joints_that_are_not_played_keep_the_pose_from_which_the_ramp_starts(trajectory):
    played = np.arange(29) >= 12
    targets = Asked(trajectory, start=0.1, play=0.3, ramp=2.0, moved=played)
    whole = Asked(trajectory, start=0.1, play=0.3, ramp=2.0)
    start = np.linspace(-0.4, 0.4, 29)
    ramp, _ = targets.begin(start), whole.begin(start)
    assert ramp.joint in JOINT_NAMES[12:]
    for phase, elapsed in ((Phase.RAMP, 1.5), (Phase.PLAY, 0.2), (Phase.HOLD, 0.1)):
        target, other = targets.at(phase, elapsed), whole.at(phase, elapsed)
        assert target.q[:12].tolist() == start[:12].tolist()
        assert not target.dq[:12].any()
        assert not target.ddq[:12].any()
        for part in ("q", "dq", "ddq"):
            assert getattr(target, part)[12:] == pytest.approx(getattr(other, part)[12:])
        assert target.root_pos.tolist() == other.root_pos.tolist()


@pytest.mark.parametrize("moved", [ALL, np.arange(29) < 12])
@pytest.mark.parametrize("offset", [0, 700_001])  # ns of the first tick of PLAY
def test_a_block_of_ticks_is_what_each_alone_is(trajectory, monkeypatch, moved, offset):
    """Each tick needs the target of its own time and of the next tick."""
    period, play = 2_000_000, 300_000_000
    timing = Timing(wait=0, ramp=0, play=play, hold=50_000_000, damp=0)
    sampled = []
    sample = type(trajectory).sample
    monkeypatch.setattr(
        type(trajectory), "sample", lambda self, t: (sampled.append(t), sample(self, t))[1]
    )
    found = []
    for block in (1, 16):
        one = Targets(trajectory, start=0.1, moved=moved, block=range(0, block * period, period))
        one.begin(np.linspace(-0.4, 0.4, 29))
        sampled.clear()
        last, row = one.first, []
        for tick in range(180):
            elapsed = offset + tick * period
            if 90 <= tick < 95:  # a late loop
                elapsed += 300_000
            for then in (elapsed, elapsed + period):
                phase = Phase.PLAY if then < play else Phase.HOLD
                last = one.at(phase, then if phase is Phase.PLAY else then - play, timing, last)
                row.append(last)
        found.append(row)
        assert len(sampled) > 100 if block == 1 else len(sampled) < 20
    for alone, together in zip(*found, strict=True):
        for expected, got in zip(alone, together, strict=True):
            assert np.array_equal(expected, got)
