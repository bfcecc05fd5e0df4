"""Motions from motion files and from sessions in which one was played."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from g1stream.errors import MotionError
from g1stream.files import is_session
from g1stream.motion.files import open_motion_file
from g1stream.motion.motion import check_fps

if TYPE_CHECKING:
    import os

    from g1stream.motion.check import FileReport
    from g1stream.motion.motion import Motion
    from g1stream.robot.model import G1

__all__ = ["check_motion_file", "load_motion"]


def load_motion(
    path_or_name: str | os.PathLike[str], robot: G1 | None = None, *, fps: float | None = None
) -> Motion:
    """Read a motion file, a session file, or a bundled motion by its name (`demo`).

    Args:
        path_or_name: a CSV file of 37 columns with a header (Foxglove) or of 36 without (LAFAN1 for
            the G1); a session file, whose motion is the reference that was played; or the name of a
            bundled motion.
        robot: whose joints a motion file must have; the 29-dof G1 if None.
        fps: frames per second. A CSV file cannot say it: 30 if None. A session is sampled at it, at
            the rate of its reference if None.

    Returns:
        The motion, its joints in motor order whatever the order in the file, its quaternions unit.
        Those that were off by more than 1e-3 give a warning in `Motion.warnings`.

    Raises:
        MotionError: there is no such file, or something in it is wrong; names line and column.
        RecordingError: the session is damaged, or no motion was played in it.
    """
    if is_session(Path(path_or_name)):
        from g1stream.session.session import open_session

        return open_session(path_or_name).motion(fps)
    file = open_motion_file(path_or_name)
    if fps is not None:
        check_fps(fps, file.path.stem)
    return file.motion(robot, fps=fps)


def check_motion_file(
    path_or_name: str | os.PathLike[str], robot: G1, *, fps: float | None = None
) -> FileReport:
    """Check what `load_motion` reads, without raising for a fault in it.

    Args:
        path_or_name: as for `load_motion`.
        robot: whose joints and limits.
        fps: as for `load_motion`.

    Raises:
        MotionError: there is no such file, it is empty or not text; or `fps` is not a frame rate.
        RecordingError: the session is damaged, or no motion was played in it.
    """
    from g1stream.motion.check import FileReport, check_file, check_motion

    path = Path(path_or_name)
    if not is_session(path):
        return check_file(path_or_name, robot, fps=fps)
    motion = load_motion(path, fps=fps)
    try:
        return FileReport(path, kind="session", motion=check_motion(motion, robot))
    except MotionError as error:
        return FileReport(path, kind="session", fault=error.cause, remedy=error.remedy)
