"""A session as a ROS 2 bag: a directory as rosbag2 writes it, with messages of ROS 2 only, in CDR.

The samples of DDS and the URDF are in CDR already and keep their bytes. Transforms, joint states
and log lines, which session files have in Foxglove's protobuf, become ROS's messages on the topics
where its tools look for them. Every message keeps its log and publish time.
"""

from __future__ import annotations

import struct
from dataclasses import asdict, dataclass, replace
from mimetypes import guess_type
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.Log_pb2 import Log
from google.protobuf.message import DecodeError

from g1stream.dds.layout import CDR_HEADER
from g1stream.errors import RecordingError
from g1stream.files import output_errors
from g1stream.session.format import CHANNELS, Channel
from g1stream.session.parts import (
    SessionFiles,
    check_recording_path,
    part_path,
    parts_directory,
    remove_recording,
    replace_recording,
    temporary_path,
    write_metadata_yaml,
)
from g1stream.session.writer import SessionWriter

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from google.protobuf.timestamp_pb2 import Timestamp

    from g1stream.session.mcap_writer import Compression

__all__ = ["Ros2Report", "write_ros2_bag"]

_DEFINITIONS: Final = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec\n",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
    "geometry_msgs/Transform": (
        "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n"
    ),
    "geometry_msgs/TransformStamped": (
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n"
    ),
    "tf2_msgs/TFMessage": "geometry_msgs/TransformStamped[] transforms\n",
    "sensor_msgs/JointState": (
        "std_msgs/Header header\nstring[] name\n"
        "float64[] position\nfloat64[] velocity\nfloat64[] effort\n"
    ),
    "rcl_interfaces/Log": (
        "byte DEBUG=10\nbyte INFO=20\nbyte WARN=30\nbyte ERROR=40\nbyte FATAL=50\n"
        "builtin_interfaces/Time stamp\nuint8 level\nstring name\nstring msg\n"
        "string file\nstring function\nuint32 line\n"
    ),
}
"""ROS's message definitions, each after those that it is made of."""


@dataclass(frozen=True)
class Ros2Report:
    """What was written.

    Attributes:
        path: the directory.
        size: of its MCAP file, bytes.
        counts: messages by topic.
        left_out: messages by topic of the session that no message of ROS's was made of.
    """

    path: Path
    size: int
    counts: dict[str, int]
    left_out: dict[str, int]

    def as_dict(self) -> dict[str, Any]:
        """The fields as JSON can say them."""
        return asdict(self) | {"path": str(self.path)}


def write_ros2_bag(
    session: Path,
    out: Path,
    *,
    force: bool = False,
    compression: Compression = "zstd",
    on_progress: Callable[[float], None] = lambda _: None,
) -> Ros2Report:
    """Write a session as a ROS 2 bag. A failure leaves nothing behind.

    Args:
        session: file or directory of a session.
        out: the directory to write; `.mcap` at its end is left out.
        force: replace a directory that g1stream wrote.
        compression: of the file's chunks.
        on_progress: called with the fraction done, 0 to 1.

    Raises:
        RecordingError: the session cannot be read, or the directory not be written.
    """
    source, out = SessionFiles(session), parts_directory(out)
    if any(part.resolve().is_relative_to(out.resolve()) for part in source.paths):
        raise RecordingError(f"The output {out} holds the session.", "Choose another directory.")
    check_recording_path(out, split=True, force=force)
    place = temporary_path(out)
    total, done = max(1, sum(source.topics.values())), 0
    try:
        with output_errors(out):
            place.mkdir()
        path = place / part_path(out, 0).name
        with SessionWriter(path, channels=_CHANNELS, compression=compression) as writer:
            writer.add_metadata(source.metadata)
            for name, data in source.attachments().items():
                writer.attach(name, guess_type(name)[0] or "application/octet-stream", data, 0)
            for topic, batch in source.batches(set(_OUTPUTS)):
                output = _OUTPUTS[topic]
                payloads = _converted(session, topic, output, batch.data)
                times = batch.log_times, batch.publish_times
                writer.write_batch(output.channel.topic, payloads, *times)
                done += len(payloads)
                on_progress(done / total)
        write_metadata_yaml(place, [writer.part()], _CHANNELS)
        size = path.stat().st_size
        if out.exists():
            replace_recording(place, out)
        else:
            with output_errors(out):
                place.rename(out)
    finally:
        remove_recording(place)
    left_out = {topic: n for topic, n in source.topics.items() if n and topic not in _OUTPUTS}
    return Ros2Report(out, size, writer.counts, left_out)


class _Output(NamedTuple):
    """Where a topic's messages go, and what makes them of the session's; None keeps their bytes."""

    channel: Channel
    convert: Callable[[bytes], bytes] | None = None


