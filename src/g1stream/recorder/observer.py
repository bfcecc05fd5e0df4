"""The messages of a session file as they come, for a program that shows them and keeps no file."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from g1stream.dds.domain import Participant
from g1stream.dds.messages import TOPICS
from g1stream.realtime import quick_thread_switches
from g1stream.recorder.receiver import Receiver
from g1stream.robot.model import G1
from g1stream.view.pipeline import MessagePipeline

if TYPE_CHECKING:
    from collections.abc import Callable, Generator

    from g1stream.config import Config
    from g1stream.session.format import MessageBatch

__all__ = ["observe"]


def observe(
    config: Config, should_stop: Callable[[], bool]
) -> Generator[list[MessageBatch], None, None]:
    """Yield the messages that a recorder on this domain would write, until told to stop.

    Scenes and URDF come first, when samples are already being received; a viewer that joins later
    needs them too, and `record.channels` raw counts as standard. After that comes a list every
    `record.batch`, which may be empty. What the caller does with one may take its time: samples are
    received in a thread of their own.

    Args:
        config: all settings.
        should_stop: asked before each list.

    Raises:
        RobotError: the URDF has a shape that cannot be read.
        ConfigError: a link of the robot has the name of the world's frame.
        WireError: DDS does not allow it.
        RecordingError: samples cannot be received any more.
    """
    settings = config.record
    if settings.channels == "raw":  # to keep a file small; viewers would show nothing
        settings = settings.model_copy(update={"channels": "standard"})
    pipeline = MessagePipeline(G1.load(config.robot), settings)
    header = pipeline.file_header(time.time_ns())
    with Participant(config.dds.domain, config.dds.interface) as participant:
        receiver = Receiver(participant, TOPICS)
        receiver.start()
        try:
            with quick_thread_switches():  # else log times would be late while messages are made
                yield header
                while not should_stop():
                    time.sleep(settings.batch)
                    yield pipeline.encode(receiver.drain())
        finally:
            receiver.stop()
