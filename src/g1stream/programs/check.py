"""Look at whatever can be converted, without converting it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from g1stream.motion.file_check import check_file, check_session
from g1stream.session.magic import is_mcap

if TYPE_CHECKING:
    from g1stream.motion.file_check import FileReport
    from g1stream.robot.model import G1

__all__ = ["check"]


def check(motion: str | Path, robot: G1, *, fps: float | None = None) -> FileReport:
    """Tell what is in a motion file, a session file, or a bundled motion by its bare name.

    Args:
        motion: which, as `g1stream.load_motion` takes it.
        robot: whose joints it should have.
        fps: frames a second; what the motion says if None.

    Raises:
        MotionError: there is no such file, or it is empty or no text; or the frame rate is none.
        RecordingError: the session is damaged, or no motion was played in it.
    """
    if not is_mcap(Path(motion)):
        return check_file(motion, robot, fps=fps)
    from g1stream.session.motions import load_motion  # brings the reader

    return check_session(motion, load_motion(motion, robot, fps=fps), robot)
