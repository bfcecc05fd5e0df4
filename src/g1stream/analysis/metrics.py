"""How closely a robot followed its reference; pure.

A LowState shows what commands published before its stamp have done; how long before that stamp it
was measured, it does not say. So a tracking delay is all that lies between the stamp of a reference
and the stamp of the state that shows it: the wire there, the servo, and the time that the bridge
let pass between measuring and stamping.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from g1stream.analysis.message_stats import clock_offset
from g1stream.robot.joints import JOINT_GROUPS, JOINT_NAMES, N_JOINTS
from g1stream.types import Floats, Phase

if TYPE_CHECKING:
    from g1stream.analysis.angles import AskedAngles, MeasuredAngles
    from g1stream.session.streams import Measured, Reference


__all__ = [
    "Comparison",
    "Delay",
    "Tracking",
    "by_group",
    "common_times",
    "compare",
    "pooled",
    "track",
]

MAX_HOLE: Final = 0.1
"""References further apart than this, s, say nothing of the time between them."""

SHORTEST_DELAY, LONGEST_DELAY = -0.02, 0.2
"""Between these a tracking delay is looked for, s; positive: the robot comes after."""

_COARSE, _FINE = 0.01, 0.002
_DELAY_SAMPLES = 20_000

#: A joint takes part in finding the delay if reference and measurement span more than this, rad.
_MOVES = 0.05


class Comparison(NamedTuple):
    """Reference and measurement at the same N instants: the stamps of LowStates in PLAY.

    Times are s since the first reference, on the recorder's clock.

    Attributes:
        time: (N,) s.
        motion_time: (N,) s since the motion's first frame.
        reference, measured: (N, 29) rad, motor order.
        left_out: LowStates in PLAY that have no reference, because it has a hole there.
        duration: s of PLAY, holes left out.
        all_times, all_q: (R,) s and (R, 29) rad, the reference in every phase.
    """

    time: Floats
    motion_time: Floats
    reference: Floats
    measured: Floats
    left_out: int
    duration: float
    all_times: Floats
    all_q: Floats

    @property
    def error(self) -> Floats:
        """(N, 29) rad, reference - measured."""
        return self.reference - self.measured


class Delay(NamedTuple):
    """By how much the robot comes after the reference, and how well it follows apart from that.

    Attributes:
        seconds: the shift of the reference that explains most of the error of the joints that
            move: it makes what is left besides each joint's mean error smallest. So a joint that
            only hangs lower than it should does not count as late.
        rmse: (29,) rad, of the reference `seconds` ago - measured.
        std: (29,) rad, the same without each joint's mean error.
    """

    seconds: float
    rmse: Floats
    std: Floats


class Tracking(NamedTuple):
    """How closely the robot followed while the motion was played.

    Attributes:
        rmse: (29,) rad, root mean square of reference - measured.
        mean: (29,) rad, mean of reference - measured, such as the sag under gravity.
        max_abs: (29,) rad, the greatest error, whichever way.
        max_abs_at: (29,) s since the motion's first frame, where that was.
        delay: None where too little moves, or no shift that is looked for fits best.
        compared: what they come from.
    """

    rmse: Floats
    mean: Floats
    max_abs: Floats
    max_abs_at: Floats
    delay: Delay | None
    compared: Comparison

    @property
    def error(self) -> Floats:
        """(N, 29) rad, reference - measured at the N instants of `compared`."""
        return self.compared.error

    @property
    def overall(self) -> float:
        """RMSE of all joints together, rad."""
        return pooled(self.rmse)

    @property
    def rmse_by_limb(self) -> dict[str, float]:
        """RMSE of the joints of each limb together, rad."""
        return by_group(self.rmse)

    @property
    def worst_joint(self) -> str:
        """The joint of the greatest RMSE."""
        return JOINT_NAMES[int(self.rmse.argmax())]

    def as_dict(self) -> dict[str, Any]:
        """The figures as JSON values, joints and limbs by name; units are in the keys."""
        delay, joints = self.delay, zip(*self[:4], strict=True)
        keys = ("rmse_rad", "mean_rad", "max_abs_rad", "max_abs_at_s")
        return {
            "rmse_rad": self.overall,
            "rmse_rad_by_group": self.rmse_by_limb,
            "worst_joint": self.worst_joint,
            "compared_states": len(self.compared.time),
            "compared_s": self.compared.duration,
            "delay_s": delay and delay.seconds,
            "rmse_rad_without_delay": delay and pooled(delay.rmse),
            "rmse_rad_without_delay_and_mean": delay and pooled(delay.std),
            "joints": {
                name: dict(zip(keys, map(float, figures), strict=True))
                for name, figures in zip(JOINT_NAMES, joints, strict=True)
            },
        }


def common_times(
    reference: Reference | AskedAngles, measured: Measured | MeasuredAngles
) -> tuple[Floats, Floats]:
    """Publish times on the recorder's clock, (N,) and (M,), s since the first reference."""
    stamps = [stream.publish_time + clock_offset(stream) for stream in (reference, measured)]
    start = stamps[0].min()
    # Nanoseconds since the epoch need more digits than a float has; the differences do not.
    first, second = ((ns - start).astype(np.float64) / 1e9 for ns in stamps)
    return first, second


