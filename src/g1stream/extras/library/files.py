"""Motion files below paths and URLs, and their content. URLs are those of fsspec."""

from __future__ import annotations

import hashlib
import os
import tempfile
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any, Final

from g1stream.errors import ConfigError, G1StreamError, MotionError, RecordingError
from g1stream.extras.formats.arrays import motions_in
from g1stream.extras.formats.table import is_sonic
from g1stream.files import output_errors
from g1stream.input_limits import MOTION_FILE
from g1stream.motion.readers import find_motion
from g1stream.optional import import_extra

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

__all__ = ["LIBRARY", "content_hash", "find_motions", "local_copy", "motions_at", "stem"]

#: Suffixes of files that may have several motions.
_SEVERAL: Final = {".pkl", ".pickle", ".joblib", ".pt", ".pth", ".motion"}
#: Suffixes of motion files in a directory. A file that is given itself is read with any suffix.
_SUFFIXES: Final = _SEVERAL | {".csv", ".npz", ".npy", ".mcap", ".db3"}
#: A directory with this file is a recording in parts, or a bag of ROS 2, and counts as one motion.
#: So does a directory of SONIC.
_BAG: Final = "metadata.yaml"
LIBRARY: Final = ".g1stream-library"
"""The file in each library's directory. Libraries are not searched for motions."""


def find_motions(places: Sequence[str]) -> list[str]:
    """Find the motion files below directories, files and URLs, in order and without duplicates.

    A directory stands for the files below it with suffixes of motion files, and for its recordings
    in parts and directories of SONIC. Libraries and hidden files and directories are skipped, and
    links to directories are not followed.

    Args:
        places: paths, one in a file of several as `library.pkl:walk`, or URLs such as
            `s3://bucket/motions`.

    Returns:
        Absolute paths, and URLs.

    Raises:
        ConfigError: a place does not exist, or the package for a kind of URL is not installed.
    """
    found: list[str] = []
    for place in places:
        found += _below_url(place) if "://" in place else _below(place)
    return list(dict.fromkeys(found))


def _below(place: str) -> Iterator[str]:
    path = Path(place).absolute()
    if not path.exists() and not find_motion(path).path.is_file():  # path of a file's member
        raise ConfigError(
            f"There is no {place}.", "Give motion files, directories with motion files, or URLs."
        )
    if not path.is_dir():
        yield str(path)
        return
    for directory, names, files in os.walk(path):
        names[:] = sorted(name for name in names if not name.startswith("."))
        one = _BAG in files or is_sonic(Path(directory))
        if one or LIBRARY in files:
            names.clear()
            if one:
                yield directory
            continue
        for name in _motions_among(files):
            if (file := Path(directory, name)).is_file():
                yield str(file)


def _motions_among(names: Iterable[str]) -> list[str]:
    paths = ((name, PurePosixPath(name)) for name in names)
    return sorted(
        name
        for name, path in paths
        if path.suffix.lower() in _SUFFIXES and not path.name.startswith(".")
    )


def _below_url(url: str) -> list[str]:
    fsspec = import_extra("fsspec", "library", "URLs need")
    try:
        files, root = fsspec.core.url_to_fs(url)
        if _motions_among([root]) and files.isfile(root):
            return [url]
        if not files.exists(root):
            raise FileNotFoundError("it does not exist")
        _, inside, archive = url.partition("::")  # zip://motions::s3://bucket/all.zip
        paths = files.find(root)
        motions = _motions_among(paths)
        if not motions and files.isfile(root):
            return [url]  # a directory on a web server is a file, too
        libraries = tuple(path.removesuffix(LIBRARY) for path in paths if path.endswith(LIBRARY))
        found = [
            path
            for path in motions
            if "/." not in f"/{path.removeprefix(root)}" and not path.startswith(libraries)
        ]
        return [f"{files.unstrip_protocol(path)}{inside}{archive}" for path in found]
    except ImportError as error:  # for example s3fs for s3, aiohttp for http
        raise ConfigError(f"{url} cannot be read: {error}.", "Install that package.") from error
    except Exception as error:  # file systems raise their own errors
        raise ConfigError(
            f"{url} cannot be listed: {type(error).__name__}: {error}.",
            "Check the URL, and whether this machine may read it.",
        ) from error


def motions_at(location: str) -> tuple[str, tuple[str, ...]]:
    """The file at a path or URL, and the names of its motions if it has several.

    A path may end with the name of one of them: `library.pkl:walk`.
    """
    if "://" not in location and (file := find_motion(location)).member:
        return str(file.path), (file.member,)
    if _path(location).suffix.lower() in _SEVERAL:
        # Errors are reported when the file is read.
        with suppress(G1StreamError, MemoryError), local_copy(location) as path:
            names = motions_in(find_motion(path))
            return location, names if len(names) > 1 else ()
    return location, ()


def stem(location: str) -> str:
    """The name of the motion at a path or URL."""
    return _path(location).stem


def _path(location: str) -> PurePosixPath:
    """The path in a URL, which an archive's URL may follow: `zip://a.npz::file:///b`."""
    return PurePosixPath(location.partition("::")[0] if "://" in location else location)


def content_hash(location: str) -> str:
    """SHA-256 of the content at a path or URL, in hex; for a directory, of its files in order.

    Raises:
        MotionError: it cannot be read, is too large, or is not a file.
    """
    digest = hashlib.sha256()
    path = Path(location)
    parts = [location]
    if "://" not in location and path.is_dir():
        parts = [str(part) for part in sorted(path.iterdir()) if part.is_file()]
    for part in parts:
        with _opened(part) as file:
            while block := file.read(2**20):
                digest.update(block)
    return digest.hexdigest()


@contextmanager
def local_copy(location: str) -> Iterator[Path]:
    """Local path of a motion: its own, or for a URL that of a temporary copy.

    Raises:
        MotionError: it cannot be read or is too large.
        RecordingError: the copy cannot be written.
    """
    if "://" not in location:
        yield Path(location)
        return
    with output_errors(Path(tempfile.gettempdir())):
        scratch = tempfile.TemporaryDirectory(prefix="g1stream-")
    with scratch as directory:
        copy = Path(directory, _path(location).name)
        with output_errors(copy), copy.open("wb") as out, _opened(location) as file:
            while block := file.read(2**20):
                with output_errors(copy):  # not an error of the URL
                    out.write(block)
        yield copy


@contextmanager
def _opened(location: str) -> Iterator[Any]:
    """Open a regular file with a limited size, or a URL."""
    try:
        if "://" in location:
            import fsspec

            files, path = fsspec.core.url_to_fs(location)
            size, opened = files.size(path), files.open
        else:
            path, opened = Path(location), Path.open
            if not path.is_file():
                raise OSError("it is not a file")
            size = path.stat().st_size
        if size is not None and size > MOTION_FILE:
            raise OSError(f"it has more than {MOTION_FILE / 2**20:g} MiB")
        with opened(path, "rb") as file:
            yield file
    except (MemoryError, RecordingError):  # raised by the caller's code
        raise
    except Exception as error:  # file systems raise their own errors
        raise MotionError(
            f"{location} cannot be read: {getattr(error, 'strerror', None) or error}.",
            "Check that it exists and that you may read it.",
        ) from error
