"""Everything received that keeps a session from its first command, or ends it; pure.

`state_checks` says whether a LowState is to be believed, `robot_monitor` whether the robot is all
right, `dds.remote` what its operator asks for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from g1stream.control.robot_monitor import RobotMonitor
from g1stream.control.state_checks import StateChecks
from g1stream.dds.remote import Operator

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from g1stream.config import SafetyConfig
    from g1stream.control.state_checks import Measured
    from g1stream.dds.messages import LowState
    from g1stream.robot.model import G1
    from g1stream.types import Floats

__all__ = ["Safety"]


class Safety:
    """The checks of a session.

    Args:
        robot: its limits.
        config: the thresholds.
        period: between two looks at LowState, ns.
        held: (29,) which joints have a position servo; all if None.

    Raises:
        ConfigError: a setting names no button of the remote.
    """

    def __init__(
        self,
        robot: G1,
        config: SafetyConfig,
        period: int = 0,
        held: NDArray[np.bool_] | None = None,
    ) -> None:
        self._states = StateChecks(robot, config)
        self._monitor = RobotMonitor(robot, config, period, held)
        self._operator = Operator(config.stop_buttons, config.deadman)
        self._begun = False
        self._missing = self._verdict = ""

    @property
    def crc_errors(self) -> int:
        """LowStates that were dropped because of their CRC."""
        return self._states.crc_errors

    def begin(self) -> None:
        """The first command follows."""
        self._begun = True
        self._states.begin()

    def take(
        self, state: LowState, publisher: int, now: int, target: Floats | None = None
    ) -> Measured | None:
        """Check a LowState that was received at `now`, ns; None if it is dropped.

        Args:
            state: the LowState.
            publisher: identity of its publisher.
            now: ns, monotonic.
            target: (29,) rad, the joint targets now; None before the first command.
        """
        measured = self._states.take(state, publisher, now, target)
        if measured is None:
            return None
        buttons = state.buttons
        self._missing = self._operator.missing(buttons)
        if self._states.unknown(now, target):
            self._verdict = ""
            return measured
        self._verdict = (
            (self._operator.verdict(buttons) if self._begun else "")
            or self._states.wrong_robot()
            or self._monitor.verdict(state, measured, now, target)
        )
        return measured

    def unknown(self, now: int, target: Floats | None = None) -> str:
        """Why nothing is known of the robot, or ""; see `StateChecks.unknown`."""
        return self._states.unknown(now, target)

    def missing(self) -> str:
        """What the operator has to do before the first command, or ""."""
        return self._missing

    def verdict(self) -> str:
        """Why the session must end by the newest LowState, whose robot is known, or ""."""
        return self._verdict
