"""Write a session with an attached motion as its reference, and new messages for viewers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import chain
from pathlib import Path
from typing import Final

from g1stream.app.session import Session
from g1stream.dds.messages import Batch
from g1stream.files import check_not_input, complete_file
from g1stream.session.format import CHANNEL_OF
from g1stream.session.writer import SessionWriter
from g1stream.view.pipeline import MessagePipeline

__all__ = ["write_attached"]

_DDS_TOPICS: Final = {topic: name for name, topic in CHANNEL_OF.items()}
_LOG: Final = "/log"


def write_attached(
    session: Session,
    path: Path,
    *,
    force: bool = False,
    progress: Callable[[str, float], None] = lambda what, fraction: None,
) -> Path:
    """Write a session with all channels. The channels for viewers are encoded again.

    Samples are written byte for byte, with log and publish times. Topics that g1stream does not
    know are omitted.

    Args:
        session: result of `Session.attach`.
        path: MCAP file to write; its directory must exist.
        force: replace an existing file.
        progress: called with a label and the fraction done, 0 to 1.

    Returns:
        The path.

    Raises:
        RecordingError: the file cannot be written, or belongs to the session.
        RobotError: the session's URDF cannot be used.
    """
    check_not_input(path, *session.paths)
    robot = session.robot
    pipeline = MessagePipeline(robot, policy=session.policy_info)
    topics = [t for t in (*_DDS_TOPICS, _LOG) if session.topics.get(t)]
    total = sum(session.topics[topic] for topic in topics)
    rounds = session.rounds(topics)
    first = next(rounds)
    start = min(batch.log_times[0] for batch in first.values())
    with complete_file(path, force=force) as temporary, SessionWriter(temporary) as writer:

        def encoded() -> Iterator[tuple[str, Batch]]:
            """The samples. Messages for viewers are written before them, and after each second."""
            done = 0
            for messages in pipeline.file_header(start):
                writer.write_batch(*messages)
            for batches in chain([first], rounds):
                yield from batches.items()
                wire = {_DDS_TOPICS[topic]: one for topic, one in batches.items() if topic != _LOG}
                for messages in pipeline.encode(wire):
                    writer.write_batch(*messages)
                done += sum(len(batch.data) for batch in batches.values())
                progress("written", done / total)

        attachments = {"robot.urdf": robot.urdf.encode()} | session.attachments
        writer.copy(session.metadata, attachments, start, encoded())
        if pipeline.base:
            writer.add_metadata({"measured_tf": pipeline.base.summary().model_dump(mode="json")})
    return path
