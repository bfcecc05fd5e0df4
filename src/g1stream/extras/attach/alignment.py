"""Find when a motion was played in recorded joint positions.

Joint velocities of the recording are compared with those of the motion by normalised
cross-correlation: short windows of one with all windows of the other. A playback of the motion is a
straight line in that table, because time in the motion advances with time in the recording. Least
squares on the joint positions then gives the line's offset and speed.
"""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from g1stream.analysis.tracking import interpolated, rms
from g1stream.session.streams import MAX_GAP_NS

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from g1stream.motion.trajectory import Trajectory
    from g1stream.types import Floats

__all__ = ["Alignment", "Play", "find_plays", "least_similarity"]

#: A longer gap without samples separates two recordings; shorter recordings are ignored, s.
_PAUSE, _SHORTEST = 60.0, 1.0
#: Sampling rate for comparing velocities, Hz.
_RATE: Final = 25
#: Length of a window, s, and the least number of windows in a short motion.
_WINDOW, _FEWEST_WINDOWS = 2.0, 2
#: Most pairs of windows to compare at one speed, and at each of several.
_PAIRS, _FEWER_PAIRS = 4_000_000, 400_000
_BLOCK: Final = 4096
#: Speeds that are tried if the motion was not played at its own speed, and the limits of a speed.
_SPEEDS: Final = tuple(1.1 ** np.arange(-8, 9))
_SLOWEST, _FASTEST = 0.4, 2.5
#: Velocities below these are rest: RMS over the joints, and of one joint, rad/s.
_REST, _JOINT_RESTS = 0.05, 0.05
#: Number of places in the table that are refined, and the time between them, s.
_CANDIDATES, _APART = 6, 0.5
#: Places with at least this fraction of the best score are refined.
_WORTH: Final = 0.2
#: Least squares: most samples, first time span on either side, s, steps for each span, and the
#: growth factor of the span.
_SAMPLES, _FIRST_SPAN, _STEPS, _GROWTH = 600, 2.0, 5, 1.6
#: A joint, or a second of all joints, follows the motion if velocities correlate by more.
_FOLLOWS: Final = 0.5
#: Least similarity of a playback, by its length, s. Other motions reach 0.9 for 3 s.
_SECONDS, _SIMILAR = (0.0, 3.0, 6.0, 10.0), (1.0, 0.96, 0.85, 0.7)
#: Another place is as good as the best if its similarity is at least this fraction of the best.
_RIVAL: Final = 0.9


class Play(NamedTuple):
    """One playback of a motion.

    Attributes:
        start: time of the motion's first frame, even if that was not played, s, on the clock of
            the recorded samples.
        speed: seconds of the motion per second of that clock.
        first, last: the played part of the motion, s.
        similarity: -1 to 1, normalised cross-correlation of all joint velocities in that part.
        rmse: RMSE of the joints that follow, without each joint's mean error, rad.
        joints: (29,) which joints follow.
    """

    start: float
    speed: float
    first: float
    last: float
    similarity: float
    rmse: float
    joints: NDArray[np.bool_]

    @property
    def seconds(self) -> float:
        """Length of the played part, s of the motion."""
        return self.last - self.first

    @property
    def span(self) -> tuple[float, float]:
        """Start and end of the playback, s on the clock of the samples."""
        return self.start + self.first / self.speed, self.start + self.last / self.speed

    @property
    def explained(self) -> float:
        """Similarity times length, s."""
        return max(self.similarity, 0.0) * self.seconds

    def is_rival(self, other: Play) -> bool:
        """Whether another playback is at the same time, but at another place in the motion."""
        (start, end), (other_start, other_end) = self.span, other.span
        same = abs(self.start - other.start) < _APART and abs(self.speed / other.speed - 1) < 0.02
        return min(end, other_end) > max(start, other_start) and not same

    def is_similar(self) -> bool:
        """Whether it is similar enough for its length."""
        return self.similarity >= least_similarity(self)

    @property
    def rank(self) -> tuple[bool, float]:
        """Orders places in a recording: the best has the greatest."""
        return self.is_similar(), self.explained


class Alignment(NamedTuple):
    """The playbacks of a motion in a recording.

    Attributes:
        plays: all playbacks, in order of time; may be empty.
        best: the playback with the most similarity times length.
        rival: another place in the motion for the time of the best playback; None if no other is
            similar. Without any playback it is the most similar place.
        ambiguous: whether the rival is as good as the best playback.
    """

    plays: tuple[Play, ...]
    best: Play | None
    rival: Play | None
    ambiguous: bool


