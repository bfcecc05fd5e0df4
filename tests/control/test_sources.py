import sys
from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest

from g1stream.config import Config, load_config
from g1stream.control.gains import Gains
from g1stream.control.loop import make_loop
from g1stream.control.plan import plan
from g1stream.control.sources import SOURCES, Changed, HeldTorques, Source, Status, Traits
from g1stream.errors import ConfigError, MotionError
from g1stream.motion.motion import Motion
from g1stream.motion.trajectory import Trajectory
from g1stream.robot.model import G1
from g1stream.types import Phase

STREAM = {"support": "feet", "feedforward": "dynamics", "ramp": 0.2, "hold": 0.1, "damp": 0.5}
CONFIG = Config.model_validate({"stream": STREAM})
GAINS = Gains(np.full(29, 7.0), np.full(29, 0.5))


class Policy(Source):
    """Targets of its own at 50 Hz, 0.01 rad above those that it is given. It tells each tick."""

    traits = Traits(GAINS)

    def __init__(self, config, robot, *, simulated):
        super().__init__(config, robot, simulated=simulated)
        assert (config.stream.support, simulated) == ("feet", True)
        self.computed, self.seen, self.ticks = [], [], []
        self._until, self._q, self._step = 0, None, b""

    @property
    def status(self):
        return Status(step=self._step)

    def prepare(self, motion):
        if motion.fps > 50.0:
            raise MotionError("It is too fast.", "Slow it.")
        return Changed(replace(motion, name="changed"), "as the policy knows it")

    def command(self, moment):
        self.seen.append(moment.phase)
        self._step = moment.tick.to_bytes(4, "little")
        self.ticks.append(moment.tick)
        if moment.measured.arrived >= self._until:
            self._until = moment.measured.arrived + 20_000_000
            self._q = moment.target.q + 0.01
            self.computed.append(moment.phase)
        return moment.target._replace(q=self._q, dq=np.zeros(29))


@pytest.fixture
def policy(monkeypatch):
    module = ModuleType("g1stream.extras.made")
    module.Policy = Policy
    monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.setitem(SOURCES, "feet", "g1stream.extras.made:Policy")


@pytest.mark.usefixtures("policy")
def test_a_source_has_its_own_motion_gains_targets_and_rate(link, clock, motion, events):
    planned = plan(motion, CONFIG, simulated=True)
    assert planned.motion.name == "changed"
    assert [values.tolist() for values in planned.gains] == [values.tolist() for values in GAINS]
    assert planned.events[0][1] == "as the policy knows it"
    make_loop(planned, link, clock).run()
    playing = link.in_phase(Phase.PLAY)
    for before, sent in zip(playing[:-10], playing[10:], strict=True):
        assert sent.command.kp.tolist() == [7.0] * 29
        assert not sent.command.dq.any()
        # Computed within the last ten ticks, from a target that moves by up to 0.4 rad/s.
        assert sent.command.q == pytest.approx(before.reference.q + 0.01, abs=0.0081)
    assert planned.source.computed.count(Phase.PLAY) == len(playing) / 10
    assert list(dict.fromkeys(planned.source.seen)) == [Phase.RAMP, Phase.PLAY, Phase.HOLD]


@pytest.mark.usefixtures("policy")
def test_what_is_told_of_a_command_that_is_not_sent_comes_with_the_next_one(
    link, clock, motion, monkeypatch
):
    """32 ticks are skipped, and two commands cannot be written."""
    planned, send, refused = plan(motion, CONFIG, simulated=True), link.send, []
    for n in range(20, 240, 7):
        clock.oversleeps[clock.now() + 2_000_000 * n] = 3_000_000

    def refusing(command, reference, stamp):
        if len(link.sent) in (100, 150) and len(link.sent) not in refused:
            refused.append(len(link.sent))
            return 0
        return send(command, reference, stamp)

    monkeypatch.setattr(link, "send", refusing)
    report = make_loop(planned, link, clock, settle=0).run()
    assert (report.skipped, refused) == (32, [100, 150])
    beside = {sent.stamp: int(sent.reference.tick) for sent in link.sent}
    ticks = [int.from_bytes(data, "little") for data, _ in link.steps]
    assert ticks == planned.source.ticks
    assert ticks == [beside.get(stamp) for _, stamp in link.steps]
    assert len({*ticks}) == len(ticks) - 32 - 2


