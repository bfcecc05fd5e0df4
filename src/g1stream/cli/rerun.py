"""`g1stream rerun`: a session, or what is on DDS, in the Rerun viewer."""

from __future__ import annotations

import logging
import sys
from dataclasses import dataclass
from pathlib import Path

from g1stream.cli.command import EXIT_OK, SettingsCommand, announce_wire, on_signals
from g1stream.cli.flags import flag, flag_name
from g1stream.errors import ConfigError
from g1stream.events import ConsoleHandler, handled_by
from g1stream.realtime import lower_priority

__all__ = ["Rerun"]


@dataclass(frozen=True, kw_only=True)
class Rerun(SettingsCommand):
    """Shows the measured robot, the reference as a ghost, joints and torques with the worst first,
    errors by limb, timing, phases and events; or saves that as a file for the viewer.

    A viewer is started, which listens on this machine only; --connect takes one that runs. With
    --live it shows what is on DDS: it only subscribes, so that it cannot disturb robot and stream.

    Needs the extra `rerun`. The real G1's meshes are used with the extra `meshes`.

    Examples:
      g1stream rerun session.mcap
      g1stream rerun session.mcap -o session.rrd
      g1stream rerun --live --domain 1

    Exit codes:
      0  shown or saved; live: ended by Ctrl-C, or the viewer was closed
      2  bad input: not a session file, no viewer
    """  # noqa: D205

    session: Path | None = flag(
        None, "The session file, or the directory of a split recording.", "SESSION", positional=True
    )
    out: Path | None = flag(None, "Save into this file (.rrd).", "FILE", aliases=("-o",))
    live: bool = flag(False, "Show what is on DDS, until Ctrl-C.")
    connect: str | None = flag(
        None, "Show in the viewer that listens there.", "HOST:PORT", shown="start one"
    )
    force: bool = flag(False, "Replace a file that is there.")

    def run(self) -> int:
        """Show or save, and return the exit code."""
        self._check()
        if self.live:
            return self._show_live()
        from g1stream.app.session import open_session

        assert self.session is not None
        session = open_session(self.session)
        if self.out:
            print(session.to_rerun(self.out, force=self.force))
        else:
            from g1stream.app.rerun import show_session

            show_session(session, self.connect)
        return EXIT_OK

    def _check(self) -> None:
        """Refuse what does not go together."""
        if self.live == (self.session is not None):
            both = "A session and --live do not go together." if self.live else "Nothing to show."
            raise ConfigError(both, "Give a session file, or --live for what is on DDS.")
        if self.live:
            wrong = [name for name in ("out", "force") if getattr(self, name)]
            against, remedy = "--live", "Leave it out; `g1stream record` saves what is on DDS."
        else:
            wrong = ["config"] if self.config else []
            wrong += [name.rpartition(".")[2] for name in self.settings]
            against, remedy = "a session", "Leave it out."
        if wrong:
            raise ConfigError(f"{flag_name(wrong[0])} does not go with {against}.", remedy)
        if self.out and self.connect:
            raise ConfigError("--out and --connect do not go together.", "Leave one of them out.")

    def _show_live(self) -> int:
        from g1stream.app.rerun import show_live

        lower_priority()
        config = self.resolve()
        stopped: list[str] = []

        def on_ready() -> None:
            announce_wire(config, commands=False)
            print("Showing it in Rerun. Ctrl-C ends it, and the viewer stays.", file=sys.stderr)

        with on_signals(stopped.append), handled_by(ConsoleHandler(logging.WARNING)):
            show_live(config, self.connect, should_stop=lambda: bool(stopped), on_ready=on_ready)
        return EXIT_OK
