"""Files: input of bounded size, path checks, output that gets its name when it is complete."""

from __future__ import annotations

import errno
import os
import shutil
import stat
from contextlib import contextmanager, suppress
from datetime import datetime, timezone
from typing import TYPE_CHECKING, Final

from g1stream.errors import ConfigError, RecordingError
from g1stream.input_limits import SMALL_FILE

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator
    from pathlib import Path

    from matplotlib.figure import Figure

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
    "save_figure",
    "temporary_path",
    "timestamped",
]

_MCAP: Final = b"\x89MCAP"


def read_file(path: Path, most: int = SMALL_FILE) -> bytes:
    """The content of a file.

    Args:
        path: of a regular file: reading a pipe or a device may block, or never end.
        most: bytes that it may have.

    Raises:
        OSError: it is larger or not a regular file, or cannot be read; `strerror` says why.
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
        # Files in /proc have the size 0 and a content.
        content = file.read(min(about.st_size or SMALL_FILE, most) + 1)
    if len(content) > most:
        raise OSError(errno.EFBIG, f"it has more than {most / 2**20:g} MiB")
    return content


def is_session(path: Path) -> bool:
    """Whether a path is that of a session: an MCAP file, or a directory with metadata.yaml.

    False where neither can be read.
    """
    try:
        return (path / "metadata.yaml").is_file() or begins_with(path, _MCAP)
    except OSError:
        return False


def begins_with(path: Path, start: bytes) -> bool:
    """Whether a file begins with some bytes; False if it cannot be read."""
    try:
        # Only regular files are opened: bytes read from a pipe are gone.
        if not path.is_file():
            return False
        with path.open("rb") as file:
            return file.read(len(start)) == start
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


def check_not_input(path: Path, *sources: Path | None) -> None:
    """Check that an output path is none of the input files.

    Raises:
        RecordingError: it is.
    """
    for source in sources:
        with suppress(OSError):  # one of them does not exist, or cannot be accessed
            if source and path.samefile(source):
                raise RecordingError(
                    f"The output path {path} is the input file.",
                    f"Choose another output path, such as converted{path.suffix}.",
                )


def check_suffix(path: Path, kind: str, *suffixes: str) -> None:
    """Check that an output path ends as files of a kind do.

    Args:
        path: of the file.
        kind: such as "a figure".
        suffixes: in lower case, with their dots.

    Raises:
        ConfigError: it does not.
    """
    if path.suffix.lower() not in suffixes:
        raise ConfigError(
            f"{path} is not the name of {kind}.", f"Use one that ends in {', '.join(suffixes)}."
        )


def check_output_path(path: Path, *, force: bool) -> None:
    """Check that a file can be written to a path, without touching anything.

    Args:
        path: of the file.
        force: whether an existing file may be replaced.

    Raises:
        RecordingError: the directory is missing or not writable, or the path is taken: by a file
            without `force`, or by something that is not a regular file, such as a symbolic link.
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
                "Name the file that it leads to, or remove the link.",
            )
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


def temporary_path(path: Path) -> Path:
    """Where a file is written until it replaces the one at `path`."""
    return path.with_name(f".{path.name}.{os.getpid()}.part")


@contextmanager
def complete_file(path: Path, *, force: bool = True) -> Iterator[Path]:
    """Write a file under a temporary name beside its own, and rename it when it is complete.

    On any exception, Ctrl-C included, the temporary file is removed and `path` stays as it was.

    Args:
        path: of the file.
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
            temporary.unlink(missing_ok=True)  # left by a killed process with the same id
            yield temporary
            check_output_path(path, force=force)
            temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def complete_directory(path: Path, names: Collection[str], *, force: bool) -> Iterator[Path]:
    """Write a directory of files under a temporary name, and rename it when it is complete.

    On any exception, Ctrl-C included, the temporary directory is removed and `path` stays as it
    was, or what was there is beside it with the suffix `.old`.

    Args:
        path: of the directory.
        names: of the files that it may have; one with others is not replaced.
        force: whether an existing directory may be replaced.

    Yields:
        The temporary path, of an empty directory.

    Raises:
        RecordingError: the path is taken, or cannot be written.
    """
    if not path.name or path.is_symlink() or (path.exists() and not path.is_dir()):
        raise RecordingError(f"{path} is no directory to be made.", "Name a new one in it.")
    with output_errors(path):
        check_directory(path.parent)
        if path.exists():
            if not force:
                raise FileExistsError
            if others := sorted({one.name for one in path.iterdir()} - set(names)):
                raise RecordingError(
                    f"{path} is not replaced, as it has other files: {others[0]}.",
                    "Choose another path, or move these away.",
                )
    temporary, old = temporary_path(path), path.with_name(f".{path.name}.{os.getpid()}.old")
    try:
        with output_errors(path):
            shutil.rmtree(temporary, ignore_errors=True)  # left by a killed process, same id
            temporary.mkdir()
            yield temporary
            if path.exists():
                path.rename(old)
            temporary.rename(path)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    shutil.rmtree(old, ignore_errors=True)


def save_figure(draw: Callable[[], Figure], path: Path, *, force: bool) -> None:
    """Write a figure, which is drawn once the path has been checked.

    Raises:
        ConfigError: the path ends neither in .png nor in .svg nor in .pdf.
        RecordingError: it cannot be written.
    """
    check_suffix(path, "a figure", ".png", ".svg", ".pdf")
    with complete_file(path, force=force) as temporary:
        draw().savefig(temporary, format=path.suffix[1:].lower())


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
            f"{path} exists already.", "Choose another path, or give --force to replace it."
        ) from error
    except FileNotFoundError as error:
        if path.parent.is_dir():  # such as /proc, which takes no files
            raise RecordingError(
                f"{path.parent} takes no new files.", "Choose another directory."
            ) from error
        raise RecordingError(
            f"The directory {path.parent} does not exist.", f"Create it: mkdir -p {path.parent}"
        ) from error
    except OSError as error:
        raise RecordingError(
            f"{path} cannot be written: {error.strerror or error}.",
            "Free disk space, or choose another place.",
        ) from error
