"""The tracking error of joints: sums over any number of states, and that of a run that goes on."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from g1stream.robot.joints import N_JOINTS
from g1stream.types import MAX_GAP_NS, Floats

if TYPE_CHECKING:
    from g1stream.control.reading import Reading
    from g1stream.control.targets import Target

__all__ = ["ErrorSums", "RunningError"]

#: References that are kept: 128 ms of them at 500 Hz, longer than a LowState is on its way.
_REFERENCES: Final = 64
#: States whose errors are added at once.
_BLOCK: Final = 64
_JOINTS: Final = np.arange(N_JOINTS)


class ErrorSums:
    """What is known of the errors of all joints, without the errors.

    Attributes:
        n: states that were added.
        max_abs: (29,) rad, the greatest error, either way.
        max_abs_at: (29,) s since the motion's first frame, where that was.
    """

    def __init__(self) -> None:
        self.n = 0
        self.max_abs, self.max_abs_at = np.zeros((2, N_JOINTS))
        self._squares, self._total = np.zeros((2, N_JOINTS))

    def add(self, error: Floats, motion_time: Floats) -> None:
        """Add the errors of one state or more.

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
        """(29,) rad, root mean square; of one state at least."""
        found: Floats = np.sqrt(self._squares / self.n)
        return found

    @property
    def mean(self) -> Floats:
        """(29,) rad; of one state at least."""
        return self._total / self.n


class _Asked(NamedTuple):
    """A reference that was published, at `stamp`, ns since the epoch."""

    stamp: int
    q: Floats
    motion_time: float
    playing: bool


class RunningError:
    """The tracking error of a run in PLAY, of the LowStates that the loop uses.

    As of a recording, each LowState is compared with the reference at its publish time: see
    `g1stream.analysis.tracking`. Where the clock of its publisher differs, the time of reception
    stands for that. Memory does not grow with the run.

    Attributes:
        excluded: LowStates in PLAY that are left out: the reference has a gap there, or a value is
            not finite.
        duration: ns of PLAY, gaps left out.
    """

    def __init__(self) -> None:
        self.excluded = self.duration = 0
        self._sums = ErrorSums()
        self._asked: deque[_Asked] = deque(maxlen=_REFERENCES)
        self._newest: Reading | None = None
        self._rows = 0
        self._around = np.empty((2, _BLOCK, N_JOINTS))  # the references before and after
        self._times = np.empty((2, _BLOCK))
        self._measured = np.empty((_BLOCK, N_JOINTS))
        self._share = np.empty(_BLOCK)  # of the way from the one before to the one after

    def asked(self, stamp: int, target: Target, *, playing: bool) -> None:
        """A reference was published at `stamp`, ns since the epoch."""
        if self._asked and (last := self._asked[-1]).playing:
            gap = stamp - last.stamp
            self.duration += gap if 0 <= gap <= MAX_GAP_NS else 0
        self._asked.append(_Asked(stamp, target.q, target.motion_time, playing))

    def received(self, measured: Reading) -> None:
        """A LowState was received; the references around the one before it are known by now."""
        previous, self._newest = self._newest, measured
        if previous is None:
            return
        published, received = previous.stamps
        time = published if 0 <= received - published <= MAX_GAP_NS else received
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
        row, self._rows = self._rows, self._rows + 1
        self._around[0, row], self._around[1, row] = before.q, after.q
        self._times[:, row] = before.motion_time, after.motion_time
        self._measured[row] = measured.q
        self._share[row] = (time - before.stamp) / gap
        if self._rows == _BLOCK:
            self._add()

    def _add(self) -> None:
        rows, self._rows = slice(self._rows), 0
        (q, later), (times, later_times) = self._around[:, rows], self._times[:, rows]
        share = self._share[rows]
        error = q + share[:, np.newaxis] * (later - q) - self._measured[rows]
        self._sums.add(error, times + share * (later_times - times))

    def finish(self) -> ErrorSums:
        """The errors of all states, after the last one."""
        if self._rows:
            self._add()
        return self._sums
