"""The tracking error: reference minus measured, at the publish time of each measured state.

The reference between two samples is taken as a straight line. Between samples further apart than
`MAX_GAP_NS` nothing is known of it, and states there have no error.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from g1stream.robot.joints import JOINT_GROUPS
from g1stream.session.streams import MAX_GAP_NS, neighbours
from g1stream.types import Floats, Ints

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["Track", "TrackingError", "by_limb"]

#: How long a state waits for the reference that follows it, ns.
_MAX_WAIT_NS: Final = 1_000_000_000


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
