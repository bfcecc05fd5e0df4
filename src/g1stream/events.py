"""Events of a run: standard logging below the logger `g1stream`, handled off the caller's thread.

Code that has something to report calls `logging.getLogger(__name__)`. A program decides where the
records go: to DDS, into the session file, onto the terminal.
"""

from __future__ import annotations

import logging
from contextlib import contextmanager
from logging.handlers import QueueHandler, QueueListener
from queue import SimpleQueue
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["console_handler", "handled_by", "severity"]

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


def console_handler(program: str, level: int = logging.WARNING) -> logging.Handler:
    """A handler that prints events of this level and above on standard error."""
    handler = logging.StreamHandler()
    handler.setLevel(level)
    handler.setFormatter(logging.Formatter(f"{program}: %(message)s"))
    return handler


def severity(record: logging.LogRecord) -> int:
    """A record's level as foxglove.Log and the Log on the wire number it: 1 debug to 5 fatal."""
    return min(max(record.levelno // 10, 1), 5)
