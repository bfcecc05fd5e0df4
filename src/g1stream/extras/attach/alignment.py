"""Find when a motion was played in recorded joint positions.

Joint velocities of the recording are compared with those of the motion by normalised
cross-correlation: short windows of one with all windows of the other. A playback of the motion is a
straight line in that table, because time in the motion advances with time in the recording. Least
squares on the joint positions then gives the line's offset and speed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from g1stream.analysis.tracking import interpolated, rms
from g1stream.session.streams import MAX_GAP_NS

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

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
#: Most pairs of windows to compare at speed 1, and at each other speed.
_PAIRS, _FEWER_PAIRS = 4_000_000, 400_000
_BLOCK: Final = 4096
#: Speeds that are tried if the motion was not played at its own speed: 0.25 to 4.
_SPEEDS: Final = tuple(
    sorted((1.1**i for i in range(-14, 15) if i), key=lambda speed: abs(np.log(speed)))
)
#: Velocities below these are rest: RMS over the joints, and of one joint, rad/s.
_REST, _JOINT_RESTS = 0.05, 0.05
#: Number of places in the table that are refined, and the time between them, s.
_CANDIDATES, _APART = 6, 0.5
#: Places with at least this fraction of the best score are refined.
_WORTH: Final = 0.2
#: Least squares: most samples, first time span on either side, s, steps for each span, and the
#: growth factor of the span.
_SAMPLES, _FIRST_SPAN, _STEPS, _GROWTH = 600, 2.0, 5, 1.6
#: Lowest speed; the highest is its inverse.
_SLOWEST: Final = 0.2
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


def find_plays(
    times: Floats, q: Floats, trajectory: Trajectory, *, any_speed: bool = True
) -> Alignment:
    """Find all playbacks of a motion.

    Args:
        times: (N,) s, increasing.
        q: (N, 29) rad, motor order: measured positions, or the targets of commands.
        trajectory: the motion.
        any_speed: try speeds from a quarter to four times if it was not played at its own speed.
    """
    # A clock may have been stepped by years.
    pauses = np.flatnonzero(np.diff(times) > _PAUSE) + 1
    signals = [
        _Signal(times[part], q[part])
        for part in np.split(np.arange(len(times)), pauses)
        if len(part) > 1 and times[part[-1]] - times[part[0]] > _SHORTEST
    ]
    found = [play for signal in signals for play in _search(signal, trajectory, any_speed)]
    plays = sorted(_distinct(filter(_is_play, found)), key=lambda play: play.span)
    best = max(plays, key=lambda play: play.explained, default=None)
    others = found
    if best:  # the same place with worse convergence is no other place
        others = [one for one in found if _overlap(one, best) and not _is_same(one, best)]
    rival = max(others, key=lambda one: one.explained, default=None)
    ambiguous = bool(best and rival and rival.explained >= _RIVAL * best.explained)
    return Alignment(tuple(plays), best, rival, ambiguous)


def _search(signal: _Signal, trajectory: Trajectory, any_speed: bool) -> list[Play]:
    """Places that are similar to the motion: playbacks, and other places at the same times."""
    found: list[Play] = []
    for speeds, pairs in (((1.0,), _PAIRS), (_SPEEDS if any_speed else (), _FEWER_PAIRS)):
        while new := _best_places(signal, trajectory, speeds, pairs):
            found += new
            free = int(signal.free.sum())
            for play in filter(_is_play, new):  # then search the remaining time
                signal.set_aside(play)
            if signal.free.sum() == free:
                break
        # A short match may be chance, and another speed may explain more.
        explained = sum(play.explained for play in _distinct(filter(_is_play, found)))
        if explained > 0.5 * min(signal.moving, trajectory.duration):
            break
    return found


def _best_places(
    signal: _Signal, trajectory: Trajectory, speeds: Sequence[float], pairs: int
) -> list[Play]:
    """The most similar places at some speeds, without duplicates."""
    places = [place for speed in speeds for place in _places(signal, trajectory, speed, pairs)]
    places.sort(key=lambda place: -place.score)
    found: list[Play] = []
    for place in places[:_CANDIDATES]:
        if place.score < _WORTH * places[0].score:
            break
        play = _refined(signal, trajectory, place)
        if play is not None and not any(_is_same(play, other) for other in found):
            found.append(play)
    return found


def _distinct(plays: Iterable[Play]) -> list[Play]:
    """The best of the playbacks at each time, best first."""
    found: list[Play] = []
    for play in sorted(plays, key=lambda play: -play.explained):
        if not any(_overlap(play, other) for other in found):
            found.append(play)
    return found


def least_similarity(play: Play) -> float:
    """The similarity from which on a part of this length counts as a playback."""
    return float(np.interp(play.seconds / play.speed, _SECONDS, _SIMILAR))


def _is_play(play: Play) -> bool:
    return play.similarity >= least_similarity(play)


def _is_same(one: Play, other: Play) -> bool:
    return abs(one.start - other.start) < _APART and abs(one.speed / other.speed - 1.0) < 0.02


def _overlap(one: Play, other: Play) -> bool:
    (start, end), (other_start, other_end) = one.span, other.span
    return min(end, other_end) - max(start, other_start) > 0.0


class _Signal:
    """Recorded joints.

    Attributes:
        times, q: as in the constructor.
        grid: (T,) s, `_RATE` a second.
        dq: (T, 29) rad/s on the grid.
        known: (T,) whether there are samples nearby.
        free: (T,) whether no playback was found there.
        moving: total time in which the joints move, s.
        joints: (29,) which joints move in that time.
    """

    def __init__(self, times: Floats, q: Floats) -> None:
        self.times, self.q = times, q
        self.grid = np.arange(times[0], times[-1], 1.0 / _RATE)
        # The mean over each step, which has less noise than the sample at it.
        edges = np.append(self.grid, self.grid[-1] + 1.0 / _RATE) - 0.5 / _RATE
        total = np.zeros(q.shape)
        np.multiply(q[1:] + q[:-1], 0.5 * np.diff(times)[:, np.newaxis], out=total[1:])
        np.cumsum(total, axis=0, out=total)
        self.dq = _velocities(_RATE * np.diff(_extended(edges, times, total, q), axis=0))
        after = np.searchsorted(times, self.grid).clip(1, len(times) - 1)
        gap = times[after] - times[after - 1]
        self.known = gap <= max(MAX_GAP_NS / 1e9, 3.0 * float(np.median(np.diff(times))))
        self.dq[~self.known] = 0.0
        self.free = np.ones(len(self.grid), dtype=bool)
        moves = rms(self.dq.T) > _REST
        self.moving = float(moves.sum() / _RATE)
        self.joints = (
            rms(self.dq[moves]) > _JOINT_RESTS if moves.any() else np.zeros(q.shape[1], bool)
        )

    def set_aside(self, play: Play) -> None:
        """Exclude the time of a playback from the search."""
        start, end = play.span
        self.free[(self.grid >= start) & (self.grid <= end)] = False


def _extended(at: Floats, times: Floats, total: Floats, q: Floats) -> Floats:
    """The integral (N, 29) of positions q (N, 29) at any times; positions rest outside `times`."""
    found = interpolated(at, times, total)
    found += np.minimum(at - times[0], 0.0)[:, np.newaxis] * q[0]
    found += np.maximum(at - times[-1], 0.0)[:, np.newaxis] * q[-1]
    return found


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
    moving = signal.joints & (rms(dq) > 0.0)
    if not moving.any() or len(dq) < length:
        return
    n_motion = len(dq) - length + 1
    rows = _windows(signal, moving, length, max(8, most // n_motion))
    if not len(rows):
        return
    ours = _normalised(signal.dq[:, moving], length, rows)
    similar = np.empty((len(rows), n_motion), np.float32)
    for first in range(0, n_motion, _BLOCK):
        columns = np.arange(first, min(first + _BLOCK, n_motion))
        similar[:, columns] = ours @ _normalised(dq[:, moving], length, columns).T
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
        columns = rows - (lag + lowest)
        inside = (columns >= 0) & (columns < n_motion)
        line = np.where(inside, weight[np.arange(len(rows)), columns.clip(0, n_motion - 1)], -1.0)
        row = int(rows[line.argmax()])
        begins = float(signal.grid[0] + (lag + lowest) / _RATE)
        centre = float(signal.grid[row] + 0.5 * length / _RATE)
        yield _Place(float(score[lag]), begins, speed, centre)
        score[max(0, lag - apart) : lag + apart + 1] = 0.0


def _windows(
    signal: _Signal, moving: NDArray[np.bool_], length: int, most: int
) -> NDArray[np.intp]:
    """First rows of the recording's windows in which joints move, evenly spaced."""
    speed = np.sqrt(np.square(signal.dq[:, moving]).mean(axis=1))
    total = np.concatenate([[0.0], np.cumsum(speed)])
    known = np.concatenate([[0], np.cumsum(signal.known & signal.free)])
    starts = np.arange(len(speed) - length + 1)
    moves = (total[starts + length] - total[starts]) / length > _REST
    rows = starts[moves & (known[starts + length] - known[starts] == length)]
    return np.asarray(rows[:: max(1, -(-len(rows) // most), length // 4)])


def _normalised(dq: Floats, length: int, rows: NDArray[np.intp]) -> NDArray[np.float32]:
    """(R, length * J) windows that begin at some rows, with norm 1, or 0 without movement."""
    windows = sliding_window_view(dq.astype(np.float32), length, axis=0)[rows]
    flat = windows.reshape(len(rows), -1)
    norm = np.linalg.norm(flat, axis=1, keepdims=True)
    rest = norm < _REST * np.sqrt(flat.shape[1])
    found: NDArray[np.float32] = np.where(rest, 0.0, flat / np.maximum(norm, 1e-9))
    return found.astype(np.float32, copy=False)


def _refined(signal: _Signal, trajectory: Trajectory, place: _Place) -> Play | None:
    """Refine a place by least squares over a span that grows from its most similar point.

    The initial speed must be accurate enough that the ends of the span are off by only a
    fraction of a movement. A longer span gives a more accurate speed.
    """
    start, speed, span = place.start, place.speed, _FIRST_SPAN
    joints = signal.joints
    whole = False
    while not whole:
        whole = span * speed > trajectory.duration
        first = max(start, place.centre - span)
        last = min(start + trajectory.duration / speed, place.centre + span)
        for _ in range(_STEPS):
            better = _least_squares(signal, trajectory, joints, (start, speed), (first, last))
            if better is None:
                return None
            start, speed = better
        if not _SLOWEST < speed < 1.0 / _SLOWEST:
            return None
        span *= _GROWTH
    play = _measure(signal, trajectory, start, speed)
    for _ in range(2):  # without the samples outside the playback
        if play is None:
            return None
        better = _least_squares(signal, trajectory, play.joints, play[:2], play.span)
        if better is None:
            return None
        play = _measure(signal, trajectory, *better)
    return play


def _least_squares(
    signal: _Signal,
    trajectory: Trajectory,
    joints: NDArray[np.bool_],
    place: tuple[float, float],
    span: tuple[float, float],
) -> tuple[float, float] | None:
    """Improve start and speed by a Gauss-Newton step; None if there is no information.

    Each joint has its own mean error. Samples far off have a low weight (Cauchy), because samples
    from outside the motion must not affect the result.
    """
    start, speed = place
    inside = slice(*np.searchsorted(signal.times, span))
    rows = np.arange(inside.start, inside.stop)
    rows = rows[:: max(1, len(rows) // _SAMPLES)]
    if len(rows) < 10:
        return None
    times = signal.times[rows]
    middle = 0.5 * (span[0] + span[1])
    pos, slope = trajectory.sample_joints(speed * (times - start))
    error = signal.q[rows] - pos
    error -= np.median(error, axis=0)
    size = np.sqrt(np.square(error[:, joints]).mean(axis=1))
    scale = max(2.0 * float(np.median(size)), 1e-6)
    weight = 1.0 / (1.0 + np.square(size / scale))
    # The parameters are the motion time at the span's middle, and the speed: independent.
    away = (times - middle)[:, np.newaxis]
    root = np.sqrt(weight)[:, np.newaxis]
    by_time, by_speed, wanted = (
        root * (values - np.average(values, axis=0, weights=weight))
        for values in (slope[:, joints], slope[:, joints] * away, error[:, joints])
    )
    both = np.vdot(by_time, by_speed)
    matrix = np.array([[np.vdot(by_time, by_time), both], [both, np.vdot(by_speed, by_speed)]])
    if np.linalg.det(matrix) <= 1e-9 * matrix[0, 0] * matrix[1, 1]:
        return None
    ahead, faster = np.linalg.solve(matrix, [np.vdot(by_time, wanted), np.vdot(by_speed, wanted)])
    in_motion = speed * (middle - start) + np.clip(ahead, -0.5, 0.5)
    speed += float(np.clip(faster, -0.2 * speed, 0.2 * speed))
    return float(middle - in_motion / speed), speed


def _measure(signal: _Signal, trajectory: Trajectory, start: float, speed: float) -> Play | None:
    """Measure which part of the motion was played at a place, and its similarity."""
    inside = (signal.grid >= start) & (signal.grid <= start + trajectory.duration / speed)
    if inside.sum() < _RATE:
        return None
    at = speed * (signal.grid[inside] - start)
    known = signal.known[inside]
    ours = signal.dq[inside][known]
    theirs = _velocities(trajectory.sample_joints(at)[0])[known]
    at = at[known]
    followed = _longest_following(ours, theirs, at)
    if followed is None:
        return None
    ours, theirs, at = ours[followed], theirs[followed], at[followed]
    joints = _following(ours, theirs)
    if not joints.any():
        return None
    similarity = (ours * theirs)[:, joints].sum() / np.sqrt(
        np.square(ours[:, joints]).sum() * np.square(theirs[:, joints]).sum() + 1e-12
    )
    first, last = _ends(signal, trajectory, (start, speed), (at[0], at[-1]), joints)
    error = _errors(signal, trajectory, (start, speed), (first, last))[:, joints]
    if not len(error):
        return None
    rmse = float(np.sqrt(np.square(error - error.mean(axis=0)).mean()))
    return Play(start, speed, first, last, float(similarity), rmse, joints)


def _longest_following(ours: Floats, theirs: Floats, at: Floats) -> slice | None:
    """The range of rows with the most similarity, in which velocities (T, 29) follow others."""
    n = min(_RATE, len(at))
    kernel = np.ones(n)

    def around(values: Floats) -> Floats:
        found: Floats = np.convolve(values.sum(axis=1), kernel, mode="same")
        return found

    product, own, other = around(ours * theirs), around(ours**2), around(theirs**2)
    rest = _REST**2 * ours.shape[1] * n
    similar = product / np.sqrt(own * other + 1e-12) - _FOLLOWS
    gain = np.where((own < rest) & (other < rest), 0.0, similar) * np.diff(at, append=at[-1])
    total = np.concatenate([[0.0], np.cumsum(gain)])
    lowest = np.minimum.accumulate(total)
    # Rest at either end belongs to the playback, because there is no evidence against it.
    end = len(total) - 1 - int((total - lowest)[::-1].argmax())
    begin = int(total[: end + 1].argmin())
    return slice(begin, end) if end - begin >= _RATE // 2 else None


def _following(ours: Floats, theirs: Floats) -> NDArray[np.bool_]:
    """(29,) which velocities (T, 29) follow others; a joint that rests in both follows."""
    total, other = np.square(ours).sum(axis=0), np.square(theirs).sum(axis=0)
    correlation = (ours * theirs).sum(axis=0) / np.sqrt(total * other + 1e-12)
    rests = np.maximum(total, other) < _JOINT_RESTS**2 * len(ours)
    return np.asarray(rests | (correlation > _FOLLOWS))


def _errors(
    signal: _Signal, trajectory: Trajectory, place: tuple[float, float], part: Sequence[float]
) -> Floats:
    """(N, 29) rad, motion minus recording, in a part of the motion, s."""
    start, speed = place
    span = start + np.asarray(part) / speed
    rows = slice(*np.searchsorted(signal.times, span))
    error: Floats = (
        trajectory.sample_joints(speed * (signal.times[rows] - start))[0] - signal.q[rows]
    )
    return error


def _ends(
    signal: _Signal,
    trajectory: Trajectory,
    place: tuple[float, float],
    part: tuple[float, float],
    joints: NDArray[np.bool_],
) -> tuple[float, float]:
    """Start and end of the played part, s of the motion.

    Velocity windows give them to half a second. Positions are more accurate, because before and
    after a playback the robot is elsewhere.
    """
    start, speed = place
    wide = max(0.0, part[0] - speed), min(trajectory.duration, part[1] + speed)
    rows, inner = (
        slice(*np.searchsorted(signal.times, start + np.asarray(of) / speed)) for of in (wide, part)
    )
    if inner.start == inner.stop:
        return part
    inside = slice(inner.start - rows.start, inner.stop - rows.start)
    at = speed * (signal.times[rows] - start)
    error = _errors(signal, trajectory, place, wide)[:, joints]
    size = rms((error - np.median(error[inside], axis=0)).T)
    most = 2.0 * float(np.quantile(size[inside], 0.9)) + 0.01
    # An error may be large for a moment within the playback, so a sum decides. One sample counts
    # against the playback at most as much as three without an error count for it.
    total = np.cumsum(1.0 - np.minimum(np.square(size / most), 4.0))
    half = 0.5 * (part[0] + part[1])
    before, after = at < min(part[0] + speed, half), at > max(part[1] - speed, half)
    first = np.where(before, np.append(0.0, total[:-1]), np.inf).argmin()
    last = np.where(after, total, -np.inf).argmax()
    return float(at[first]), float(at[last])
