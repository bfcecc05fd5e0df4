"""The events of a session, as the channel /log has them."""

from __future__ import annotations

from typing import NamedTuple

from foxglove_schemas_protobuf.Log_pb2 import Log

__all__ = ["LogEvent", "log_event"]

_NAMES = {number: name for name, number in Log.Level.items()}


class LogEvent(NamedTuple):
    """One event of a session.

    Attributes:
        time: when it happened, ns since the epoch.
        level: DEBUG, INFO, WARNING, ERROR or FATAL; UNKNOWN where it is none of these.
        name: the program that told it.
        text: what happened.
    """

    time: int
    level: str
    name: str
    text: str


def log_event(data: bytes) -> LogEvent:
    """The event in a message of /log."""
    message = Log.FromString(data)
    return LogEvent(
        message.timestamp.ToNanoseconds(),
        _NAMES.get(message.level, "UNKNOWN"),
        message.name,
        message.message,
    )