def compare(reference: Reference | AskedAngles, measured: Measured | MeasuredAngles) -> Comparison:
    """Put the reference beside each LowState that was stamped while the motion was played.

    The reference between two stamps h apart is taken as a straight line; that is off by at most
    h^2 / 8 times the joint's acceleration: 0.1 mrad for 200 rad/s^2 at 500 Hz. It is where the
    reference was published, so a command that came late counts as late.
    """
    times, state_times = common_times(reference, measured)
    order = np.argsort(times, kind="stable")
    times, q = times[order], reference.q[order]
    played = reference.phase[order][:-1] == Phase.PLAY
    intervals = np.diff(times)
    known = played & (intervals <= MAX_HOLE)

    state_order = np.argsort(state_times, kind="stable")
    state_times = state_times[state_order]
    interval = np.searchsorted(times, state_times, side="right") - 1
    inside = np.flatnonzero((interval >= 0) & (interval < len(intervals)))
    compared = inside[known[interval[inside]]]
    at = state_times[compared]
    return Comparison(
        time=at,
        motion_time=np.interp(at, times, reference.motion_time[order]),
        reference=_at(at, times, q),
        measured=measured.q[state_order[compared]],
        left_out=int(played[interval[inside]].sum()) - len(compared),
        duration=float(intervals[known].sum()),
        all_times=times,
        all_q=q,
    )


def track(comparison: Comparison) -> Tracking:
    """How closely the robot followed.

    Raises:
        ValueError: nothing was compared.
    """
    if not len(comparison.time):
        raise ValueError("no LowState was stamped while the motion was played")
    error = comparison.error
    worst = np.abs(error).argmax(axis=0)
    return Tracking(
        rmse=_rms(error),
        mean=error.mean(axis=0),
        max_abs=np.abs(error[worst, np.arange(N_JOINTS)]),
        max_abs_at=comparison.motion_time[worst],
        delay=_delay(comparison),
        compared=comparison,
    )


def by_group(values: Floats) -> dict[str, float]:
    """RMSE by limb, from the RMSE (29,) of its joints."""
    return {group: pooled(values[list(joints)]) for group, joints in JOINT_GROUPS.items()}


def pooled(values: Floats) -> float:
    """One RMSE of several joints, from the RMSE of each over the same instants."""
    return float(np.sqrt(np.mean(np.square(values))))


def _delay(comparison: Comparison) -> Delay | None:
    """The best shift: looked for on a coarse grid, then on a fine one, then by a parabola."""
    # A robot that is late shows what was asked before PLAY, so that must have been recorded too.
    covered = (comparison.time - LONGEST_DELAY >= comparison.all_times[0]) & (
        comparison.time - SHORTEST_DELAY <= comparison.all_times[-1]
    )
    moving = np.minimum(_span(comparison.reference), _span(comparison.measured)) > _MOVES
    if not moving.any() or not covered.any():
        return None
    times, measured = comparison.time[covered], comparison.measured[covered]
    few = slice(None, None, -(-len(times) // _DELAY_SAMPLES))
    few_times, few_measured = times[few], measured[few][:, moving]
    moving_q = comparison.all_q[:, moving]

    def cost(shift: float) -> float:
        error = _at(few_times - shift, comparison.all_times, moving_q) - few_measured
        return float(error.var(axis=0).sum())

    steps = round((LONGEST_DELAY - SHORTEST_DELAY) / _COARSE)
    coarse = np.linspace(SHORTEST_DELAY, LONGEST_DELAY, steps + 1)
    near = int(np.argmin([cost(shift) for shift in coarse]))
    if not 0 < near < steps:
        return None
    steps = round(_COARSE / _FINE)
    fine = coarse[near] + _FINE * np.arange(-steps, steps + 1)
    costs = [cost(shift) for shift in fine]
    # A neighbour on the coarse grid is no better, so that the best is never the first or the last.
    best = int(np.argmin(costs[1:-1])) + 1
    left, middle, right = costs[best - 1 : best + 2]
    curvature = left - 2.0 * middle + right
    seconds = fine[best] + (0.5 * _FINE * (left - right) / curvature if curvature > 0 else 0.0)
    error = _at(times - seconds, comparison.all_times, comparison.all_q) - measured
    return Delay(float(seconds), _rms(error), error.std(axis=0))


def _at(instants: Floats, times: Floats, values: Floats) -> Floats:
    """(N, J) values (R, J) of increasing times (R,) at other instants (N,), straight between."""
    return np.column_stack([np.interp(instants, times, column) for column in values.T])


def _span(values: Floats) -> Floats:
    span: Floats = np.ptp(values, axis=0)
    return span


def _rms(errors: Floats) -> Floats:
    """(29,) root mean square over the first axis."""
    rms: Floats = np.sqrt(np.mean(np.square(errors), axis=0))
    return rms
