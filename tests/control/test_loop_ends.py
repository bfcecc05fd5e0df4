import logging
import signal

import numpy as np
import pytest

from g1stream.config import SafetyConfig
from g1stream.control.stop import Stop
from g1stream.control.targets import Targets
from g1stream.errors import SafetyError
from g1stream.types import Phase

MS = 1_000_000
PERIOD = 2 * MS
RAMP, PLAY, HOLD, DAMP = 50, 250, 10, 100  # commands that the phases of `timing` last


@pytest.mark.parametrize("n", [0, RAMP, 200, RAMP + PLAY + 3])
def test_a_stop_damps_from_the_next_command_on(make_loop, link, events, n):
    loop = make_loop()
    link.at_send(n, lambda: loop.request_stop(Stop.by_signal(signal.SIGINT)))
    report = loop.run()
    assert report.commands == n + 1 + DAMP
    assert report.stop == Stop("signal", "SIGINT", 2)
    assert report.played == 2 * MS * min(max(0, n + 1 - RAMP), PLAY)
    link.assert_damped()
    stopped = Phase(int(link.sent[n].reference.phase)).name
    assert (logging.INFO, f"{stopped} -> DAMP: SIGINT") in events()


def test_whether_it_has_damped_is_known_before_every_command(make_loop, link):
    loop = make_loop()
    seen = []
    link.on_send = lambda _: seen.append(loop.damped)
    loop.run()
    phases = [Phase(int(sent.reference.phase)) for sent in link.sent]
    assert seen == [True, *(phase is Phase.DAMP for phase in phases[:-1])]
    assert loop.damped


@pytest.mark.parametrize("phase", [Phase.PLAY, Phase.DAMP])
def test_a_command_that_could_not_be_written_is_none(make_loop, link, phase):
    loop = make_loop()
    send = link.send

    def fail(command, reference, stamp):
        return 0 if loop.state.phase is phase else send(command, reference, stamp)

    link.send = fail
    report = loop.run()
    assert report.commands == len(link.sent)
    assert not link.in_phase(phase)
    assert loop.damped == (phase is Phase.PLAY)


def test_the_first_reason_counts_and_damping_cannot_be_cut_short(make_loop, link):
    loop = make_loop()
    link.on_send = lambda i: loop.request_stop(f"stop {i}") if i >= 100 else None
    assert loop.run().stop.text == "stop 100"
    link.assert_damped()


def test_a_stop_before_the_first_command_sends_nothing(make_loop, link, events):
    loop = make_loop()
    loop.request_stop("SIGTERM")
    assert loop.run().stop.text == "SIGTERM"
    assert link.sent == []
    assert events() == [(logging.ERROR, "WAIT -> DONE: SIGTERM")]
    assert loop.report.rate is None


@pytest.mark.parametrize("n", [0, 200, RAMP + PLAY + 3])
def test_where_the_guard_has_taken_over_only_damping_is_sent(make_loop, link, n):
    link.at_send(n, lambda: setattr(link, "guard_took_over", "the guard damps"))
    loop = make_loop()
    assert loop.run().stop.text == "the guard damps"
    assert int(link.sent[n + 1].reference.phase) == Phase.DAMP
    link.assert_damped()
    assert loop.damped


def test_a_stale_state_damps(make_loop, link):
    link.at_send(99, lambda: setattr(link, "silent", True))
    report = make_loop().run()
    assert "no LowState for 0.102 s" in report.stop.text
    assert "skipped" not in report.stop.text
    # The last state came with the command before; the first tick beyond 0.1 s prepares the next.
    damped = link.in_phase(Phase.DAMP)[0]
    assert damped.time - link.sent[98].time == 102 * MS + PERIOD
    link.assert_damped()


def test_a_wrong_robot_gets_no_command(make_loop, link):
    link.robot.mode_machine[()] = 4
    assert "mode_machine 4" in make_loop().run().stop.text
    assert link.sent == []


PUBLISHERS = ["policy (pid 4242)", "another (pid 1)"]
of_commands_or_states = pytest.mark.parametrize(
    ("others", "topic"), [("others", "rt/lowcmd"), ("state_others", "rt/lowstate")]
)


@of_commands_or_states
def test_another_publisher_is_refused_before_the_first_command(make_loop, link, others, topic):
    setattr(link, others, PUBLISHERS)
    loop = make_loop()
    with pytest.raises(SafetyError, match=f"publisher on {topic}: ") as no:
        loop.run()
    assert ", ".join(PUBLISHERS) in no.value.cause
    assert loop.report.stop.text == f"{no.value.cause} {no.value.remedy}".rstrip(".")
    assert link.sent == []


