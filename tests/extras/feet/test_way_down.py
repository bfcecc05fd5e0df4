"""A robot on its feet goes down from RAMP where the run ends there."""

from __future__ import annotations

import pytest

from g1stream.control.schedule import Inputs, PhaseState, Schedule
from g1stream.control.targets import Targets, Timing
from g1stream.extras.feet.squat import Squat
from g1stream.extras.physics.example_motions import squatting
from g1stream.extras.physics.stance import stand
from g1stream.motion.trajectory import Trajectory
from g1stream.robot.model import G1
from g1stream.types import Phase

ROBOT = G1.default()
MS = 1_000_000
SQUATTING = Timing(
    wait=0, ramp=500 * MS, play=1000 * MS, hold=500 * MS, damp=100 * MS, way_down=2000 * MS
)


@pytest.fixture
def schedule():
    """RAMP waits, for 0.6 s so far."""
    trajectory = Trajectory(stand(squatting(2.0), ROBOT).motion)
    targets = Targets(trajectory, start=0.0, way_down=Squat(ROBOT))
    schedule = Schedule(targets, SQUATTING, 2 * MS)
    schedule.state = PhaseState(Phase.RAMP, 0)
    schedule.begin_ramp(targets.first.q)
    for now in range(0, 600 * MS, 2 * MS):
        go(schedule, now, targets.first)
    assert schedule.state.phase is Phase.RAMP
    return schedule


def go(schedule, now, last):
    schedule.wait_in_ramp(now, "the feet")
    schedule.advance(now, Inputs())
    return schedule.target(now, last)


def test_a_robot_on_its_feet_squats_down_from_ramp(schedule):
    before, phases = schedule.first, []
    for now in range(600 * MS, 4000 * MS, 2 * MS):
        assert schedule.go_down(now, "asked", before, stands=now < 700 * MS)
        target = go(schedule, now, before)
        phases.append(schedule.state.phase)
        assert target.q == pytest.approx(before.q, abs=0.01)
        before = target
    assert list(dict.fromkeys(phases)) == [Phase.RAMP, Phase.HOLD, Phase.DAMP, Phase.DONE]
    assert phases.count(Phase.RAMP) <= 101  # it waits no longer than it takes to end at rest
    assert schedule.state.reason == "asked"
    assert before.root_pos[2] < schedule.first.root_pos[2] - 0.1
