"""How closely a robot followed its reference in PLAY.

A LowState shows the effect of commands published before it, but not how long before its publish
time it was measured. A tracking delay is therefore the whole time from the publish time of a
reference to that of the state that shows it: DDS, the servo, and the time between measuring and
publishing.

The delay is found by cross-correlation of joint positions. For each joint and each delay of a
grid, the measured position is correlated with the delayed reference. The result is the delay
with the least unexplained variance, interpolated by a parabola through it and its neighbours.
Scale and mean of a joint do not matter: a joint that moves less than commanded, or sags, is not
late. Targets of a slow policy are held, so the delay grows within each of its steps. The result
is the mean over these steps, because states are compared at their own times; of many states, a
random one of each interval, which is not in step with anything.

The confidence interval is that of least squares with correlated residuals. Each second counts as
one observation, so that a lasting disturbance does not count many times (K.-Y. Liang and S. Zeger,
"Longitudinal data analysis using generalized linear models", Biometrika, 1986).
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, cached_property
from statistics import NormalDist
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from g1stream.control.tracking_error import ErrorSums
from g1stream.dds.messages import played_joints
from g1stream.errors import RecordingError
from g1stream.input_limits import NUMBER
from g1stream.robot.joints import AB_JOINTS, JOINT_GROUPS, JOINT_NAMES
from g1stream.session.recording import once
from g1stream.session.records import Int, Record
from g1stream.session.streams import (
    MAX_GAP_NS,
    CommandStream,
    MeasuredStream,
    Neighbours,
    ReferenceStream,
    Stream,
    neighbours,
)
from g1stream.types import Floats, Phase

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from g1stream.control.tracking_error import RunningError
    from g1stream.session.recording import Recording

__all__ = [
    "UNSURE",
    "Delay",
    "ErrorStats",
    "JointErrors",
    "NothingToCompareError",
    "Tracking",
    "TrackingSummary",
    "blocks",
    "compare",
    "errors_of_run",
    "interpolated",
    "no_joints",
    "parallel",
    "pooled",
    "rms",
    "tracking",
]

#: Rows of 29 joints in one block of a computation.
_BLOCK: Final = 2048

#: Range of the grid of delays, in steps: -0.02 to 0.2 s. Positive: the robot is behind.
_STEP: Final = 0.005
_LAGS: Final = np.arange(-4, 41)
#: Most states that are compared, and that are compared at every delay of the grid.
_MOST_STATES, _MOST_ON_GRID = 20_000, 2_000
#: A joint is used if reference and measurement both span more than this, rad.
_MOVES: Final = 0.05
#: Length of an observation, s, and the least number for a confidence interval.
_OBSERVATION: Final = 1.0
_FEWEST_OBSERVATIONS: Final = 5


class NothingToCompareError(RecordingError):
    """A session has no state in PLAY, or no reference."""


class ErrorStats(Record):
    """The tracking error, reference - measured, of a joint or of several joints together.

    `Session.summary` leaves fields None that take long to compute; `Session.metrics` sets them.

    Attributes:
        rmse_rad: root mean square.
        bias_rad: mean, such as the sag under gravity; for several joints the root mean square of
            their means.
        max_abs_rad: largest absolute error.
        max_abs_at_s: its time, since the motion's first frame.
        worst_joint: the joint with the largest RMSE; None for a single joint.
        mae_rad: mean absolute error.
        p99_rad: 99th percentile of the absolute error.
        delay_s: delay of the joints behind the reference; None without enough movement.
        delay_ci95_s: half the width of the delay's 95 % confidence interval.
        correlation: 0 to 1, of the measurement with the reference at that delay.
        velocity_rmse_rad_s: of the joint velocities; None if the robot reports none.
        acceleration_rmse_rad_s2: of the joint accelerations; None likewise.
    """

    rmse_rad: float
    bias_rad: float
    max_abs_rad: float
    max_abs_at_s: float
    worst_joint: str | None = None
    mae_rad: float | None = None
    p99_rad: float | None = None
    delay_s: float | None = None
    delay_ci95_s: float | None = None
    correlation: float | None = None
    velocity_rmse_rad_s: float | None = None
    acceleration_rmse_rad_s2: float | None = None


class TrackingSummary(Record):
    """How closely the joints followed the reference in PLAY.

    Attributes:
        compared_states: LowStates that were compared with the reference.
        excluded_states: LowStates in PLAY in a gap of the reference, or with non-finite values.
        compared_s: length of PLAY without gaps.
        rmse_without_delay_rad: RMSE of all joints with the reference delayed by `delay_s`.
        rmse_without_delay_and_mean_rad: the same without each joint's mean error.
        all_joints: all joints that played, together.
        limbs: by name.
        joints: by name.
    """

    compared_states: Int
    excluded_states: Int
    compared_s: float
    rmse_without_delay_rad: float | None = None
    rmse_without_delay_and_mean_rad: float | None = None
    all_joints: ErrorStats
    limbs: dict[str, ErrorStats]
    joints: dict[str, ErrorStats]

    @property
    def worst(self) -> tuple[str, ErrorStats]:
        """The joint with the largest error, and its errors."""
        return max(self.joints.items(), key=lambda one: one[1].max_abs_rad)


@dataclass(frozen=True, eq=False)
class JointErrors:
    """The errors reference - measured in PLAY by joint, in motor order.

    Joints that did not play the motion are excluded from all results over several joints.

    Attributes:
        sums: the errors of at least one LowState.
        excluded: number of LowStates in PLAY that are excluded: in a gap of the reference, or with
            a joint position that is not finite or beyond 1e9 rad.
        duration: length of PLAY without gaps, s.
        joints: motor indices of the joints that played the motion.
    """

    sums: ErrorSums
    excluded: int
    duration: float
    joints: tuple[int, ...]

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: RMSE {self.overall:.4f} rad, worst {self.worst_joint}>"

    @cached_property
    def rmse(self) -> Floats:
        """(29,) rad, root mean square."""
        return self.sums.rmse

    @property
    def mean(self) -> Floats:
        """(29,) rad, mean error, such as the sag under gravity."""
        return self.sums.mean

    @property
    def max_abs(self) -> Floats:
        """(29,) rad, largest absolute error."""
        return self.sums.max_abs

    @property
    def max_abs_at(self) -> Floats:
        """(29,) time of the largest error, s since the motion's first frame."""
        return self.sums.max_abs_at

    @property
    def overall(self) -> float:
        """RMSE of all joints together, rad."""
        return pooled(self.rmse[list(self.joints)])

    @property
    def rmse_by_limb(self) -> dict[str, float]:
        """RMSE of the joints of each limb together, rad."""
        return {limb: pooled(self.rmse[joints]) for limb, joints in self.limbs.items()}

    @cached_property
    def limbs(self) -> dict[str, list[int]]:
        """The played joints by limb, without empty limbs."""
        found = {limb: sorted({*joints} & {*self.joints}) for limb, joints in JOINT_GROUPS.items()}
        return {limb: joints for limb, joints in found.items() if joints}

    @property
    def worst_joint(self) -> str:
        """The joint with the largest RMSE."""
        return JOINT_NAMES[max(self.joints, key=self.rmse.__getitem__)]

    def summary(self) -> TrackingSummary:
        """The results without the arrays."""
        return TrackingSummary(
            compared_states=self.sums.n,
            excluded_states=self.excluded,
            compared_s=self.duration,
            all_joints=self._stats(self.joints),
            limbs={limb: self._stats(joints) for limb, joints in self.limbs.items()},
            joints={JOINT_NAMES[joint]: self._stats([joint], alone=True) for joint in self.joints},
        )

    def _stats(self, joints: Sequence[int], *, alone: bool = False) -> ErrorStats:
        rmse, largest = self.rmse[list(joints)], self.max_abs[list(joints)]
        most = joints[int(largest.argmax())]
        return ErrorStats(
            rmse_rad=pooled(rmse),
            bias_rad=float(self.mean[most]) if alone else pooled(self.mean[list(joints)]),
            max_abs_rad=float(self.max_abs[most]),
            max_abs_at_s=float(self.max_abs_at[most]),
            worst_joint=None if alone else JOINT_NAMES[joints[int(rmse.argmax())]],
        )