@of_commands_or_states
def test_another_publisher_stops_within_a_tenth_of_a_second(make_loop, link, others, topic):
    link.at_send(120, lambda: setattr(link, others, PUBLISHERS))
    report = make_loop().run()
    assert report.stop.text.endswith(f"publisher on {topic}: {', '.join(PUBLISHERS)}")
    assert 1 <= report.commands - DAMP - 120 <= 51
    link.assert_damped()


def test_the_guard_is_no_other_publisher(make_loop, link, monkeypatch):
    """It takes over within a tick, after the loop has looked for that, and is then discovered."""

    def discovered():
        if len(link.sent) > 120:
            link.guard_took_over = "the guard process damps the robot"
        return [link.guard_took_over] * bool(link.guard_took_over)

    monkeypatch.setattr(link, "other_publishers", discovered)
    report = make_loop().run()
    assert report.stop.text == "the guard process damps the robot"
    link.assert_damped()


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda link: link.robot.wireless_remote.fill(0), "R1 was released on the remote"),
        (lambda link: link.robot.q.put(3, np.nan), "LowState contains a position"),
        (lambda link: setattr(link, "publisher", 2), "the publisher of LowState has changed"),
    ],
)
def test_a_state_that_is_wrong_damps(make_loop, link, change, reason):
    link.robot.wireless_remote[2] = 1
    link.at_send(120, lambda: change(link))
    report = make_loop(SafetyConfig(deadman="R1")).run()
    assert report.stop.text.startswith(reason)
    assert report.commands == 121 + DAMP
    link.assert_damped()


def test_another_publisher_may_be_allowed(make_loop, link):
    with link.contested():
        report = make_loop(allow_second_writer=True).run()
    assert (report.commands, report.stop) == (RAMP + PLAY + HOLD + DAMP, None)


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda link: setattr(link, "silent", True), "no LowState received"),
        (lambda link: setattr(link, "waits_for", "the guard is not ready"), "the guard is not"),
        (lambda link: link.robot.q.put(0, 100.0), "left_hip_pitch_joint is at 100.000 rad"),
    ],
)
def test_what_is_missing_is_named_after_the_wait(make_loop, link, clock, spoil, reason):
    spoil(link)
    start = clock.now()
    report = make_loop().run()
    assert report.stop.text.startswith(reason)
    assert "stream.wait" in report.stop.text
    assert link.sent == []
    assert clock.now() - start == 1000 * MS - PERIOD


@pytest.mark.parametrize(
    "spoil",
    [
        lambda robot: (robot.quaternion.fill(0.0), robot.mode_machine.fill(0)),
        lambda robot: robot.wireless_remote.fill(0),  # the dead man's switch
    ],
)
def test_the_first_command_waits_for_the_robot(make_loop, link, clock, spoil):
    """The first LowStates of unitree_mujoco's bridges are all zeros, mode_machine included."""
    link.robot.wireless_remote[2] = 1
    start, ready = clock.now(), link.robot.tobytes()
    spoil(link.robot)
    receive = link.receive

    def receive_at(state):
        if clock.now() >= start + 700 * MS:
            link.robot.load(ready)
        return receive(state)

    link.receive = receive_at
    report = make_loop(SafetyConfig(mode_machine=(5,), deadman="R1")).run()
    assert report.stop is None
    assert link.sent[0].time == start + 700 * MS + PERIOD
    link.assert_damped()


def test_a_robot_that_falls_silent_before_the_first_command_is_waited_for(
    make_loop, bare_link, clock
):
    """A simulator that is restarted while a stream waits."""
    silent, start = (150 * MS, 600 * MS), clock.now()
    receive, bare_link.silent = bare_link.receive, False
    bare_link.waits_for = ""

    def receive_unless_silent(state):
        return None if silent[0] <= clock.now() - start < silent[1] else receive(state)

    bare_link.receive = receive_unless_silent
    assert make_loop(link=bare_link).run().stop is None
    # The first LowState after the silence came too late after the one before.
    assert bare_link.sent[0].time == start + silent[1] + 2 * PERIOD


def test_a_machine_that_stalls_is_told_beside_a_silent_robot(make_loop, link, clock):
    def fall_silent():
        link.silent = True
        clock.oversleeps[clock.now() + 20 * PERIOD] = 8 * PERIOD

    link.at_send(120, fall_silent)
    report = make_loop().run()
    assert "safety.state_timeout" in report.stop.text
    assert "skipped 8 ticks" in report.stop.text
    link.assert_damped()


def test_the_first_command_waits_for_a_subscriber(make_loop, link, clock, monkeypatch):
    comes = clock.now() + 400 * MS
    monkeypatch.setattr(link, "unready", lambda: "" if clock.now() >= comes else "no subscriber")
    make_loop().run()
    assert link.sent[0].time == comes + PERIOD


class BrokenError(Exception):
    """Raised by the tests within the loop."""


