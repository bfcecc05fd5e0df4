"""Adds the index, which viewers need, to a session file whose recorder was killed.

All readable records are written to a new file, which replaces the original when it is complete.
"""

from __future__ import annotations

import fcntl
import os
import shutil
from collections import Counter
from pathlib import Path
from typing import IO, NamedTuple

from g1stream.errors import RecordingError
from g1stream.files import complete_file
from g1stream.session.format import CHANNELS, METADATA_NAME, MessageBatch, metadata_to_strings
from g1stream.session.mcap_reader import RECOVER, McapFile, open_mcap
from g1stream.session.mcap_writer import McapWriter
from g1stream.session.parts import Part, parts_of, write_metadata_yaml

__all__ = ["Repair", "repair_session"]


class Repair(NamedTuple):
    """The result for one file.

    Attributes:
        path: path of the file.
        messages: number of messages in the file.
        dropped: size of the incomplete record at its end, bytes; None if it already had its index.
    """

    path: Path
    messages: int
    dropped: int | None


def repair_session(path: Path) -> list[Repair]:
    """Add the missing index to the files of a session.

    Args:
        path: a session file, or the directory of a split recording. Files in it that are absent
            or unreadable are not changed, and the others are repaired.

    Returns:
        The result for each file.

    Raises:
        RecordingError: a file is no session, damaged, still being recorded, or cannot be written.
            That file is not changed.
    """
    files = parts_of(path)
    if files == [path]:
        return [_repair_file(path)]
    done, parts = [], []
    unread: RecordingError | None = None
    for file in files:
        part = Part(file.name, {}, None, None)
        try:
            if file.is_file():
                done.append(_repair_file(file))
                about = McapFile(file)
                part = Part(file.name, about.counts, *about.log_times)
        except RecordingError as error:
            unread = unread or error
        parts.append(part)
    if any(one.dropped is not None for one in done):
        write_metadata_yaml(path, parts, CHANNELS)
    if unread:
        raise unread
    return done


def _repair_file(path: Path) -> Repair:
    with open_mcap(path) as file:
        _lock(file, path)  # first, because a recorder that ends now still writes
        source = McapFile(path)
        messages = source.counts.total()
        if source.indexed:
            return Repair(path, messages, None)
        with complete_file(path) as temporary:
            _copy(source, temporary)
            shutil.copymode(path, temporary)
            with temporary.open("rb") as copy:
                os.fsync(copy.fileno())
    return Repair(path, messages, source.unread)


def _copy(source: McapFile, path: Path) -> None:
    """Write the content of a file to a new one, with its index."""
    unknown = sorted(source.ambiguous | (source.counts.keys() - source.channels.keys()))
    if unknown:
        raise RecordingError(
            f"{source.path} has no description of {unknown[0]}, or several.", RECOVER
        )
    writer = McapWriter(path, source.channels, profile=source.profile)
    writer.path = source.path
    written: Counter[str] = Counter()
    try:
        for record in source.metadata_records:
            writer.write_metadata(record.name, record.metadata)
        if source.metadata and not source.complete:  # else nothing would show that its end is lost
            values = metadata_to_strings({"repaired": True})
            writer.write_metadata(f"{METADATA_NAME}.repaired", values)
        for one in source.attachments():
            writer.attach(one.name, one.media_type, one.data, one.log_time)
        for topic, messages in source.batches({*source.channels}):
            batch = MessageBatch(topic, messages.data, messages.log_times, messages.publish_times)
            writer.write_chunk([batch], written[topic] + 1, last=True)
            written[topic] += len(messages.data)
    finally:
        writer.close()


def _lock(file: IO[bytes], path: Path) -> None:
    """Check that no recorder has the file open. A recorder holds a lock until it ends."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise RecordingError(
            f"{path} is still being recorded.", "Repair it when its recorder has ended."
        ) from error
    except OSError:  # a file system without locks
        return
