"""Every error a user can cause, in one tree.

    G1StreamError
    ├── ConfigError      a flag, a config file, a gains file, or an extra that is absent
    ├── RobotError       a URDF
    ├── MotionError      a motion file
    ├── WireError        DDS: domain, interface, discovery, matching
    ├── SafetyError      a command that must not be sent
    ├── SimError         the MuJoCo bridge
    └── RecordingError   a session file, read or written

Each says what is wrong in one sentence and what to do in another. The command line prints the two
and exits with code 2; a traceback therefore always means a bug of ours.

Both may quote a file or a peer on DDS, and are shown on a terminal, so that what a terminal would
obey is escaped.
"""

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
    """An error with one sentence of cause and one of remedy.

    Args:
        cause: what is wrong, naming the offender (file, line, joint, topic).
        remedy: what to do about it, naming the valid choices where there are some.
    """

    def __init__(self, cause: str, remedy: str) -> None:
        self.cause = printable(cause)
        self.remedy = printable(remedy)
        super().__init__(f"{self.cause} {self.remedy}")


class ConfigError(G1StreamError):
    """A flag, config file or gains file that cannot be used, or an extra that is not installed."""


class RobotError(G1StreamError):
    """A URDF that cannot be used."""


class MotionError(G1StreamError):
    """A motion file that cannot be used."""


class WireError(G1StreamError):
    """DDS cannot be set up, or no peer was found or matched."""


class SafetyError(G1StreamError):
    """A command that must not be sent to a robot."""


class SimError(G1StreamError):
    """The MuJoCo bridge cannot run as asked."""


class RecordingError(G1StreamError):
    """A session file that cannot be written or read."""