@dataclass(frozen=True, eq=False, repr=False)
class Tracking(JointErrors):
    """Reference and measurement at the publish times of N LowStates in PLAY, and their difference.

    Arrays (N, 29) are computed when they are asked for, and not kept; `rows` gives some rows.

    Attributes:
        time: (N,) s on the motion's clock, as `Stream.time`.
        motion_time: (N,) s since the motion's first frame.
        delays: finds the delay of any joints together.
        states: (N,) which LowStates they are.
        around: the references around each of them.
        targets: (R, 29) rad, all references, in the order of their publish times.
        positions: (M, 29) rad, of all LowStates, in the wire's precision.
    """

    time: Floats
    motion_time: Floats
    delays: Delays
    states: NDArray[np.intp]
    around: Neighbours
    targets: Floats
    positions: NDArray[Any]

    @cached_property
    def delay(self) -> Delay | None:
        """Delay of all joints together; None without enough movement or a best delay in the grid.

        Its `rmse` and `std` are in the order of `joints`, rad.
        """
        return self.delays.of(self.joints)

    @property
    def reference(self) -> Floats:
        """(N, 29) rad."""
        return self.around.interpolate(self.targets)

    @property
    def measured(self) -> Floats:
        """(N, 29) rad."""
        done: Floats = self.positions[self.states].astype(np.float64)
        return done

    @property
    def error(self) -> Floats:
        """(N, 29) rad, reference - measured."""
        return self.reference - self.measured

    def rows(self, index: slice | NDArray[np.intp]) -> tuple[Floats, NDArray[Any]]:
        """(K, 29) rad, reference and measured of some of the N, the latter as it was recorded."""
        asked = self.around.where(index).interpolate(self.targets)
        return asked, self.positions[self.states[index]]

    def error_of(self, joint: int) -> Floats:
        """(N,) rad, reference - measured of a joint, by its motor index."""
        asked = self.around.interpolate(self.targets[:, joint, np.newaxis])[:, 0]
        error: Floats = asked - self.positions[self.states, joint]
        return error

    def summary(self) -> TrackingSummary:
        """The results without the arrays."""
        delay, found = self.delay, super().summary()
        found.rmse_without_delay_rad = delay and pooled(delay.rmse)
        found.rmse_without_delay_and_mean_rad = delay and pooled(delay.std)
        found.all_joints.delay_s = delay and delay.seconds
        found.all_joints.delay_ci95_s = delay and delay.ci95
        return found


