"""Output files: path checks, and files that get their name only when they are complete."""

from __future__ import annotations

import errno
import os
import stat
from contextlib import contextmanager
from datetime import datetime, timezone
from typing import TYPE_CHECKING, Final

from g1stream.errors import RecordingError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

__all__ = [
    "check_directory",
    "check_output_path",
    "complete_file",
    "is_session",
    "output_errors",
    "timestamped",
]

_MCAP: Final = b"\x89MCAP"


def is_session(path: Path) -> bool:
    """Whether a path is that of a session: an MCAP file, or a directory with metadata.yaml.

    False where neither can be read. Only regular files are opened: bytes read from a pipe are gone.
    """
    try:
        if (path / "metadata.yaml").is_file():
            return True
        if not path.is_file():
            return False
        with path.open("rb") as file:
            return file.read(len(_MCAP)) == _MCAP
    except OSError:
        return False


def timestamped(path: Path, now_ns: int) -> Path:
    """The path with a time, UTC, in its name: `session-20260301T120000Z.mcap`.

    Args:
        path: of the file.
        now_ns: the time, ns since the epoch.
    """
    now = datetime.fromtimestamp(now_ns // 1_000_000_000, timezone.utc)
    return path.with_name(f"{path.stem}-{now:%Y%m%dT%H%M%SZ}{path.suffix}")


def check_output_path(path: Path, *, force: bool) -> None:
    """Check that a file can be written to a path, without touching anything.

    Args:
        path: of the file; a link is followed.
        force: whether an existing file may be replaced.

    Raises:
        RecordingError: the directory is missing or not writable, or the path is taken: by a file
            without `force`, or by something that is not a regular file.
    """
    with output_errors(path):
        check_directory(path.parent)
        try:
            mode = path.stat().st_mode
        except FileNotFoundError:
            return
        if stat.S_ISDIR(mode):
            raise IsADirectoryError
        if not stat.S_ISREG(mode):
            raise RecordingError(f"{path} is not a file.", "Name a file, such as session.mcap.")
        if not force:
            raise FileExistsError
        if not os.access(path, os.W_OK):
            raise PermissionError(errno.EACCES, "no permission to replace it")


def check_directory(directory: Path) -> None:
    """Check that files can be created in a directory.

    Raises:
        OSError: it is missing, not a directory, or not writable.
    """
    if not stat.S_ISDIR(directory.stat().st_mode):
        raise NotADirectoryError(errno.ENOTDIR, f"{directory} is not a directory")
    if not os.access(directory, os.W_OK | os.X_OK):
        raise PermissionError(errno.EACCES, f"no permission to create files in {directory}")


@contextmanager
def complete_file(path: Path, *, force: bool = True) -> Iterator[Path]:
    """Write a file under a temporary name beside its own, and rename it when it is complete.

    On any exception, Ctrl-C included, the temporary file is removed and `path` stays as it was.

    Args:
        path: of the file; a link is followed.
        force: whether an existing file may be replaced.

    Yields:
        The temporary path to write to.

    Raises:
        RecordingError: the path cannot be written.
    """
    check_output_path(path, force=force)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with output_errors(path):
            yield temporary
            check_output_path(path, force=force)
            temporary.replace(path.resolve())
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def output_errors(path: Path) -> Iterator[None]:
    """Turn an OSError while writing a path into a RecordingError with its remedy."""
    try:
        yield
    except IsADirectoryError as error:
        raise RecordingError(
            f"{path} is a directory.", "Name a file in it, such as session.mcap."
        ) from error
    except FileExistsError as error:
        raise RecordingError(
            f"{path} exists already.", "Choose another name, or give --force to replace it."
        ) from error
    except FileNotFoundError as error:
        raise RecordingError(
            f"The directory {path.parent} does not exist.", f"Create it: mkdir -p {path.parent}"
        ) from error
    except OSError as error:
        raise RecordingError(
            f"{path} cannot be written: {error.strerror or error}.",
            "Free disk space, or choose another place.",
        ) from error
