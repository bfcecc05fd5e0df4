"""Motions from wherever there are some: motion files, and sessions in which one was played."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from g1stream.motion import readers
from g1stream.session.magic import is_mcap

if TYPE_CHECKING:
    import os

    from g1stream.motion.motion import Motion
    from g1stream.robot.model import G1

__all__ = ["load_motion"]


def load_motion(
    path_or_name: str | os.PathLike[str], robot: G1 | None = None, *, fps: float | None = None
) -> Motion:
    """Read a motion file, a session file, or a bundled motion by its bare name (`demo`).

    Args:
        path_or_name: what `g1stream.motion.readers.load_motion` takes, or a session file, of which
            the motion is the reference that was played.
        robot: whose joints a motion file must have; the 29-dof G1 if None.
        fps: frames a second: of a motion file, those that it has; of a session, those that it is to
            be sampled with, which are the rate of its reference if None.

    Raises:
        MotionError: there is no such motion file, or something in it cannot be right.
        RecordingError: the session is damaged, or no motion was played in it.
    """
    if not is_mcap(Path(path_or_name)):
        return readers.load_motion(path_or_name, robot, fps=fps)
    from g1stream.session.session import open_session

    return open_session(path_or_name).motion(fps)