@once
def tracking(session: Recording) -> Tracking:
    """Compute the tracking error of a session in PLAY.

    Raises:
        NothingToCompareError: there is no reference, or no state in PLAY.
        RecordingError: the file is damaged.
    """
    absent = [t for t in (ReferenceStream.topic, MeasuredStream.topic) if not session.topics.get(t)]
    reason = f"it has no messages on {' and '.join(absent)}"
    if not absent:
        reference = session.reference.read("motion_time", "phase", "played", "q")
        attached = session.attached
        delay_known = attached is None or not attached.by_robot
        if found := compare(reference, session.measured, delay_known=delay_known):
            motors = no_joints(session, found)
            if known := tuple(joint for joint in found.joints if joint not in motors):
                return replace(found, joints=known)
        reason = f"no {MeasuredStream.topic} with joints that played was published in PLAY"
    raise NothingToCompareError(
        f"{session.path} has no tracking error: {reason}.",
        "Record while a robot, or a simulator, publishes its state and a motion is streamed.",
    )


def parallel(session: Recording) -> Iterator[tuple[Stream, NDArray[np.bool_]]]:
    """Commands and states, and (N,) in which of them `AB_JOINTS` are the motors A and B."""
    kinds: tuple[type[CommandStream | MeasuredStream], ...] = (CommandStream, MeasuredStream)
    for kind in kinds:
        if session.topics.get(kind.topic):
            with suppress(RecordingError):  # whoever uses the topic says what is wrong with it
                stream = session.stream(kind).read("mode_pr")
                yield stream, stream.mode_pr != 0


