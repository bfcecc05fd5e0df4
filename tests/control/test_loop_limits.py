import numpy as np
import pytest

from g1stream.config import Config, SafetyConfig
from g1stream.control import loop as control_loop
from g1stream.control.limits import CommandLimits
from g1stream.control.plan import plan
from g1stream.dds.messages import LowState
from g1stream.types import Phase

PERIOD = 2_000_000
MARGIN = 0.25
PLAYED = 250  # commands of the motion


def test_a_joint_that_starts_outside_a_limit_is_moved_inside_by_the_ramp(make_loop, link, robot):
    start = np.clip(0.0, robot.lower + MARGIN, robot.upper - MARGIN)
    start[3] = robot.lower[3]  # the left knee
    link.robot.q[:] = start
    make_loop(SafetyConfig(position_margin=MARGIN)).run()
    knee = np.array([sent.command.q[3] for sent in link.sent])
    assert knee[0] == link.robot.q[3]
    # Minimum jerk is at most 1.875 times as fast as an even move; the motion adds its 0.4 rad/s.
    assert np.abs(np.diff(knee[:300])).max() < (1.875 * MARGIN / 0.1 + 0.4) * PERIOD / 1e9
    played = np.array([sent.command.q[3] for sent in link.in_phase(Phase.PLAY)])
    assert (played >= np.float32(robot.lower[3] + MARGIN)).all()


def test_the_torque_is_limited_by_the_age_that_a_state_has_when_its_command_acts(
    make_loop, link, monkeypatch
):
    """Five ticks without a state: the newest gets older by a period with each command."""
    apply, ages = CommandLimits.apply, []

    def seen(limits, *args, age, **others):
        ages.append(round(age * 1e9))
        return apply(limits, *args, age=age, **others)

    monkeypatch.setattr(CommandLimits, "apply", seen)
    link.on_send = lambda i: setattr(link, "silent", 100 <= i < 105)
    make_loop().run()
    assert ages[95:110] == [PERIOD] * 6 + [PERIOD * k for k in range(2, 7)] + [PERIOD] * 4


def test_a_state_from_before_the_session_is_discarded(make_loop, bare_link):
    old = LowState()
    old.quaternion[:] = (1.0, 0.0, 0.0, 0.0)
    old.mode_machine[()] = 5
    bare_link.publish_state(old.tobytes())
    with bare_link.subscribed():
        report = make_loop(link=bare_link).run()
    assert "no LowState received" in report.stop.text
    assert report.commands == 0


def test_states_of_a_stall_are_received_before_their_age_is_checked(make_loop, link, clock):
    """The stall itself is within the limit; with the tick before it, the last state is not."""
    late = clock.now() + 300_000_000 + PERIOD + 100 * PERIOD
    clock.oversleeps[late] = 100_000_000
    report = make_loop().run()
    assert report.skipped == 50
    assert report.stop is None


@pytest.mark.parametrize(("support", "damps"), [("free", True), ("hanging", False), (None, False)])
def test_a_tilt_ends_the_session_of_a_robot_that_nothing_holds(link, clock, motion, support, damps):
    """By 1.2 rad: as far as a robot that hangs may swing, and as one that falls."""
    loop = control_loop.make_loop(plan(motion, Config(), simulated=True), link, clock, settle=0)
    turned = np.array([np.cos(0.6), 0.0, np.sin(0.6), 0.0], np.float32)
    link.at_send(20, lambda: link.robot.quaternion.__setitem__(slice(None), turned))
    with link.held(support):
        report = loop.run()
    assert (report.stop is not None and report.stop.kind == "tilt") == damps
    assert len(link.in_phase(Phase.PLAY)) == (0 if damps else PLAYED)
