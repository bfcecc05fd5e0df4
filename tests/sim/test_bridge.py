"""The bridge over real DDS: what it publishes, what it obeys and what it refuses."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import numpy as np
import pytest

from g1stream.clock import SystemClock
from g1stream.config import SimConfig
from g1stream.dds.domain import Participant
from g1stream.dds.endpoints import RawReader, RawWriter
from g1stream.dds.messages import Log, LowCmd, LowState, SecondaryImu, SportModeState
from g1stream.dds.topics import LOG, LOWCMD, LOWSTATE, SECONDARY_IMU, SPORTMODESTATE
from g1stream.robot.model import G1
from g1stream.sim.bridge import MODE_MACHINE_29, Bridge
from g1stream.sim.world import World

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

KNEE = 3


class Peer:
    """The other end of the wire, and the bridge run for as long as the test wants."""

    def __init__(self, domain_id: int, **settings: object) -> None:
        self._participants = [Participant(domain_id, "lo") for _ in range(2)]
        ours, theirs = self._participants
        topics = (LOWSTATE, SPORTMODESTATE, SECONDARY_IMU, LOG)
        self.readers = {topic.name: RawReader(theirs, topic, depth=2000) for topic in topics}
        self.writer = RawWriter(theirs, LOWCMD)
        self.world = World(G1.default())
        self.events: list[str] = []
        self.bridge = Bridge(
            ours,
            self.world,
            SimConfig(**settings),
            SystemClock(),
            on_event=lambda level, text: self._note(text),
        )

    def _note(self, text: str) -> None:
        if "cannot keep up" not in text:  # of the machine, not of what is tested
            self.events.append(text)

    def run(self, ticks: int, at_tick: Callable[[int], None] = lambda tick: None) -> None:
        """Run the bridge for so many LowStates; `at_tick` is called before each."""
        count = iter(range(ticks))

        def should_stop() -> bool:
            tick = next(count, None)
            if tick is not None:
                at_tick(tick)
            return tick is None

        self.bridge.run(should_stop)
        time.sleep(0.05)

    def take(self, topic: str) -> list[bytes]:
        return [sample.data for sample in self.readers[topic].take(2000)]

    def close(self) -> None:
        for participant in self._participants:
            participant.close()


@pytest.fixture
def peer(domain_id: int) -> Iterator[Peer]:
    peer = Peer(domain_id)
    yield peer
    peer.close()


def good_command() -> LowCmd:
    command = LowCmd()
    command.motor_mode = 1
    command.mode_machine[()] = MODE_MACHINE_29
    command.kp[:], command.kd[:] = 60.0, 2.0
    command.q[KNEE] = 0.5
    return command


def test_states_carry_tick_checksum_attitude_and_mode(peer):
    peer.run(100)
    states = peer.take(LOWSTATE.name)
    assert len(states) == 100
    state = LowState()
    ticks = []
    for data in states:
        state.load(data)
        assert state.crc_matches()
        ticks.append(int(state.tick))
    assert np.unique(np.diff(ticks)).tolist() == [2]
    assert int(state.mode_machine) == MODE_MACHINE_29
    assert np.allclose(state.quaternion, [1, 0, 0, 0], atol=1e-6)
    assert np.allclose(state.accelerometer, [0, 0, 9.81], atol=1e-3)


def test_the_base_and_the_torso_are_published_too(peer):
    peer.run(20)
    sport, torso = SportModeState(), SecondaryImu()
    sport.load(peer.take(SPORTMODESTATE.name)[-1])
    torso.load(peer.take(SECONDARY_IMU.name)[-1])
    assert np.allclose(sport.position, peer.world.state().base_pos, atol=1e-6)
    assert int(sport.nanosec) == 38_000_000  # the first of the 20 states is that of time 0
    assert np.linalg.norm(torso.quaternion) == pytest.approx(1.0, abs=1e-6)


def test_a_good_command_moves_the_joint(peer):
    data = good_command().seal()
    peer.run(400, lambda tick: peer.writer.write(data))
    assert peer.world.state().q[KNEE] == pytest.approx(0.5, abs=0.2)
    assert peer.bridge.report.commands > 100
    assert not peer.bridge.report.refused


def spoiled(change: Callable[[LowCmd], None], *, sealed: bool = True) -> bytes:
    command = good_command()
    if not sealed:
        command.seal()
    change(command)
    return command.seal() if sealed else command.tobytes()


def set_q(value: float) -> Callable[[LowCmd], None]:
    return lambda command: command.q.__setitem__(KNEE, value)


REFUSED = {
    "checksum": lambda: spoiled(set_q(1.0), sealed=False),
    "mode_pr": lambda: spoiled(lambda command: command.mode_pr.__setitem__((), 1)),
    "mode_machine": lambda: spoiled(lambda command: command.mode_machine.__setitem__((), 4)),
    "not finite": lambda: spoiled(set_q(float("nan"))),
}


@pytest.mark.parametrize("why", REFUSED)
def test_a_bad_command_is_refused_and_reported(peer, why):
    data = REFUSED[why]()
    peer.run(100, lambda tick: peer.writer.write(data))
    report = peer.bridge.report
    assert report.commands == 0
    assert sum(report.refused.values()) > 20
    assert all(why in reason for reason in report.refused)
    assert peer.world.state().q[KNEE] == pytest.approx(0.0, abs=0.05)
    told = Log()
    for event in peer.take(LOG.name):
        told.load(event)
        if "cannot keep up" not in told.text:
            break
    assert why in told.text
    assert told.name == "sim"
    assert len(peer.events) == 1  # told once a second, not at every command


def test_motors_that_are_not_enabled_stay_limp(peer):
    command = good_command()
    command.motor_mode = 0
    data = command.seal()
    peer.run(100, lambda tick: peer.writer.write(data))
    assert not peer.world.state().tau_est.any()
    assert "29 of 29 motors are not enabled" in peer.events[0]


def test_without_commands_the_motors_only_damp(domain_id):
    peer = Peer(domain_id, command_timeout=0.1)
    data = good_command().seal()
    peer.run(300, lambda tick: tick < 150 and peer.writer.write(data))
    state = peer.world.state()
    peer.close()
    assert peer.bridge.report.timeouts >= 1  # one more for each time that the machine stops
    assert "the motors only damp" in peer.events[-1]
    # Gravity alone moves it now: the motor resists speed and nothing else.
    assert state.tau_est[KNEE] == pytest.approx(-3.0 * state.dq[KNEE], abs=0.3)


@pytest.mark.parametrize("rate", [100, 300, 500, 1000])
def test_simulated_time_is_counted_in_periods_of_the_rate(domain_id, rate):
    from g1stream.programs.sim import simulate

    ticks = iter(range(31))
    config = {"dds": {"domain": domain_id}, "sim": {"rate": rate}}
    from g1stream.config import Config

    report = simulate(Config.model_validate(config), should_stop=lambda: next(ticks) == 30)
    assert report.simulated == pytest.approx(30 / rate)