def test_a_held_robot_rests_at_the_end_of_each_motion_but_the_last():
    angles = 0.3 * np.sin(np.arange(60)[:, None] / 10.0 + np.arange(29))
    a, b, c = (Motion.from_arrays(k * angles, fps=30.0, name=f"{k}") for k in (1, 2, 3))
    config = load_config(over={"stream.wait_for": "A", "stream.start": 0.5})
    source = Source(config, G1.default(), simulated=True)
    motion, _, rests = source.prepare(a.then(b).then(c))
    assert motion.name == "1+rest+2+rest+3"
    assert [part.name for part in motion.parts] == motion.name.split("+")
    first = a.trim(0.5)
    assert rests[0] == pytest.approx(first.duration + 1.0 + 0.5 - 0.1, abs=0.04)
    at = Trajectory(motion).sample
    for rest, last in zip(rests, (a, b), strict=True):
        for time in (rest - 0.3, rest, rest + 0.05):
            assert at(time).joint_pos == pytest.approx(last.joint_pos[-1], abs=1e-6)
            assert at(time).joint_vel == pytest.approx(np.zeros(29), abs=1e-5)
    assert motion.joint_pos[: first.n_frames] == pytest.approx(first.joint_pos)
    assert motion.joint_pos[-60:] == pytest.approx(c.joint_pos)


@pytest.mark.parametrize(
    "over", [{}, {"stream.duration": 1.0}, {"stream.loop": True}, {"stream.wait_for": "select"}]
)
def test_what_cannot_wait_is_refused(over):
    motion = Motion.from_arrays(np.zeros((60, 29)), fps=30.0)
    joined = motion if not over else motion.then(motion)
    with pytest.raises(ConfigError, match=r"waits for|wait_for"):
        plan(joined, load_config(over={"stream.wait_for": "A"} | over), simulated=True)


@pytest.mark.usefixtures("policy")
@pytest.mark.parametrize("own", [False, True])
def test_a_joint_need_not_follow_a_motion_that_its_source_only_observes(
    link, clock, own, monkeypatch
):
    """An elbow swings by 1.2 rad in the reference; the robot's rests at its mean."""
    monkeypatch.setattr(Policy, "traits", Traits(GAINS, makes_targets=own))
    angles = np.zeros((300, 29))
    angles[:, 18] = 0.6 * np.sin(np.arange(300) / 8.0)
    planned = plan(Motion.from_arrays(angles, fps=50.0), CONFIG, simulated=True)
    stop = make_loop(planned, link, clock, settle=0).run().stop
    assert (stop and stop.kind) == (None if own else "jam")


@pytest.mark.usefixtures("policy")
def test_on_the_way_to_the_first_frame_each_joint_must_follow(link, clock, monkeypatch):
    monkeypatch.setattr(Policy, "traits", Traits(GAINS, makes_targets=True))
    angles = np.zeros((300, 29))
    angles[:, 18] = 1.5
    planned = plan(Motion.from_arrays(angles, fps=50.0), CONFIG, simulated=True)
    assert make_loop(planned, link, clock, settle=0).run().stop.kind == "jam"


@pytest.mark.usefixtures("policy")
def test_a_source_refuses_a_motion_before_anything_is_sent(motion):
    with pytest.raises(MotionError, match="too fast"):
        plan(replace(motion, fps=100.0), CONFIG, simulated=True)


def test_a_source_that_is_not_installed_is_named_with_its_extra(monkeypatch, motion):
    monkeypatch.setitem(SOURCES, "feet", "g1stream.extras.nowhere.source:Policy")
    with pytest.raises(ConfigError) as refused:
        plan(motion, CONFIG, simulated=True)
    assert "pip install 'g1stream[nowhere]'" in refused.value.remedy


@pytest.mark.parametrize(
    ("kind", "source"), [("none", Source), ("velocity", Source), (None, HeldTorques)]
)
def test_without_an_extra_torques_are_those_of_a_held_robot(motion, kind, source):
    settings = Config.model_validate({"stream": {"feedforward": kind}})
    assert type(plan(motion, settings, simulated=True).source) is source
