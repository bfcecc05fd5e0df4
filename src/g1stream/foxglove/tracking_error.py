"""The tracking error: reference minus measured, at the moment of each measured state."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from g1stream.foxglove.templates import JointStatesTemplate
from g1stream.types import Floats, Ints

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from g1stream.robot.model import G1


__all__ = ["Track", "TrackingError"]

#: Between references further apart than this nothing is known of the motion.
_WIDEST_GAP: Final = 100_000_000
#: How long a state waits for the reference behind it.
_PATIENCE: Final = 1_000_000_000


class Track(NamedTuple):
    """Joints at T times: publish and log times (T,) ns, q and dq (T, 29) rad and rad/s."""

    publish_times: Ints
    log_times: Ints
    q: Floats
    dq: Floats

    def where(self, index: NDArray[np.bool_] | NDArray[np.intp] | slice) -> Track:
        """Some of the times."""
        return Track(
            self.publish_times[index], self.log_times[index], self.q[index], self.dq[index]
        )

    def then(self, other: Track) -> Track:
        """Both, one behind the other."""
        return Track(
            np.concatenate([self.publish_times, other.publish_times]),
            np.concatenate([self.log_times, other.log_times]),
            np.concatenate([self.q, other.q]),
            np.concatenate([self.dq, other.dq]),
        )


class TrackingError:
    """Makes a foxglove.JointStates of each state's tracking error: position and velocity.

    The reference is interpolated, linearly, between the two that were published before and after
    the state; so an error is known when the later of the two has come, and its log time is when the
    last of what it is made of was received.

    Args:
        robot: whose joints.
    """

    def __init__(self, robot: G1) -> None:
        self._template = JointStatesTemplate(robot.joint_names, ("position", "velocity"))
        self._references = _nothing(len(robot.joint_names))
        self._states = _nothing(len(robot.joint_names))

    def add_references(self, references: Track) -> None:
        """Take in references."""
        together = self._references.then(references)
        # Two writers' references may come interleaved.
        self._references = together.where(np.argsort(together.publish_times, kind="stable"))

    def add_states(self, states: Track) -> None:
        """Take in measured states."""
        self._states = self._states.then(states)

    def take(self) -> tuple[NDArray[np.uint8], Ints, Ints]:
        """What is known by now: payloads (T, size), log times (T,) and publish times (T,), ns."""
        known = self._states.publish_times <= self._references.publish_times[-1:].max(initial=-1)
        errors = _errors(self._references, self._states.where(known))
        self._states = _recent(self._states.where(~known))
        # Kept though no state waits: one published before them may be handed over after them.
        self._references = _recent(self._references)
        payloads = self._template.encode(errors.publish_times, errors.q, errors.dq)
        return payloads, errors.log_times, errors.publish_times


def _errors(references: Track, states: Track) -> Track:
    """Reference minus measured at those states that lie between two references."""
    times = references.publish_times
    after = np.searchsorted(times, states.publish_times)
    exact = np.zeros(len(after), dtype=bool)
    if len(times):
        exact = times[np.minimum(after, len(times) - 1)] == states.publish_times
    before = np.where(exact, after, after - 1)
    inside = before >= 0
    states, before, after = states.where(inside), before[inside], after[inside]
    span = times[after] - times[before]
    near = span <= _WIDEST_GAP
    states, before, after, span = states.where(near), before[near], after[near], span[near]
    part = ((states.publish_times - times[before]) / np.maximum(span, 1))[:, np.newaxis]
    earlier, later = references.where(before), references.where(after)
    return Track(
        states.publish_times,
        np.maximum(states.log_times, later.log_times),
        earlier.q + part * (later.q - earlier.q) - states.q,
        earlier.dq + part * (later.dq - earlier.dq) - states.dq,
    )


def _recent(track: Track) -> Track:
    """Without what is much older than the newest."""
    newest = track.publish_times.max(initial=0)
    return track.where(track.publish_times >= newest - _PATIENCE)


def _nothing(n_joints: int) -> Track:
    times, joints = np.empty(0, dtype=np.int64), np.empty((0, n_joints))
    return Track(times, times, joints, joints)
