"""Commanded and measured signals of the joints over time, for plots."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Literal, NamedTuple, get_args

import numpy as np

from g1stream.analysis.torque import commanded_torque
from g1stream.analysis.tracking import blocks
from g1stream.errors import ConfigError, RecordingError
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS
from g1stream.session.motions import motion_of
from g1stream.session.streams import CommandStream, MeasuredStream, ReferenceStream
from g1stream.types import Floats, Ints, Phase
from g1stream.view.encoders import JointStatesTemplate

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from g1stream.session.recording import Recording

__all__ = [
    "QUANTITIES",
    "SIMULATED",
    "Line",
    "Quantity",
    "Signal",
    "chosen_quantities",
    "min_max",
    "signal",
    "simulated",
]

Quantity = Literal["q", "dq", "tau", "error"]
"""Quantities of a plot: joint position, velocity, torque, tracking error."""

QUANTITIES: Final[tuple[Quantity, ...]] = get_args(Quantity)

#: A line is interrupted at gaps longer than this, s.
_GAP: Final = 0.05

SIMULATED: Final = "/simulated/joint_states"
"""The topic of the joints that `g1stream simulate` computed."""


class Line(NamedTuple):
    """A line of a plot for each joint.

    Attributes:
        name: what it is, such as "measured".
        time: (N,) s on the motion's clock, rising.
        values: (N, J) in the unit of the signal, nan where there are none; each joint's follow one
            another in memory.
    """

    name: str
    time: Floats
    values: Floats

    @classmethod
    def from_samples(cls, name: str, time: Floats, values: Floats) -> Line:
        """A line with samples in the order of time, interrupted at gaps."""
        if (np.diff(time) < 0.0).any():
            order = np.argsort(time, kind="stable")
            time, values = time[order], values[order]
        if len(gaps := np.flatnonzero(np.diff(time) > _GAP) + 1):
            time = np.insert(time, gaps, time[gaps])
            values = np.insert(values, gaps, np.nan, axis=0)
        return cls(name, time, np.asfortranarray(values))


@dataclass(frozen=True, eq=False)
class Signal:
    """One quantity of joints.

    Attributes:
        title, unit: labels of the axis.
        lines: the available lines.
    """

    title: str
    unit: str
    lines: tuple[Line, ...]

    @property
    def label(self) -> str:
        """Label of the axis: name and unit."""
        return f"{self.title}, {self.unit}"


def signal(
    session: Recording, quantity: Quantity, joints: Sequence[int] = range(N_JOINTS)
) -> Signal:
    """A quantity of joints of a session; without lines where nothing of it was recorded.

    Positions, velocities and errors are in degrees. The commanded torque is
    `commanded_torque`. In a long session a few `joints` at a time, by motor index, take less
    memory.
    """
    makers: dict[Quantity, Callable[[], Signal]] = {
        "q": lambda: Signal("position", "deg", _asked_and_measured(session, "q", joints)),
        "dq": lambda: Signal("velocity", "deg/s", _asked_and_measured(session, "dq", joints)),
        "tau": lambda: Signal("torque", "N·m", _torques(session, joints)),
        "error": lambda: Signal("error", "deg", _errors(session, joints)),
    }
    return makers[quantity]()


def chosen_quantities(names: Sequence[str]) -> list[Quantity]:
    """Validate names of quantities, and return them in their order.

    Raises:
        ConfigError: the list is empty, or a quantity is unknown.
    """
    chosen = [known for name in names for known in QUANTITIES if known == name]
    if len(chosen) < max(len(names), 1):
        wrong = next((name for name in names if name not in QUANTITIES), "")
        raise ConfigError(
            f"There is no quantity {wrong!r} to plot.", f"Choose from {', '.join(QUANTITIES)}."
        )
    return chosen


def min_max(values: Floats, most: int) -> Ints:
    """Indices of about `most` of N samples, in order, that show the same peaks in a plot.

    Each of `most` // 2 runs of samples gives its minimum, its maximum and its first nan. If N is
    not larger than `most`, all indices are returned. The time is proportional to N.

    Args:
        values: (N,).
        most: number of indices, not counting those of nan.
    """
    n = len(values)
    if n <= most:
        return np.arange(n)
    width = -(-n // (most // 2))
    runs = np.pad(values, (0, -n % width), mode="edge").reshape(-1, width)
    absent = np.isnan(runs)
    if absent.any():
        lowest = np.where(absent, np.inf, runs).argmin(axis=1)
        highest = np.where(absent, -np.inf, runs).argmax(axis=1)
        kept = [lowest, highest, absent.argmax(axis=1)]  # index 0 if none is nan
    else:
        kept = [runs.argmin(axis=1), runs.argmax(axis=1)]
    indices: Ints = np.unique((np.stack(kept) + width * np.arange(len(runs))).clip(max=n - 1))
    return indices


def _asked_and_measured(
    session: Recording, column: Literal["q", "dq"], joints: Sequence[int]
) -> tuple[Line, ...]:
    lines = []
    if session.topics.get(ReferenceStream.topic):
        reference = session.reference.read("phase", column)
        asked = _degrees(reference.recorded(column), joints)
        asked[reference.phase == Phase.DAMP] = np.nan  # where nothing is asked for but damping
        lines.append(Line.from_samples("reference", reference.time, asked))
    elif session.topics.get(CommandStream.topic):
        command = session.command
        degrees = _degrees(command.recorded(column), joints)
        lines.append(Line.from_samples("command", command.time, degrees))
    elif column == "q" and session.converted:
        motion = motion_of(session)
        time = np.arange(motion.n_frames) / motion.fps
        lines.append(Line.from_samples("motion", time, _degrees(motion.joint_pos, joints)))
    lines += simulated(session, column, joints)
    if session.topics.get(MeasuredStream.topic):
        measured = session.measured
        degrees = _degrees(measured.recorded(column), joints)
        lines.append(Line.from_samples("measured", measured.time, degrees))
    return tuple(lines)


def simulated(
    session: Recording, column: Literal["q", "dq", "tau"], joints: Sequence[int]
) -> list[Line]:
    """What `g1stream simulate` added to the session, in the unit of the signal; or nothing.

    Raises:
        RecordingError: the added messages cannot be decoded.
    """
    if not session.topics.get(SIMULATED):
        return []
    template = JointStatesTemplate(JOINT_NAMES, ("position", "velocity", "effort"))
    try:
        values = template.decode([message.data for message in session.messages(SIMULATED)])
    except ValueError as error:
        raise RecordingError(
            f"{SIMULATED} in {session.path} cannot be decoded: {error}.",
            "Simulate the session again, with this version of g1stream.",
        ) from error
    chosen = values[:, :, ("q", "dq", "tau").index(column)]
    time = session.times[SIMULATED].time
    chosen = chosen[:, joints] if column == "tau" else _degrees(chosen, joints)
    return [Line.from_samples("simulated", time, chosen)]


def _errors(session: Recording, joints: Sequence[int]) -> tuple[Line, ...]:
    """Also in RAMP and HOLD, unlike `tracking`."""
    lines = {line.name: line for line in _asked_and_measured(session, "q", joints)}
    if not {"reference", "measured"} <= lines.keys():
        return ()
    asked, (_, time, error) = lines["reference"], lines["measured"]
    if not len(asked.time):  # a part before the first
        return ()
    for column, target in zip(error.T, asked.values.T, strict=True):
        column[:] = np.interp(time, asked.time, target, np.nan, np.nan) - column
    known = ~np.isnan(error).all(axis=1)
    return (Line.from_samples("reference - measured", time[known], error[known]),)


def _degrees(values: NDArray[Any], joints: Sequence[int]) -> Floats:
    """(N, J) rad in degrees, of (N, 29); each joint's follow one another in memory."""
    degrees = np.empty((len(values), len(joints)), order="F")
    for part in blocks(len(values)):
        degrees[part] = np.degrees(values[part][:, joints].astype(np.float64, copy=False))
    return degrees


def _torques(session: Recording, joints: Sequence[int]) -> tuple[Line, ...]:
    lines = []
    if session.topics.get(MeasuredStream.topic):
        measured = session.measured.read("q", "dq", "tau")
        if session.topics.get(CommandStream.topic):
            asked = commanded_torque(session)[:, joints]
            lines.append(Line.from_samples("commanded", measured.time, asked))
        lines += simulated(session, "tau", joints)
        estimated = measured.recorded("tau")[:, joints]
        lines.append(Line.from_samples("estimated", measured.time, estimated))
    return tuple(lines)
