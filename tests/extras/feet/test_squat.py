import numpy as np
import pytest

from g1stream.control.schedule import Inputs, PhaseState, Schedule
from g1stream.control.stop import Stop
from g1stream.control.targets import Setpoint, Targets, Timing
from g1stream.extras.feet.squat import Squat
from g1stream.extras.feet.standing import BodyState, StandingDynamics
from g1stream.robot.model import G1
from g1stream.types import Phase

ROBOT = G1.default()
DYNAMICS = StandingDynamics(ROBOT)
PERIOD = 0.002
MS = 1_000_000


def state_of(target):
    return BodyState(target.root_quat_wxyz, np.zeros(3), target.q, target.dq)


@pytest.fixture(scope="module")
def standing(squats):
    return Setpoint.from_point(1.0, squats.sample(1.0)).at_rest()


@pytest.fixture(scope="module")
def way(standing):
    squat = Squat(ROBOT)
    target_at, targets = squat.plan(standing), [standing]
    for k in range(round(squat.length / PERIOD) + 1):
        targets.append(target_at(k * PERIOD, targets[-1].q))
    return targets[1:]


def test_it_begins_where_the_robot_stands_and_the_soles_stay_there(way, standing):
    assert way[0].q == pytest.approx(standing.q, abs=1e-6)
    pos, headings = DYNAMICS.soles(state_of(standing))
    for target in way[::100]:
        then, turned = DYNAMICS.soles(state_of(target))
        assert then + target.root_pos == pytest.approx(pos + standing.root_pos, abs=1e-5)
        assert turned == pytest.approx(headings, abs=1e-5)


def test_it_ends_low_and_at_rest_with_the_mass_above_the_middle_of_the_feet(way, standing):
    last = way[-1]
    assert last.root_pos[2] < standing.root_pos[2] - 0.1
    assert not last.dq.any()
    assert (last.q < ROBOT.upper).all()
    assert (last.q > ROBOT.lower).all()
    assert last.q[12:].tolist() == standing.q[12:].tolist()
    still = np.zeros(3)
    centre = DYNAMICS.movement(
        state_of(last), last.root_pos, still, (still, still, np.zeros(29))
    ).pos
    middle = DYNAMICS.soles(state_of(last))[0].mean(axis=0) + last.root_pos
    assert centre[:2] == pytest.approx(middle[:2], abs=1e-3)


def test_speeds_and_accelerations_are_the_derivatives_of_the_angles(way):
    q, dq, ddq = (np.array([getattr(one, name) for one in way]) for name in ("q", "dq", "ddq"))
    inner = slice(2, -2)
    assert np.gradient(q, PERIOD, axis=0)[inner] == pytest.approx(dq[inner], abs=1e-4)
    assert np.gradient(dq, PERIOD, axis=0)[inner] == pytest.approx(ddq[inner], abs=1e-3)
    assert np.abs(dq).max() > 0.1


def test_there_is_no_way_down_while_a_foot_is_lifted(demo):
    squat = Squat(ROBOT)
    possible = [squat.possible(Setpoint.from_point(t, demo.sample(t))) for t in (8.4, 8.7, 9.2)]
    assert possible == [True, False, True]


def test_a_run_that_ends_while_ramp_waits_for_the_feet_squats_down(squats):
    timing = Timing(
        wait=0, ramp=500 * MS, play=1000 * MS, hold=500 * MS, damp=100 * MS, way_down=2000 * MS
    )
    targets = Targets(squats, start=0.0, moved=ROBOT.present, way_down=Squat(ROBOT))
    schedule = Schedule(targets, timing, 2 * MS)
    schedule.state = PhaseState(Phase.RAMP, 0)
    schedule.begin_ramp(targets.first.q)

    def go(now, last):
        schedule.wait_in_ramp(now, "the feet")
        schedule.advance(now, Inputs())
        return schedule.target(now, last)

    for now in range(0, 600 * MS, 2 * MS):
        go(now, targets.first)
    assert schedule.state.phase is Phase.RAMP
    asked = Stop("requested", "asked")
    before, phases = schedule.targets.first, []
    for now in range(600 * MS, 4000 * MS, 2 * MS):
        assert schedule.go_down(now, asked, before, stands=now < 700 * MS)
        target = go(now, before)
        phases.append(schedule.state.phase)
        assert target.q == pytest.approx(before.q, abs=0.01)
        before = target
    assert list(dict.fromkeys(phases)) == [Phase.RAMP, Phase.HOLD, Phase.DAMP, Phase.DONE]
    assert phases.count(Phase.RAMP) <= 101  # it waits no longer than it takes to end at rest
    assert schedule.state.stop is asked
    assert before.root_pos[2] < schedule.targets.first.root_pos[2] - 0.1