def find_plays(times: Floats, q: Floats, trajectory: Trajectory) -> Alignment:
    """Find all playbacks of a motion that have the speed of the best one.

    Args:
        times: (N,) s, increasing.
        q: (N, 29) rad, motor order: measured positions, or the targets of commands.
        trajectory: the motion.
    """
    # A clock may have been stepped by years.
    pauses = np.flatnonzero(np.diff(times) > _PAUSE) + 1
    parts = np.split(np.arange(len(times)), pauses)
    found = [places for part in parts for places in _search(times[part], q[part], trajectory)]
    found.sort(key=lambda places: places[0].rank, reverse=True)
    plays = [places[0] for places in found if places[0].is_similar()]
    best = plays[0] if plays else None
    others = found[0][1:] if best else [one for places in found for one in places]
    rival = max(others, key=lambda one: one.explained, default=None)
    ambiguous = bool(best and rival and rival.explained >= _RIVAL * best.explained)
    return Alignment(tuple(sorted(plays, key=lambda play: play.span)), best, rival, ambiguous)


def least_similarity(play: Play) -> float:
    """The similarity from which on a part of this length counts as a playback."""
    return float(np.interp(play.seconds / play.speed, _SECONDS, _SIMILAR))


def _search(
    times: Floats, q: Floats, trajectory: Trajectory, speed: float | None = None
) -> list[list[Play]]:
    """The playbacks, each with its rivals; without any, the places that are most similar.

    The speed is 1 or the best one if it is not given.
    """
    if len(times) < 2 or times[-1] - times[0] < _SHORTEST:
        return []
    signal = _Signal(times, q)
    places = _best_places(signal, trajectory, [speed or 1.0], _PAIRS)
    # A short match may be chance, and another speed may explain more.
    enough = 0.5 * min(signal.moving, trajectory.duration)
    if not (speed or any(one.is_similar() and one.explained > enough for one in places)):
        places += _best_places(signal, trajectory, _SPEEDS, _FEWER_PAIRS)
    places.sort(key=lambda place: place.rank, reverse=True)
    if not places or not places[0].is_similar():
        return [places] if places else []
    best = places[0]
    rivals = [one for one in places if one.is_rival(best)]
    before, after = np.searchsorted(times, best.span)
    return [
        *_search(times[:before], q[:before], trajectory, best.speed),
        [best, *rivals],
        *_search(times[after:], q[after:], trajectory, best.speed),
    ]


def _best_places(
    signal: _Signal, trajectory: Trajectory, speeds: Sequence[float], pairs: int
) -> list[Play]:
    """The most similar places at some speeds; a place may be there twice."""
    places = [place for speed in speeds for place in _places(signal, trajectory, speed, pairs)]
    places.sort(key=lambda place: -place.score)
    found = []
    for place in places[:_CANDIDATES]:
        if place.score >= _WORTH * places[0].score:
            with suppress(_NotPlayedError):
                found.append(_refined(signal, trajectory, place))
    return found


class _NotPlayedError(Exception):
    """The motion was not played at a place."""


class _Signal:
    """Recorded joints.

    Attributes:
        times, q: as in the constructor.
        grid: (T,) s, `_RATE` a second.
        dq: (T, 29) rad/s on the grid.
        known: (T,) whether there are samples nearby.
        moving: total time in which the joints move, s.
        joints: (29,) which joints move in that time.
    """

    def __init__(self, times: Floats, q: Floats) -> None:
        self.times, self.q = times, q
        self.grid = np.arange(times[0], times[-1], 1.0 / _RATE)
        # The mean over each step, which has less noise than the sample at it.
        total = np.zeros(q.shape)
        np.cumsum(0.5 * np.diff(times)[:, np.newaxis] * (q[1:] + q[:-1]), axis=0, out=total[1:])
        edges = np.append(self.grid, self.grid[-1] + 1.0 / _RATE) - 0.5 / _RATE
        edges = edges.clip(times[0], times[-1])
        integrals = np.diff(interpolated(edges, times, total), axis=0)
        self.dq = _velocities(integrals / np.diff(edges)[:, np.newaxis])
        after = np.searchsorted(times, self.grid).clip(1, len(times) - 1)
        gap = times[after] - times[after - 1]
        self.known = gap <= max(MAX_GAP_NS / 1e9, 3.0 * float(np.median(np.diff(times))))
        self.dq[~self.known] = 0.0
        moves = rms(self.dq.T) > _REST
        self.moving = float(moves.sum() / _RATE)
        self.joints = np.square(self.dq[moves]).sum(axis=0) > _JOINT_RESTS**2 * moves.sum()


