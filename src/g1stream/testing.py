"""Test doubles for DDS, the clock and the robot, for tests of code that streams.

With `FakeClock` and `FakeLink` a loop runs without waiting, and every sleep, command and timestamp
can be asserted to the nanosecond:

    clock = FakeClock()
    link = FakeLink(clock)
    loop = make_loop(plan(motion, config, simulated=True), link, clock)  # of g1stream.control
    loop.run()
    assert link.phases()["DAMP"] == 500

`Lockstep` is a link and a clock with the physics of g1stream's bridge; `g1stream.rollout` uses it
for whole sessions.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from g1stream.dds.messages import (
    LOWCMD,
    LOWSTATE,
    REFERENCE,
    SPORTMODESTATE,
    LowCmd,
    LowState,
    Reference,
    encode_samples,
)
from g1stream.robot.joints import EXAMPLE_KD, EXAMPLE_KP, N_JOINTS
from g1stream.sim.lockstep import Lockstep
from g1stream.sim.robot import MODE_MACHINE_29
from g1stream.types import Floats, Ints, Phase

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import ArrayLike

    from g1stream.dds.messages import Topic
    from g1stream.session.source import MemorySource
    from g1stream.session.writer import SessionWriter

__all__ = ["EPOCH", "FakeClock", "FakeLink", "Lockstep", "Sent", "SyntheticSession"]

EPOCH: Final = 1_700_000_000_000_000_000
"""Publish time of the first sample, ns since the epoch."""


class FakeClock:
    """A clock that advances only with `sleep_until` and `work`.

    Args:
        limit: maximum time that may pass, ns; more raises an AssertionError, so that an endless
            loop fails.

    Attributes:
        time: the return value of `now`, ns.
        deadlines: the arguments of `sleep_until`, in order, including deadlines that had passed.
        oversleeps: deadline -> lateness of the sleep that ends there, ns; 0 for all others.
    """

    def __init__(self, limit: int = 100_000_000_000) -> None:
        self.time = 5_000_000_000
        self.deadlines: list[int] = []
        self.oversleeps: dict[int, int] = {}
        self._end = self.time + limit

    def now(self) -> int:
        return self.time

    def stamp(self) -> int:
        return EPOCH + self.time

    def sleep_until(self, deadline: int) -> None:
        self.deadlines.append(deadline)
        if deadline > self.time:
            self.time = deadline + self.oversleeps.get(deadline, 0)
        if self.time > self._end:
            raise AssertionError("the loop does not end")

    def work(self, duration: int) -> None:
        """Advance the clock by a duration, ns, as a computation does."""
        self.time += duration


class Sent(NamedTuple):
    """One LowCmd with its Reference, as sent to a `FakeLink`."""

    time: int  # of the clock, ns
    stamp: int  # publish time, ns since the epoch
    command: LowCmd
    reference: Reference


class FakeLink:
    """An in-process link (`g1stream.control.link.Link`) with a robot that a test controls.

    Args:
        clock: the clock of the loop.

    Attributes:
        sent: the commands of the loop.
        steps: steps of a policy: data, publish time.
        robot: the robot's LowState, which the loop receives at every tick. It stands upright. Its
            accelerometer has noise, because a LowState that never changes counts as frozen.
        silent: the robot publishes only with `publish_state`.
        others: names of other publishers of LowCmd.
        publisher: identity of the publisher of LowState.
        state_others: names of the publishers of LowState, if there are several.
        waits_for: why the first command has to wait; "" if it need not.
        guard_took_over: why the guard process damps the robot; "" while it does not.
        support: the support that the robot announces.
        on_send: called after each `send` with the number of earlier ones.
    """

    def __init__(self, clock: FakeClock) -> None:
        self.sent: list[Sent] = []
        self.steps: list[tuple[bytes, int]] = []
        self.robot = LowState()
        self.robot.quaternion[:] = (1.0, 0.0, 0.0, 0.0)
        self.robot.mode_machine[()] = MODE_MACHINE_29
        self.silent = False
        self.others: list[str] = []
        self.publisher = 1
        self.state_others: list[str] = []
        self.waits_for = self.guard_took_over = ""
        self.support: str | None = None
        self.on_send: Callable[[int], object] = lambda n: None
        self._clock = clock
        self._published: bytes | None = None
        self._noise = 2.0**-20

    def other_publishers(self) -> list[str]:
        return list(self.others)

    def announced(self) -> tuple[str | None, str | None]:
        return self.support, None

    def receive(self, state: LowState) -> int | None:
        if not self.robot.crc:  # a state with a CRC is left as it is
            self._noise = -self._noise
            self.robot.accelerometer[2] += self._noise
        data = self._published if self.silent else self.robot.tobytes()
        self._published = None
        if data is None:
            return None
        state.load(data)
        state.published = state.received = self._clock.stamp()
        return self.publisher

    def state_publishers(self) -> list[str]:
        return list(self.state_others)

    def send(self, command: bytes, reference: bytes, stamp: int) -> int:
        sent = Sent(self._clock.now(), stamp, LowCmd(), Reference())
        sent.command.load(command)
        sent.reference.load(reference)
        self.sent.append(sent)
        self.on_send(len(self.sent) - 1)
        return self._clock.now()

    def send_step(self, data: bytes, stamp: int) -> None:
        self.steps.append((data, stamp))

    def unready(self) -> str:
        return self.waits_for

    def replaced(self) -> str:
        return self.guard_took_over

    def publish_state(self, data: bytes) -> None:
        """Publish one LowState of a silent robot."""
        self._published = data

    def at_send(self, n: int, act: Callable[[], object]) -> None:
        """Call `act` after the n-th command, counted from 0."""
        self.on_send = lambda i: act() if i == n else None

    def phases(self) -> dict[str, int]:
        """Number of commands by phase, in the order of the phases."""
        return dict(Counter(Phase(int(sent.reference.phase)).name for sent in self.sent))

    def in_phase(self, phase: Phase) -> list[Sent]:
        """The commands that were sent in a phase."""
        return [sent for sent in self.sent if int(sent.reference.phase) == phase]


#: Durations of RAMP and HOLD, s.
_RAMP: Final = 0.5
_HOLD: Final = 0.3


@dataclass(frozen=True)
class SyntheticSession:
    """A synthetic session of a robot with known tracking errors.

    Attributes:
        seconds: length of PLAY, s; RAMP takes 0.5 s and HOLD 0.3 s.
        rate: commands and states per second, Hz; states are half a period after commands.
        delay: (29,) s or one value for all, delay of the robot relative to the reference.
        gain: measured over reference motion.
        bias: (29,) rad or one value for all, reference - measured.
        noise: standard deviation of measured positions, rad.
        torque: (29,) N·m·s/rad or one value for all, ratio of each motor's torque to its velocity.
        gaps: (start, length) s in which no LowState is recorded; PLAY starts at 0.
        clock_offset: offset of the robot's clock from the recorder's, s.
        latency: latency of every message, s.
        seed: seed of the noise.
        metadata: metadata of the session.
    """

    seconds: float
    rate: float = 500.0
    delay: Floats | float = 0.0
    gain: float = 1.0
    bias: Floats | float = 0.0
    noise: float = 0.0
    torque: Floats | float = 0.0
    gaps: tuple[tuple[float, float], ...] = ()
    clock_offset: float = 0.0
    latency: float = 100e-6
    seed: int = 0
    metadata: Mapping[str, Any] = field(default_factory=dict)

    def joints(self, time: ArrayLike, late: ArrayLike = 0.0) -> tuple[Floats, Floats, Floats]:
        """q, dq and ddq (T, 29) of the reference at times (T,) s, delayed by `late` s."""
        numbers = np.arange(N_JOINTS)
        total = np.zeros((3, np.size(time), N_JOINTS))
        for amplitude, hertz in ((0.3, 0.21), (0.08, 1.3)):
            omega = 2.0 * np.pi * hertz * (1.0 + 0.03 * numbers)
            angle = omega * (np.asarray(time)[:, np.newaxis] - late) + numbers
            total[0] += amplitude * np.sin(angle)
            total[1] += amplitude * omega * np.cos(angle)
            total[2] -= amplitude * omega**2 * np.sin(angle)
        return total[0], total[1], total[2]

    def write(self, writer: SessionWriter | MemorySource) -> None:
        """Write the samples, and finally the metadata."""
        rng = np.random.default_rng(self.seed)
        ticks = round((_RAMP + self.seconds + _HOLD) * self.rate)
        size = round(0.25 * self.rate)
        for start in range(0, ticks, size):
            ticked = np.arange(start, min(start + size, ticks))
            self._write_commands(writer, ticked)
            self._write_states(writer, ticked, rng)
        writer.add_metadata(self.metadata)

    def _write_commands(self, writer: SessionWriter | MemorySource, ticks: Ints) -> None:
        time = ticks / self.rate - _RAMP
        stamps = EPOCH + np.round(ticks * 1e9 / self.rate).astype(np.int64)
        q, dq, ddq = self.joints(time)
        in_play = (time >= -1e-9) & (time < self.seconds - 1e-9)
        phase = np.where(in_play, Phase.PLAY, np.where(time < 0.0, Phase.RAMP, Phase.HOLD))
        n = len(ticks)
        reference = {
            "tick": ticks,
            "motion_time": time.clip(0.0),
            "phase": phase,
            "q": q,
            "dq": dq,
            "ddq": ddq,
            "root_pos": np.tile([0.0, 0.0, 0.8], (n, 1)),
            "root_quat_wxyz": np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)),
        }
        command = {
            "motor_cmd.mode": np.ones((n, N_JOINTS)),
            "motor_cmd.q": q,
            "motor_cmd.dq": dq,
            "motor_cmd.kp": np.tile(EXAMPLE_KP, (n, 1)),
            "motor_cmd.kd": np.tile(EXAMPLE_KD, (n, 1)),
        }
        for topic, values in ((REFERENCE, reference), (LOWCMD, command)):
            logged = stamps + round(self.latency * 1e9)
            writer.write_batch(_channel(topic), encode_samples(topic, values, n), logged, stamps)

    def _write_states(
        self, writer: SessionWriter | MemorySource, ticks: Ints, rng: np.random.Generator
    ) -> None:
        time = (ticks + 0.5) / self.rate - _RAMP
        q, dq, ddq = self.joints(time, self.delay)
        measured = self.gain * q - self.bias + self.noise * rng.standard_normal(q.shape)
        tau = self.torque * dq
        kept = np.ones(len(time), dtype=bool)
        for start, length in self.gaps:
            kept &= (time < start) | (time >= start + length)
        n = int(kept.sum())
        stamps = EPOCH + np.round((ticks[kept] + 0.5) * 1e9 / self.rate).astype(np.int64)
        logged = stamps + round(self.latency * 1e9)
        published = stamps + round(self.clock_offset * 1e9)
        state = {
            "tick": ticks[kept],
            "motor_state.q": measured[kept],
            "motor_state.dq": self.gain * dq[kept],
            "motor_state.ddq": self.gain * ddq[kept],
            "motor_state.tau_est": tau[kept],
            "imu_state.quaternion": np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)),
        }
        base = {"position": np.tile([0.0, 0.0, 0.8], (n, 1))}
        for topic, values in ((LOWSTATE, state), (SPORTMODESTATE, base)):
            writer.write_batch(_channel(topic), encode_samples(topic, values, n), logged, published)


def _channel(topic: Topic) -> str:
    """The topic of a session file that contains the samples of a DDS topic."""
    from g1stream.session.streams import STREAMS  # here, because fake clocks and links need none

    return next(name for name, kind in STREAMS.items() if kind.source == topic)
