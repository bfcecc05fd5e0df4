"""Logging handler that publishes events on the topic rt/g1stream/log."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

from g1stream.dds.endpoints import RawWriter
from g1stream.dds.messages import LOG, Log
from g1stream.events import severity

if TYPE_CHECKING:
    from collections.abc import Callable

    from g1stream.dds.domain import Participant

__all__ = ["LogHandler", "dds_log_handler"]


class LogHandler(logging.Handler):
    """Publishes log records as `Log` messages, with the time of logging as publish time.

    Args:
        name: name of the program, such as `stream`, which is published with every event.
        publish: called with the sample and its publish time, ns since the epoch.
    """

    def __init__(self, name: str, publish: Callable[[bytes, int], object]) -> None:
        super().__init__(logging.INFO)
        self._publish = publish
        self._message = Log()
        self._message.name = name

    def emit(self, record: logging.LogRecord) -> None:
        try:
            self._message.level[()] = severity(record)
            self._message.text = record.getMessage()
            self._publish(self._message.tobytes(), int(record.created * 1e9))
        except Exception:  # a handler must not raise in the code that logs
            self.handleError(record)


def dds_log_handler(participant: Participant, name: str) -> LogHandler:
    """Make a handler that publishes on DDS.

    Its writer is closed with the participant, so all records must be handled before that.
    """
    return LogHandler(name, RawWriter(participant, LOG, depth=100).write)
