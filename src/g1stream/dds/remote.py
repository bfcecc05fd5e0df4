"""The robot's remote control, from `wireless_remote` of LowState. Pure.

Bytes 2 and 3 of the 40 bytes are the buttons, one bit each, little endian (source: the joystick
classes of Unitree's SDK). Without a remote, as in a simulator without a joystick, all bytes are 0.
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
"""The buttons in the order of their bits, lowest first."""

BUTTONS_AT: Final = slice(2, 4)
"""The bytes of `wireless_remote` with the buttons."""


def button_mask(combination: str, setting: str) -> int:
    """The bits of a combination of buttons, such as `L2+B`.

    Raises:
        ConfigError: a button does not exist; the error names the setting.
    """
    mask = 0
    known = {name.lower(): bit for bit, name in enumerate(BUTTONS)}
    for name in combination.split("+"):
        bit = known.get(name.strip().lower())
        if bit is None:
            raise ConfigError(
                f"{setting} = {combination!r}: the remote has no button {name.strip()!r}.",
                f"Choose from {', '.join(BUTTONS)}; join buttons that are pressed together with +.",
            )
        mask |= 1 << bit
    return mask


class Operator:
    """Evaluates the stop buttons, the deadman button and the go-on button of the remote.

    Args:
        stop_buttons: combinations of buttons, each of which ends the session.
        deadman: buttons that must be held while the robot moves; None: no deadman button.
        wait_for: buttons with which a resting motion goes on; none if None or `enter`.

    Raises:
        ConfigError: a button does not exist.
    """

    def __init__(
        self, stop_buttons: Sequence[str], deadman: str | None, wait_for: str | None = None
    ) -> None:
        self._stops = [(button_mask(one, "safety.stop_buttons"), one) for one in stop_buttons]
        self._deadman = deadman
        self._held = 0 if deadman is None else button_mask(deadman, "safety.deadman")
        self._go_on, self._pressed = 0, False
        if wait_for is not None and wait_for != "enter":
            self._go_on = button_mask(wait_for, "stream.wait_for (enter, or a button)")
            stops = (mask for mask, _ in self._stops)
            if self._go_on & self._held or any(self._go_on & one == one for one in stops):
                raise ConfigError(
                    f"stream.wait_for = {wait_for} stops the robot, or is its deadman button.",
                    "Choose another button, or enter.",
                )

    def missing(self, buttons: int) -> str:
        """Why the first command has to wait, or "".

        Args:
            buttons: the bits of the pressed buttons.
        """
        if buttons & self._held != self._held:
            return f"{self._deadman} is not held on the remote (safety.deadman)"
        return self._stop(buttons)

    def stop_reason(self, buttons: int) -> str:
        """Why a session that commands the robot must end, or ""."""
        if stop := self._stop(buttons):
            return stop
        if buttons & self._held != self._held:
            return f"{self._deadman} was released on the remote (safety.deadman)"
        return ""

    def goes_on(self, buttons: int) -> bool:
        """Whether the go-on button is pressed now, and was not in the last call."""
        before, self._pressed = self._pressed, buttons & self._go_on == self._go_on
        return bool(self._go_on) and self._pressed and not before

    def _stop(self, buttons: int) -> str:
        for mask, combination in self._stops:
            if buttons & mask == mask:
                return f"{combination} was pressed on the remote (safety.stop_buttons)"
        return ""
