"""Writes a session as a ROS 2 bag: a directory as from rosbag2, with only ROS messages in CDR.

DDS samples and the URDF are already in CDR and are kept byte for byte. Transforms, joint states and
log messages, which session files have in Foxglove's protobuf, become ROS messages on the topics
that ROS tools expect. Every message keeps its log and publish time.
"""

from __future__ import annotations

import struct
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from operator import itemgetter
from pathlib import Path
from typing import Any, Final, NamedTuple

from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.Log_pb2 import Log
from google.protobuf.message import DecodeError
from rosbags.serde import SerdeError
from rosbags.typesys.stores import ros2_humble as ros

from g1stream._version import __version__
from g1stream.dds.messages import Batch
from g1stream.errors import RecordingError
from g1stream.extras.attach.recorded_motion import FOXGLOVE
from g1stream.extras.ros2.messages import STORE, encode, joint_state, tf_message, time_message
from g1stream.files import complete_directory
from g1stream.session.format import CHANNELS, Channel, encode_string
from g1stream.session.recording import open_recording
from g1stream.session.source import METADATA_YAML
from g1stream.session.writer import SessionWriter
from g1stream.view.encoders import MEASURED_PREFIX

#: Version of metadata.yaml: the first with `custom_data`, which every ROS 2 since Humble reads.
#: `Channel.offered_qos_profiles` has this version, too.
_VERSION: Final = 6


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
    on_progress: Callable[[float], None] = lambda _: None,
) -> Ros2Report:
    """Write a session as a ROS 2 bag. Nothing is written if it fails."""
    recorded, out = open_recording(session), out.with_suffix("") if out.suffix == ".mcap" else out
    if any(part.resolve().is_relative_to(out.resolve()) for part in recorded.paths):
        raise RecordingError(f"The output {out} contains the session.", "Choose another directory.")
    total, name = max(1, sum(recorded.topics.values())), f"{out.name}_0.mcap"
    left_out = {
        topic: n
        for topic, n in recorded.topics.items()
        if n and (topic not in _OUTPUTS or topic in recorded.source.foreign)
    }
    with complete_directory(out, (METADATA_YAML, name), force=force) as place:
        path = place / name
        with SessionWriter(path, channels=_CHANNELS) as writer:

            def converted() -> Iterator[tuple[str, Batch]]:
                for batches in recorded.rounds(recorded.topics.keys() - left_out.keys()):
                    made: dict[str, list[tuple[int, int, bytes]]] = defaultdict(list)
                    for topic, batch in batches.items():
                        output = _OUTPUTS[topic]
                        data = _converted(session, topic, output, batch.data)
                        times = batch.log_times, batch.publish_times
                        made[output.channel.topic] += zip(*times, data, strict=True)
                    for topic, messages in made.items():  # several topics become /tf
                        logged, published, payloads = zip(
                            *sorted(messages, key=itemgetter(0)), strict=True
                        )
                        yield topic, Batch(list(payloads), list(logged), list(published))
                    on_progress(sum(writer.counts.values()) / total)

            writer.copy(recorded.metadata, recorded.attachments, 0, converted())
        _write_metadata_yaml(place, name, writer.counts, writer.log_times)
        size = path.stat().st_size
    return Ros2Report(out, size, writer.counts, left_out)


def _write_metadata_yaml(
    directory: Path,
    name: str,
    counts: Mapping[str, int],
    log_times: tuple[int | None, int | None],
) -> None:
    """Write the metadata.yaml of a bag with one file.

    Args:
        directory: the bag.
        name: name of the file.
        counts: number of messages by topic.
        log_times: first and last log time, ns since the epoch; None without messages.

    """
    import yaml

    first, last = (time or 0 for time in log_times)
    about = {
        "starting_time": {"nanoseconds_since_epoch": first},
        "duration": {"nanoseconds": last - first},
        "message_count": sum(counts.values()),
    }
    bag = {
        "version": _VERSION,
        "storage_identifier": "mcap",
        "relative_file_paths": [name],
        **about,
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic,
                    "type": _CHANNELS[topic].schema_name,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": _CHANNELS[topic].offered_qos_profiles,
                },
                "message_count": n,
            }
            for topic, n in sorted(counts.items())
        ],
        "compression_format": "",
        "compression_mode": "",
        "files": [{"path": name, **about}],
        "custom_data": {"g1stream": __version__},
    }
    text = yaml.safe_dump({"rosbag2_bagfile_information": bag}, sort_keys=False)
    (directory / METADATA_YAML).write_text(text, "utf-8")


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
