"""Files: reading with a size limit, path checks, and output that is renamed when complete."""

from __future__ import annotations

import errno
import os
import shutil
import stat
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Final

from g1stream.errors import ConfigError, RecordingError
from g1stream.input_limits import SMALL_FILE

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator
    from pathlib import Path


__all__ = [
    "begins_with",
    "check_directory",
    "check_not_input",
    "check_output_path",
    "check_suffix",
    "complete_directory",
    "complete_file",
    "is_session",
    "output_errors",
    "read_file",
    "temporary_path",
]

_MCAP: Final = b"\x89MCAP"


def read_file(path: Path, most: int = SMALL_FILE) -> bytes:
    """Read a file of limited size.

    Args:
        path: path of a regular file; reading a pipe or a device may block, or never end.
        most: maximum size, bytes.

    Raises:
        OSError: the file is larger, not a regular file, or cannot be read; `strerror` says which.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except ValueError as error:  # a null character in the name
        raise OSError(errno.EINVAL, str(error)) from error
    with open(descriptor, "rb") as file:  # noqa: PTH123
        about = os.fstat(descriptor)
        if stat.S_ISDIR(about.st_mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        if not stat.S_ISREG(about.st_mode):
            raise OSError(errno.EINVAL, "it is not a regular file")
        # Files in /proc have size 0 but are not empty.
        content = file.read(min(about.st_size or SMALL_FILE, most) + 1)
    if len(content) > most:
        raise OSError(errno.EFBIG, f"it has more than {most / 2**20:g} MiB")
    return content


def is_session(path: Path) -> bool:
    """Return whether a path is a session: an MCAP file, or a directory with metadata.yaml.

    False if it cannot be read.
    """
    try:
        return (path / "metadata.yaml").is_file() or begins_with(path, _MCAP)
    except OSError:
        return False


def begins_with(path: Path, start: bytes) -> bool:
    """Return whether a file begins with the bytes `start`; False if it cannot be read."""
    try:
        # Only regular files are opened, because bytes that are read from a pipe are lost.
        if not path.is_file():
            return False
        with path.open("rb") as file:
            return file.read(len(start)) == start
    except OSError:
        return False


def check_not_input(path: Path, *sources: Path | None) -> None:
    """Check that an output path is not one of the input files.

    Raises:
        RecordingError: the output path is an input file.
    """
    for source in sources:
        with suppress(OSError):  # one of them does not exist, or cannot be accessed
            if source and path.samefile(source):
                raise RecordingError(
                    f"The output path {path} is the input file.",
                    f"Choose another output path, such as converted{path.suffix}.",
                )


def check_suffix(path: Path, kind: str, *suffixes: str) -> None:
    """Check that an output path has one of the suffixes of its file type.

    Args:
        path: path of the file.
        kind: name of the file type in the error, such as "a figure".
        suffixes: valid suffixes, in lower case, with their dots.

    Raises:
        ConfigError: the path has another suffix.
    """
    if path.suffix.lower() not in suffixes:
        raise ConfigError(
            f"{path} is not the name of {kind}.",
            f"Use a name that ends in {', '.join(suffixes)}.",
        )


def check_output_path(path: Path, *, force: bool) -> None:
    """Check that a file can be written to a path, without changing anything.

    Args:
        path: path of the file.
        force: whether an existing file may be replaced.

    Raises:
        RecordingError: the directory is missing or not writable, the file exists and `force` is
            False, or the path is not a regular file, such as a symbolic link.
    """
    with output_errors(path):
        check_directory(path.parent)
        try:
            mode = path.lstat().st_mode
        except FileNotFoundError:
            return
        if stat.S_ISLNK(mode):
            raise RecordingError(
                f"{path} is a symbolic link to {path.readlink()}.",
                "Use the path of the target file, or remove the link.",
            )
        if stat.S_ISDIR(mode):
            raise IsADirectoryError
        if not stat.S_ISREG(mode):
            raise RecordingError(
                f"{path} is not a regular file.", "Use the path of a file, such as session.mcap."
            )
        if not force:
            raise FileExistsError
        if not os.access(path, os.W_OK):
            raise PermissionError(errno.EACCES, "no permission to replace it")


def check_directory(directory: Path) -> None:
    """Check that files can be created in a directory.

    Raises:
        OSError: the directory is missing, not a directory, or not writable.
    """
    if not stat.S_ISDIR(directory.stat().st_mode):
        raise NotADirectoryError(errno.ENOTDIR, f"{directory} is not a directory")
    if not os.access(directory, os.W_OK | os.X_OK):
        raise PermissionError(errno.EACCES, f"no permission to create files in {directory}")


def temporary_path(path: Path) -> Path:
    """Temporary path at which a file is written before it replaces `path`."""
    return path.with_name(f".{path.name}.{os.getpid()}.part")


@contextmanager
def complete_file(path: Path, *, force: bool = True) -> Iterator[Path]:
    """Write a file under a temporary name in the same directory, and rename it when complete.

    On any exception, including Ctrl-C, the temporary file is removed and `path` is unchanged.

    Args:
        path: path of the file.
        force: whether an existing file may be replaced.

    Yields:
        The temporary path to write to.

    Raises:
        RecordingError: the path cannot be written.
    """
    check_output_path(path, force=force)
    temporary = temporary_path(path)
    try:
        with output_errors(path):
            temporary.unlink(missing_ok=True)  # of a killed process with the same id
            yield temporary
            check_output_path(path, force=force)
            temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def complete_directory(path: Path, names: Collection[str], *, force: bool) -> Iterator[Path]:
    """Write a directory of files under a temporary name, and rename it when complete.

    On any exception, including Ctrl-C, the temporary directory is removed. `path` is unchanged, or
    its old content is beside it with the suffix `.old`.

    Args:
        path: path of the directory.
        names: names of the files that it may have; a directory with others is not replaced.
        force: whether an existing directory may be replaced.

    Yields:
        The path of an empty temporary directory.

    Raises:
        RecordingError: the path exists already, or cannot be written.
    """
    if not path.name or path.is_symlink() or (path.exists() and not path.is_dir()):
        raise RecordingError(
            f"{path} cannot be created as a directory.", "Use the path of a new directory."
        )
    with output_errors(path):
        check_directory(path.parent)
        if path.exists():
            if not force:
                raise FileExistsError
            if others := sorted({one.name for one in path.iterdir()} - set(names)):
                raise RecordingError(
                    f"{path} is not replaced, because it contains other files: {others[0]}.",
                    "Choose another path, or move these files away.",
                )
    temporary, old = temporary_path(path), path.with_name(f".{path.name}.{os.getpid()}.old")
    try:
        with output_errors(path):
            shutil.rmtree(temporary, ignore_errors=True)  # of a killed process with the same id
            temporary.mkdir()
            yield temporary
            if path.exists():
                path.rename(old)
            temporary.rename(path)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    shutil.rmtree(old, ignore_errors=True)


@contextmanager
def output_errors(path: Path) -> Iterator[None]:
    """Convert an OSError while writing a path into a RecordingError with a remedy."""
    try:
        yield
    except IsADirectoryError as error:
        raise RecordingError(
            f"{path} is a directory.", "Use the path of a file in it, such as session.mcap."
        ) from error
    except FileExistsError as error:
        raise RecordingError(
            f"{path} exists already.", "Choose another path, or replace it with --force."
        ) from error
    except FileNotFoundError as error:
        if path.parent.is_dir():  # such as /proc, in which no files can be created
            raise RecordingError(
                f"No files can be created in {path.parent}.", "Choose another directory."
            ) from error
        raise RecordingError(
            f"The directory {path.parent} does not exist.", f"Create it: mkdir -p {path.parent}"
        ) from error
    except OSError as error:
        raise RecordingError(
            f"{path} cannot be written: {error.strerror or error}.",
            "Free disk space, or choose another directory.",
        ) from error
