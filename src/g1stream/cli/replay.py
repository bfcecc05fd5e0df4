"""`g1stream replay`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from g1stream.cli.common import Flag, announce_wire, on_signals, value
from g1stream.cli.progress import watching
from g1stream.cli.stream import PlayCommand

if TYPE_CHECKING:
    from g1stream.control.loop import StreamLoop
    from g1stream.motion.motion import Motion

__all__ = ["Replay"]


@dataclass(frozen=True, kw_only=True)
class Replay(PlayCommand):
    """Play a recorded session again on whatever robot listens.

    Plays the recorded reference as `g1stream stream` plays a motion: from the measured pose, within
    the same limits, with the gains of this call. Ctrl-C damps and ends.

    Exit code 0: played as asked; 1: something stopped it, or is missing from the recording; 2: bad
    input; 128 + n: signal n ended it, so that it is 130 after Ctrl-C.
    """

    file: Annotated[Path, tyro.conf.Positional, value("MCAP")]
    """The session file, or one of its parts."""
    exact: Flag = False
    """Publish the recorded LowCmds, bit for bit, gains and torques included, while it plays.
    Refused where one is beyond a limit or for motors that are off, or where the robot would leap:
    at a splice, or over a gap of more than safety.state_timeout."""
    speed: Annotated[float, value("X", "1")] = 1.0
    """How many times as fast as it was recorded."""

    def run(self) -> int:
        """Play, and return the exit code."""
        from g1stream.programs.replay import replay

        config = self.resolve()

        with watching() as watch:

            def prepare(loop: StreamLoop, motion: Motion) -> None:
                announce_wire(config)
                on_signals(loop.request_stop)
                watch(loop, motion)

            summary = replay(
                self.file,
                config,
                exact=self.exact,
                speed=self.speed,
                record=self.record,
                force=self.force,
                on_loop=prepare,
            )
        return self.report(summary)
