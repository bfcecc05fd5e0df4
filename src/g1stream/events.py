"""Events of a run: standard logging below the logger `g1stream`, handled off the caller's thread.

Code that has something to report calls `logging.getLogger(__name__)`. A program decides where the
records go: to DDS, into the session file, onto the terminal.
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
"""The guard process logs under this name, and only when it damps."""

LOWCMD_TIMEOUT: Final = "LowCmd timeout"
"""What a simulator logs when commands stop coming begins with this."""

_LOGGER = logging.getLogger("g1stream")
_LOGGER.addHandler(logging.NullHandler())
_LOGGER.setLevel(logging.INFO)
_LOCK = Lock()
_HANDLING_TIMEOUT_S: Final = 2.0


class _Listener(QueueListener):
    """Hands records to handlers, each of which may fail without harm to the others."""

    def handle(self, record: logging.LogRecord) -> None:
        for handler in self.handlers:
            if record.levelno >= handler.level:
                try:
                    handler.handle(record)
                except Exception:  # what cannot be shown must not end what runs
                    handler.handleError(record)


@contextmanager
def handled_by(*handlers: logging.Handler) -> Iterator[None]:
    """Pass events to handlers in a thread of its own, for the length of a `with`.

    The thread that logs only puts the record into a queue, so that a slow disk or terminal cannot
    block a real-time loop. Handlers of the root logger and of `g1stream` get the records the same
    way. At the end every record has been handled, unless a handler blocks for more than 2 s.

    Args:
        handlers: each gets the records of its level and above.
    """
    records: SimpleQueue[logging.LogRecord] = SimpleQueue()
    queue = QueueHandler(records)
    with _LOCK:
        before, propagate = _LOGGER.handlers[:], _LOGGER.propagate
        # Within another `with` there is only its queue, which goes on getting the records.
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
"""The environment variable that keeps all but warnings and errors off the terminal, also in child
processes."""


def is_quiet() -> bool:
    """Whether only warnings and errors are to be printed."""
    return bool(os.environ.get(QUIET))


class ConsoleHandler(logging.Handler):
    """Prints events on standard error, a line each.

    Args:
        level: events of this level and above; if `is_quiet`, warnings at least.
        program: printed before each, where several programs share a terminal.
    """

    def __init__(self, level: int = logging.INFO, program: str = "") -> None:
        super().__init__(max(level, logging.WARNING) if is_quiet() else level)
        self._prefix = f"{program}: " if program else ""

    def emit(self, record: logging.LogRecord) -> None:
        """Print an event."""
        severity = "" if record.levelno <= logging.INFO else f"{record.levelname.lower()}: "
        with suppress(OSError, ValueError):  # a closed terminal must not end what it only shows
            sys.stderr.write(f"{self._prefix}{severity}{printable(record.getMessage())}\n")
            sys.stderr.flush()


def severity(record: logging.LogRecord) -> int:
    """A record's level as foxglove.Log and the Log on the wire number it: 1 debug to 5 fatal."""
    return min(max(record.levelno // 10, 1), 5)
