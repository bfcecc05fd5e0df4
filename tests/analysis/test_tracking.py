"""The tracking of a session, as it is had in Python."""

import numpy as np
import pytest

import g1stream
from g1stream.analysis.metrics import compare, track

SAG = np.linspace(-0.2, 0.1, 29)


def test_it_is_that_of_the_sessions_arrays(play, write_session):
    session = g1stream.open_session(write_session(*play(0.04, -SAG)))
    found = g1stream.tracking(session)
    expected = track(compare(session.reference, session.measured))
    np.testing.assert_array_equal(found.rmse, expected.rmse)
    np.testing.assert_array_equal(found.error, expected.error)
    assert found.delay.seconds == expected.delay.seconds == pytest.approx(0.04, abs=1e-4)


def test_its_figures_agree_with_each_other(play, write_session):
    found = g1stream.tracking(g1stream.open_session(write_session(*play(offset=-SAG))))
    assert found.error.shape == (2000, 29)
    assert found.compared.time.shape == found.compared.motion_time.shape == (2000,)
    np.testing.assert_allclose(found.error.mean(axis=0), SAG, atol=1e-4)
    assert found.overall == pytest.approx(np.sqrt(np.mean(found.error**2)))
    assert found.worst_joint == "left_hip_pitch_joint"
    assert found.rmse_by_limb["waist"] == pytest.approx(np.sqrt(np.mean(SAG[12:15] ** 2)), abs=1e-4)


def test_only_the_joint_positions_are_read(play, write_session):
    session = g1stream.open_session(write_session(*play()))
    g1stream.tracking(session)
    assert {"q", "phase", "motion_time"} <= vars(session.reference).keys()
    assert "q" in vars(session.measured)
    assert "dq" not in vars(session.reference) | vars(session.measured)


def test_nothing_to_compare_is_said(play, take, write_session):
    reference, measured = play()
    with pytest.raises(g1stream.G1StreamError, match="no messages on /reference"):
        g1stream.tracking(g1stream.open_session(write_session(None, measured, name="a.mcap")))
    before = [take(stream, slice(0, 200)) for stream in (reference, measured)]
    with pytest.raises(g1stream.G1StreamError, match="no state came while the motion was played"):
        g1stream.tracking(g1stream.open_session(write_session(*before, name="b.mcap")))
