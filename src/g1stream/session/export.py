"""A session as tables for pandas and Parquet; both come with the extra `export`."""

from __future__ import annotations

from contextlib import suppress
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

from g1stream.errors import RecordingError
from g1stream.files import complete_file, output_errors
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS
from g1stream.session.streams import STREAMS

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    import pandas
    from numpy.typing import NDArray

    from g1stream.session.session import Session

__all__ = ["to_dataframe", "to_parquet"]

_AXES: Final = {3: ("x", "y", "z"), 4: ("w", "x", "y", "z")}


def to_dataframe(session: Session, topic: str) -> pandas.DataFrame:
    """The samples of a topic as a table.

    Args:
        session: to take them from.
        topic: one of `g1stream.session.streams.STREAMS`, such as `/lowstate`.

    Returns:
        A row for each sample, indexed by `publish_time`; `log_time` is a column. Both are in UTC,
        to the nanosecond. Other columns are named as the attributes of the topic's stream, and what
        has several values in a row is spread: `q.left_knee_joint`, `root_pos.x`,
        `imu_quat_wxyz.w`. Units are those of the stream.

    Raises:
        RecordingError: pandas is not installed, the topic is not in this session or has no arrays,
            or the file is damaged.
    """
    table = _required("pandas")
    if topic not in STREAMS:
        raise RecordingError(
            f"The topic {topic} cannot be had as a table.", f"Choose from {', '.join(STREAMS)}."
        )
    kind = STREAMS[topic]
    stream = session.stream(kind)
    columns: dict[str, Any] = {"log_time": table.to_datetime(stream.log_time, unit="ns", utc=True)}
    for attribute in kind.wire_fields():
        columns |= _spread(attribute, getattr(stream, attribute))
    index = table.to_datetime(stream.publish_time, unit="ns", utc=True)
    frame: pandas.DataFrame = table.DataFrame(columns, index=index.rename("publish_time"))
    return frame


def to_parquet(session: Session, directory: Path) -> list[Path]:
    """Write the tables of all topics that have one: /lowstate to lowstate.parquet, and so on.

    Args:
        session: to take them from.
        directory: where to; made where it is missing. Files of these names are replaced.

    Returns:
        The files.

    Raises:
        RecordingError: pandas or pyarrow is not installed, the session is damaged, or a file cannot
            be written.
    """
    _required("pyarrow")
    written = []
    for topic in STREAMS:
        if not session.topics.get(topic):
            continue
        table = to_dataframe(session, topic)
        path = directory / f"{topic.strip('/')}.parquet"
        with output_errors(directory), suppress(FileExistsError):
            directory.mkdir(parents=True)
        with complete_file(path) as temporary:
            table.to_parquet(temporary, engine="pyarrow")
        written.append(path)
    return written


def _spread(attribute: str, values: NDArray[Any]) -> Iterator[tuple[str, NDArray[Any]]]:
    """(column, values (N,)) of an attribute (N,) or (N, K)."""
    if values.ndim == 1:
        yield attribute, values
        return
    width = values.shape[1]
    names = JOINT_NAMES if width == N_JOINTS else _AXES[width]
    for name, column in zip(names, values.T, strict=True):
        yield f"{attribute}.{name}", column


def _required(package: str) -> Any:
    try:
        return import_module(package)
    except ImportError as error:
        raise RecordingError(
            f"Tables need {package}, which is not installed.",
            "Install the extra: pip install 'g1stream[export]'",
        ) from error
