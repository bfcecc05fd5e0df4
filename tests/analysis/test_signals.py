from types import SimpleNamespace

import numpy as np
import pytest

from g1stream.analysis.signals import min_max, signal
from g1stream.app.session import open_session
from g1stream.errors import ConfigError
from g1stream.session.streams import CommandStream, MeasuredStream
from g1stream.types import Phase


@pytest.mark.parametrize("n", [1001, 99_999])
def test_every_peak_is_kept(n):
    values = np.random.default_rng(n).normal(size=n)
    values[[n // 3, n // 2]] = 50.0, -50.0
    kept = min_max(values, 200)
    assert len(kept) <= 200
    assert (np.diff(kept) > 0).all()
    assert {n // 3, n // 2} <= set(kept.tolist())
    # Of any stretch as long as two runs, what is kept spans what was there in one of them.
    for first in range(0, n - n // 50, n // 50):
        inside = values[kept[(kept >= first) & (kept < first + n // 50)]]
        middle = values[first + n // 100 : first + n // 100 + 3]
        assert inside.max() >= middle.max()
        assert inside.min() <= middle.min()


def test_an_interruption_stays_one():
    values = np.sin(np.arange(10_000) / 50.0)
    values[5000], values[7000:8000] = np.nan, np.nan
    kept = min_max(values, 100)
    assert 5000 in kept
    assert np.isnan(values[kept][(kept >= 7300) & (kept < 7700)]).all()
    assert not np.isnan(values[kept][kept < 4900]).any()


def test_positions_are_in_degrees_and_end_where_they_are_missing(play, take, write_session):
    """Where only damping is commanded, and where there are no states."""
    reference, measured = play()
    kept = np.r_[0:500, 600 : len(measured)]
    session = open_session(write_session(reference, take(measured, kept)))
    reference, measured = signal(session, "q").lines
    damping = session.reference.phase == Phase.DAMP
    assert np.isnan(reference.values[damping]).all()
    expected = np.degrees(session.reference.q[~damping])
    np.testing.assert_allclose(reference.values[~damping], expected)
    assert len(measured.time) == len(kept) + 1
    assert np.flatnonzero(np.isnan(measured.values).all(axis=1)).tolist() == [500]
    found = np.delete(measured.values, 500, axis=0)
    np.testing.assert_allclose(found, np.degrees(session.measured.q))


def test_the_error_is_that_of_every_phase_in_which_a_pose_is_asked_for(play, write_session):
    phases = ((Phase.RAMP, 0.4), (Phase.PLAY, 1.0), (Phase.HOLD, 0.3), (Phase.DAMP, 0.2))
    session = open_session(write_session(*play(0.02, 0.1, phases)))
    (line,) = signal(session, "error").lines
    found, states = session.tracking(), session.measured.time
    for one in session.phases:
        inside = states[(states > one.start_s + 0.01) & (states < one.end_s - 0.01)]
        assert (np.isin(inside, line.time) == (one.phase is not Phase.DAMP)).all()
    in_play = np.isin(line.time, found.time)
    np.testing.assert_allclose(line.values[in_play], np.degrees(found.error), atol=1e-6)


def test_a_part_before_the_first_reference_has_no_error(play, write_session):
    part = open_session(write_session(*play())).sel(time=slice(-9.0, -5.0))
    assert signal(part, "error").lines == ()


def test_the_torque_asked_for_is_the_servos():
    rng = np.random.default_rng(6)

    def stream(kind, time, *names):
        columns = {name: rng.normal(size=(4, 29)) for name in names}
        stamps = np.round(time * 1e9).astype(np.int64)
        return kind(log_time=stamps, publish_time=stamps, **columns)

    command = stream(CommandStream, np.arange(4) * 0.002, "q", "dq", "tau", "kp", "kd")
    state = stream(MeasuredStream, np.array([-0.0005, 0.0005, 0.0019, 0.002]), "q", "dq", "tau")
    topics = {"/lowcmd": 4, "/lowstate": 4}

    def blocks(kind, names):
        assert kind is CommandStream
        for start, end in ((0, 1), (1, 4)):
            yield start, {name: getattr(command, name)[start:end] for name in names}

    session = SimpleNamespace(
        topics=topics, command=command, measured=state, computed={}, blocks=blocks
    )
    asked, measured = signal(session, "tau").lines
    assert np.isnan(asked.values[0]).all()
    for i, j in ((1, 0), (2, 0), (3, 1)):
        position = command.kp[j] * (command.q[j] - state.q[i])
        velocity = command.kd[j] * (command.dq[j] - state.dq[i])
        np.testing.assert_allclose(asked.values[i], command.tau[j] + position + velocity)
    np.testing.assert_array_equal(measured.values, state.tau)


def test_what_was_not_recorded_has_no_line(play, write_session):
    session = open_session(write_session(reference=play().reference))
    assert [line.name for line in signal(session, "q").lines] == ["reference"]
    assert signal(session, "error").lines == ()
    with pytest.raises(ConfigError):
        session.plot(what=["speed"])
