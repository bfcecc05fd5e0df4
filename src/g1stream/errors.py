"""Errors that a user can cause, in one class hierarchy.

    G1StreamError
    ├── ConfigError      a flag, a config file, a gains file, or an extra that is absent
    ├── RobotError       a URDF
    ├── MotionError      a motion file
    ├── WireError        DDS: domain, interface, discovery, matching
    ├── SafetyError      a command that must not be sent
    ├── SimError         the MuJoCo bridge
    └── RecordingError   a session file, read or written

Each error has one sentence for the cause and one for the remedy. The command line prints both and
exits with code 2, so a traceback always means a bug in g1stream.

Both may quote a file or a peer on DDS, so control characters in them are escaped.
"""

from __future__ import annotations

import copyreg
from typing import Any

from g1stream.text import printable

__all__ = [
    "ConfigError",
    "G1StreamError",
    "MotionError",
    "RecordingError",
    "RobotError",
    "SafetyError",
    "SimError",
    "WireError",
]


class G1StreamError(Exception):
    """An error with a cause and a remedy, one sentence each.

    Args:
        cause: what is wrong, with the name of the file, line, joint or topic.
        remedy: what to do about it, with the valid choices if there are any. Flags in it are those
            of the command line; in Python `--joint-order` is the argument `joint_order`.
    """

    def __init__(self, cause: str, remedy: str) -> None:
        self.cause = printable(cause)
        self.remedy = printable(remedy)
        super().__init__(f"{self.cause} {self.remedy}")

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle without `__init__`, whose arguments `args` does not hold.

        So a pool of processes can raise the error in its parent.
        """
        return copyreg.__newobj__, (type(self), *self.args), self.__dict__  # type: ignore[attr-defined]


class ConfigError(G1StreamError):
    """A flag, config file or gains file that cannot be used, or an extra that is not installed."""


class RobotError(G1StreamError):
    """A URDF that cannot be used."""


class MotionError(G1StreamError):
    """A motion file that cannot be used."""


class WireError(G1StreamError):
    """DDS that cannot be set up, or a peer that was not found or matched."""


class SafetyError(G1StreamError):
    """A command that must not be sent to a robot."""


class SimError(G1StreamError):
    """A MuJoCo bridge that cannot run as requested."""


class RecordingError(G1StreamError):
    """A session file that cannot be written or read."""
