"""What the picture of a session shows, as arrays; pure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.analysis.metrics import common_times, compare, track
from g1stream.robot.joints import JOINT_GROUPS, N_JOINTS
from g1stream.types import Floats, Phase

if TYPE_CHECKING:
    from g1stream.analysis.metrics import Comparison, Tracking
    from g1stream.session.streams import Measured, Reference
    from g1stream.session.summary import PhaseInterval


__all__ = ["LONGEST_VIEW", "Scene", "binned_rms", "joints_to_show", "make_scene"]

LONGEST_VIEW: Final = 20.0
"""A longer session shows its joints for so long only, around the greatest error, s."""

_NARROWEST_BIN: Final = 0.1
_MOST_BINS: Final = 200


@dataclass(frozen=True)
class Scene:
    """What is drawn: times are s since the motion began, angles degrees.

    Attributes:
        times: (N,) when references were published.
        asked: (N, 29) what they asked for; nan while the joints were only damped.
        state_times: (M,) when LowStates were published.
        measured: (M, 29).
        phases: in order.
        compared: reference and measurement at the same instants, in its own times and units.
        tracking: None where nothing was compared.
        error_times: (K,) the instants that were compared.
        error: (K, 29) reference - measured.
        view: from when to when the joints are shown.
    """

    times: Floats
    asked: Floats
    state_times: Floats
    measured: Floats
    phases: list[PhaseInterval]
    compared: Comparison
    tracking: Tracking | None
    error_times: Floats
    error: Floats
    view: tuple[float, float]


def make_scene(reference: Reference, measured: Measured) -> Scene:
    """Put the whole of a session on the motion's own time."""
    times, state_times = common_times(reference, measured)
    compared = compare(reference, measured)
    playing = times[reference.phase == Phase.PLAY]
    origin = playing[0] if len(playing) else times[0]
    damping = (reference.phase == Phase.DAMP)[:, None]
    phases = reference.phases
    error = np.degrees(compared.error)
    error_times = compared.time - origin
    return Scene(
        times=times - origin,
        asked=np.where(damping, np.nan, np.degrees(reference.q)),
        state_times=state_times - origin,
        measured=np.degrees(measured.q),
        phases=phases,
        compared=compared,
        tracking=track(compared) if len(compared.time) else None,
        error_times=error_times,
        error=error,
        view=_view(phases[0].start_s, phases[-1].end_s, error_times, error),
    )


def joints_to_show(scene: Scene) -> tuple[list[int], list[int]]:
    """The joint of each limb of which the widest way is asked, and the worst of the others.

    Returns:
        five motor indices, and one, or none where nothing was compared.
    """
    asked = scene.compared.reference if scene.tracking else scene.compared.all_q
    way = np.ptp(asked, axis=0)
    busiest = [max(joints, key=lambda joint: float(way[joint])) for joints in JOINT_GROUPS.values()]
    if scene.tracking is None:
        return busiest, []
    rmse = scene.tracking.rmse
    others = [joint for joint in range(N_JOINTS) if joint not in busiest]
    return busiest, [max(others, key=lambda joint: float(rmse[joint]))]


def binned_rms(times: Floats, errors: Floats) -> tuple[Floats, Floats]:
    """RMS of errors (K, J) at times (K,) in bins of 0.1 s, or in 200 bins of a longer session.

    Returns:
        the middle of each bin (B,) and its RMS (B,), nan where it is empty.
    """
    width = max(_NARROWEST_BIN, float(times[-1] - times[0]) / _MOST_BINS)
    edges = times[0] + width * np.arange(int((times[-1] - times[0]) / width) + 2)
    counts, _ = np.histogram(times, edges)
    sums, _ = np.histogram(times, edges, weights=np.square(errors).mean(axis=1))
    mean_squares = np.divide(sums, counts, out=np.full(len(counts), np.nan), where=counts > 0)
    return (edges[:-1] + edges[1:]) / 2.0, np.sqrt(mean_squares)


def _view(first: float, last: float, error_times: Floats, error: Floats) -> tuple[float, float]:
    if last - first <= LONGEST_VIEW or not len(error):
        return first, last
    worst = float(error_times[np.abs(error).max(axis=1).argmax()])
    start = min(max(worst - LONGEST_VIEW / 2.0, first), last - LONGEST_VIEW)
    return start, start + LONGEST_VIEW
