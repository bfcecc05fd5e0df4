"""Events of a run: standard logging below the logger `g1stream`, handled off the caller's thread.

Code that has something to report calls `logging.getLogger(__name__)`. A program decides where the
records go: to DDS, into the session file, onto the terminal.
"""

from __future__ import annotations

import logging
import sys
from contextlib import contextmanager, suppress
from logging.handlers import QueueHandler, QueueListener
from queue import SimpleQueue
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["ConsoleHandler", "handled_by", "severity"]

_LOGGER = logging.getLogger("g1stream")
_LOGGER.addHandler(logging.NullHandler())
_LOGGER.setLevel(logging.INFO)


@contextmanager
def handled_by(*handlers: logging.Handler) -> Iterator[None]:
    """Pass events to handlers in a thread of its own, for the length of a `with`.

    The thread that logs only puts the record into a queue, so that a slow disk or terminal cannot
    block a real-time loop. Handlers of the root logger get the records the same way. At the end
    every record that was logged has been handled.

    Args:
        handlers: each gets the records of its level and above.
    """
    records: SimpleQueue[logging.LogRecord] = SimpleQueue()
    queue = QueueHandler(records)
    propagate = _LOGGER.propagate  # False within another `with`, which serves the root's handlers
    root = logging.getLogger().handlers if propagate else ()
    listener = QueueListener(records, *handlers, *root, respect_handler_level=True)
    _LOGGER.addHandler(queue)
    _LOGGER.propagate = False
    listener.start()
    try:
        yield
    finally:
        _LOGGER.removeHandler(queue)
        _LOGGER.propagate = propagate
        listener.stop()


class ConsoleHandler(logging.Handler):
    """Prints events on standard error, a line each.

    Args:
        level: events of this level and above.
        program: printed before each, where several programs share a terminal.
    """

    def __init__(self, level: int = logging.INFO, program: str = "") -> None:
        super().__init__(level)
        self._prefix = f"{program}: " if program else ""

    def emit(self, record: logging.LogRecord) -> None:
        """Print an event."""
        severity = "" if record.levelno <= logging.INFO else f"{record.levelname.lower()}: "
        with suppress(OSError):  # a closed terminal must not end what it only shows
            sys.stderr.write(f"{self._prefix}{severity}{record.getMessage()}\n")
            sys.stderr.flush()


def severity(record: logging.LogRecord) -> int:
    """A record's level as foxglove.Log and the Log on the wire number it: 1 debug to 5 fatal."""
    return min(max(record.levelno // 10, 1), 5)