def _velocities(q: Floats) -> Floats:
    """(T, 29) rad/s from positions at the grid's rate; the same method for both sides."""
    dq: Floats = np.gradient(q, 1.0 / _RATE, axis=0)
    return dq


class _Place(NamedTuple):
    """A line in the table of windows. `centre` is its most similar point, s in the recording."""

    score: float
    start: float
    speed: float
    centre: float


def _places(signal: _Signal, trajectory: Trajectory, speed: float, most: int) -> Iterator[_Place]:
    """The best places of a motion at a speed, best first."""
    step = speed / _RATE
    at = np.arange(0.0, trajectory.duration + 0.5 * step, step)
    length = round(_RATE * min(_WINDOW, trajectory.duration / speed / _FEWEST_WINDOWS))
    if length < 2 or len(signal.grid) < 2 * length:
        return
    dq = _velocities(trajectory.sample_joints(at)[0])
    joints = signal.joints & (rms(dq) > 0.0)
    if not joints.any():
        return
    ours, theirs = signal.dq[:, joints], dq[:, joints]
    n_motion = len(dq) - length + 1
    moves = sliding_window_view(rms(ours.T), length).mean(axis=1) > _REST
    rows = np.flatnonzero(moves & sliding_window_view(signal.known, length).all(axis=1))
    rows = rows[:: max(1, -(-len(rows) // max(8, most // n_motion)), length // 4)]
    if not len(rows):
        return
    windows = _normalised(ours, length, rows)
    similar = np.empty((len(rows), n_motion), np.float32)
    for first in range(0, n_motion, _BLOCK):
        columns = np.arange(first, min(first + _BLOCK, n_motion))
        similar[:, columns] = windows @ _normalised(theirs, length, columns).T
    # Cubed, because one similar window is worth more than many slightly similar ones.
    weight = np.clip(similar, 0.0, None) ** 3
    lags = rows[:, np.newaxis] - np.arange(n_motion)
    lowest = int(lags.min())
    score = np.bincount((lags - lowest).ravel(), weight.ravel()) / len(rows)
    apart = round(_APART * _RATE)
    for _ in range(_CANDIDATES):
        lag = int(score.argmax())
        if score[lag] <= 0.0:
            return
        line = np.where(lags == lag + lowest, weight, 0.0).max(axis=1)
        begins = float(signal.grid[0] + (lag + lowest) / _RATE)
        centre = float(signal.grid[rows[line.argmax()]] + 0.5 * length / _RATE)
        yield _Place(float(score[lag]), begins, speed, centre)
        score[max(0, lag - apart) : lag + apart + 1] = 0.0


def _normalised(dq: Floats, length: int, rows: NDArray[np.intp]) -> NDArray[np.float32]:
    """(R, length * J) windows that begin at some rows, with norm 1, or 0 without movement."""
    windows = sliding_window_view(dq.astype(np.float32), length, axis=0)[rows]
    flat = windows.reshape(len(rows), -1)
    norm = np.linalg.norm(flat, axis=1, keepdims=True)
    flat /= np.maximum(norm, 1e-9)
    flat[norm.ravel() < _REST * np.sqrt(flat.shape[1])] = 0.0
    return flat


def _refined(signal: _Signal, trajectory: Trajectory, place: _Place) -> Play:
    """Refine a place by least squares over a span that grows from its most similar point.

    The initial speed must be accurate enough that the ends of the span are off by only a
    fraction of a movement. A longer span gives a more accurate speed.

    Raises:
        _NotPlayedError: nothing similar is there.
    """
    start, speed, span = place.start, place.speed, _FIRST_SPAN
    whole = False
    while not whole:
        whole = span * speed > trajectory.duration
        first = max(start, place.centre - span)
        last = min(start + trajectory.duration / speed, place.centre + span)
        for _ in range(_STEPS):
            start, speed = _improved(signal, trajectory, start, speed, (first, last), signal.joints)
        span *= _GROWTH
    play = _measured(signal, trajectory, start, speed)
    for _ in range(2):  # without the samples outside the playback
        better = _improved(signal, trajectory, *play[:2], play.span, play.joints)
        play = _measured(signal, trajectory, *better)
    return play


def _improved(
    signal: _Signal,
    trajectory: Trajectory,
    start: float,
    speed: float,
    span: tuple[float, float],
    joints: NDArray[np.bool_],
) -> tuple[float, float]:
    """Start and speed after a Gauss-Newton step.

    Each joint has its own mean error. Samples far off have a low weight (Cauchy), because samples
    from outside the motion must not affect the result.

    Raises:
        _NotPlayedError: the samples in the span do not tell both.
    """
    rows = np.arange(*np.searchsorted(signal.times, span))
    rows = rows[:: max(1, len(rows) // _SAMPLES)]
    if len(rows) < 10:
        raise _NotPlayedError
    middle = 0.5 * (span[0] + span[1])
    pos, slope = trajectory.sample_joints(speed * (signal.times[rows] - start))
    slope, error = slope[:, joints], (signal.q[rows] - pos)[:, joints]
    error -= np.median(error, axis=0)
    size = rms(error.T)
    weight = 1.0 / (1.0 + np.square(size / max(2.0 * float(np.median(size)), 1e-6)))
    # The parameters are the motion time at the span's middle, and the speed: independent.
    away = (signal.times[rows] - middle)[:, np.newaxis]
    by_time, by_speed, wanted = (
        np.sqrt(weight)[:, np.newaxis] * (values - np.average(values, axis=0, weights=weight))
        for values in (slope, slope * away, error)
    )
    both = np.vdot(by_time, by_speed)
    matrix = np.array([[np.vdot(by_time, by_time), both], [both, np.vdot(by_speed, by_speed)]])
    if np.linalg.det(matrix) <= 1e-9 * matrix[0, 0] * matrix[1, 1]:
        raise _NotPlayedError
    ahead, faster = np.linalg.solve(matrix, [np.vdot(by_time, wanted), np.vdot(by_speed, wanted)])
    in_motion = speed * (middle - start) + np.clip(ahead, -0.5, 0.5)
    speed += float(np.clip(faster, -0.2 * speed, 0.2 * speed))
    if not _SLOWEST < speed < _FASTEST:
        raise _NotPlayedError
    return float(middle - in_motion / speed), speed


def _measured(signal: _Signal, trajectory: Trajectory, start: float, speed: float) -> Play:
    """Measure which part of the motion was played at a place, and its similarity.

    Raises:
        _NotPlayedError: nothing similar is there.
    """
    at = speed * (signal.grid - start)
    inside = (at >= 0.0) & (at <= trajectory.duration)
    if inside.sum() < _RATE:
        raise _NotPlayedError
    ours, at, known = signal.dq[inside], at[inside], signal.known[inside]
    theirs = _velocities(trajectory.sample_joints(at)[0])
    ours, theirs, at = ours[known], theirs[known], at[known]
    part = _longest_following(ours, theirs)
    ours, theirs = ours[part], theirs[part]
    # A joint that rests in both follows.
    own, other = np.square(ours).sum(axis=0), np.square(theirs).sum(axis=0)
    product = (ours * theirs).sum(axis=0)
    joints = product > _FOLLOWS * np.sqrt(own * other + 1e-12)
    joints |= np.maximum(own, other) < _JOINT_RESTS**2 * len(ours)
    if not joints.any():
        raise _NotPlayedError
    similarity = product[joints].sum() / np.sqrt(own[joints].sum() * other[joints].sum() + 1e-12)
    edges = np.concatenate([[0.0], 0.5 * (at[1:] + at[:-1]), [trajectory.duration]])
    ends = edges[[part.start, part.stop]]
    rows = slice(*np.searchsorted(signal.times, start + ends / speed))
    at = speed * (signal.times[rows] - start)
    if not len(at):
        raise _NotPlayedError
    error = (trajectory.sample_joints(at)[0] - signal.q[rows])[:, joints]
    # Positions tell the ends more exactly: before and after a playback the robot is elsewhere.
    size = rms((error - np.median(error, axis=0)).T)
    near = np.flatnonzero(size <= 2.0 * np.quantile(size, 0.9) + 0.01)
    at, error = at[near[0] : near[-1] + 1], error[near[0] : near[-1] + 1]
    rmse = float(rms(rms(error - error.mean(axis=0))))
    return Play(start, speed, float(at[0]), float(at[-1]), float(similarity), rmse, joints)


def _longest_following(ours: Floats, theirs: Floats) -> slice:
    """The range of rows with the most similarity, in which velocities (T, 29) follow others."""
    own, other = rms(ours.T), rms(theirs.T)
    similar = (ours * theirs).mean(axis=1) / np.maximum(own * other, 1e-12)
    gain = np.where(np.maximum(own, other) < _REST, 0.0, similar - _FOLLOWS)
    total = np.concatenate([[0.0], np.cumsum(gain)])
    # Rest at either end belongs to the playback, because there is no evidence against it.
    end = len(total) - 1 - int((total - np.minimum.accumulate(total))[::-1].argmax())
    begin = int(total[: end + 1].argmin())
    if end - begin < _RATE // 2:
        raise _NotPlayedError
    return slice(begin, end)
