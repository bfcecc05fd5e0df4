"""Libraries: check, simulate or convert many motions."""

from typing import TYPE_CHECKING

from g1stream.optional import lazily

if TYPE_CHECKING:
    from g1stream.extras.library.compute import LibraryCase as LibraryCase
    from g1stream.extras.library.run import LibraryRun as LibraryRun
    from g1stream.extras.library.run import run_library as run_library
    from g1stream.extras.library.table import (
        JointRow as JointRow,
    )
    from g1stream.extras.library.table import (
        Library as Library,
    )
    from g1stream.extras.library.table import (
        MotionRow as MotionRow,
    )
    from g1stream.extras.library.table import (
        open_library as open_library,
    )

__all__ = [
    "JointRow",
    "Library",
    "LibraryCase",
    "LibraryRun",
    "MotionRow",
    "open_library",
    "run_library",
]

__getattr__ = lazily(
    __name__,
    {
        "LibraryCase": "compute",
        "LibraryRun": "run",
        "run_library": "run",
        "JointRow": "table",
        "Library": "table",
        "MotionRow": "table",
        "open_library": "table",
    },
)