def no_joints(session: Recording, found: Tracking) -> tuple[int, ...]:
    """Joints whose slots in PLAY are motors A and B."""
    first, last = found.time[[0, -1]]
    for stream, motors in parallel(session):
        if motors[(stream.time >= first) & (stream.time <= last)].any():
            return AB_JOINTS
    return ()


def compare(
    reference: ReferenceStream, measured: MeasuredStream, *, delay_known: bool = True
) -> Tracking | None:
    """Compare each LowState in PLAY with the reference at its publish time; None without states.

    If the robot itself reported when the reference began, the delay is unknown.

    The reference is interpolated linearly between two samples h apart. The error is at most h^2 / 8
    times the joint's acceleration: 0.1 mrad for 200 rad/s^2 at 500 Hz. References are at their
    publish times, so a command that came late counts as late.
    """
    times, state_times = reference.published, measured.published
    order, state_order = np.argsort(times, kind="stable"), np.argsort(state_times, kind="stable")
    sane = _are_sane(reference.q) & (np.abs(reference.motion_time) < NUMBER)
    order = order[sane[order]]
    if not len(order):
        return None
    times, phase = times[order], reference.phase[order]
    in_order = len(order) == len(sane) and (np.diff(order) == 1).all()
    q = reference.q if in_order else reference.q[order]  # copy only if needed
    around = neighbours(times, state_times[state_order])
    in_play = around.where(phase[around.before] == Phase.PLAY)
    positions = measured.recorded("q")
    sane = _are_sane(positions)[state_order]
    compared = in_play.where((in_play.gap <= MAX_GAP_NS) & sane[in_play.instants])
    if not len(compared.gap):
        return None
    states = state_order[compared.instants]
    motion_time = compared.interpolate(reference.motion_time[order][:, np.newaxis])[:, 0]
    played = played_joints(np.bitwise_or.reduce(reference.played[order][phase == Phase.PLAY]))
    sums = ErrorSums()
    for part in blocks(len(states)):
        asked = compared.where(part).interpolate(q)
        sums.add(asked - positions[states[part]], motion_time[part])
    # States without a gap are a view, because a long recording takes much memory.
    whole = (np.diff(states) == 1).all()
    done = positions[states[0] : states[-1] + 1] if whole else positions[states]
    gaps = np.diff(times)[phase[:-1] == Phase.PLAY]
    seconds, state_seconds = (times - times[0]) / 1e9, (state_times[states] - times[0]) / 1e9
    return Tracking(
        sums=sums,
        excluded=len(in_play.gap) - len(compared.gap),
        duration=float(gaps[gaps <= MAX_GAP_NS].sum() / 1e9),
        time=measured.time[states],
        motion_time=motion_time,
        around=compared,
        targets=q,
        positions=positions,
        delays=Delays(seconds, q, state_seconds, done, known=delay_known),
        states=states,
        joints=tuple(np.flatnonzero(played).tolist()),
    )


def errors_of_run(running: RunningError, played: NDArray[np.bool_]) -> JointErrors | None:
    """The tracking error of a run, from its loop's data; None without a state.

    `played` (29,) marks the joints that played the motion.
    """
    sums, joints = running.finish(), tuple(np.flatnonzero(played).tolist())
    return JointErrors(sums, running.excluded, running.duration / 1e9, joints) if sums.n else None


def blocks(n_rows: int, size: int = _BLOCK) -> Iterator[slice]:
    """Slices of a long array, so that intermediate results stay in the cache."""
    return (slice(start, min(start + size, n_rows)) for start in range(0, n_rows, size))


