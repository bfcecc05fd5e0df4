"""How closely a robot followed its reference; pure.

A LowState shows what commands published before its stamp have done; how long before that stamp it
was measured, it does not say. So a tracking delay is all that lies between the stamp of a reference
and the stamp of the state that shows it: the wire there, the servo, and the time that the bridge
let pass between measuring and stamping.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from g1stream.foxglove.tracking_error import MAX_GAP_NS, neighbours
from g1stream.robot.joints import JOINT_GROUPS, JOINT_NAMES, N_JOINTS
from g1stream.types import Floats, Ints, Phase

if TYPE_CHECKING:
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


def common_times(reference: Reference, measured: Measured) -> tuple[Floats, Floats]:
    """Publish times on the recorder's clock, (N,) and (M,), s since the first reference."""
    stamps = _times_ns(reference, measured)
    start = stamps[0].min()
    # Nanoseconds since the epoch need more digits than a float has; the differences do not.
    first, second = ((ns - start).astype(np.float64) / 1e9 for ns in stamps)
    return first, second


def _times_ns(*streams: Reference | Measured) -> list[Ints]:
    """Publish times on the recorder's clock, ns since the epoch."""
    return [stream.publish_time + stream.clock_offset for stream in streams]


def compare(reference: Reference, measured: Measured) -> Comparison:
    """Put the reference beside each LowState that was stamped while the motion was played.

    The reference between two stamps h apart is taken as a straight line; that is off by at most
    h^2 / 8 times the joint's acceleration: 0.1 mrad for 200 rad/s^2 at 500 Hz. It is where the
    reference was published, so a command that came late counts as late.
    """
    times, state_times = _times_ns(reference, measured)
    order, state_order = np.argsort(times, kind="stable"), np.argsort(state_times, kind="stable")
    times, q, phase = times[order], reference.q[order], reference.phase[order]
    around = neighbours(times, state_times[state_order])
    around = around.where(phase[around.before] == Phase.PLAY)
    compared = around.where(around.gap <= MAX_GAP_NS)
    gaps = np.diff(times)[phase[:-1] == Phase.PLAY]
    seconds = (times - times[0]) / 1e9
    at = state_order[compared.instants]
    return Comparison(
        time=(state_times[at] - times[0]) / 1e9,
        motion_time=compared.interpolate(reference.motion_time[order][:, np.newaxis])[:, 0],
        reference=compared.interpolate(q),
        measured=measured.q[at],
        left_out=len(around.gap) - len(compared.gap),
        duration=float(gaps[gaps <= MAX_GAP_NS].sum() / 1e9),
        all_times=seconds,
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
