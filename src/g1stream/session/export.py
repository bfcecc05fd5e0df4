"""A session in other forms: tables for pandas and Parquet (the extra `export`), one MCAP file."""

from __future__ import annotations

from contextlib import suppress
from heapq import merge
from mimetypes import guess_type
from typing import TYPE_CHECKING, Any, Final

from g1stream.errors import RecordingError
from g1stream.files import complete_file, output_errors
from g1stream.optional import import_extra
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS
from g1stream.session.format import CHANNELS
from g1stream.session.streams import STREAMS
from g1stream.session.writer import SessionWriter

if TYPE_CHECKING:
    from pathlib import Path

    import pandas
    from numpy.typing import NDArray

    from g1stream.session.session import Session

__all__ = ["save", "to_dataframe", "to_parquet"]

_EXTRA: Final = "export", "Tables need"
_AXES: Final = {3: ("x", "y", "z"), 4: ("w", "x", "y", "z")}


def to_dataframe(session: Session, topic: str) -> pandas.DataFrame:
    """See `Session.to_dataframe`."""
    table = import_extra("pandas", *_EXTRA)
    if topic not in STREAMS:
        raise RecordingError(
            f"There is no table for the topic {topic}.", f"Choose from {', '.join(STREAMS)}."
        )
    stream = session.stream(STREAMS[topic]).read()
    columns: dict[str, Any] = {
        "log_time": table.to_datetime(stream.log_time, unit="ns", utc=True),
        "time": stream.time,
    }
    for name in stream.wire_fields():
        columns |= _by_joint_or_axis(name, getattr(stream, name))
    index = table.to_datetime(stream.publish_time, unit="ns", utc=True)
    frame: pandas.DataFrame = table.DataFrame(columns, index=index.rename("publish_time"))
    return frame


def to_parquet(session: Session, directory: Path) -> list[Path]:
    """See `Session.to_parquet`."""
    import_extra("pyarrow", *_EXTRA)
    with output_errors(directory), suppress(FileExistsError):
        directory.mkdir(parents=True)
    paths = []
    for topic in STREAMS:
        if session.topics.get(topic):
            path = directory / f"{topic.strip('/')}.parquet"
            table = to_dataframe(session, topic)
            with complete_file(path) as temporary:
                table.to_parquet(temporary, engine="pyarrow")
            paths.append(path)
    return paths


def save(session: Session, path: Path, *, force: bool) -> Path:
    """See `Session.save`."""
    messages = [
        [(message, topic) for message in session.messages(topic)]
        for topic, count in sorted(session.topics.items())
        if count and topic in CHANNELS
    ]
    with complete_file(path, force=force) as temporary, SessionWriter(temporary) as writer:
        writer.add_metadata(session.metadata)
        for name, data in session.attachments.items():
            media_type = guess_type(name)[0] or "application/octet-stream"
            writer.attach(name, media_type, data, session.start_ns)
        for message, topic in merge(*messages, key=lambda pair: pair[0].log_time):
            writer.write(topic, message.data, message.log_time, message.publish_time)
    return path


def _by_joint_or_axis(name: str, values: NDArray[Any]) -> dict[str, NDArray[Any]]:
    """A column (N,) of a stream as one of the table, or one (N, K) as K."""
    if values.ndim == 1:
        return {name: values}
    labels = JOINT_NAMES if values.shape[1] == N_JOINTS else _AXES[values.shape[1]]
    return {f"{name}.{label}": one for label, one in zip(labels, values.T, strict=True)}