def _are_sane(values: Floats) -> NDArray[np.bool_]:
    """(N,) whether all values of a row (N, K) are finite and plausible."""
    sane = np.empty(len(values), dtype=bool)
    for part in blocks(len(values)):
        sane[part] = (np.abs(values[part]) < NUMBER).all(axis=1)
    return sane


def pooled(values: Floats) -> float:
    """The RMSE over several joints, from the RMSE of each over the same times."""
    return float(rms(values))


def rms(errors: Floats) -> Floats:
    """Root mean square over the first axis."""
    found: Floats = np.sqrt(np.mean(np.square(errors), axis=0))
    return found


UNSURE: Final = 0.02
"""A delay is unknown if its 95 % confidence interval reaches further than this, s."""


class Delay(NamedTuple):
    """The delay of the robot behind the reference, and the error apart from it.

    Attributes:
        seconds: positive if the robot is behind.
        ci95: half the width of the 95 % confidence interval, s; None if less than five seconds
            were compared.
        correlation: 0 to 1, of the measurement with the reference `seconds` earlier.
        rmse: (J,) rad, reference `seconds` earlier - measured.
        std: (J,) rad, the same without each joint's mean error.
    """

    seconds: float
    ci95: float | None
    correlation: float
    rmse: Floats
    std: Floats


class Delays:
    """Finds the delay of any set of joints.

    Args:
        times: (R,) s, increasing, of the reference in every phase, because a robot that is late
            shows targets from before the motion.
        q: (R, J) rad, the reference.
        state_times: (N,) s, increasing, of the compared states.
        measured: (N, J) rad.
        known: whether the delay can be determined; if not, it is None.
    """

    def __init__(
        self,
        times: Floats,
        q: Floats,
        state_times: Floats,
        measured: Floats,
        *,
        known: bool = True,
    ) -> None:
        self._times, self._q = times, q
        self._moving = np.zeros(q.shape[1], dtype=bool)
        # Around each of these states there is a reference for every delay.
        reach = times[0] + _LAGS[-1] * _STEP, times[-1] + _LAGS[0] * _STEP
        first, last = np.searchsorted(state_times, reach).tolist()
        if not known or first >= last:
            return
        rows = first + _spread(last - first, _MOST_STATES)
        self._at, self._measured = state_times[rows], measured[rows].astype(np.float64)
        self._middle = self._measured.mean(axis=0)
        self._measured -= self._middle
        self._total = self._measured.var(axis=0)
        moved = np.ptp(self._reference(0.0, None), axis=0), np.ptp(self._measured, axis=0)
        self._moving = np.minimum(*moved) > _MOVES
        few = _spread(len(rows), _MOST_ON_GRID)
        self._grid = np.array([self._cost(lag, few) for lag in _LAGS.tolist()])
        self._unexplained = cache(lambda lag: self._cost(float(_LAGS[lag])))

    def of(self, joints: Sequence[int]) -> Delay | None:
        """The delay of some joints together; None if none moves or no delay fits best."""
        moving = [joint for joint in joints if self._moving[joint]]
        if not moving:
            return None
        best, downhill = int(self._grid[:, moving].sum(axis=1).argmin()), -1
        while downhill:  # a few states suffice to come near
            if not 0 < best < len(_LAGS) - 1:
                return None
            costs = [self._unexplained(best + side)[moving].sum() for side in (-1, 0, 1)]
            downhill = int(np.argmin(costs)) - 1
            best += downhill
        left, middle, right = costs
        curvature = left - 2.0 * middle + right
        fraction = 0.5 * (left - right) / curvature if curvature > 0.0 else 0.0
        shift = float(_LAGS[best] + fraction)
        chosen = list(joints)
        q = self._reference(shift, chosen)
        error = q - (self._measured[:, chosen] + self._middle[chosen])
        explained = 1.0 - middle / self._total[moving].sum()
        return Delay(
            seconds=shift * _STEP,
            ci95=self._ci95(shift, moving, q[:, [joint in moving for joint in chosen]]),
            correlation=float(np.sqrt(np.clip(explained, 0.0, 1.0))),
            rmse=rms(error),
            std=error.std(axis=0),
        )

    def _reference(
        self, shift: float, joints: list[int] | None, rows: NDArray[np.intp] | slice = slice(None)
    ) -> Floats:
        """(T, J) reference of joints (None: all), `shift` steps before states (all or `rows`)."""
        at = self._at[rows] - shift * _STEP
        after = np.searchsorted(self._times, at).clip(1, len(self._times) - 1)
        earlier, later = self._times[after - 1], self._times[after]
        weight = (at - earlier) / np.maximum(later - earlier, np.finfo(float).tiny)
        around = (one if joints is None else np.ix_(one, joints) for one in (after - 1, after))
        q, later = (self._q[where].astype(np.float64, copy=False) for where in around)
        found: Floats = q + weight[:, np.newaxis] * (later - q)
        return found

    def _cost(self, shift: float, rows: NDArray[np.intp] | slice = slice(None)) -> Floats:
        """(J,) the unexplained variance of every joint, rad^2."""
        return _regress(self._reference(shift, None, rows), self._measured[rows])[1]

    def _ci95(self, shift: float, joints: list[int], q: Floats) -> float | None:
        """As in `Delay`, from the reference q (T, J) of the joints at the delay."""
        of = ((self._at - self._at[0]) / _OBSERVATION).astype(np.intp)
        starts = np.flatnonzero(np.diff(of, prepend=-1))
        if len(starts) < _FEWEST_OBSERVATIONS:
            return None
        measured = self._measured[:, joints]
        factor = _regress(q, measured)[0]
        slope = self._reference(shift - 0.5, joints) - self._reference(shift + 0.5, joints)
        slope *= factor / _STEP
        error = measured - factor * q
        error -= error.mean(axis=0)
        scores = np.add.reduceat((error * slope).sum(axis=1), starts)
        information = np.square(slope).sum()
        spread = np.sqrt(np.square(scores).sum() * len(starts) / (len(starts) - 1.0))
        return float(_t_975(len(starts) - 1) * spread / information)


