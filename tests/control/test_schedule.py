import pytest
from hypothesis import given
from hypothesis import strategies as st

from g1stream.control.schedule import Inputs, PhaseState, step
from g1stream.control.targets import Timing
from g1stream.types import Phase

WAIT, RAMP, PLAY, HOLD, DAMP, DONE = Phase
TIMING = Timing(wait=1000, ramp=300, play=5000, hold=200, damp=500)
START = 7_000_000_123
READY, STOP = Inputs(), Inputs(stop="enough")
WAITING = Inputs(missing="no LowState")


def test_waits_for_what_is_missing():
    state = PhaseState(WAIT, START)
    assert step(START + 999, state, WAITING, TIMING) == state
    assert step(START + 999, state, READY, TIMING) == PhaseState(RAMP, START + 999)


def test_waits_for_other_publishers_to_be_discovered():
    state, timing = PhaseState(WAIT, START), TIMING._replace(settle=100)
    assert step(START + 99, state, READY, timing) == state
    assert step(START + 100, state, READY, timing) == PhaseState(RAMP, START + 100)


def test_gives_up_waiting_at_the_exact_instant():
    state = PhaseState(WAIT, START)
    given_up = step(START + 1000, state, WAITING, TIMING)
    assert (given_up.phase, given_up.since) == (DONE, START + 1000)
    assert given_up.stop.text == "no LowState (waited for stream.wait = 1e-06 s)"
    assert step(START + 1000, state, READY, TIMING).phase is RAMP


@pytest.mark.parametrize(
    ("phase", "lasts", "following"), [(RAMP, 300, PLAY), (PLAY, 5000, HOLD), (HOLD, 200, DAMP)]
)
def test_a_phase_ends_at_its_exact_instant(phase, lasts, following):
    state, end = PhaseState(phase, START), START + lasts
    assert step(end - 1, state, READY, TIMING) == state
    assert step(end, state, READY, TIMING) == PhaseState(following, end)
    late = end + 17  # a tick that shifts nothing, but the whole time of DAMP
    since = late if following is DAMP else end
    assert step(late, state, READY, TIMING) == PhaseState(following, since)


def test_several_phases_pass_in_one_step():
    state = step(START + 300 + 5000 + 50, PhaseState(RAMP, START), READY, TIMING)
    assert state == PhaseState(HOLD, START + 300 + 5000)
    no_hold = TIMING._replace(hold=0)
    state = step(START + 300 + 5000, PhaseState(RAMP, START), Inputs(), no_hold)
    assert state == PhaseState(DAMP, START + 300 + 5000)


def test_damping_lasts_its_whole_time_however_late_it_begins():
    now = START + 1_000_000
    state = step(now, PhaseState(RAMP, START), READY, TIMING)
    assert state == PhaseState(DAMP, now)
    assert step(now + 499, state, READY, TIMING) == state
    assert step(now + 500, state, READY, TIMING) == PhaseState(DONE, now + 500)


@pytest.mark.parametrize("phase", [RAMP, PLAY, HOLD])
def test_a_stop_leads_to_damping_also_at_the_end_of_a_phase(phase):
    now = START + 300
    assert step(now, PhaseState(phase, START), STOP, TIMING) == PhaseState(DAMP, now, "enough")


durations = st.integers(0, 10_000)
timings = st.builds(
    Timing,
    wait=durations,
    ramp=durations,
    play=st.none() | durations,
    hold=durations,
    damp=st.integers(1, 10_000),
    settle=durations,
    awaited=durations,
    way_down=durations,
)
ticks = st.lists(
    st.tuples(
        st.integers(1, 20_000),
        st.builds(
            Inputs,
            missing=st.sampled_from(["", "it"]),
            stop=st.sampled_from(["", "", "", "enough"]),
        ),
    ),
    max_size=40,
)


@given(timings, ticks)
def test_whatever_happens_damping_comes_between_a_command_and_the_end(timing, ticks):
    """Phases never go back, and DAMP is seen at a tick of its own for its whole time."""
    now, state, seen = START, PhaseState(WAIT, START), []
    for wait, inputs in ticks:
        now += wait
        before, state = state, step(now, state, inputs, timing)
        assert state.phase >= before.phase
        assert before.since <= state.since <= now
        seen.append((state.phase, now))
    commanded = any(RAMP <= phase <= HOLD for phase, _ in seen)
    damped = [at for phase, at in seen if phase is DAMP]
    ended = [at for phase, at in seen if phase is DONE]
    if commanded and ended:
        assert damped
        assert ended[0] - damped[0] >= timing.damp
    assert commanded or not damped
