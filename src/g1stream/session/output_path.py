"""Where a recording may be put, and in which words it is refused elsewhere."""

from __future__ import annotations

import stat
from contextlib import contextmanager
from typing import TYPE_CHECKING, Final

from g1stream.errors import RecordingError
from g1stream.session.output import Output

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

__all__ = ["check_free", "create", "try_out"]

_REPLACE: Final = "Choose another name, or give --force to replace it."
_REPLACE_OR_TIME: Final = (
    "Choose another name, give --force to replace it, or --auto-name to add the time."
)


def create(path: Path, *, force: bool) -> Output:
    """Make the file of a recording, which may be a device.

    Raises:
        RecordingError: there is one already and `force` is off, or none can be made there.
    """
    with _refusing(path, _REPLACE_OR_TIME):
        if path.is_dir():
            raise IsADirectoryError
        return Output(path, "w" if force else "x")


def try_out(path: Path, *, force: bool) -> None:
    """See whether `create` would succeed, and leave everything as it is.

    Raises:
        RecordingError: there is one already and `force` is off, or none can be made there.
    """
    with _refusing(path, _REPLACE_OR_TIME):
        if path.is_dir():
            raise IsADirectoryError
        if force and path.exists():
            path.open("r+b", buffering=0).close()
        elif not (force and path.is_symlink()):  # one that leads nowhere yet
            Output(path, "x").close()
            path.unlink()


def check_free(path: Path, *, force: bool) -> None:
    """Look whether a file may be moved to a path.

    Raises:
        RecordingError: there is one already and `force` is off, or there can be none.
    """
    with _refusing(path, _REPLACE):
        path.parent.stat()
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


@contextmanager
def _refusing(path: Path, replace: str) -> Iterator[None]:
    """Say what is wrong with a path, and how what is there could be replaced."""
    try:
        yield
    except IsADirectoryError as error:
        raise RecordingError(
            f"{path} is a directory.", "Name a file in it, such as session.mcap."
        ) from error
    except FileExistsError as error:
        raise RecordingError(f"The file {path} exists already.", replace) from error
    except FileNotFoundError as error:
        raise RecordingError(
            f"The directory {path.parent} does not exist.", f"Make it: mkdir -p {path.parent}"
        ) from error
    except OSError as error:
        raise RecordingError(
            f"The file {path} cannot be made: {error.strerror}.", "Choose another place for it."
        ) from error
