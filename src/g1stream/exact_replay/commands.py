"""The recorded commands of a session, checked before they are sent again.

A recorded command is sent unmodified. It is refused if the safety envelope would not have passed
it, or if a joint cannot follow from the command before.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.control.commands import MAX_STEP_TIME, SPEED_TOLERANCE, CommandLimits
from g1stream.control.state_checks import STATE_TIMEOUT
from g1stream.dds.layout import CDR_HEADER, Layout
from g1stream.dds.messages import LowCmd
from g1stream.errors import RecordingError, SafetyError
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS
from g1stream.session.streams import Command, Reference
from g1stream.settings import MAX_KD, MAX_KP
from g1stream.types import Floats, Phase

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from g1stream.dds.messages import Samples
    from g1stream.robot.model import G1
    from g1stream.safety_settings import SafetyConfig
    from g1stream.session.session import Session

__all__ = ["RecordedCommands", "find_jump", "recorded_commands"]

#: Tolerance for values that were rounded to float32, relative above 1.
_ROUNDING: Final = 1e-6
#: Without a reference, two publish times may be this much too close, s: one period of 500 Hz, after
#: which a publisher that is late skips a tick.
_JITTER: Final = 0.002
#: Commands that are checked at once.
_BLOCK: Final = 1024


@dataclass(frozen=True)
class RecordedCommands:
    """Commands that may be sent again.

    Attributes:
        times: (N,) when in the motion each is due at the speed of the replay, s, not decreasing.
        data: (N) as they were on the wire, CDR header included; 1 kB each.
        q: (N, 29) float32, their joint targets, rad.
        velocity: (29,) the speed that the joints can follow, rad/s.
    """

    times: Floats
    data: Sequence[bytes]
    q: NDArray[np.float32]
    velocity: Floats


def recorded_commands(
    session: Session, robot: G1, safety: SafetyConfig, speed: float = 1.0
) -> RecordedCommands:
    """The commands of PLAY; in a session without a reference, all commands with kp above 0.

    Args:
        session: where they were recorded.
        robot: whose limits apply.
        safety: the margin to the joint limits, and the longest gap between commands.
        speed: factor relative to the recording.

    Raises:
        RecordingError: there are none, or the file is damaged.
        SafetyError: one of them must not be sent to this robot.
    """
    times, data, duration = _schedule(session)
    times, duration = times / speed, duration / speed
    checks = _CommandChecks(robot, safety)
    q = np.empty((len(data), N_JOINTS), np.float32)
    for start in range(0, len(data), _BLOCK):
        block = slice(start, start + _BLOCK)
        samples = session.samples(Command, data[block])
        if problem := checks.find_problem(samples, data[block]):
            raise _refused(session, problem)
        q[block] = samples["motor_cmd.q"]
    # Motion times of a reference are exact, however late the ticks were.
    jitter = 0.0 if _has_reference(session) else _JITTER / speed
    problem = _find_gap(times, duration, safety.state_timeout or STATE_TIMEOUT)
    if problem := problem or find_jump(times, q, robot.velocity, jitter):
        raise _refused(session, problem)
    return RecordedCommands(times, data, q, robot.velocity)


def _has_reference(session: Session) -> bool:
    return bool(session.topics.get(Reference.topic))


def _schedule(session: Session) -> tuple[Floats, list[bytes], float]:
    """When each command is due (N,), s from the begin of the motion; the commands; its duration."""
    messages = list(session.messages(Command.topic))
    publish_times = np.array([message.publish_time for message in messages])
    if _has_reference(session):
        reference = session.reference
        playing = np.flatnonzero(reference.phase == Phase.PLAY)
        playing = playing[np.argsort(reference.publish_time[playing], kind="stable")]
        motion_time, of_reference = reference.motion_time[playing], reference.publish_time[playing]
        # A command and its reference have the same publish time.
        nearest = np.searchsorted(of_reference, publish_times).clip(max=max(0, len(playing) - 1))
        rows = np.flatnonzero(of_reference[nearest] == publish_times) if len(playing) else playing
        times = motion_time[nearest[rows]]
    else:
        kp = session.samples(Command, [message.data for message in messages])["motor_cmd.kp"]
        rows = np.flatnonzero(kp.any(axis=1))
        times = motion_time = (publish_times[rows] - publish_times[0]) / 1e9
    if len(rows) < 2:
        raise RecordingError(
            f"{session.path} has no commands that played a motion.",
            "Give a session that contains LowCmds with kp above 0.",
        )
    start, end = float(motion_time.min()), float(motion_time.max())
    if not 0.0 < end - start < np.inf:
        raise RecordingError(
            f"The commands of {session.path} have no valid motion times: the motion lasts "
            f"{end - start:g} s.",
            "Record the motion again.",
        )
    return times - start, [messages[row].data for row in rows.tolist()], end - start


class _CommandChecks:
    """Checks of single commands against the safety envelope."""

    def __init__(self, robot: G1, safety: SafetyConfig) -> None:
        CommandLimits(robot, safety)  # raises if the margin leaves no range
        margin, zero = safety.position_margin, np.zeros(N_JOINTS)
        self._margin = f" with safety.position_margin = {margin:g} rad" if margin else ""
        self._limits: tuple[tuple[str, str, Floats, Floats], ...] = (
            ("q", "rad", robot.lower + margin, robot.upper - margin),
            ("dq", "rad/s", -robot.velocity, robot.velocity),
            ("tau", "N·m", -robot.torque_limit, robot.torque_limit),
            ("kp", "N·m/rad", zero, zero + MAX_KP),
            ("kd", "N·m·s/rad", zero, zero + MAX_KD),
        )
        self._command = LowCmd()
        self._layout = Layout.of(LowCmd.idl_type)

    def find_problem(self, samples: Samples, data: Sequence[bytes]) -> str:
        """What is wrong with one of the commands, or ""."""
        for command in data:
            self._command.load(command)
            if not self._command.crc_matches():
                return "has a wrong CRC"
        return self._find_mode(samples) or self._find_limit(samples) or self._find_extra(data)

    @staticmethod
    def _find_mode(samples: Samples) -> str:
        if (mode_pr := samples["mode_pr"]).any():
            return f"has mode_pr {mode_pr.max()}; only 0 is allowed"
        modes = samples["motor_cmd.mode"]
        if (modes == 1).all():
            return ""
        row, joint = np.argwhere(modes != 1)[0]
        return f"has mode {modes[row, joint]} for {JOINT_NAMES[joint]}; only 1 is allowed"

    def _find_extra(self, data: Sequence[bytes]) -> str:
        """Motors that a G1 does not have may be enabled, as some publishers do, and nothing else.

        The comparison is also true for NaN.
        """
        rows = np.frombuffer(b"".join(data), np.uint8).reshape(len(data), -1)[:, len(CDR_HEADER) :]
        for name in ("mode", *(name for name, *_ in self._limits)):
            field = self._layout[f"motor_cmd.{name}"]
            values = replace(field, offsets=field.offsets[N_JOINTS:]).read(rows)
            wrong = np.argwhere((values != 0) & ((name != "mode") | (values != 1)))
            if len(wrong):
                row, motor = wrong[0]
                return (
                    f"has {name}={values[row, motor]:g} for motor {N_JOINTS + motor}: a G1 has "
                    f"motors 0-{N_JOINTS - 1}"
                )
        return ""

    def _find_limit(self, samples: Samples) -> str:
        for name, unit, lower, upper in self._limits:
            values = samples[f"motor_cmd.{name}"].astype(np.float64)
            tolerance = _ROUNDING * np.maximum(1.0, np.maximum(np.abs(lower), np.abs(upper)))
            # Negated, so that NaN is outside.
            outside = ~((values >= lower - tolerance) & (values <= upper + tolerance))
            if outside.any():
                row, joint = np.argwhere(outside)[0]
                return (
                    f"has {name} = {values[row, joint]:.3f} {unit} for {JOINT_NAMES[joint]}, whose "
                    f"limits are {lower[joint]:.3f} and {upper[joint]:.3f}"
                    f"{self._margin * (name == 'q')}"
                )
        return ""


def _find_gap(times: Floats, duration: float, longest: float) -> str:
    """Where commands (N,) are out of order or missing, or ""."""
    back = np.flatnonzero(np.diff(times) < 0.0)
    if len(back):
        i = int(back[0])
        return (
            f"at {times[i]:.3f} s of the motion is followed by one at {times[i + 1]:.3f} s: the "
            "session contains more than one motion, or the clock was set back"
        )
    whole = np.concatenate([[0.0], times, [duration]])
    gaps = np.diff(whole)
    i = int(np.argmax(gaps))
    if gaps[i] <= longest + 1e-9:
        return ""
    return (
        f"would be held from {whole[i]:.3f} to {whole[i + 1]:.3f} s of the motion because others "
        f"are missing: {gaps[i]:.3f} s (limit {longest:g} s, safety.state_timeout)"
    )


def find_jump(times: Floats, q: NDArray[np.float32], velocity: Floats, jitter: float) -> str:
    """Where a joint cannot follow the commands, or "".

    A step may take no more than the time between its two commands and the jitter, of which at most
    `MAX_STEP_TIME` counts. What the jitter allows may not add up to more than that either.

    Args:
        times: (N,) when the commands are due, s.
        q: (N, 29) joint targets, rad.
        velocity: (29,) the speed that the joints can follow, rad/s.
        jitter: by how much two times may be too close, s.
    """
    durations = np.abs(np.diff(q, axis=0)) / velocity
    joints, needed = durations.argmax(axis=1), durations.max(axis=1)
    between, rounding = np.diff(times), _ROUNDING / velocity.min()
    allowed = np.minimum(between + jitter, MAX_STEP_TIME)
    jumps = np.flatnonzero(needed > (1.0 + SPEED_TOLERANCE) * allowed + rounding)
    if len(jumps):
        i, joint = int(jumps[0]), int(joints[jumps[0]])
        return (
            f"moves {JOINT_NAMES[joint]} by {velocity[joint] * needed[i]:.3f} rad in one step at "
            f"{times[i + 1]:.3f} s of the motion; {velocity[joint]:g} rad/s allow "
            f"{velocity[joint] * allowed[i]:.3f} rad"
        )
    # The delay of the slowest joint: time that is missing adds up, spare time reduces it to 0.
    total = np.cumsum(needed - (1.0 + SPEED_TOLERANCE) * between - rounding)
    delay = total - np.minimum(np.minimum.accumulate(total), 0.0)
    late = np.flatnonzero(delay > MAX_STEP_TIME)
    if len(late):
        i, joint = int(late[0]), int(joints[late[0]])
        return (
            f"is too early at {times[i + 1]:.3f} s of the motion: at {velocity[joint]:g} rad/s "
            f"{JOINT_NAMES[joint]} would be {delay[i]:.3f} s late (limit {MAX_STEP_TIME:g} s)"
        )
    return ""


def _refused(session: Session, problem: str) -> SafetyError:
    remedy = (
        "Replay the reference, which stays within the limits: leave out --exact."
        if _has_reference(session)
        else "Record the motion again; without a reference, only recorded commands can be replayed."
    )
    return SafetyError(f"A recorded command of {session.path} {problem}.", remedy)
