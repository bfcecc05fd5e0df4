"""The files of a recording: one file, or a directory of parts as rosbag2 writes them.

    session/
      metadata.yaml
      session_0.mcap
      session_1.mcap

rosbag2 requires one serialisation format in a bag, so metadata.yaml lists the topics in CDR and
omits those in protobuf. The parts contain both.
"""

from __future__ import annotations

import errno
import os
import shutil
from collections import Counter
from contextlib import suppress
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from g1stream._version import __version__
from g1stream.errors import RecordingError
from g1stream.files import (
    check_directory,
    check_output_path,
    complete_file,
    output_errors,
    read_file,
)
from g1stream.input_limits import SETTINGS_FILE

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from g1stream.session.format import Channel

__all__ = [
    "Part",
    "check_recording_path",
    "part_path",
    "parts_directory",
    "parts_of",
    "remove_recording",
    "replace_recording",
    "write_metadata_yaml",
]

_METADATA: Final = "metadata.yaml"
#: Version of metadata.yaml: the first with `custom_data`, which every ROS 2 since Humble reads.
#: `Channel.offered_qos_profiles` has this version, too.
_VERSION: Final = 6


class Part(NamedTuple):
    """The entry of a part in metadata.yaml.

    Attributes:
        name: name of the file.
        counts: number of messages by topic.
        first_log_time, last_log_time: ns since the epoch; None without messages.
    """

    name: str
    counts: Mapping[str, int]
    first_log_time: int | None
    last_log_time: int | None


def parts_of(path: Path) -> list[Path]:
    """The files of a session: a file itself, or those listed in a directory's metadata.yaml."""
    try:
        is_directory = path.is_dir()
    except OSError:  # opening the file gives the reason
        is_directory = False
    if not is_directory:
        return [path]
    return [path / name for name in _read_metadata_yaml(path)["relative_file_paths"]]


def parts_directory(path: Path) -> Path:
    """The directory of a split recording: `session` for `session.mcap`."""
    return path.with_suffix("") if path.suffix == ".mcap" else path


def part_path(directory: Path, number: int) -> Path:
    """The path of a part, counted from 0."""
    return directory / f"{directory.name}_{number}.mcap"


def check_recording_path(path: Path, *, split: bool, force: bool) -> None:
    """Check that a recording can be written to a path, without changing anything.

    Args:
        path: path of the file; the directory of a split recording is named after it.
        split: whether the recording is split into parts.
        force: whether a file, or a directory that g1stream recorded, may be replaced.

    Raises:
        RecordingError: the path cannot be written, or something there may not be replaced.
    """
    if not split:
        check_output_path(path, force=force)
        return
    directory = parts_directory(path)
    with output_errors(directory):
        check_directory(directory.parent)
        if not os.path.lexists(directory):
            return
        if not force:
            raise FileExistsError
        if directory.is_symlink() or not directory.is_dir():
            raise RecordingError(
                f"{directory} is not a directory that g1stream recorded.",
                "Move it, or choose another name.",
            )
        if not os.access(directory, os.R_OK | os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, "no permission to replace it")
        found = {entry.name for entry in directory.iterdir()}
    about = _read_metadata_yaml(directory)
    foreign = sorted(found - {*about["relative_file_paths"], _METADATA})
    custom = about.get("custom_data")
    if foreign or not isinstance(custom, dict) or "g1stream" not in custom:
        raise RecordingError(
            f"{directory} holds {foreign[0]}, which is not a part of the recording in it."
            if foreign
            else f"{directory} was not recorded by g1stream.",
            "Move it, or choose another name.",
        )


def replace_recording(new: Path, path: Path) -> None:
    """Replace an old file or directory by a new one. An old directory is removed last."""
    with output_errors(path):
        if path.is_symlink() or not path.is_dir():  # replace a link, not its target
            new.replace(path)
            return
        old = new.with_suffix(".old")
        path.rename(old)
        new.rename(path)
        shutil.rmtree(old, ignore_errors=True)


def remove_recording(path: Path) -> None:
    """Remove the file or the directory of a recording that g1stream just wrote."""
    with suppress(OSError):
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink()


def write_metadata_yaml(
    directory: Path, parts: Sequence[Part], channels: Mapping[str, Channel]
) -> None:
    """Write or replace the metadata.yaml of a directory.

    Raises:
        RecordingError: it cannot be written.
    """
    import yaml

    cdr = {topic: one for topic, one in channels.items() if one.message_encoding == "cdr"}

    def count(*parts: Part) -> dict[str, int]:
        counts = sum((Counter(part.counts) for part in parts), Counter[str]())
        return {topic: n for topic, n in sorted(counts.items()) if topic in cdr}

    about = {
        "version": _VERSION,
        "storage_identifier": "mcap",
        "relative_file_paths": [part.name for part in parts],
        **_times(parts),
        "message_count": sum(count(*parts).values()),
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic,
                    "type": cdr[topic].schema_name,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": cdr[topic].offered_qos_profiles,
                },
                "message_count": n,
            }
            for topic, n in count(*parts).items()
        ],
        "compression_format": "",
        "compression_mode": "",
        "files": [
            {"path": part.name, **_times([part]), "message_count": sum(count(part).values())}
            for part in parts
        ],
        "custom_data": {"g1stream": __version__},
    }
    with complete_file(directory / _METADATA) as path:
        path.write_text(
            yaml.safe_dump({"rosbag2_bagfile_information": about}, sort_keys=False), "utf-8"
        )


def _times(parts: Sequence[Part]) -> dict[str, Any]:
    first = min((p.first_log_time for p in parts if p.first_log_time is not None), default=0)
    last = max((p.last_log_time for p in parts if p.last_log_time is not None), default=first)
    return {
        "starting_time": {"nanoseconds_since_epoch": first},
        "duration": {"nanoseconds": last - first},
    }


def _read_metadata_yaml(directory: Path) -> dict[str, Any]:
    import yaml

    path = directory / _METADATA
    try:
        text = read_file(path, SETTINGS_FILE).decode("utf-8")
        about: dict[str, Any] = dict(yaml.safe_load(text)["rosbag2_bagfile_information"])
        # Parts are in the directory itself, whatever the paths say.
        names = [PurePath(name).name for name in about["relative_file_paths"]]
        if not names or not all(names):
            raise ValueError("it lists no files")
    except FileNotFoundError as error:
        raise RecordingError(
            f"{directory} is a directory without {_METADATA}.",
            "Give an MCAP file, or the directory of a split recording.",
        ) from error
    except Exception as error:  # a YAML file may fail in many ways
        raise RecordingError(
            f"{path} cannot be read: {getattr(error, 'strerror', None) or error}.",
            "Give one of the MCAP files in the directory instead.",
        ) from error
    return about | {"relative_file_paths": names}
