import numpy as np
import pytest

from g1stream.types import Phase

MS = 1_000_000
SOFT = 50  # commands, 100 ms


@pytest.fixture
def sagging(link):
    """A robot whose joints sag until the soft start is over."""
    link.on_send = lambda n: link.robot.q.__setitem__(slice(None), 0.001 * min(n, SOFT))
    return link


def test_soft_start_damps_and_then_ramps_from_the_pose_measured_then(make_loop, sagging):
    make_loop(soft_start=2 * SOFT * MS).run()
    damping, ramping = sagging.sent[:SOFT], sagging.sent[SOFT]
    for sent in damping:
        assert int(sent.reference.phase) == Phase.DAMP
        assert not sent.command.kp.any()
        assert (sent.command.kd == 3.0).all()
        assert not sent.command.tau.any()
        assert not sent.command.dq.any()
    assert int(ramping.reference.phase) == Phase.RAMP
    assert ramping.command.kp.tolist() == (np.arange(29) / 8.0 + 4.0).tolist()
    assert not ramping.command.dq.any()
    # The measured pose of the tick before, which the servo is therefore not torn from.
    assert ramping.command.q == pytest.approx(np.full(29, 0.001 * SOFT), abs=0.0021)
    phases = [int(sent.reference.phase) for sent in sagging.sent]
    changes = [a for a, b in zip(phases, [None, *phases], strict=False) if a != b]
    assert changes == [Phase.DAMP, Phase.RAMP, Phase.PLAY, Phase.HOLD, Phase.DAMP]
    assert phases.count(Phase.RAMP) == 50
    sagging.assert_sound()


@pytest.mark.parametrize("at", [0, SOFT // 2, SOFT - 1])
def test_a_stop_during_the_soft_start_keeps_damping(make_loop, link, at):
    loop = make_loop(soft_start=2 * SOFT * MS)
    link.at_send(at, lambda: loop.request_stop("enough"))
    report = loop.run()
    assert report.stop.text == "enough"
    assert not any(sent.command.kp.any() for sent in link.sent)
    assert {int(sent.reference.phase) for sent in link.sent} == {Phase.DAMP}
    assert len(link.sent) >= at + 100


def test_a_stall_during_the_soft_start_does_not_stiffen_the_robot_early(make_loop, link, clock):
    loop = make_loop(soft_start=2 * SOFT * MS)
    link.at_send(10, lambda: clock.work(30 * MS))
    loop.run()
    stiff = next(sent for sent in link.sent if sent.command.kp.any())
    assert stiff.time - link.sent[0].time >= 2 * (SOFT - 1) * MS
    assert link.sent.index(stiff) >= SOFT - 1  # time without commands does not damp
    assert stiff.command.q == pytest.approx(link.robot.q)
