"""How closely a robot followed its reference in PLAY.

A LowState shows what commands published before it have done; how long before it was published it
was measured, it does not tell. So a tracking delay is all that lies between the publish time of a
reference and that of the state that shows it: DDS, the servo, and the time between measuring and
publishing.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.analysis.delay import Delay, Delays
from g1stream.dds.messages import played_joints
from g1stream.errors import RecordingError
from g1stream.input_limits import NUMBER
from g1stream.robot.joints import JOINT_GROUPS, JOINT_NAMES, N_JOINTS
from g1stream.session.streams import Measured, Reference
from g1stream.session.summary import JointTracking, TrackingSummary
from g1stream.types import Floats, Phase
from g1stream.view.tracking_error import MAX_GAP_NS, neighbours

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from g1stream.session.session import Session

__all__ = ["NothingToCompareError", "Tracking", "blocks", "compare", "pooled", "tracking"]

#: Rows of 29 joints that are computed at once.
_BLOCK: Final = 2048


class NothingToCompareError(RecordingError):
    """A session has no state in PLAY, or no reference."""


@dataclass(frozen=True, eq=False)
class Tracking:
    """Reference and measurement at the publish times of N LowStates in PLAY, and their difference.

    Joints are in motor order. Those that did not play the motion count in no figure of several
    joints together.

    Attributes:
        time: (N,) s on the motion's clock, as `Stream.time`.
        motion_time: (N,) s since the motion's first frame.
        reference, measured: (N, 29) rad.
        excluded: LowStates in PLAY that are left out: the reference has a gap there, or a joint
            position is not finite or beyond 1e9 rad.
        duration: s of PLAY, gaps left out.
        rmse: (29,) rad, root mean square of reference - measured.
        mean: (29,) rad, mean of reference - measured, such as the sag under gravity.
        max_abs: (29,) rad, the greatest error, either way.
        max_abs_at: (29,) s since the motion's first frame, where that was.
        delays: finds the delay of any joints together.
        states: (N,) which LowStates they are.
        joints: motor indices of those that played the motion.
    """

    time: Floats
    motion_time: Floats
    reference: Floats
    measured: Floats
    excluded: int
    duration: float
    rmse: Floats
    mean: Floats
    max_abs: Floats
    max_abs_at: Floats
    delays: Delays
    states: NDArray[np.intp]
    joints: tuple[int, ...]

    @cached_property
    def delay(self) -> Delay | None:
        """Of all joints together; None where too little moves, or no delay that is searched fits.

        Its `rmse` and `std` are in the order of `joints`, rad.
        """
        return self.delays.of(self.joints)

    @property
    def error(self) -> Floats:
        """(N, 29) rad, reference - measured."""
        return self.reference - self.measured

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
        """The played joints of each limb that has any."""
        found = {limb: sorted({*joints} & {*self.joints}) for limb, joints in JOINT_GROUPS.items()}
        return {limb: joints for limb, joints in found.items() if joints}

    @property
    def worst_joint(self) -> str:
        """The joint of the greatest RMSE."""
        return JOINT_NAMES[max(self.joints, key=self.rmse.__getitem__)]

    def summary(self) -> TrackingSummary:
        """The figures, without the arrays."""
        delay = self.delay
        figures = zip(self.rmse, self.mean, self.max_abs, self.max_abs_at, strict=True)
        return TrackingSummary(
            rmse_rad=self.overall,
            rmse_by_limb_rad=self.rmse_by_limb,
            worst_joint=self.worst_joint,
            compared_states=len(self.time),
            excluded_states=self.excluded,
            compared_s=self.duration,
            delay_s=delay and delay.seconds,
            rmse_without_delay_rad=delay and pooled(delay.rmse),
            rmse_without_delay_and_mean_rad=delay and pooled(delay.std),
            joints={
                name: JointTracking(rmse_rad=rmse, mean_rad=mean, max_abs_rad=most, max_abs_at_s=at)
                for joint, (name, (rmse, mean, most, at)) in enumerate(
                    zip(JOINT_NAMES, figures, strict=True)
                )
                if joint in self.joints
            },
        )


def tracking(session: Session) -> Tracking:
    """How closely the robot of a session followed its reference in PLAY.

    Raises:
        NothingToCompareError: there is no reference, or no state in PLAY.
        RecordingError: the file is damaged.
    """
    absent = [t for t in (Reference.topic, Measured.topic) if not session.topics.get(t)]
    reason = f"it has no messages on {' and '.join(absent)}"
    if not absent:
        reference = session.reference.read("motion_time", "phase", "played", "q")
        if found := compare(reference, session.measured.read("q")):
            return found
        reason = f"no {Measured.topic} was published in PLAY"
    raise NothingToCompareError(
        f"{session.path} has no tracking error: {reason}.",
        "Record while a robot, or a simulator, publishes its state and a motion is streamed.",
    )


def compare(reference: Reference, measured: Measured) -> Tracking | None:
    """Compare each LowState in PLAY with the reference at its publish time; None without one.

    The reference between two samples h apart is taken as a straight line; that is off by at most
    h^2 / 8 times the joint's acceleration: 0.1 mrad for 200 rad/s^2 at 500 Hz. It is where the
    reference was published, so a command that came late counts as late.
    """
    times = reference.publish_time + reference.clock_offset
    state_times = measured.publish_time + measured.clock_offset
    order, state_order = np.argsort(times, kind="stable"), np.argsort(state_times, kind="stable")
    sane = _are_sane(reference.q) & (np.abs(reference.motion_time) < NUMBER)
    order = order[sane[order]]
    if not len(order):
        return None
    times, phase = times[order], reference.phase[order]
    in_order = len(order) == len(sane) and (np.diff(order) == 1).all()
    q = reference.q if in_order else reference.q[order]  # a copy only where one is needed
    around = neighbours(times, state_times[state_order])
    in_play = around.where(phase[around.before] == Phase.PLAY)
    sane = _are_sane(measured.q)[state_order]
    compared = in_play.where((in_play.gap <= MAX_GAP_NS) & sane[in_play.instants])
    if not len(compared.gap):
        return None
    states = state_order[compared.instants]
    motion_time = compared.interpolate(reference.motion_time[order][:, np.newaxis])[:, 0]
    played = played_joints(np.bitwise_or.reduce(reference.played[order][phase == Phase.PLAY]))
    asked = np.empty((len(states), N_JOINTS))
    # Of states without a gap it is a view: a long recording has much of everything.
    whole = (np.diff(states) == 1).all()
    done = measured.q[states[0] : states[-1] + 1] if whole else measured.q[states]
    squares, total, largest = np.zeros((3, N_JOINTS))
    worst, joints = np.zeros(N_JOINTS, dtype=np.intp), np.arange(N_JOINTS)
    for part in blocks(len(states)):
        asked[part] = compared.where(part).interpolate(q)
        error = asked[part] - done[part]
        squares += np.square(error).sum(axis=0)
        total += error.sum(axis=0)
        size = np.abs(error)
        at = size.argmax(axis=0)
        worst = np.where(size[at, joints] > largest, at + part.start, worst)
        largest = np.maximum(largest, size[at, joints])
    gaps = np.diff(times)[phase[:-1] == Phase.PLAY]
    seconds, state_seconds = (times - times[0]) / 1e9, (state_times[states] - times[0]) / 1e9
    return Tracking(
        time=measured.time[states],
        motion_time=motion_time,
        reference=asked,
        measured=done,
        excluded=len(in_play.gap) - len(compared.gap),
        duration=float(gaps[gaps <= MAX_GAP_NS].sum() / 1e9),
        rmse=np.sqrt(squares / len(states)),
        mean=total / len(states),
        max_abs=largest,
        max_abs_at=motion_time[worst],
        delays=Delays(seconds, q, state_seconds, done),
        states=states,
        joints=tuple(np.flatnonzero(played).tolist()),
    )


def blocks(n_rows: int, size: int = _BLOCK) -> Iterator[slice]:
    """Rows of a long array, some at a time, so that what is computed of them stays in the cache."""
    return (slice(start, min(start + size, n_rows)) for start in range(0, n_rows, size))


def _are_sane(values: Floats) -> NDArray[np.bool_]:
    """(N,) whether all of a row (N, K) are finite and of a sane size."""
    sane = np.empty(len(values), dtype=bool)
    for part in blocks(len(values)):
        sane[part] = (np.abs(values[part]) < NUMBER).all(axis=1)
    return sane


def pooled(values: Floats) -> float:
    """One RMSE of several joints, from the RMSE of each over the same instants."""
    return float(rms(values))


def rms(errors: Floats) -> Floats:
    """Root mean square over the first axis."""
    found: Floats = np.sqrt(np.mean(np.square(errors), axis=0))
    return found