def assert_limp(commands):
    for sent in commands:
        assert int(sent.reference.phase) == Phase.DAMP
        assert not sent.command.kp.any()
        assert sent.command.crc_matches()


@pytest.fixture
def changed(trajectory, robot):
    """Targets that are changed from 0.1 s into PLAY on."""

    def make(change):
        targets = Targets(trajectory, start=0.0, moved=robot.present)
        at = targets.at

        def changed_at(phase, elapsed, *others):
            target = at(phase, elapsed, *others)
            return change(target) if (phase, elapsed) >= (Phase.PLAY, 100 * MS) else target

        targets.at = changed_at
        return targets

    return make


def test_an_error_in_the_targets_damps_and_is_raised_again(make_loop, link, changed, events):
    def fail(_):
        raise BrokenError("no target")

    loop = make_loop(targets=changed(fail))
    with pytest.raises(BrokenError, match="no target"):
        loop.run()
    assert link.phases() == {"RAMP": RAMP, "PLAY": 50, "DAMP": DAMP}
    link.assert_damped()
    assert loop.state.phase is Phase.DONE
    assert loop.report.stop.text == "BrokenError: no target"
    assert events()[-1] == (logging.ERROR, "PLAY -> DAMP: BrokenError: no target")


@pytest.mark.parametrize(("name", "value"), [("q", np.nan), ("tau", np.nan), ("dq", -1e300)])
@pytest.mark.filterwarnings("ignore:overflow")
def test_invalid_values_are_never_sent(make_loop, link, changed, name, value):
    targets = changed(lambda target: target._replace(**{name: np.full(29, value)}))
    with pytest.raises(SafetyError, match=f"{name} = "):
        make_loop(targets=targets).run()
    assert link.phases() == {"RAMP": RAMP, "PLAY": 50, "DAMP": DAMP}
    link.assert_damped()


@pytest.mark.parametrize(("error", "n"), [(BrokenError, 0), (KeyboardInterrupt, 120)])
def test_an_error_of_the_wire_damps_and_is_raised_again(make_loop, link, error, n):
    def fail():
        raise error("no wire")

    link.at_send(n, fail)
    with pytest.raises(error, match="no wire"):
        make_loop().run()
    assert len(link.sent) == n + 1 + DAMP
    assert_limp(link.sent[-DAMP:])


@pytest.mark.parametrize("transition", ["PLAY -> HOLD", "HOLD -> DAMP"])
def test_an_error_in_a_log_handler_does_not_prevent_damping(
    make_loop, link, monkeypatch, transition
):
    def fail(level, text):
        if text.startswith(transition) or "DAMP" in text:
            raise BrokenError(text)

    monkeypatch.setattr("g1stream.control.loop._LOGGER.log", fail)
    with pytest.raises(BrokenError):
        make_loop().run()
    link.assert_damped()


def test_an_error_in_damping_damps_again(make_loop, link, events):
    def fail():
        raise BrokenError("once")

    link.at_send(RAMP + PLAY + HOLD + 50, fail)
    with pytest.raises(BrokenError, match="once"):
        make_loop().run()
    assert link.phases()["DAMP"] == 51 + DAMP
    assert events()[-1] == (logging.INFO, "HOLD -> DAMP")


def test_errors_while_damping_do_not_shorten_it(make_loop, link, monkeypatch):
    """The wire fails, and then thrice while the robot is damped because of it."""
    send = link.send

    def fail(*sample):
        sent = send(*sample)
        if len(link.sent) in (121, 122, 126, 127):
            raise KeyboardInterrupt("no wire")
        return sent

    monkeypatch.setattr(link, "send", fail)
    loop = make_loop()
    with pytest.raises(KeyboardInterrupt, match="no wire"):
        loop.run()
    assert len(link.sent) == 121 + DAMP
    assert_limp(link.sent[127:])
    assert loop.state.phase is Phase.DONE


def test_an_error_between_damp_and_its_gains_damps(make_loop, link, monkeypatch):
    loop = make_loop()
    enter_phase = loop._enter_phase

    def interrupted(before):
        if loop.state.phase is Phase.DAMP:
            raise KeyboardInterrupt
        enter_phase(before)

    monkeypatch.setattr(loop, "_enter_phase", interrupted)
    with pytest.raises(KeyboardInterrupt):
        loop.run()
    link.assert_damped()


def test_an_error_before_the_first_command_sends_nothing(make_loop, link, events, monkeypatch):
    def unready():
        raise BrokenError("no wire")

    monkeypatch.setattr(link, "unready", unready)
    loop = make_loop()
    with pytest.raises(BrokenError):
        loop.run()
    assert link.sent == []
    assert loop.state.phase is Phase.DONE
    assert loop.report.stop.text == "BrokenError: no wire"
    assert events() == []  # the error is told by who gets it
