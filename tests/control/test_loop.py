"""The loop from WAIT to DONE on a fake clock and a fake link: every command, to the ns."""

import gc
import logging
import math
import sys

import numpy as np
import pytest

from g1stream.config import Config
from g1stream.control.feedforward import FeedForward
from g1stream.control.schedule import PhaseState, Schedule
from g1stream.control.sources import Source, Status
from g1stream.control.targets import Targets
from g1stream.motion.trajectory import Trajectory
from g1stream.robot.model import G1
from g1stream.types import Phase

MS = 1_000_000
PERIOD = 2 * MS
SETTLE = 300 * MS
RAMP, PLAY, HOLD, DAMP = 50, 250, 10, 100  # commands that the phases of `timing` last
ALL = RAMP + PLAY + HOLD + DAMP


def test_a_whole_session(make_loop, link, clock, events):
    start = clock.now()
    loop = make_loop()
    report = loop.run()
    assert link.phases() == {"RAMP": RAMP, "PLAY": PLAY, "HOLD": HOLD, "DAMP": DAMP}
    first = start + SETTLE + PERIOD
    assert [sent.time for sent in link.sent] == [first + i * PERIOD for i in range(len(link.sent))]
    assert [sent.stamp - sent.time for sent in link.sent] == [clock.stamp() - clock.time] * ALL
    link.assert_damped()
    for sent in link.sent[:-DAMP]:
        assert sent.command.kp.tolist() == (np.arange(29) / 8.0 + 4.0).tolist()
        assert sent.command.kd.tolist() == np.float32(np.arange(29) / 100.0 + 0.1).tolist()
    went = ["WAIT -> RAMP", "RAMP -> PLAY", "PLAY -> HOLD", "HOLD -> DAMP", "DAMP -> DONE"]
    went.insert(0, "feed-forward: velocity")
    assert events() == [(logging.INFO, text) for text in went]
    assert loop.state.phase is Phase.DONE
    assert report is loop.report
    assert report.stop is None
    assert report.commands == ALL
    assert report.states == 151 + ALL  # one a tick, those of WAIT included
    assert report.skipped == 0
    assert report.rate == 500.0
    assert (report.first_sent, report.last_sent) == (link.sent[0].time, link.sent[-1].time)
    assert (report.lateness.n, report.lateness.maximum_ns) == (ALL, 0)


