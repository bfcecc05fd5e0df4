"""The robot's own remote control, as LowState's `wireless_remote` shows it; pure.

40 bytes, of which bytes 2 and 3 are the buttons, one bit for each, little endian. Source: the
joystick classes of Unitree's SDK. Where there is no remote, as in a simulator without a joystick,
all are zero.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from g1stream.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["BUTTONS", "BUTTONS_AT", "Operator", "button_mask"]

BUTTONS: Final = (
    "R1",
    "L1",
    "start",
    "select",
    "R2",
    "L2",
    "F1",
    "F2",
    "A",
    "B",
    "X",
    "Y",
    "up",
    "right",
    "down",
    "left",
)
"""The buttons by their bit, lowest first."""

BUTTONS_AT: Final = slice(2, 4)
"""The bytes of the buttons."""


def button_mask(combination: str, setting: str) -> int:
    """The bits of buttons that are pressed together, such as `L2+B`.

    Raises:
        ConfigError: a button does not exist; names the setting.
    """
    mask = 0
    known = {name.lower(): bit for bit, name in enumerate(BUTTONS)}
    for name in combination.split("+"):
        bit = known.get(name.strip().lower())
        if bit is None:
            raise ConfigError(
                f"{setting} = {combination!r} names no button of the remote: {name.strip()!r}.",
                f"Choose from {', '.join(BUTTONS)}; join those pressed together by +.",
            )
        mask |= 1 << bit
    return mask


class Operator:
    """What the operator asks for with the remote.

    Args:
        stop_buttons: combinations of buttons, each of which ends the session.
        deadman: buttons that have to be held as long as the robot moves; None: nothing has to.

    Raises:
        ConfigError: a button does not exist.
    """

    def __init__(self, stop_buttons: Sequence[str], deadman: str | None) -> None:
        self._stops = [(button_mask(one, "safety.stop_buttons"), one) for one in stop_buttons]
        self._deadman = deadman
        self._held = 0 if deadman is None else button_mask(deadman, "safety.deadman")

    def missing(self, buttons: int) -> str:
        """What the first command still waits for, or "".

        Args:
            buttons: the bits of those that are pressed.
        """
        if buttons & self._held != self._held:
            return f"{self._deadman} is not held on the remote (safety.deadman)"
        return self._stop(buttons)

    def stop_reason(self, buttons: int) -> str:
        """Why the session must end, or "", once the robot is commanded."""
        if stop := self._stop(buttons):
            return stop
        if buttons & self._held != self._held:
            return f"{self._deadman} was released on the remote (safety.deadman)"
        return ""

    def _stop(self, buttons: int) -> str:
        for mask, combination in self._stops:
            if buttons & mask == mask:
                return f"{combination} was pressed on the remote (safety.stop_buttons)"
        return ""
