"""A loop over a fake clock and a fake link, and a short motion to play."""

import logging
from contextlib import contextmanager

import numpy as np
import pytest

from g1stream.config import SafetyConfig, load_config
from g1stream.control.command import Composer, NextCommand
from g1stream.control.feedforward import FeedForward
from g1stream.control.gains import Gains
from g1stream.control.limits import CommandLimits
from g1stream.control.loop import StreamLoop
from g1stream.control.lowstate import LONGEST_INTERVAL, LowStateChecks
from g1stream.control.receiver import Receiver
from g1stream.control.report import Overruns
from g1stream.control.schedule import Schedule
from g1stream.control.sources import Source
from g1stream.control.targets import Targets, Timing
from g1stream.motion.motion import Motion
from g1stream.motion.trajectory import Trajectory
from g1stream.profiles import PROFILES
from g1stream.robot.joints import N_JOINTS
from g1stream.robot.model import G1
from g1stream.testing import FakeClock, FakeLink
from g1stream.types import Phase

MS = 1_000_000
UNSUBSCRIBED = "no subscriber on rt/lowcmd"


class CheckedLink(FakeLink):
    """A fake link with the checks that every session must pass."""

    _DAMP = 100  # commands of DAMP in the `timing` below

    def __init__(self, clock):
        super().__init__(clock)
        self.waits_for = UNSUBSCRIBED

    def assert_damped(self):
        """The session ended in its whole share of commands that only damp, and all are sound."""
        last, *damping = self.sent[-self._DAMP - 1 :]
        assert damping == self.in_phase(Phase.DAMP)
        for sent in damping:
            assert not sent.command.kp.any()
            assert not sent.command.tau.any()
            assert not sent.command.dq.any()
            assert sent.command.kd.tolist() == [3.0] * 29
            assert sent.command.q.tolist() == damping[0].command.q.tolist()
        # The pose due when damping began, a tick after the last; nothing moves faster than 1 rad/s.
        assert damping[0].command.q == pytest.approx(last.command.q, abs=0.002)
        assert damping[-1].time - damping[0].time >= 198 * MS
        self.assert_sound()

    def assert_sound(self):
        """Every command is what it must be, whatever happens."""
        for i, sent in enumerate(self.sent):
            assert sent.command.crc_matches()
            assert sent.command.motor_mode.tolist() == [1] * 29
            assert int(sent.command.mode_pr) == 0
            assert int(sent.command.mode_machine) == 5
            assert int(sent.reference.tick) == i
            for values in (sent.command.q, sent.command.dq, sent.command.tau):
                assert np.isfinite(values).all()

    @contextmanager
    def subscribed(self):
        """With a subscriber of LowCmd."""
        self.waits_for = ""
        yield
        self.waits_for = UNSUBSCRIBED

    @contextmanager
    def held(self, support):
        """With a bridge that announces its support."""
        self.support = support
        yield
        self.support = None

    @contextmanager
    def contested(self):
        """With another publisher of LowCmd; yields a part of its name."""
        self.others.append("policy (pid 4242 on elsewhere)")
        yield "4242"
        self.others.pop()


@pytest.fixture
def events(caplog):
    """Gives (level, message) of all events so far."""
    caplog.set_level(logging.INFO, logger="g1stream")
    return lambda: [(record.levelno, record.getMessage()) for record in caplog.records]


@pytest.fixture
def clock():
    return FakeClock()


@pytest.fixture
def link(clock):
    """A link with a robot that subscribes to LowCmd."""
    link = CheckedLink(clock)
    with link.subscribed():
        yield link


@pytest.fixture
def bare_link(clock):
    """A link without subscribers that receives nothing by itself."""
    link = CheckedLink(clock)
    link.silent = True
    return link


@pytest.fixture(scope="session")
def motion():
    """Half a second at 50 fps in which every joint and the root move, the ends included."""
    time = np.arange(26)[:, np.newaxis] / 50
    phase = np.linspace(0.1, 1.5, N_JOINTS)
    heading = 0.5 * time
    return Motion(
        name="made",
        fps=50.0,
        joint_pos=0.1 * np.sin(4.0 * time + phase),
        root_pos=np.hstack([0.3 * time, 0.1 * time**2, 0.8 + 0.0 * time]),
        root_quat_wxyz=np.hstack(
            [np.cos(heading / 2), 0.0 * time, 0.0 * time, np.sin(heading / 2)]
        ),
    )


@pytest.fixture(scope="session")
def trajectory(motion):
    return Trajectory(motion)


@pytest.fixture(scope="session")
def robot():
    return G1.default()


@pytest.fixture
def timing():
    return Timing(
        wait=1000 * MS,
        ramp=100 * MS,
        play=500 * MS,
        hold=20 * MS,
        damp=200 * MS,
        settle=302 * MS,
    )


@pytest.fixture
def make_loop(clock, link, trajectory, robot, timing):
    """A loop at 500 Hz over the fake link; keyword arguments replace its parts."""

    def make(safety=None, targets=None, timing=timing, constants=PROFILES["simulator"], **other):
        safety = safety or SafetyConfig(state_timeout=LONGEST_INTERVAL)
        targets = targets or Targets(trajectory, start=0.0, moved=robot.present)
        # Soft: the robot of the fake link does not move, and no torque limit is to be reached.
        gains = Gains(np.arange(29) / 8.0 + 4.0, np.arange(29) / 100.0 + 0.1)
        rests = other.pop("rests", ())
        schedule = Schedule(targets, timing, 2 * MS, rests=rests)
        velocity = load_config(over={"stream.feedforward": "velocity"})
        source = Source(velocity, robot, simulated=True)
        plain = FeedForward(source, limit=np.full(29, 50.0), period=0.002)
        commands = NextCommand(
            schedule,
            Composer(
                CommandLimits(robot, safety),
                gains,
                Receiver(2 * MS, 0.2),
                robot.present,
                robot.present,
            ),
            other.pop("feedforward", plain),
            period=2 * MS,
            soft_start=other.pop("soft_start", 0),
        )
        parts = {
            "link": link,
            "clock": clock,
            "schedule": schedule,
            "commands": commands,
            "checks": LowStateChecks(
                robot, robot.present, safety, constants, wait_for=other.get("wait_for")
            ),
            "overruns": Overruns(2 * MS, safety, constants),
            "period": 2 * MS,
        }
        return StreamLoop(**(parts | other))

    return make