def test_the_rate_does_not_depend_on_the_wall_clock(make_loop, clock, link, monkeypatch):
    hour = 3_600_000_000_000
    monkeypatch.setattr(clock, "stamp", lambda: clock.time + hour * (len(link.sent) > PLAY // 2))
    report = make_loop().run()
    assert link.sent[-1].stamp - link.sent[0].stamp > hour
    assert report.rate == 500.0


def test_the_tracking_error_is_that_of_the_references_that_were_sent(make_loop, link):
    link.robot.q[:] = np.linspace(-0.02, 0.02, 29)
    report = make_loop().run()
    played = np.array([sent.reference.q.copy() for sent in link.in_phase(Phase.PLAY)])
    error, found = played - link.robot.q, report.error.finish()
    assert (found.n, report.error.excluded) == (PLAY, 0)
    assert report.error.duration == PLAY * PERIOD
    np.testing.assert_allclose(found.rmse, np.sqrt((error**2).mean(axis=0)), atol=1e-7)
    np.testing.assert_allclose(found.max_abs_at, 0.002 * np.abs(error).argmax(axis=0))


def test_commands_have_the_mode_machine_of_the_robot(make_loop, link):
    link.robot.mode_machine[()] = 0
    make_loop().run()
    assert {int(sent.command.mode_machine) for sent in link.sent} == {0}


def test_the_part_that_is_played(make_loop, trajectory, timing):
    targets = Targets(trajectory, start=0.1, moved=np.ones(29, bool))
    assert make_loop(targets=targets).part == (0.1, 0.6)
    assert make_loop(targets=targets, timing=timing._replace(play=None)).part == (0.1, math.inf)


def test_what_wait_waits_for_is_said_meanwhile(make_loop, link, clock, timing, events):
    link.waits_for = "no subscriber on rt/lowcmd"
    make_loop(timing=timing._replace(wait=4_500 * MS), where="domain 7 on lo").run()
    told = [text for _, text in events() if text.startswith("WAIT, ")]
    assert len(told) == 2  # after 1 and 4 s
    assert set(told) == {"WAIT, up to 4.5 s, in domain 7 on lo: no subscriber on rt/lowcmd"}


def test_play_is_sampled_exactly_at_its_deadlines(make_loop, link, trajectory):
    make_loop().run()
    played = link.in_phase(Phase.PLAY)
    for i, sent in enumerate(played):
        due = trajectory.sample(i * PERIOD / 1e9)
        assert float(sent.reference.motion_time) == i * PERIOD / 1e9
        for message in (sent.reference, sent.command):
            assert message.q.tolist() == due.joint_pos.astype(np.float32).tolist()
            assert message.dq.tolist() == due.joint_vel.astype(np.float32).tolist()
        assert not sent.command.tau.any()


def feedforward(kind=Source, **other):
    source = kind(Config(), G1.default(), simulated=True)
    return FeedForward(source, limit=np.full(29, 50.0), period=0.002, **other)


@pytest.mark.parametrize("preview", [0.002, 0.05])
def test_a_preview_crosses_into_the_next_phase(make_loop, link, preview):
    """The motion moves at up to 0.4 rad/s from its first frame to its last."""
    link.robot.q[:] = 0.1 * np.sin(np.linspace(0.1, 1.5, 29))
    report = make_loop(feedforward=feedforward(preview=preview)).run()
    assert report.summary().preview_s == preview
    q = np.array([sent.command.q for sent in link.sent])
    fastest = max(np.abs(sent.command.dq).max() for sent in link.sent)
    assert np.abs(np.diff(q, axis=0)).max() < 1.1 * fastest * PERIOD / 1e9
    damping = link.in_phase(Phase.DAMP)
    assert damping[0].command.q.tolist() == link.sent[-DAMP - 1].command.q.tolist()


class ConstantTorque(Source):
    def command(self, moment):
        return moment.target._replace(tau=np.full(29, 8.0))


def test_stale_state_fades_the_torque_out_and_in_again(make_loop, link):
    """60 ms without a LowState, the last 40 of them stale: 0.4 of the fade."""
    feed, link.support = feedforward(ConstantTorque), "bolted"
    silent = range(150, 180)
    link.on_send = lambda i: setattr(link, "silent", i in silent)
    make_loop(feedforward=feed).run()
    torque = np.array([sent.command.tau[0] for sent in link.sent])
    assert torque[140:160].tolist() == [8.0] * 20
    assert torque[140:290].min() == pytest.approx(8.0 * 0.6, abs=0.5)
    assert 180 <= 140 + np.argmin(torque[140:290]) <= 183
    assert torque[210:290].tolist() == [8.0] * 80


def test_a_looping_motion_plays_until_stopped(make_loop, link, motion, timing):
    targets = Targets(Trajectory(motion, loop=True), start=0.0, moved=np.ones(29, bool))
    loop = make_loop(targets=targets, timing=timing._replace(play=None))
    link.at_send(500, lambda: loop.request_stop("enough"))
    loop.run()
    assert link.phases() == {"RAMP": RAMP, "PLAY": 501 - RAMP, "DAMP": DAMP}
    assert float(link.sent[500].reference.motion_time) == 450 * PERIOD / 1e9
    link.assert_damped()


def test_lateness_ends_with_the_write_and_work_begins_there(make_loop, link, clock, trajectory):
    class Laborious(Targets):
        def at(self, *args):
            clock.work(300_000)
            return super().at(*args)

    link.on_send = lambda _: clock.work(150_000)
    report = make_loop(targets=Laborious(trajectory, start=0.0, moved=np.ones(29, bool))).run()
    assert report.lateness.sparse() == {150: ALL}
    assert report.lateness.maximum_ns == 150_000
    assert report.worst_work == 300_000
    assert report.skipped == 0


@pytest.mark.parametrize(
    ("at", "late", "skipped", "delayed"),
    [
        (100, PERIOD - 1, 0, 0),
        (RAMP - 2, 5 * PERIOD + 7, 5, 0),  # into the next phase
        (80, 5 * PERIOD + 7, 5, 0),
        (299, 5 * PERIOD + 7, 5, 0),
        (100, 9 * PERIOD, 9, 0),
        (100, 10 * PERIOD, 10, 1),
    ],
)
def test_a_stall_skips_ticks_and_delays_the_motion_by_what_is_beyond_20_ms(
    make_loop, link, clock, at, late, skipped, delayed
):
    deadline = clock.now() + SETTLE + PERIOD + at * PERIOD
    clock.oversleeps[deadline] = late
    report = make_loop().run()
    assert (report.stop, report.skipped, report.delay) == (None, skipped, delayed * PERIOD)
    assert report.commands == ALL - skipped + delayed
    assert report.lateness.maximum_ns == late - skipped * PERIOD
    sent, following = link.sent[at : at + 2]
    assert (sent.time, following.time) == (deadline + late, deadline + (skipped + 1) * PERIOD)
    ticks = min(at + skipped - delayed - RAMP, PLAY)
    assert float(sent.reference.motion_time) == ticks * PERIOD / 1e9
    assert int(sent.reference.phase) == (Phase.PLAY if at < 290 else Phase.HOLD)
    link.assert_damped()


def test_a_long_stall_damps(make_loop, link, clock):
    clock.oversleeps[clock.now() + SETTLE + PERIOD + 80 * PERIOD] = 100 * MS + PERIOD
    report = make_loop().run()
    assert "stalled for 0.102 s" in report.stop.text
    assert link.phases() == {"RAMP": RAMP, "PLAY": 30, "DAMP": DAMP}
    link.assert_damped()


@pytest.mark.parametrize("ahead", [-1, 0, 50])
def test_damping_is_commanded_in_full_whatever_stalls(make_loop, link, clock, ahead):
    n = RAMP + PLAY + HOLD + ahead
    clock.oversleeps[clock.now() + SETTLE + PERIOD + n * PERIOD] = 60_000 * MS
    make_loop().run()
    link.assert_damped()


def test_waiting_is_not_counted_as_skipping(make_loop, clock):
    clock.oversleeps[clock.now() + 10 * PERIOD] = 20 * PERIOD
    assert make_loop().run().skipped == 0


def test_memory_does_not_grow_with_the_motion(make_loop, link, clock, motion, timing, monkeypatch):
    """Without the collector, as in a session: what refers to itself would stay for ever."""
    looping = Targets(Trajectory(motion, loop=True), start=0.0, moved=np.ones(29, bool))
    loop = make_loop(targets=looping, timing=timing._replace(play=None))
    blocks = []

    def send(command, reference, stamp):
        if loop.report.commands in (1000, 2000):
            blocks.append(sys.getallocatedblocks())
        if loop.report.commands == 2000:
            loop.request_stop("enough")
        return clock.now()

    def sleep_without_a_record(deadline):
        clock.time = max(clock.time, deadline)

    monkeypatch.setattr(link, "send", send)
    monkeypatch.setattr(clock, "sleep_until", sleep_without_a_record)
    gc.collect()
    gc.disable()
    try:
        loop.run()
    finally:
        gc.enable()
    assert len(blocks) == 2
    assert blocks[1] - blocks[0] < 100


class Awaiting(ConstantTorque):
    """Torques for a robot that is not ready for the first 200 commands."""

    asked, awaited = 0, "the robot is not there"

    def command(self, moment):
        self.asked += 1
        return super().command(moment)

    @property
    def status(self):
        return Status(awaited=self.awaited if self.asked <= 200 else "")


def test_ramp_rests_at_the_first_frame_until_what_it_waits_for_has_come(make_loop, link, events):
    link.support = "bolted"
    loop = make_loop(feedforward=feedforward(Awaiting))
    assert loop.run().stop is None
    coasting = 100  # commands, 0.2 s
    assert link.phases()["RAMP"] == 200 + coasting + 1
    assert link.phases()["PLAY"] == PLAY
    resting = np.array([sent.reference.q for sent in link.sent[RAMP + 2 : 200]])
    first = link.in_phase(Phase.PLAY)[0].reference
    assert np.ptp(resting, axis=0).max() == 0.0
    assert resting[0] == pytest.approx(first.q, abs=1e-6)
    assert not any(sent.reference.dq.any() for sent in link.sent[RAMP + 2 : 200])
    assert (logging.INFO, f"RAMP waits: {Awaiting.awaited}") in events()


@pytest.fixture
def motion_times(link):
    """Gives the motion times of all References in PLAY, s."""
    return lambda: np.array([float(one.reference.motion_time) for one in link.in_phase(Phase.PLAY)])


def test_a_motion_rests_until_the_operator_lets_it_go_on(make_loop, link, events, motion_times):
    """A call before the rest does not count, and a rest takes no time of the motion."""
    loop = make_loop(rests=[200 * MS, 300 * MS])
    link.on_send = lambda n: n in (RAMP + 20, 400, 700) and loop.go_on()
    report = loop.run()
    times = motion_times()
    counts = [int((np.abs(times - at) < 1e-9).sum()) for at in (0.2, 0.3)]
    assert counts == pytest.approx([400 - RAMP - 100, 700 - 400 - 50], abs=3)
    assert np.unique(times.round(9)) == pytest.approx(np.arange(PLAY) * 0.002)
    assert (np.diff(times) >= 0.0).all()
    assert (report.played, link.phases()["HOLD"]) == (PLAY * PERIOD, HOLD)
    said = [text.split()[1] for _, text in events() if text.startswith("PLAY ")]
    assert said == ["waits", "goes", "waits", "goes", "->"]


def test_a_button_lets_the_motion_go_on(make_loop, link, motion_times):
    def hold(n):  # A, from before the rest on, and again
        link.robot.wireless_remote[3] = RAMP + 10 < n < 400 or n > 500

    link.on_send = hold
    make_loop(rests=[200 * MS], wait_for="A").run()
    found = int((np.abs(motion_times() - 0.2) < 1e-9).sum())
    assert found == pytest.approx(500 - RAMP - 100, abs=3)


def test_a_rest_is_one_also_if_the_robot_s_time_moves_meanwhile(timing, trajectory):
    schedule = Schedule(
        Targets(trajectory, start=0.0, moved=np.ones(29, bool)), timing, PERIOD, rests=[200 * MS]
    )
    schedule.state = PhaseState(Phase.PLAY, 0)
    assert not schedule.rest(198 * MS)
    for now in (202 * MS, 300 * MS):
        assert schedule.rest(now)
        assert schedule.state.elapsed(now) == 200 * MS
        schedule.delay(10 * MS)
    schedule.go_on()
    assert not schedule.rest(500 * MS)


class Down:
    """A way down of 0.3 s that keeps the pose."""

    length = 0.3

    def possible(self, target):
        return True

    def plan(self, standing):
        return lambda elapsed, near: standing


@pytest.mark.parametrize("way_down", [None, Down()])
@pytest.mark.parametrize("unheard", [False, True])
def test_a_resting_motion_can_be_ended(make_loop, link, trajectory, timing, way_down, unheard):
    """On its feet the robot goes down first. A rest that nothing ends any more ends the run."""
    targets = Targets(trajectory, start=0.0, moved=np.ones(29, bool), way_down=way_down)
    timing = timing._replace(way_down=round(1e9 * Down.length) if way_down else 0)
    loop = make_loop(targets=targets, timing=timing, rests=[200 * MS])
    end = loop.end_at_rest if unheard else loop.request_stop
    link.at_send(RAMP + (10 if unheard else 200), lambda: end("enough"))
    assert loop.run().stop.text == "enough"
    link.assert_damped()
    assert ("HOLD" in link.phases()) == (way_down is not None)
    assert link.phases()["PLAY"] == pytest.approx(101 if unheard else 201, abs=2)