def _regress(q: Floats, measured: Floats) -> tuple[Floats, Floats]:
    """(J,): the factor of a reference (T, J), and the variance of `measured` that it leaves.

    `measured` (T, J) is that of the same times, without its mean over all times.
    """
    q = q - q.mean(axis=0)
    variance = np.einsum("tj,tj->j", q, q)
    covariance = np.einsum("tj,tj->j", q, measured)
    factor: Floats = covariance.clip(0.0) / np.maximum(variance, np.finfo(float).tiny)
    unexplained: Floats = (np.square(measured).sum(axis=0) - factor * covariance) / len(q)
    return factor, unexplained


def _spread(n: int, most: int) -> NDArray[np.intp]:
    """Indices of n values, or a random one of each of `most` intervals; the same at each call."""
    if n <= most:
        return np.arange(n)
    random = np.random.default_rng(0).random(most)
    return ((np.arange(most) + random) * n / most).astype(np.intp)


def _t_975(freedom: int) -> float:
    """The 0.975 quantile of Student's t, within 4e-4 for 4 or more degrees of freedom.

    An expansion around the normal distribution (Abramowitz and Stegun 26.7.5). Importing SciPy
    would take as long as the rest of a short session's summary.
    """
    z = NormalDist().inv_cdf(0.975)
    return (
        z
        + (z**3 + z) / (4 * freedom)
        + (5 * z**5 + 16 * z**3 + 3 * z) / (96 * freedom**2)
        + (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / (384 * freedom**3)
        + (79 * z**9 + 776 * z**7 + 1482 * z**5 - 1920 * z**3 - 945 * z) / (92160 * freedom**4)
    )


def interpolated(at: Floats, times: Floats, values: Floats) -> Floats:
    """(T, J) linear interpolation at times (T,) of values (R, J) at increasing times (R,)."""
    return np.column_stack([np.interp(at, times, column) for column in values.T])
