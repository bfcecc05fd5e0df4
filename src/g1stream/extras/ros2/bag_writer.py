"""Writes a session as a ROS 2 bag: a directory as from rosbag2, with only ROS messages in CDR.

DDS samples and the URDF are already in CDR and are kept byte for byte. Transforms, joint states and
log messages, which session files have in Foxglove's protobuf, become ROS messages on the topics
that ROS tools expect. Every message keeps its log and publish time.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from mimetypes import guess_type
from pathlib import Path
from typing import Any, Final, NamedTuple

from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.Log_pb2 import Log
from google.protobuf.message import DecodeError
from rosbags.serde import SerdeError
from rosbags.typesys.stores import ros2_humble as ros

from g1stream.errors import RecordingError
from g1stream.extras.attach.recorded_motion import FOXGLOVE
from g1stream.extras.ros2.messages import STORE, encode, joint_state, tf_message, time_message
from g1stream.files import output_errors, temporary_path
from g1stream.session.format import CHANNELS, Channel, encode_string
from g1stream.session.mcap_writer import Compression
from g1stream.session.parts import (
    check_recording_path,
    part_path,
    parts_directory,
    remove_recording,
    replace_recording,
    write_metadata_yaml,
)
from g1stream.session.source import SessionFiles
from g1stream.session.writer import SessionWriter
from g1stream.view.encoders import MEASURED_PREFIX


@dataclass(frozen=True)
class Ros2Report:
    """Result of writing a bag."""

    path: Path  # the directory
    size: int  # size of its MCAP file, bytes
    counts: dict[str, int]  # messages by topic
    # Messages by session topic without a ROS message type.
    left_out: dict[str, int]

    def as_dict(self) -> dict[str, Any]:
        """The fields as JSON values."""
        return asdict(self) | {"path": str(self.path)}


def write_ros2_bag(
    session: Path,
    out: Path,
    *,
    force: bool = False,
    compression: Compression = "zstd",
    on_progress: Callable[[float], None] = lambda _: None,
) -> Ros2Report:
    """Write a session as a ROS 2 bag. Nothing is written if it fails."""
    source, out = SessionFiles(session), parts_directory(out)
    if any(part.resolve().is_relative_to(out.resolve()) for part in source.paths):
        raise RecordingError(f"The output {out} contains the session.", "Choose another directory.")
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
    """The output topic of a channel, and the conversion of its messages; None keeps the bytes."""

    channel: Channel
    convert: Callable[[bytes], bytes] | None = None


def _converted(session: Path, topic: str, output: _Output, data: Sequence[bytes]) -> list[bytes]:
    if output.convert is None:
        return list(data)
    try:
        return [output.convert(one) for one in data]
    except (DecodeError, SerdeError, ValueError, struct.error) as error:
        raise RecordingError(
            f"A message of {topic} in {session} does not have g1stream's format.",
            "Give a session that g1stream recorded.",
        ) from error


def _joint_state(data: bytes) -> bytes:
    message = JointStates.FromString(data)
    columns = (
        [getattr(joint, field) for joint in message.joints]
        if all(joint.HasField(field) for joint in message.joints)
        else []
        for field in ("position", "velocity", "effort")
    )
    names = [joint.name for joint in message.joints]
    return joint_state(message.timestamp.ToNanoseconds(), names, *columns)


def _log(data: bytes) -> bytes:
    message = Log.FromString(data)
    time = time_message(message.timestamp.ToNanoseconds())
    level = 10 * message.level  # Foxglove counts the same levels from 1 to 5
    texts = message.name, message.message, message.file, ""
    return encode(ros.rcl_interfaces__msg__Log(time, level, *texts, message.line))


def _description(data: bytes) -> bytes:
    """The URDF without the prefix of its links, because RViz has a setting for it."""
    message: Any = STORE.deserialize_cdr(data, "std_msgs/msg/String")
    return encode_string(message.data.replace(f'"{MEASURED_PREFIX}', '"'))


def _output(source: Channel) -> _Output | None:
    """The output for a channel of a session; None if ROS has no message type for it."""
    if source.message_encoding == "cdr":
        return _Output(source)
    if source.schema_name not in _CONVERTERS:
        return None
    name, topic, convert = _CONVERTERS[source.schema_name]
    channel = replace(
        source,
        topic=topic or source.topic,
        schema_name=name,
        schema_encoding="ros2msg",
        message_encoding="cdr",
        build_schema=STORE.generate_msgdef(name, ros_version=2)[0].encode,
    )
    return _Output(channel, convert)


_transforms = FOXGLOVE.transforms["foxglove.FrameTransforms", "protobuf"]
_CONVERTERS: Final = {
    "foxglove.JointStates": ("sensor_msgs/msg/JointState", None, _joint_state),
    "foxglove.FrameTransforms": (
        "tf2_msgs/msg/TFMessage",
        "/tf",
        lambda data: tf_message(_transforms(data)),
    ),
    "foxglove.Log": ("rcl_interfaces/msg/Log", "/rosout", _log),
}
"""By schema of a session's channel: the ROS message type, the topic that ROS tools expect (None:
the session's own), and the conversion."""

_OUTPUTS: Final = {
    topic: output for topic, channel in CHANNELS.items() if (output := _output(channel))
} | {"/measured/robot_description": _Output(CHANNELS["/robot_description"], _description)}
_CHANNELS: Final = {output.channel.topic: output.channel for output in _OUTPUTS.values()}
