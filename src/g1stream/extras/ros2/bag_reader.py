"""Bags of ROS 2 as motions, from sensor_msgs/JointState and tf2_msgs/TFMessage."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any, Final

import numpy as np
from rosbags.rosbag2 import Reader

from g1stream.errors import RecordingError
from g1stream.extras.attach.recorded_motion import (
    FOXGLOVE,
    Decoders,
    FramePose,
    JointAngles,
    RecordedMotion,
)
from g1stream.extras.ros2.messages import STORE
from g1stream.files import begins_with
from g1stream.input_limits import LATEST_NS
from g1stream.motion.readers import MotionFile
from g1stream.session.mcap_reader import McapFile, Messages
from g1stream.session.source import FilesSource, RecordingFile, files_of

#: Number of messages per batch.
_ROWS: Final = 100


def open_bag(file: MotionFile) -> RecordedMotion:
    """Open a bag: an MCAP or SQLite file, or a directory with metadata.yaml."""
    parts = files_of(file.path)
    # Unlike rosbags, the session reader can read files of a killed recorder.
    in_mcap = begins_with(parts[0], b"\x89MCAP")
    files: list[RecordingFile] = [*map(McapFile, parts)] if in_mcap else [_Bag(file.path)]
    return RecordedMotion(file, files, DECODERS)


class BagSource(FilesSource):
    """A bag in SQLite, or compressed, as a session; messages have only one time.

    Args:
        path: path of the file, or of the directory with metadata.yaml.

    Raises:
        RecordingError: it cannot be read.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.paths = [one for one in files_of(path) if one.is_file()]
        self._read_from([_Bag(path)])

    def attachments(self) -> dict[str, bytes]:
        """Empty, because a bag has no attachments."""
        return {}


class _Bag:
    """A bag in SQLite, or compressed, as a `RecordingFile`."""

    def __init__(self, path: Path) -> None:
        self._path = path
        with self._opened() as reader:
            self.types = {
                one.topic: (one.msgtype, getattr(one.ext, "serialization_format", ""))
                for one in reader.connections
            }
            self.unread = 0
            self.counts = Counter({one.topic: one.msgcount for one in reader.connections})

    def batches(self, topics: set[str]) -> Iterator[tuple[str, Messages]]:
        """The messages of some topics, topic by topic, in the order of their times."""
        with self._opened() as reader:
            for topic in sorted(topics & self.types.keys()):
                messages = reader.messages(
                    [one for one in reader.connections if one.topic == topic]
                )
                while some := list(islice(messages, _ROWS)):
                    _, times, data = zip(*some, strict=True)
                    if not all(isinstance(time, int) and 0 <= time < LATEST_NS for time in times):
                        raise ValueError("a message has no time")
                    if not all(isinstance(one, bytes) for one in data):
                        raise ValueError("a message has no content")
                    published = np.array(times, dtype=np.int64)
                    yield topic, Messages(published, published, data).plain()

    @contextmanager
    def _opened(self) -> Iterator[Reader]:
        try:
            with Reader(self._path) as reader:
                yield reader
        except Exception as error:  # errors of SQLite, YAML, zstd, and of damaged fields
            raise RecordingError(
                f"{self._path} cannot be read as a bag of ROS 2: {' '.join(str(error).split())}.",
                "Record it again, or as MCAP.",
            ) from error


def _decoded(data: bytes, kind: str) -> Any:
    try:
        return STORE.deserialize_cdr(data, kind)
    except Exception as error:  # SerdeError, and errors of damaged lengths and strings
        raise ValueError(str(error)) from error


def _nanoseconds(header: Any) -> int:
    return int(header.stamp.sec * 1_000_000_000 + header.stamp.nanosec)


def _joint_state(data: bytes) -> JointAngles:
    message = _decoded(data, "sensor_msgs/msg/JointState")
    return JointAngles(_nanoseconds(message.header), tuple(message.name), message.position.tolist())


def _transforms(data: bytes) -> list[FramePose]:
    found = []
    for one in _decoded(data, "tf2_msgs/msg/TFMessage").transforms:
        pos, quat = one.transform.translation, one.transform.rotation
        found.append(
            FramePose(
                _nanoseconds(one.header),
                one.header.frame_id,
                one.child_frame_id,
                (pos.x, pos.y, pos.z),
                (quat.w, quat.x, quat.y, quat.z),
            )
        )
    return found


DECODERS: Final = Decoders(
    {("sensor_msgs/msg/JointState", "cdr"): _joint_state, **FOXGLOVE.joint_states},
    {("tf2_msgs/msg/TFMessage", "cdr"): _transforms, **FOXGLOVE.transforms},
)
"""Decoders of ROS 2's messages and of Foxglove's."""
