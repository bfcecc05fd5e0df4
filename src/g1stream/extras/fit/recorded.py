"""The commands and states of a session in the form that a simulation needs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline
from scipy.signal import butter, sosfiltfilt

from g1stream.errors import RecordingError
from g1stream.input_limits import NUMBER
from g1stream.robot.rotations import quat_normalize, sign_continuous
from g1stream.session.recording import Recording
from g1stream.session.records import StreamSummary, read_record
from g1stream.session.streams import CommandStream, MeasuredStream
from g1stream.types import Floats, Ints, StreamSupport

__all__ = ["Recorded", "noise_of", "smoothed"]

#: A longer time between two LowStates, s or periods, splits the record.
_GAP, _GAP_PERIODS = 0.02, 5.0
#: Length of a part of an excerpt, s.
_PART: Final = 10.0
#: States are resampled evenly if this fraction of their intervals is off by this much.
_UNEVEN, _OFF = 0.005, 0.2
#: The robot's own clock is used if its rate is within this fraction of real time.
_CLOCK: Final = 0.5
#: Low-pass frequency for attitude and place of a base that is driven along them, Hz.
_BASE_CUTOFF: Final = 15.0
#: Attributes with a row for each LowState.
_OF_STATES: Final[tuple[str, ...]] = (
    *("published", "time", "q", "dq", "tau", "quat_wxyz", "gyroscope", "accelerometer"),
    *("base_pos", "base_lin_vel"),
)
#: Ratio of the standard deviations of white noise's fourth difference and the noise.
_FOURTH: Final = np.sqrt(70.0)
#: Ratio of the median of |x| to the standard deviation of a normal distribution.
_MEDIAN: Final = 0.6745


@dataclass(frozen=True, eq=False)
class Recorded:
    """N LowStates from the first command to the last, in the order of publish times.

    Attributes:
        name: name of the session.
        published: (N,) ns.
        time: (N,) s, on the robot's own clock (LowState's tick) if it has one.
        period: time between two LowStates, s.
        q, dq, tau: (N, 29) as measured, motor order.
        quat_wxyz: (N, 4) attitude of the pelvis.
        gyroscope: (N, 3) rad/s, pelvis frame.
        accelerometer: (N, 3) m/s², pelvis frame, gravity included.
        base_pos, base_lin_vel: (N, 3) m and m/s, world; None if the base's place is unknown.
        command_times: (M,) ns.
        enabled: (M, 29) whether each motor is enabled.
        commands: (M, 5, 29) q, dq, tau, kp and kd.
        support: how the robot was held according to the session; None if unknown.
    """

    name: str
    published: Ints
    time: Floats
    period: float
    q: Floats
    dq: Floats
    tau: Floats
    quat_wxyz: Floats
    gyroscope: Floats
    accelerometer: Floats
    base_pos: Floats | None
    base_lin_vel: Floats | None
    command_times: Ints
    enabled: NDArray[np.bool_]
    commands: Floats
    support: StreamSupport | None

    @classmethod
    def of(cls, session: Recording) -> Recorded:
        """Read a session.

        Raises:
            RecordingError: it lacks commands or states, or the two do not overlap.
        """
        columns = ("q", "dq", "tau", "imu_quat_wxyz", "gyroscope", "accelerometer", "tick")
        of_commands = ("mode", "q", "dq", "tau", "kp", "kd")
        session.read({MeasuredStream: columns, CommandStream: of_commands})
        command, measured, base = session.command, session.measured, session.base
        asked = np.argsort(command.published, kind="stable")
        commands = np.stack([getattr(command, name)[asked] for name in of_commands[1:]], axis=1)
        sound = (np.abs(commands) < NUMBER).all(axis=(1, 2))
        asked, commands = asked[sound], commands[sound]
        order = np.argsort(measured.published, kind="stable")
        published = measured.published[order]
        finite = np.ones(len(order), dtype=bool)
        for name in columns[:-1]:
            finite &= (np.abs(getattr(measured, name)[order]) < NUMBER).all(axis=1)
        finite &= np.diff(published, prepend=published[:1] - 1) > 0
        # A simulator may publish a state twice before its next step.
        tick = measured.tick[order]
        finite &= (np.diff(tick, prepend=tick[:1] - 1) != 0) | (not tick.any())
        stream, _ = read_record(StreamSummary, session.metadata.get("stream"), "stream")
        support = stream.support if stream else None
        if len(asked):
            first, last = command.published[asked[[0, -1]]]
            if support in ("free", "feet"):  # a simulator holds the base until then
                first = max(first, session.start_ns)
            finite &= (published >= first) & (published <= last)
        order = order[finite]
        if not len(asked) or len(order) < 2:
            raise RecordingError(
                f"{session.path} has no LowStates between its first command and its last.",
                "Record rt/lowcmd and rt/lowstate while the robot is commanded.",
            )
        published = measured.published[order]
        position = velocity = None
        if base is not None and len(base):
            of_base = np.argsort(base.published, kind="stable")
            position, velocity = (
                _at(published, base.published[of_base], values[of_base])
                for values in (base.position, base.velocity)
            )
        time = _own_time(measured.tick[order], published)
        recorded = cls(
            name=session.path.name,
            published=published,
            time=time,
            period=float(np.median(np.diff(time))),
            q=measured.q[order],
            dq=measured.dq[order],
            tau=measured.tau[order],
            quat_wxyz=quat_normalize(sign_continuous(measured.imu_quat_wxyz[order])),
            gyroscope=measured.gyroscope[order],
            accelerometer=measured.accelerometer[order],
            base_pos=position,
            base_lin_vel=velocity,
            command_times=command.published[asked],
            enabled=command.mode[asked] == 1,
            commands=commands,
            support=support,
        )
        steps = np.diff(time) / recorded.period
        uneven = np.mean(np.abs(steps - 1.0) > _OFF) > _UNEVEN
        return recorded._evened() if uneven else recorded

    @property
    def gap(self) -> float:
        """A longer time between two states splits the record, s."""
        return max(_GAP, _GAP_PERIODS * self.period)

    def _evened(self) -> Recorded:
        """The same, resampled evenly between gaps: positions by cubics, the rest linearly."""
        times = [self.time[part] for part in self._continuous() if part.stop - part.start > 1]
        at = np.concatenate(
            [
                one[0] + self.period * np.arange(int((one[-1] - one[0]) / self.period) + 1)
                for one in times
            ]
        )
        changed: Any = {
            name: _at(at, self.time, values)
            for name in _OF_STATES[2:]
            if (values := getattr(self, name)) is not None
        }
        changed["q"] = CubicHermiteSpline(self.time, self.q, self.dq)(at)
        changed["quat_wxyz"] = quat_normalize(changed["quat_wxyz"])
        first = self.published[0]
        changed["published"] = first + np.interp(at, self.time, self.published - first).astype(int)
        return replace(self, time=at, **changed)

    def part(self, rows: slice | Ints) -> Recorded:
        """Some of the states, with all commands."""
        of_states: Any = {
            name: values[rows] for name in _OF_STATES if (values := getattr(self, name)) is not None
        }
        return replace(self, **of_states)

    @property
    def seconds(self) -> float:
        """Time in which there are states, s."""
        return len(self.time) * self.period

    def excerpt(self, most: float) -> Recorded:
        """About `most` s of it: parts of at most 10 s, evenly spread."""
        if self.seconds <= most:
            return self
        parts = self.windows(min(_PART, most))
        n = max(1, int(len(parts) * most / self.seconds))
        chosen = np.linspace(0, len(parts) - 1, n).astype(int)
        rows = [np.arange(parts[i].start, parts[i].stop) for i in chosen]
        return self.part(np.unique(np.concatenate(rows)))

    def windows(self, length: float) -> list[slice]:
        """Parts of at most `length` s without gaps; each ends with the first state of the next."""
        n = max(1, round(length / self.period))
        return [
            slice(start, min(start + n + 1, part.stop))
            for part in self._continuous()
            for start in range(part.start, part.stop - 1, n)
        ]

    @cached_property
    def begins(self) -> NDArray[np.bool_]:
        """(N,) whether a state is the first one, or the first one after a gap."""
        return np.append(True, np.diff(self.time) > self.gap)

    def _continuous(self) -> list[slice]:
        """The parts between gaps."""
        starts = np.flatnonzero(self.begins).tolist()
        return [slice(a, b) for a, b in pairwise([*starts, len(self.time)])]

    @cached_property
    def acts(self) -> Floats:
        """(M,) publish times of the commands on the clock of `time`, s."""
        first = self.published[0]
        times = np.interp(self.command_times - first, self.published - first, self.time)
        before = np.minimum(self.command_times - first, 0) / 1e9
        after = np.maximum(self.command_times - self.published[-1], 0) / 1e9
        found: Floats = times + before + after
        return found

    def total(self, delay: float, times: Floats) -> Floats:
        """(T, 3, 29) integrals up to times (T,) of tau + kp q + kd dq, kp and kd of the commands.

        A command acts from `delay` s after its publish time until the next one does. Motors that
        are not enabled, and all before the first command, have 0.
        """
        values, integral = self._integral
        number = np.searchsorted(self.acts, times - delay, side="right") - 1
        held = number.clip(0)
        since = np.maximum(times - delay - self.acts[held], 0.0)[:, np.newaxis, np.newaxis]
        found: Floats = integral[held] + values[held] * since
        return found

    @cached_property
    def _integral(self) -> tuple[Floats, Floats]:
        """The commands of `total`, and their integrals up to each of them."""
        q, dq, tau, kp, kd = self.commands.transpose(1, 0, 2)
        values = np.stack([tau + kp * q + kd * dq, kp, kd], axis=1)
        values = values * self.enabled[:, np.newaxis]
        steps = values[:-1] * np.diff(self.acts)[:, np.newaxis, np.newaxis]
        return values, np.concatenate([np.zeros_like(values[:1]), np.cumsum(steps, axis=0)])

    def servo(self, delay: float) -> tuple[Floats, Floats]:
        """(N, 29) N·m that the servo law gives at each LowState, and the part of the commands.

        The torque is tau + kp (q - measured q) + kd (dq - measured dq), and the commands' part
        tau + kp q + kd dq, where commands are means over the period around the LowState. They do
        not depend on the torques that the robot reports.
        """
        half = 0.5 * self.period
        mean = self.total(delay, self.time + half) - self.total(delay, self.time - half)
        feed, kp, kd = (mean / self.period).transpose(1, 0, 2)
        return feed - kp * self.q - kd * self.dq, feed

    def wait(self, early: float) -> float:
        """Mean time from the publish times of commands, s, until the embedded simulator uses them.

        Commands count as received `early` s earlier.
        """
        commands = self.command_times - round(early * 1e9)
        state = np.searchsorted(self.published, commands).clip(0, len(self.published) - 1)
        waits = (self.published[state] - self.command_times) / 1e9
        return float(np.mean(waits[np.abs(waits) <= 2.0 * self.period]))

    def in_force(self, delay: float, early: float = 0.0) -> Ints:
        """(N,) index of the command in force from each LowState to the next one; -1 for none.

        As in the embedded simulator, a command that was published before a LowState is received
        with it, and used `delay` s after its publish time, which is half a period before its
        reception on average, rounded to a LowState. States in a gap count as if they had been
        recorded. Commands count as published `early` s earlier.
        """
        commands = self.command_times - round(early * 1e9)
        received = np.searchsorted(self.published, commands)  # LowState of the reception
        state = received.clip(0, len(self.time) - 1)
        waited = (self.published[state] - commands) / np.median(np.diff(self.published))
        unseen = np.where(self.begins[state], np.floor(waited), 0.0)
        delayed = int(delay / self.period + 1e-6)
        obeyed = received + np.maximum(0, delayed - unseen).astype(int)
        newest: Ints = np.searchsorted(obeyed, np.arange(len(self.time)), side="right") - 1
        return newest

    def smooth_base(self) -> tuple[Floats, Floats]:
        """Attitude (N, 4) and angular velocity (N, 3), pelvis frame, without their noise."""
        parts = self._continuous()
        quat, gyroscope = (
            np.concatenate(
                [smoothed(values[part], 1.0 / self.period, _BASE_CUTOFF) for part in parts]
            )
            for values in (self.quat_wxyz, self.gyroscope)
        )
        return quat_normalize(quat), gyroscope


def _at(
    instants: NDArray[np.number[Any]], times: NDArray[np.number[Any]], values: Floats
) -> Floats:
    """(N, K) values at instants (N,), interpolated linearly at increasing times (R,)."""
    first = times[0]
    return np.stack(
        [np.interp(instants - first, times - first, column) for column in values.T], axis=1
    )


def _own_time(tick: NDArray[np.uint32], published: Ints) -> Floats:
    """(N,) s from the first state, from the robot's ticks, ms, if they are a clock."""
    ticks = (tick.astype(np.int64) - int(tick[0])) / 1e3
    real = (published - published[0]) / 1e9
    if (np.diff(ticks) > 0).all() and abs(ticks[-1] / real[-1] - 1.0) < _CLOCK:
        return ticks
    # Publish times have jitter, so intervals close to the usual one are set to it.
    period = float(np.median(np.diff(real)))
    steps = np.diff(real) / period
    near = np.abs(steps - np.round(steps).clip(1)) < 0.5 - 1e-9
    even = np.where(near, np.round(steps).clip(1), steps) * period
    total = np.concatenate([[0.0], np.cumsum(even)])
    evened: Floats = total * (real[-1] / total[-1])
    return evened


def smoothed(values: Floats, rate: float, cutoff: float) -> Floats:
    """Low-pass filter values (N, K) at a rate, Hz, without phase; short ones are unchanged."""
    sections = _low_pass(rate, min(cutoff, 0.4 * rate))
    pad = min(len(values) - 1, 3 * round(rate / cutoff))
    if pad < 1:
        return values
    found: Floats = sosfiltfilt(sections, values, axis=0, padlen=pad)
    return found


@cache
def _low_pass(rate: float, cutoff: float) -> Floats:
    sections: Floats = butter(2, cutoff, fs=rate, output="sos")
    return sections


def noise_of(values: Floats) -> Floats:
    """Standard deviations (K,) of the white noise in evenly sampled values (N, K).

    It is that of the fourth difference, over sqrt(70), to which a movement of some Hz, sampled at
    500 Hz, contributes almost nothing. It is estimated by the median of absolute values, which is
    robust against steps.
    """
    if len(values) < 16:
        return np.zeros(values.shape[1])
    fourth = np.diff(values, 4, axis=0)
    sigma: Floats = np.median(np.abs(fourth), axis=0) / _MEDIAN / _FOURTH
    return sigma
