"""Tracking error of the joints: its statistics, and their computation during a run."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from g1stream.clock import have_one_clock
from g1stream.robot.joints import N_JOINTS
from g1stream.types import MAX_GAP_NS, Floats

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from g1stream.control.reading import Reading
    from g1stream.control.targets import Setpoint

__all__ = ["ErrorSums", "RunningError"]

#: Number of references that are kept; 128 ms at 500 Hz, longer than the latency of a LowState.
_REFERENCES: Final = 64
#: Number of states whose errors are added together.
_BLOCK: Final = 64
_JOINTS: Final = np.arange(N_JOINTS)


class ErrorSums:
    """Running statistics of the errors of all joints.

    Attributes:
        n: number of states.
        max_abs: (29,) maximum absolute error, rad.
        max_abs_at: (29,) motion time of the maximum, s since the motion's first frame.
    """

    def __init__(self) -> None:
        self.n = 0
        self.max_abs, self.max_abs_at = np.zeros((2, N_JOINTS))
        self._squares, self._total = np.zeros((2, N_JOINTS))

    def add(self, error: Floats, motion_time: Floats) -> None:
        """Add the errors of one or more states.

        Args:
            error: (N, 29) rad, reference - measured.
            motion_time: (N,) s since the motion's first frame.
        """
        self.n += len(error)
        self._squares += np.square(error).sum(axis=0)
        self._total += error.sum(axis=0)
        size = np.abs(error)
        at = size.argmax(axis=0)
        largest = size[at, _JOINTS]
        self.max_abs_at = np.where(largest > self.max_abs, motion_time[at], self.max_abs_at)
        self.max_abs = np.maximum(self.max_abs, largest)

    @property
    def rmse(self) -> Floats:
        """(29,) root mean square error, rad; needs at least one state."""
        found: Floats = np.sqrt(self._squares / self.n)
        return found

    @property
    def mean(self) -> Floats:
        """(29,) mean error, rad; needs at least one state."""
        return self._total / self.n


class _Asked(NamedTuple):
    """A reference that was published, at `stamp`, ns since the epoch."""

    stamp: int
    q: Floats
    motion_time: float
    playing: bool


class RunningError:
    """Computes the tracking error in PLAY during a run, from the LowStates that the loop uses.

    As for a recording, each LowState is compared with the reference at its publish time, see
    `g1stream.analysis.tracking`. If the clock of its publisher differs, the time of reception is
    used instead. Memory does not grow with the run.

    Attributes:
        excluded: number of LowStates in PLAY that are left out, because the reference has a gap
            there or a value is not finite.
        duration: duration of PLAY without gaps, ns.
    """

    def __init__(self) -> None:
        self.excluded = self.duration = 0
        self._sums = ErrorSums()
        self._asked: deque[_Asked] = deque(maxlen=_REFERENCES)
        self._newest: Reading | None = None
        # References before and after a state, the share of the way between them, 0 to 1, and q.
        self._compared: list[tuple[_Asked, _Asked, float, NDArray[np.floating]]] = []

    def asked(self, stamp: int, target: Setpoint, *, playing: bool) -> None:
        """Add a reference that was published at `stamp`, ns since the epoch."""
        if self._asked and (last := self._asked[-1]).playing:
            gap = stamp - last.stamp
            self.duration += gap if 0 <= gap <= MAX_GAP_NS else 0
        self._asked.append(_Asked(stamp, target.q, target.motion_time, playing))

    def received(self, measured: Reading) -> None:
        """Add a LowState, and compare the previous one, whose references are known by now."""
        previous, self._newest = self._newest, measured
        if previous is None:
            return
        published, received = previous.stamps
        time = published if have_one_clock(received - published) else received
        after: _Asked | None = None
        for before in reversed(self._asked):
            if before.stamp <= time:
                if before.playing and after:
                    self._compare(previous, time, before, after)
                return
            after = before

    def _compare(self, measured: Reading, time: int, before: _Asked, after: _Asked) -> None:
        gap = after.stamp - before.stamp
        if gap > MAX_GAP_NS or not measured.finite:
            self.excluded += 1
            return
        self._compared.append((before, after, (time - before.stamp) / gap, measured.q))
        if len(self._compared) == _BLOCK:
            self._add()

    def _add(self) -> None:
        *around, shares, measured = zip(*self._compared, strict=True)
        self._compared.clear()
        q, later = (np.array([one.q for one in asked]) for asked in around)
        times, later_times = (np.array([one.motion_time for one in asked]) for asked in around)
        share = np.array(shares)
        error = q + share[:, np.newaxis] * (later - q) - np.array(measured)
        self._sums.add(error, times + share * (later_times - times))

    def finish(self) -> ErrorSums:
        """Finish after the last state, and return the errors of all states."""
        if self._compared:
            self._add()
        return self._sums