def _converted(session: Path, topic: str, output: _Output, data: Sequence[bytes]) -> list[bytes]:
    if output.convert is None:
        return list(data)
    try:
        return [output.convert(one) for one in data]
    except DecodeError as error:
        raise RecordingError(
            f"{topic} in {session} is not in Foxglove's protobuf.",
            "Give a session that g1stream recorded.",
        ) from error


class _Cdr:
    """Writes little-endian CDR: each number at a multiple of its own size."""

    def __init__(self) -> None:
        self.data = bytearray(CDR_HEADER)

    def numbers(self, kind: str, *values: float) -> None:
        """Write numbers of one kind, a character of `struct`."""
        self.data += bytes((len(CDR_HEADER) - len(self.data)) % struct.calcsize(kind))
        self.data += struct.pack(f"<{len(values)}{kind}", *values)

    def string(self, text: str) -> None:
        data = text.encode() + b"\0"
        self.numbers("I", len(data))
        self.data += data

    def doubles(self, values: Sequence[float]) -> None:
        """Write a sequence of doubles, which may be empty."""
        self.numbers("I", len(values))
        if values:
            self.numbers("d", *values)

    def header(self, stamp: Timestamp, frame: str) -> None:
        self.numbers("I", stamp.seconds, stamp.nanos)
        self.string(frame)


def _joint_state(data: bytes) -> bytes:
    message = JointStates.FromString(data)
    cdr = _Cdr()
    cdr.header(message.timestamp, "")
    cdr.numbers("I", len(message.joints))
    for joint in message.joints:
        cdr.string(joint.name)
    for field in ("position", "velocity", "effort"):
        has_field = all(joint.HasField(field) for joint in message.joints)
        cdr.doubles([getattr(joint, field) for joint in message.joints] if has_field else [])
    return bytes(cdr.data)


def _tf_message(data: bytes) -> bytes:
    message = FrameTransforms.FromString(data)
    cdr = _Cdr()
    cdr.numbers("I", len(message.transforms))
    for one in message.transforms:
        cdr.header(one.timestamp, one.parent_frame_id)
        cdr.string(one.child_frame_id)
        t, q = one.translation, one.rotation
        cdr.numbers("d", t.x, t.y, t.z, q.x, q.y, q.z, q.w)
    return bytes(cdr.data)


def _log(data: bytes) -> bytes:
    message = Log.FromString(data)
    cdr = _Cdr()
    cdr.numbers("I", message.timestamp.seconds, message.timestamp.nanos)
    cdr.numbers("B", 10 * message.level)  # Foxglove counts the same levels from 1 to 5
    for text in (message.name, message.message, message.file, ""):
        cdr.string(text)
    cdr.numbers("I", message.line)
    return bytes(cdr.data)


def _nested(name: str) -> list[str]:
    """The types that a type is made of, the one that is used first before the others."""
    used = [line.split()[0].removesuffix("[]") for line in _DEFINITIONS[name].splitlines()]
    names = [n for one in used if one in _DEFINITIONS for n in (one, *_nested(one))]
    return list(dict.fromkeys(names))


def _schema(name: str) -> bytes:
    """The definition of a type and of all that it is made of, as ROS 2 message text."""
    nested = (f"{'=' * 80}\nMSG: {one}\n{_DEFINITIONS[one]}" for one in _nested(name))
    return (_DEFINITIONS[name] + "".join(nested)).encode()


def _output(source: Channel) -> _Output | None:
    """What becomes of a channel of a session; None where ROS has no message for it."""
    if source.message_encoding == "cdr":
        return _Output(source)
    if source.schema_name not in _CONVERTERS:
        return None
    package, name, topic, convert = _CONVERTERS[source.schema_name]
    channel = replace(
        source,
        topic=topic or source.topic,
        schema_name=f"{package}/msg/{name}",
        schema_encoding="ros2msg",
        message_encoding="cdr",
        build_schema=lambda: _schema(f"{package}/{name}"),
    )
    return _Output(channel, convert)


_CONVERTERS: Final = {
    "foxglove.JointStates": ("sensor_msgs", "JointState", None, _joint_state),
    "foxglove.FrameTransforms": ("tf2_msgs", "TFMessage", "/tf", _tf_message),
    "foxglove.Log": ("rcl_interfaces", "Log", "/rosout", _log),
}
"""By schema of a session's channel: package and name of ROS's message, the topic where ROS's tools
look for it (None: the session's own), and what makes the message."""

_OUTPUTS: Final = {
    topic: output for topic, channel in CHANNELS.items() if (output := _output(channel))
}
_CHANNELS: Final = {output.channel.topic: output.channel for output in _OUTPUTS.values()}
