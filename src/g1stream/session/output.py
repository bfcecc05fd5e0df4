"""The file under a recording: whole pieces or none, and room kept for its end.

A disk that fills up tells so in the midst of a write. So room on it is claimed before anything is
written (fallocate(2), where the file system can), enough for what is to come and for the summary
that ends the file; and what was written only in part is taken back.
"""

from __future__ import annotations

import ctypes
import errno
import io
import os
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["Output"]

_KEEP_SIZE: Final = 1  # FALLOC_FL_KEEP_SIZE of linux/falloc.h
_STEP: Final = 1 << 20

_fallocate: Any = getattr(ctypes.CDLL(None, use_errno=True), "fallocate", None)
if _fallocate is not None:
    _fallocate.argtypes = (ctypes.c_int, ctypes.c_int, ctypes.c_int64, ctypes.c_int64)


class Output(io.FileIO):
    """A file that grows by whole pieces, straight to the operating system.

    Args:
        path: where to.
        mode: `x`: it must not be there yet; `w`: what is there is replaced.

    Raises:
        OSError: it cannot be opened.
    """

    def __init__(self, path: Path, mode: str) -> None:
        super().__init__(path, mode)
        self._whole = 0
        self._claimed = 0

    def write(self, data: Any, /) -> int:
        """Write all of the data.

        Raises:
            OSError: it cannot be written, or only a part of it could.
        """
        view = memoryview(data)
        while view:
            view = view[super().write(view) :]
        return len(data)

    def claim(self, size: int) -> None:
        """Claim room on the disk for `size` more bytes; does nothing where that is impossible.

        Raises:
            OSError: there is not so much room.
        """
        end = self.tell() + size
        if end <= self._claimed or _fallocate is None:
            return
        end += -end % _STEP
        if _fallocate(self.fileno(), _KEEP_SIZE, self._claimed, end - self._claimed) == 0:
            self._claimed = end
        elif (number := ctypes.get_errno()) in {errno.ENOSPC, errno.EDQUOT}:
            raise OSError(number, os.strerror(number))

    def settle(self) -> None:
        """Take all that has been written up to here for whole."""
        self._whole = self.tell()

    def take_back(self) -> None:
        """Remove what was written since the last `settle`."""
        with suppress(OSError):  # a device has no end to set
            self.truncate(self._whole)
            self.seek(self._whole)

    def close(self) -> None:
        """Give back what was claimed and not used, and close."""
        if not self.closed and self._claimed:
            with suppress(OSError):
                self.truncate(self.tell())
        super().close()
