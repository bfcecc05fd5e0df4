import numpy as np
import pytest

from g1stream.config import Config, SimConfig
from g1stream.control.loop import make_loop
from g1stream.control.plan import plan
from g1stream.robot.model import G1
from g1stream.sim.robot import SimulatedRobot
from g1stream.sim.world import World
from g1stream.testing import FakeClock, FakeLink, Lockstep

CONFIG = Config.model_validate(
    {"stream": {"ramp": 0.2, "hold": 0.0, "duration": 0.1, "feedforward": "velocity"}}
)


@pytest.fixture
def planned():
    return plan("demo", CONFIG, simulated=True)


def test_a_session_over_the_fakes(planned):
    clock = FakeClock()
    link = FakeLink(clock)
    begun = clock.now()
    report = make_loop(planned, link, clock).run()
    assert link.phases()["DAMP"] == 500
    assert report.commands == len(link.sent)
    assert np.diff([sent.time for sent in link.sent]).tolist() == [2_000_000] * (len(link.sent) - 1)
    assert link.sent[0].stamp - link.sent[0].time == clock.stamp() - clock.now()
    assert clock.now() > begun


def test_an_overslept_deadline_is_the_lateness_of_its_command(planned):
    clock = FakeClock()
    link = FakeLink(clock)
    clock.oversleeps[clock.now() + 600_000_000] = 700_000
    report = make_loop(planned, link, clock).run()
    assert report.lateness.maximum_ns == 700_000


def test_a_loop_that_does_not_end_fails():
    clock = FakeClock(limit=1000)
    with pytest.raises(AssertionError):
        clock.sleep_until(clock.now() + 1001)


def test_a_session_in_lockstep(planned):
    samples = []
    link = Lockstep(
        SimulatedRobot(World(G1.default()), SimConfig()),
        "bolted",
        on_sample=lambda topic, data, stamp: samples.append((topic.name, stamp)),
    )
    report = make_loop(planned, link, link).run()
    assert report.lateness.maximum_ns == 0
    assert sum(name == "rt/lowcmd" for name, _ in samples) == report.commands
    stamps = [stamp for _, stamp in samples]
    assert stamps == sorted(stamps)
