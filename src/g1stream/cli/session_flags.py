"""The flag --motion of commands that show sessions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from g1stream.cli.command import Command, print_warning
from g1stream.cli.flags import flag

if TYPE_CHECKING:
    from pathlib import Path

    from g1stream.app.session import Session

__all__ = ["SessionFlags"]


@dataclass(frozen=True, kw_only=True)
class SessionFlags(Command):
    """The flag --motion of a command that shows sessions."""

    motion: str | None = flag(
        None,
        "Motion that was played in a session without a reference, such as one that another "
        "program recorded. `attach --help` says how it is found.",
        "MOTION",
    )

    def open(self, path: Path) -> Session:
        """Open a session. If it has no reference, attach the motion of --motion.

        Raises:
            MotionError: the motion cannot be read.
            RecordingError: the file is no session, or the motion was not played in it.
        """
        from g1stream.app.session import open_session
        from g1stream.motion.readers import load_motion
        from g1stream.session.streams import ReferenceStream

        session = open_session(path)
        if self.motion is None:
            return session
        if session.topics.get(ReferenceStream.topic):
            print_warning(f"{path} has a reference: --motion is not used")
            return session
        motion = load_motion(self.motion)
        print_warning(*motion.warnings)
        return session.attach(motion)
