"""Event logging: records of the logger `g1stream`, handled in a separate thread.

Code reports events with `logging.getLogger(__name__)`. Each program decides where the records go:
to DDS, into the session file or to the terminal.
"""

from __future__ import annotations

import logging
import os
import sys
from contextlib import contextmanager, suppress
from logging.handlers import QueueHandler, QueueListener
from queue import SimpleQueue
from threading import Lock
from typing import TYPE_CHECKING, Final

from g1stream.text import printable

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = [
    "GUARD",
    "LOWCMD_TIMEOUT",
    "QUIET",
    "ConsoleHandler",
    "handled_by",
    "is_quiet",
    "severity",
]

GUARD: Final = "guard"
"""Logger name of the guard process, which logs only when it damps."""

LOWCMD_TIMEOUT: Final = "LowCmd timeout"
"""First words of a simulator's log message when it receives no more commands."""

_LOGGER = logging.getLogger("g1stream")
_LOGGER.addHandler(logging.NullHandler())
_LOGGER.setLevel(logging.INFO)
_LOCK = Lock()
_HANDLING_TIMEOUT_S: Final = 2.0


class _Listener(QueueListener):
    """Passes records to handlers; a handler that fails does not affect the others."""

    def handle(self, record: logging.LogRecord) -> None:
        for handler in self.handlers:
            if record.levelno >= handler.level:
                try:
                    handler.handle(record)
                except Exception:  # a record that cannot be shown must not end the program
                    handler.handleError(record)


@contextmanager
def handled_by(*handlers: logging.Handler) -> Iterator[None]:
    """Context manager that passes events to handlers in a separate thread.

    The logging thread only puts the record into a queue, so a slow disk or terminal cannot block a
    real-time loop. Handlers of the root logger and of `g1stream` receive the records the same way.
    At the end every record has been handled, unless a handler blocks for more than 2 s.

    Args:
        handlers: each receives the records of its level and above.
    """
    records: SimpleQueue[logging.LogRecord] = SimpleQueue()
    queue = QueueHandler(records)
    with _LOCK:
        before, propagate = _LOGGER.handlers[:], _LOGGER.propagate
        # In a nested context, the queue of the outer one still receives the records.
        direct = [one for one in before if not isinstance(one, QueueHandler)]
        root = logging.getLogger().handlers if propagate else []
        listener = _Listener(records, *handlers, *direct, *root, respect_handler_level=True)
        _LOGGER.handlers = [*(one for one in before if one not in direct), queue]
        _LOGGER.propagate = False
    listener.start()
    try:
        yield
    finally:
        with _LOCK:
            _LOGGER.removeHandler(queue)
            for one in direct:
                _LOGGER.addHandler(one)
            if propagate:
                _LOGGER.propagate = True
        listener.enqueue_sentinel()
        if thread := listener._thread:
            thread.join(_HANDLING_TIMEOUT_S)


QUIET: Final = "G1STREAM_QUIET"
"""Environment variable that limits the terminal to warnings and errors, also in child processes."""


def is_quiet() -> bool:
    """Return whether only warnings and errors are printed."""
    return bool(os.environ.get(QUIET))


class ConsoleHandler(logging.Handler):
    """Prints events on standard error, one line each.

    Args:
        level: minimum level of the events; at least warnings if `is_quiet`.
        program: prefix of each line, for several programs that share a terminal.
    """

    def __init__(self, level: int = logging.INFO, program: str = "") -> None:
        super().__init__(max(level, logging.WARNING) if is_quiet() else level)
        self._prefix = f"{program}: " if program else ""

    def emit(self, record: logging.LogRecord) -> None:
        """Print an event."""
        severity = "" if record.levelno <= logging.INFO else f"{record.levelname.lower()}: "
        with suppress(OSError, ValueError):  # a closed terminal must not end the program
            sys.stderr.write(f"{self._prefix}{severity}{printable(record.getMessage())}\n")
            sys.stderr.flush()


def severity(record: logging.LogRecord) -> int:
    """The level of a record as in foxglove.Log and the Log message on DDS: 1 debug to 5 fatal."""
    return min(max(record.levelno // 10, 1), 5)
