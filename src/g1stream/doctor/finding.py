"""What the doctor says."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from enum import IntEnum
from typing import Any

__all__ = ["Finding", "Level"]


class Level(IntEnum):
    """How bad a finding is; the worst one is the exit code."""

    OK = 0
    WARNING = 1
    PROBLEM = 2


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at.

    Attributes:
        level: how bad it is.
        about: what was looked at, in a word or two.
        cause: what was found.
        remedy: what to do about it; empty where all is well.
        figures: what was measured, by name and unit.
    """

    level: Level
    about: str
    cause: str
    remedy: str = ""
    figures: dict[str, float] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """The finding as JSON values."""
        return {**asdict(self), "level": self.level.name.lower()}
