"""What our programs say of themselves: in the user data of their writers and readers.

A bridge says how it holds its robot, and who reads LowCmd without obeying it says that it only
looks.

User data is part of DDS discovery (DDS 1.4, 2.2.3.1): it costs no topic and no message, takes no
part in matching, and peers that do not know it pass over it. A robot and unitree_mujoco say
nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from cyclonedds.core import Policy

if TYPE_CHECKING:
    from collections.abc import Iterable

    from g1stream.dds.domain import Endpoint

__all__ = ["OBSERVER", "observers", "support_announced", "user_data_of_support"]

OBSERVER: Final = b"g1stream.observer"
"""The user data of a reader that only looks."""

_PREFIX: Final = b"g1stream.support="


def observers(readers: Iterable[Endpoint]) -> int:
    """How many of these readers only look."""
    return sum(
        any(isinstance(p, Policy.Userdata) and p.data == OBSERVER for p in reader.qos or ())
        for reader in readers
    )


def user_data_of_support(support: str) -> bytes:
    """The user data that announces a support."""
    return _PREFIX + support.encode()


def support_announced(writers: Iterable[Endpoint]) -> str | None:
    """The support that the writers of LowState announce; None where none does or they differ."""
    found = set()
    for writer in writers:
        for policy in writer.qos or ():
            if isinstance(policy, Policy.Userdata) and policy.data.startswith(_PREFIX):
                found.add(policy.data.removeprefix(_PREFIX).decode(errors="replace"))
    return found.pop() if len(found) == 1 else None
