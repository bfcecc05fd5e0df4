import logging
import time

import numpy as np
import pytest

from g1stream.clock import SystemClock
from g1stream.config import Config, SimConfig
from g1stream.dds.discovery import AnnouncedBridge
from g1stream.dds.domain import Participant
from g1stream.dds.endpoints import RawReader, RawWriter
from g1stream.dds.messages import (
    LOG,
    LOWCMD,
    LOWSTATE,
    SECONDARY_IMU,
    SPORTMODESTATE,
    Log,
    LowState,
)
from g1stream.robot.model import G1
from g1stream.sim.bridge import Bridge
from g1stream.sim.robot import SimulatedRobot
from g1stream.sim.world import World

KNEE = 3


def stop_after(ticks, at_tick=lambda: None):
    """Ends a run after so many ticks; `at_tick` is called before each."""
    left = iter(range(ticks))

    def should_stop():
        at_tick()
        return next(left, None) is None

    return should_stop


def test_states_out_and_commands_in(domain_id, command):
    world = World(G1.default())
    robot = SimulatedRobot(world, SimConfig())
    with Participant(domain_id, "lo") as ours, Participant(domain_id, "lo") as theirs:
        topics = (LOWSTATE, SPORTMODESTATE, SECONDARY_IMU)
        readers = [RawReader(theirs, topic, depth=2000) for topic in topics]
        writer = RawWriter(theirs, LOWCMD)
        bridge = Bridge(ours, robot, "bolted", SystemClock())
        data = command.seal()
        report = bridge.run(stop_after(400, lambda: writer.write(data)))
        time.sleep(0.05)
        samples = [reader.take(2000) for reader in readers]
        assert AnnouncedBridge.by(theirs.writers(LOWSTATE.name)).support == "bolted"
    assert report.commands > 100
    assert not report.refused
    assert world.state().q[KNEE] == pytest.approx(0.5, abs=0.2)
    stamps = [[sample.publish_time for sample in of_topic] for of_topic in samples]
    assert len(stamps[0]) == report.states == 400
    assert stamps[0] == stamps[1] == stamps[2]  # measured at one instant
    state, ticks = LowState(), []
    for sample in samples[0]:
        state.load(sample.data)
        ticks.append(int(state.tick))
    assert np.unique(np.diff(ticks)).tolist() == [2]


def test_events_are_published_and_logged(domain_id, command, caplog):
    from g1stream.app.sim import simulate

    config = Config.model_validate({"dds": {"domain": domain_id}, "realtime": {"priority": 0}})
    event = Log()
    with Participant(domain_id, "lo") as theirs:
        reader, writer = RawReader(theirs, LOG, depth=100), RawWriter(theirs, LOWCMD)
        data = command.tobytes()  # without a CRC
        simulate(config, should_stop=stop_after(200, lambda: writer.write(data)))
        time.sleep(0.05)
        samples = reader.take(100)
    events = []
    for sample in samples:
        event.load(sample.data)
        events.append((event.name, event.text))
    logged = [r.message for r in caplog.records if r.levelno == logging.WARNING]
    (refusal,) = [text for text in logged if "CRC" in text]
    assert ("sim", refusal) in events


def test_a_slow_simulation_skips_time(domain_id):
    class SlowClock(SystemClock):
        def now(self):
            return super().now() * 3  # all takes three times as long

        def sleep_until(self, deadline):
            """Return at once: it is late anyway."""

    robot = SimulatedRobot(World(G1.default()), SimConfig())

    with Participant(domain_id, "lo") as participant:
        clock = SlowClock()
        start = clock.now()
        bridge = Bridge(participant, robot, "bolted", clock)
        late = iter([False] * 5)

        def should_stop():
            time.sleep(0.03)
            return next(late, True)

        report = bridge.run(should_stop)
    assert 0.0 < report.behind <= (clock.now() - start) / 1e9
    assert report.simulated == pytest.approx(5 * 0.002)
