"""Learn from sessions of one motion how to follow it more closely the next time.

Iterative learning control of P-type: after each repetition the joint targets are corrected by the
error of the one before, c' = Q(c + gain * e), with a zero-phase low-pass Q. S. Arimoto, S. Kawamura
and F. Miyazaki, "Bettering operation of robots by learning", Journal of Robotic Systems 1(2), 1984;
D. A. Bristow, M. Tharayil and A. G. Alleyne, "A survey of iterative learning control", IEEE Control
Systems Magazine 26(3), 2006. What is corrected is the reference, not the torque, so that whatever
computes the torque sees a consistent motion.

A joint that follows its target has the error c + e without correction, so that every session
measures the same, whatever its correction was. The next correction approaches the mean of that over
all sessions, in which the n-th repetition has the weight n, times the share of it that repeats.

Four rules keep it from making anything worse. It continues from the best repetition that it is
given. What differs between sessions is not learned; where the simulator is slower than real time,
most of the error may, and one session cannot tell. Nothing is learned from the time after a stall,
of the simulator or of this machine. And where an error did not respond to a change of the
correction, as in a limb that presses against another, that joint's correction is taken back there,
to what it was before, and stays.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.analysis.delay import interpolated
from g1stream.analysis.played import read_played, require_same
from g1stream.errors import RecordingError
from g1stream.motion.correction import LARGEST_CORRECTION, Correction, CorrectionSpline, grid
from g1stream.robot.joints import N_JOINTS
from g1stream.session.session import Session, open_session

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from g1stream.analysis.played import Played
    from g1stream.types import Floats

__all__ = ["Repetition", "improve", "learn", "repeating"]

#: Cut-off of the zero-phase low-pass, Hz. The model's torque makes a joint follow up to some 5 Hz;
#: a servo of Unitree's gains alone moves a leg at less than 1 Hz without lag or resonance.
_CUTOFF: Final = 5.0
_CUTOFF_WITHOUT_TORQUE: Final = 0.5
#: The error is sampled this often for the low-pass, Hz.
_RATE: Final = 500.0
#: Share of the way to the mean that a repetition goes.
_GAIN: Final = 0.8
#: No correction changes by more than this in one repetition, rad: a single session is not believed
#: as it is.
_LARGEST_STEP: Final = 0.05
#: A robot that hangs swings for this long after a stall, s.
_SETTLING: Final = 3.0
#: Below this share of real time a simulator's pace varies, and with it the error.
_STEADY: Final = 0.97
#: Whether an error repeats, and whether it responds, is judged over this time, s.
_WINDOW: Final = 0.5
#: An error is asked to respond where the correction has changed by more than this, rms, rad.
_LEAST_CHANGE: Final = 0.002
#: An error that changes by less than this share of the correction's change does not respond.
_LEAST_RESPONSE: Final = 0.25
#: ... and has not fallen to this share of its square.
_LEAST_FALL: Final = 0.7
#: A correction that is taken back blends into its surroundings over this time, s.
_BLEND: Final = 0.2


@dataclass(frozen=True, eq=False)
class Repetition:
    """One or several sessions with the same correction, on the time grid of the correction.

    Attributes:
        values: (T, 29) rad, the correction that was played.
        error: (T, 29) rad, low-pass filtered error, reference - measured.
        rmse: of all joints, rad, unfiltered.
        frozen: (T, 29) bool, of the correction that was played.
        weight: (T,) sessions in which no stall was near.
        history: RMSE of the repetitions that its correction was learned from, rad.
    """

    values: Floats
    error: Floats
    rmse: float
    frozen: NDArray[np.bool_]
    weight: Floats
    history: tuple[float, ...] = ()


def learn(sessions: Sequence[Session | str | Path] | Session | str | Path) -> Correction:
    """Learn a correction of the joint targets from one or several sessions of a motion.

    Sessions that were themselves played with a correction carry it, so that each repetition
    continues from the ones before. Give all of them: the best one counts, and two or more show
    where correcting does not help. Sessions with the same correction are averaged.

    Args:
        sessions: sessions or their files, recorded by `g1stream stream --record` or made by
            `rollout`, of the same motion, rate, gains, support and feed-forward.

    Raises:
        RecordingError: a session cannot be learned from, or they differ; names in what.
        ConfigError: the correction in a session is damaged.
    """
    given = [sessions] if isinstance(sessions, (Session, str, Path)) else list(sessions)
    if not given:
        raise RecordingError("There is no session to learn from.", "Give one or more.")
    played = [read_played(one if isinstance(one, Session) else open_session(one)) for one in given]
    first = played[0]
    for other in played[1:]:
        require_same(first, other)
    time = grid(first.start, min(one.stop for one in played))
    if len(played) == 1 and first.time_scale < _STEADY:
        raise RecordingError(
            f"In {first.path} the simulator ran at {first.time_scale:.2f} of real time, where "
            "errors differ from run to run, and one session does not tell which repeat.",
            "Learn from two or more sessions that were played in the same way.",
        )
    repetitions = [_repetition(one, time) for one in played]
    reference = interpolated(time, first.time, first.reference)
    values, frozen, history = improve(
        _averaged(repetitions),
        time,
        first.lower - reference,
        first.upper - reference,
        repeating(repetitions, time),
    )
    return Correction(first.conditions, time, values, frozen, np.array(history))


def repeating(sessions: Sequence[Repetition], time: Floats) -> Floats:
    """(T, 29) the share of the mean of c + e over sessions that repeats, 0 to 1.

    1 - (variance of the mean) / (its square), both over a window around each time: the factor by
    which the mean is nearest to what comes next, as in a Wiener filter. 1 for a single session.
    """
    weights = np.array([_weight(one) for one in sessions])
    sums = np.array([one.values + one.error for one in sessions])
    total = np.maximum(weights.sum(axis=0), 1e-9)
    mean = (weights * sums).sum(axis=0) / total
    spread = (weights * (sums - mean) ** 2).sum(axis=0) / total
    effective = total**2 / np.maximum((weights**2).sum(axis=0), 1e-9)  # sessions of equal weight
    variance = np.where(effective > 1.0, spread / np.maximum(effective - 1.0, 1e-9), 0.0)
    power = np.maximum(_smooth(mean**2, time, _WINDOW), 1e-12)
    return np.clip(1.0 - _smooth(variance, time, _WINDOW) / power, 0.0, 1.0)


def improve(
    repetitions: Sequence[Repetition],
    time: Floats,
    lower: Floats,
    upper: Floats,
    share: Floats | float = 1.0,
) -> tuple[Floats, NDArray[np.bool_], tuple[float, ...]]:
    """The next correction from those before and what they have brought; pure.

    Args:
        repetitions: at least one, all on the same grid.
        time: (T,) the grid, s.
        lower: (T, 29) rad, from the joint targets to their lower limits.
        upper: (T, 29) rad, to their upper limits.
        share: (T, 29) of the mean of c + e that repeats, see `repeating`.

    Returns:
        The correction (T, 29) rad, where it is frozen (T, 29), and the RMSE of each repetition.
    """
    in_order = sorted(repetitions, key=lambda one: len(one.history))
    history = (*in_order[-1].history, in_order[-1].rmse)
    # Compared where no repetition has a stall.
    common = np.min([one.weight for one in in_order], axis=0) + 1e-9
    best = min(in_order, key=lambda one: np.average(np.mean(one.error**2, 1), weights=common))
    weights = np.array([_weight(one) for one in in_order])
    sums = np.array([one.values + one.error for one in in_order])
    total = weights.sum(axis=0)
    mean = (weights * sums).sum(axis=0) / np.maximum(total, 1e-9)
    way = np.minimum(total, 1.0) * (share * mean - best.values)  # none where all have a stall
    values = best.values + np.clip(_GAIN * way, -_LARGEST_STEP, _LARGEST_STEP)
    # The first change without effect is taken back last, so that it counts.
    held = [(_unresponsive(*pair, time), pair[0].values) for pair in pairwise(in_order)][::-1]
    held += [(one.frozen, one.values) for one in in_order[::-1]]
    for where, before in held:
        weight = _blend(where, time)
        values = weight * before + (1.0 - weight) * values
    limit = LARGEST_CORRECTION
    values = np.clip(values, np.clip(lower, -limit, 0.0), np.clip(upper, 0.0, limit))
    return values, np.logical_or.reduce([where for where, _ in held]), history


def _weight(one: Repetition) -> Floats:
    """(T, 1) Later ones count more: they were measured nearer to what will be played."""
    return (len(one.history) + 1) * one.weight[:, np.newaxis]


def _unresponsive(before: Repetition, after: Repetition, time: Floats) -> NDArray[np.bool_]:
    """(T, 29) where the correction changed, and the error did not respond.

    A joint that follows its target moves by the change of the correction, and its error changes by
    minus that. The share is the regression of one on the other over a window.
    """
    change, answer = after.values - before.values, before.error - after.error
    # What a stall has left in one of them does not count.
    counted = np.minimum(1.0, np.minimum(before.weight, after.weight))[:, np.newaxis]
    power = _smooth(counted * change * change, time, _WINDOW)
    response = _smooth(counted * change * answer, time, _WINDOW)
    left, was = (_smooth(counted * one.error**2, time, _WINDOW) for one in (after, before))
    found: NDArray[np.bool_] = power > _LEAST_CHANGE**2
    found &= (response < _LEAST_RESPONSE * power) & (left > _LEAST_FALL * was)
    return found & ~before.frozen & ~after.frozen


def _blend(where: NDArray[np.bool_], time: Floats) -> Floats:
    """(T, 29) 1 where it is true, falling smoothly to 0 around it."""
    near = _smooth(where.astype(np.float64), time, _BLEND) > 0.0
    return _smooth(near.astype(np.float64), time, _BLEND)


def _smooth(values: Floats, time: Floats, window: float) -> Floats:
    """(T, J) weighted means over `window` seconds around each time (Hann)."""
    length = 2 * max(1, round(window / (time[1] - time[0]) / 2)) + 1
    weights = np.hanning(length + 2)[1:-1]
    norm = np.convolve(np.ones(len(time)), weights, "same")
    return np.column_stack([np.convolve(column, weights, "same") / norm for column in values.T])


def _repetition(one: Played, time: Floats) -> Repetition:
    """A session, with the correction that it was played with, on a grid."""
    values = np.zeros((len(time), N_JOINTS))
    frozen, history = np.zeros(values.shape, dtype=np.bool_), ()
    if one.correction:
        values = CorrectionSpline(one.correction, one.start, one.stop).at_many(time)
        nearest = np.abs(one.correction.time[:, np.newaxis] - time).argmin(axis=0)
        frozen = one.correction.frozen[nearest]
        history = tuple(one.correction.history.tolist())
    weight = _undisturbed(one, time)
    return Repetition(values, _filtered(one, time), one.rmse, frozen, weight, history)


def _averaged(sessions: Sequence[Repetition]) -> list[Repetition]:
    """A repetition for each correction that was played, the mean of its sessions."""
    groups: dict[bytes, list[Repetition]] = {}
    for one in sessions:
        # Rounded: the last bit depends on the interval that was played.
        groups.setdefault(np.round(one.values, 9).tobytes(), []).append(one)
    return [_mean(group) for group in groups.values()]


def _mean(group: Sequence[Repetition]) -> Repetition:
    weights = np.array([one.weight for one in group])
    # Where all have a stall, the error counts nowhere.
    shares = (weights + 1e-9) / (weights + 1e-9).sum(axis=0)
    return Repetition(
        group[0].values,
        np.einsum("st,stj->tj", shares, [one.error for one in group]),
        float(np.mean([one.rmse for one in group])),
        group[0].frozen,
        weights.sum(axis=0),
        group[0].history,
    )


def _undisturbed(played: Played, time: Floats) -> Floats:
    """(T,) 0 from a stall until the robot has settled, otherwise 1."""
    disturbed = np.zeros((len(time), 1), dtype=np.bool_)
    for begin, end in played.stalls:
        disturbed |= ((time > begin) & (time < end + _SETTLING))[:, np.newaxis]
    return 1.0 - _blend(disturbed, time)[:, 0]


def _filtered(played: Played, time: Floats) -> Floats:
    """(T, 29) the error, low-pass filtered without delay."""
    from scipy.signal import butter, filtfilt

    with_torque = played.conditions.feedforward == "dynamics"
    cutoff = _CUTOFF if with_torque else _CUTOFF_WITHOUT_TORQUE
    numerator, denominator = butter(2, cutoff / (_RATE / 2))
    fine = np.arange(time[0], time[-1] + 1.0 / _RATE, 1.0 / _RATE)
    error = interpolated(fine, played.time, played.error)
    padding = min(len(fine) - 1, round(_RATE / cutoff))
    smooth = filtfilt(numerator, denominator, error, axis=0, padlen=padding)
    return interpolated(time, fine, smooth)
