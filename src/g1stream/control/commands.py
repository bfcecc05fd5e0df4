"""From what the motion asks for to the two messages that go out at a tick."""

from __future__ import annotations

from typing import TYPE_CHECKING

from g1stream.dds.messages import LowCmd, Reference

if TYPE_CHECKING:
    from g1stream.control.gains import Gains
    from g1stream.control.measured import Measured
    from g1stream.control.safety import Envelope
    from g1stream.control.target import Target
    from g1stream.types import Phase

__all__ = ["Composer"]


class Composer:
    """Makes LowCmds within the envelope, and the References beside them.

    Args:
        envelope: the limits of a command.
        gains: kp and kd until the robot is damped.
        damp_kd: kd from then on, Nm s/rad.
    """

    def __init__(self, envelope: Envelope, gains: Gains, damp_kd: float) -> None:
        self._envelope = envelope
        self._gains = gains
        self._damp_kd = damp_kd
        self._command, self._reference = LowCmd(), Reference()

    def begin(self, measured: Measured) -> None:
        """Take the gains of the motion, for the robot that was measured."""
        self._envelope.begin(measured.q)
        command = self._command
        command.motor_mode = 1
        command.mode_pr[()] = 0  # the other mode gives ankle and waist another meaning
        command.mode_machine[()] = measured.mode_machine
        command.kp[:], command.kd[:] = self._gains

    def damp(self) -> None:
        """Take the gains that hold no position."""
        self._command.kp[:] = 0.0
        self._command.kd[:] = self._damp_kd

    def compose(
        self, target: Target, asked: Target, phase: Phase, tick: int, ramped: float
    ) -> tuple[bytes, bytes]:
        """A sealed LowCmd and its Reference, as they go onto the wire.

        Args:
            target: what is due when they are published; the Reference says it.
            asked: what is commanded to bring it about; the Reference says its torque.
            phase: of the session.
            tick: the Reference's number.
            ramped: how much of the ramp's way lies behind, 0 to 1.

        Raises:
            SafetyError: a number that is asked for is not finite.
        """
        command, reference, envelope = self._command, self._reference, self._envelope
        q, dq, tau = asked.q, asked.dq, asked.tau
        limited = envelope.limit(q, ramped)
        if limited is not q:
            dq, tau = envelope.inward(q - limited, dq, tau)
        command.q[:], command.dq[:], command.tau[:] = limited, dq, tau
        envelope.require_finite(q=command.q, dq=command.dq, tau=command.tau)
        reference.tick[()] = tick
        reference.phase[()] = phase
        reference.motion_time[()] = target.motion_time
        reference.target[:] = target.published
        reference.tau[:] = asked.tau
        return command.seal(), reference.tobytes()
