"""The tracking error: reference minus measured, at the publish time of each measured state.

The reference between two samples is taken as a straight line. Between samples further apart than
`MAX_GAP_NS` nothing is known of it, and states there have no error.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from g1stream.robot.joints import JOINT_GROUPS
from g1stream.types import Floats, Ints

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["MAX_GAP_NS", "Neighbours", "Track", "TrackingError", "by_limb", "neighbours"]

MAX_GAP_NS: Final = 100_000_000
"""References further apart than this say nothing of the time between them."""

#: How long a state waits for the reference that follows it, ns.
_MAX_WAIT_NS: Final = 1_000_000_000


class Neighbours(NamedTuple):
    """The samples around K instants; an instant equal to a sample's time has it on both sides.

    Attributes:
        instants: (K,) which of the instants asked for.
        before, after: (K,) indices of the samples.
        gap: (K,) ns between the two.
        weight: (K,) of the later one, 0 to 1.
    """

    instants: NDArray[np.intp]
    before: NDArray[np.intp]
    after: NDArray[np.intp]
    gap: Ints
    weight: Floats

    def where(self, mask: NDArray[np.bool_] | slice) -> Neighbours:
        """Some of the instants, by a mask (K,) or a slice."""
        return Neighbours._make(values[mask] for values in self)

    def interpolate(self, values: NDArray[Any]) -> Floats:
        """(K, J) the samples' values (R, J) at the instants, linearly interpolated."""
        earlier = values[self.before]
        between: Floats = values[self.after] - earlier
        between *= self.weight[:, np.newaxis]
        between += earlier
        return between


def neighbours(times: Ints, instants: Ints) -> Neighbours:
    """Find the samples around each instant; instants before the first and after the last drop out.

    Args:
        times: (R,) ns, not decreasing.
        instants: (N,) ns, in any order.
    """
    after = np.searchsorted(times, instants)
    exact = np.append(times, -1)[after] == instants
    before = np.where(exact, after, after - 1)
    inside = np.flatnonzero((before >= 0) & (after < len(times)))
    before, after = before[inside], after[inside]
    gap = times[after] - times[before]
    weight = (instants[inside] - times[before]) / np.maximum(gap, 1)
    return Neighbours(inside, before, after, gap, weight)


class Track(NamedTuple):
    """Joints at T times: publish and log times (T,) ns, q and dq (T, 29) rad and rad/s."""

    publish_times: Ints
    log_times: Ints
    q: Floats
    dq: Floats

    def where(self, index: NDArray[np.bool_] | NDArray[np.intp] | slice) -> Track:
        """Some of the times."""
        return Track._make(values[index] for values in self)

    def then(self, other: Track) -> Track:
        """Both, one after the other."""
        return Track._make(np.concatenate(pair) for pair in zip(self, other, strict=True))


class TrackingError:
    """Computes the tracking error of states and references that come in batches.

    An error is known when the reference after its state has come; its log time is when the last of
    what it is made of was received.

    Args:
        n_joints: how many joints there are.

    Attributes:
        played: (n_joints,) those that play the motion, by the references taken in last.
    """

    def __init__(self, n_joints: int) -> None:
        times, joints = np.empty(0, dtype=np.int64), np.empty((0, n_joints))
        self._references = self._states = Track(times, times, joints, joints)
        self.played = np.ones(n_joints, dtype=bool)

    def add_references(self, references: Track, played: NDArray[np.bool_] | None = None) -> None:
        """Take in references, and which joints (n_joints,) play them; all if None."""
        if played is not None:
            self.played = played
        together = self._references.then(references)
        # Two writers' references may come interleaved.
        self._references = together.where(np.argsort(together.publish_times, kind="stable"))

    def add_states(self, states: Track) -> None:
        """Take in measured states."""
        self._states = self._states.then(states)

    def take(self) -> Track:
        """The errors that became known: q (rad) and dq (rad/s) are reference minus measured."""
        references, states = self._references, self._states
        known = states.publish_times <= references.publish_times[-1:].max(initial=-1)
        self._states = _recent(states.where(~known))
        # Kept though no state waits: one published before them may be handed over after them.
        self._references = _recent(references)
        states = states.where(known)
        around = neighbours(references.publish_times, states.publish_times)
        around = around.where(around.gap <= MAX_GAP_NS)
        states = states.where(around.instants)
        return Track(
            states.publish_times,
            np.maximum(states.log_times, references.log_times[around.after]),
            around.interpolate(references.q) - states.q,
            around.interpolate(references.dq) - states.dq,
        )


def by_limb(errors: Floats, played: NDArray[np.bool_]) -> Floats:
    """RMS over the joints of each limb that play the motion.

    Args:
        errors: (T, 29).
        played: (29,) which joints play.

    Returns:
        (T, 5), limbs as in `JOINT_GROUPS`; nan for one of which no joint plays.
    """
    limbs = np.full((len(errors), len(JOINT_GROUPS)), np.nan)
    for limb, joints in enumerate(JOINT_GROUPS.values()):
        if members := [joint for joint in joints if played[joint]]:
            limbs[:, limb] = np.sqrt((errors[:, members] ** 2).mean(axis=1))
    return limbs


def _recent(track: Track) -> Track:
    """Without what is much older than the newest."""
    newest = track.publish_times.max(initial=0)
    return track.where(track.publish_times >= newest - _MAX_WAIT_NS)
