"""Publishers that must not be there beside the robot and the loop."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from g1stream.dds.messages import LOWCMD, LOWSTATE, Topic

if TYPE_CHECKING:
    from g1stream.control.link import Link

__all__ = ["OtherPublishers"]

#: How often the loop looks for them, ns.
_PERIOD: Final = 100_000_000


class OtherPublishers:
    """Looks for other publishers of LowCmd, and for several of LowState.

    Args:
        link: the wire.
        allow_second_writer: whether there may be another publisher of commands.
        topic: of the commands.
    """

    def __init__(self, link: Link, *, allow_second_writer: bool, topic: Topic = LOWCMD) -> None:
        self._link, self._topic = link, topic
        self._allow_second_writer = allow_second_writer
        self._next_command_check = self._next_state_check = 0

    def verdict(self, now: int, *, waiting: bool) -> str:
        """Who else publishes at `now`, ns, or "".

        Args:
            now: time, ns.
            waiting: for the first command; then publishers of LowCmd are looked for at every call.
        """
        if now >= self._next_state_check:
            self._next_state_check = now + _PERIOD
            if several := self.of_state():
                return several
        if self._allow_second_writer or now < self._next_command_check:
            return ""
        if not waiting:
            self._next_command_check = now + _PERIOD
        others = self._link.other_publishers()
        return f"another publisher on {self._topic.name}: {', '.join(others)}" if others else ""

    def of_state(self) -> str:
        """The publishers of LowState, if several publish at once, or ""."""
        names = self._link.state_publishers()
        return f"more than one publisher on {LOWSTATE.name}: {', '.join(names)}" if names else ""
