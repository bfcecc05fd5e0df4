"""The commands of a session that played its motion, looked at before they are sent again.

Nothing alters a recorded command, so that none may be sent which would not have passed the envelope
or at which the robot would leap. A session is read a batch at a time: what stays in memory of a
command is what differs from others.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import islice
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from g1stream.config import MAX_KD, MAX_KP
from g1stream.control.safety import Envelope
from g1stream.dds.layout import CDR_HEADER, Layout
from g1stream.dds.messages import LowCmd, Samples
from g1stream.errors import RecordingError, SafetyError
from g1stream.replay.pace import JITTER, ROUNDING, Steps, disorder, pause
from g1stream.replay.recorded_link import PackedCommands
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS
from g1stream.session.streams import Command, Reference
from g1stream.types import Floats, Phase

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from g1stream.config import SafetyConfig
    from g1stream.robot.model import G1
    from g1stream.session.session import Session


__all__ = ["RecordedCommands", "recorded_commands"]

#: Commands that are looked at together.
_BATCH: Final = 1024


@dataclass(frozen=True)
class RecordedCommands:
    """Commands that may be sent again.

    Attributes:
        times: (N,) when in the motion each was due, s at the speed of the recording.
        commands: (N) as they were on the wire, CDR header included.
        q: (N, 29) float32, their joint targets, rad; (0, 29) where the session has a reference,
            which says better what was meant.
    """

    times: Floats
    commands: PackedCommands
    q: NDArray[np.float32]


def recorded_commands(
    session: Session, robot: G1, safety: SafetyConfig, speed: float = 1.0
) -> RecordedCommands:
    """The commands of PLAY, or where there is no reference all that held the robot.

    Args:
        session: where they were recorded.
        robot: whose limits hold.
        safety: the margin to the joint limits, and how long a loop may stand still.
        speed: how many times as fast they are to be sent.

    Raises:
        RecordingError: there are none, or the file is damaged.
        SafetyError: one of them must not be sent, or the robot would leap at it.
    """
    due = _Due(session)
    look = _Look(robot, safety)
    # The motion times of a reference are those of the ticks, however late they came.
    steps = Steps(robot.velocity, 0.0 if due.has_reference else JITTER)
    packed, times, targets = PackedCommands(), [np.empty(0)], [np.empty((0, N_JOINTS), np.float32)]
    for stamps, data in _batches(session):
        samples = session.samples(Command, data)
        rows, when = due.find(stamps, samples)
        chosen = [data[row] for row in rows.tolist()]
        if odd := look.at(samples, rows) or look.at_whole(chosen):
            raise _unsafe(session, odd)
        q = samples["motor_cmd.q"][rows]
        steps.add(q)
        packed.add(chosen)
        times.append(when)
        if not due.has_reference:
            targets.append(q)
    all_times = np.concatenate(times)
    begin, end = due.interval(session, all_times)
    all_times -= begin
    whole = np.concatenate([[0.0], all_times, [end - begin]])
    odd = disorder(all_times) or pause(whole, safety.state_timeout, speed)
    if odd := odd or steps.leap(all_times, speed):
        raise _unsafe(session, odd)
    return RecordedCommands(all_times, packed, np.concatenate(targets))


def _batches(session: Session) -> Iterator[tuple[NDArray[np.int64], list[bytes]]]:
    """Publish times (n,), ns, and bytes (n) of the recorded commands, in the order of the file."""
    messages = session.messages(Command.topic)
    while batch := list(islice(messages, _BATCH)):
        yield np.array([one.publish_time for one in batch]), [one.data for one in batch]


class _Due:
    """Which commands are sent again, and when each was due.

    Attributes:
        has_reference: it says so; a command and its reference have the very same stamp.
    """

    def __init__(self, session: Session) -> None:
        self.has_reference = bool(session.topics.get(Reference.topic))
        self._stamps: NDArray[np.int64] = np.empty(0, np.int64)
        self._times: Floats = np.empty(0)
        if self.has_reference:
            reference = session.reference
            playing = np.flatnonzero(reference.phase == Phase.PLAY)
            stamps = reference.publish_time[playing]
            order = np.argsort(stamps, kind="stable")
            self._stamps, self._times = stamps[order], reference.motion_time[playing][order]

    def find(self, stamps: NDArray[np.int64], samples: Samples) -> tuple[NDArray[np.intp], Floats]:
        """The rows (m,) of a batch that are sent again, and when they were due (m,), s."""
        if not self.has_reference:
            rows = np.flatnonzero(samples["motor_cmd.kp"].any(axis=1))
            # Since the first command of all, so that no digit is lost.
            self._stamps = self._stamps if len(self._stamps) else stamps[:1]
            return rows, (stamps[rows] - self._stamps[0]) / 1e9
        if not len(self._stamps):
            return np.empty(0, np.intp), np.empty(0)
        nearest = np.searchsorted(self._stamps, stamps).clip(max=len(self._stamps) - 1)
        rows = np.flatnonzero(self._stamps[nearest] == stamps)
        return rows, self._times[nearest[rows]]

    def interval(self, session: Session, times: Floats) -> tuple[float, float]:
        """When the motion begins and ends of which commands (N,) are due at these times, s.

        Raises:
            RecordingError: there is no motion.
        """
        if len(times) < 2:
            raise RecordingError(
                f"{session.path} has no commands that played a motion.",
                "Give a session in which somebody held the robot with kp above 0.",
            )
        when = self._times if self.has_reference else times
        begin, end = float(when.min()), float(when.max())
        if not 0.0 < end - begin < np.inf:
            raise RecordingError(
                f"{session.path} does not say when its commands are due: by their times, the "
                f"motion lasts {end - begin:g} s.",
                "Record the motion again.",
            )
        return begin, end


class _Look:
    """Whether single commands would have passed the envelope."""

    def __init__(self, robot: G1, safety: SafetyConfig) -> None:
        Envelope(robot, safety)  # refuses a margin that leaves nothing
        margin = safety.position_margin
        torque = robot.torque_limit
        nothing = np.zeros(N_JOINTS)
        self._kept = f", with safety.position_margin = {margin:g} rad" if margin else ""
        self._limits: tuple[tuple[str, str, Floats, Floats], ...] = (
            ("q", "rad", robot.lower + margin, robot.upper - margin),
            ("dq", "rad/s", -robot.velocity, robot.velocity),
            ("tau", "Nm", -torque, torque),
            ("kp", "Nm/rad", nothing, nothing + MAX_KP),
            ("kd", "Nm s/rad", nothing, nothing + MAX_KD),
        )
        self._seen = LowCmd()
        layout = Layout.of(LowCmd.idl_type)
        names = ("mode", *(name for name, *_ in self._limits))
        fields = {name: layout[f"motor_cmd.{name}"] for name in names}
        #: Of the motors that only the wire has.
        self._spare = {
            name: replace(field, offsets=field.offsets[N_JOINTS:]) for name, field in fields.items()
        }

    def at(self, samples: Samples, rows: NDArray[np.intp]) -> str:
        """What is wrong with the values of these rows of a batch, or ""."""
        for name, unit, lower, upper in self._limits:
            values = samples[f"motor_cmd.{name}"][rows].astype(np.float64)
            if not np.isfinite(values).all():
                joint = JOINT_NAMES[int(np.argwhere(~np.isfinite(values))[0, 1])]
                return f"has a {name} of {joint} that is not finite"
            # What lies at a limit was rounded to float32 on the wire.
            slack = ROUNDING * np.maximum(1.0, np.maximum(np.abs(lower), np.abs(upper)))
            beyond = (values < lower - slack) | (values > upper + slack)
            if beyond.any():
                row, j = np.argwhere(beyond)[0]
                return (
                    f"asks {JOINT_NAMES[j]} for a {name} of {values[row, j]:.3f} {unit}, beyond "
                    f"its limits {lower[j]:.3f} and {upper[j]:.3f}{self._kept * (name == 'q')}"
                )
        return self._modes(samples, rows)

    @staticmethod
    def _modes(samples: Samples, rows: NDArray[np.intp]) -> str:
        if (odd := samples["mode_pr"][rows]).any():
            return f"has mode_pr {odd.max()}, not 0"
        modes: NDArray[Any] = samples["motor_cmd.mode"][rows]
        if (modes != 1).any():
            row, j = np.argwhere(modes != 1)[0]
            return f"has mode {modes[row, j]} for the motor of {JOINT_NAMES[j]}, not 1"
        return ""

    def at_whole(self, commands: list[bytes]) -> str:
        """What is wrong with commands as a whole, or ""."""
        for data in commands:
            self._seen.load(data)
            if not self._seen.crc_matches():
                return "has a checksum that does not fit"
        return self._at_spare(commands) if commands else ""

    def _at_spare(self, commands: list[bytes]) -> str:
        """What is asked of the motors that a G1 has not, or "".

        Their mode may be 0 or 1: some publishers of Unitree's enable all that the wire has.
        """
        samples = np.frombuffer(b"".join(commands), np.uint8).reshape(len(commands), -1)
        for name, field in self._spare.items():
            values = field.read(samples[:, len(CDR_HEADER) :])
            # Of numbers that are none, this is true, too.
            odd = np.argwhere((values != 0) & ((name != "mode") | (values != 1)))
            if len(odd):
                row, j = odd[0]
                return (
                    f"has a {name} of {values[row, j]:g} for motor {N_JOINTS + j}, which a G1 has "
                    "not"
                )
        return ""


def _unsafe(session: Session, what: str) -> SafetyError:
    if session.topics.get(Reference.topic):
        remedy = "Replay the reference instead, which stays within the envelope: leave out --exact."
    else:
        remedy = "Record the commands again: without a reference there is no other way to replay."
    return SafetyError(f"A recorded command of {session.path} {what}.", remedy)
