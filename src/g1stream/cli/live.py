"""The flag --live of commands that put something on DDS, or record it."""

from __future__ import annotations

import sys
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

from g1stream.cli.command import SettingsCommand
from g1stream.cli.flags import flag
from g1stream.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from g1stream.config import Config


@dataclass(frozen=True, kw_only=True)
class LiveCommand(SettingsCommand):
    """A subcommand that can serve what it does to a viewer."""

    # The port has a flag of its own: in `stream --live dance.csv` the motion would be taken for it.
    live: bool = flag(
        False,
        "Serve what is on the DDS domain to Foxglove and Lichtblick on this machine "
        "(extra `live`).",
    )

    def resolve(self) -> Config:
        """The config file, if any, with the flags over it."""
        if not self.live and "live_port" in self.settings:
            raise ConfigError(
                "The flag --live-port has no effect without --live.", "Add --live, or leave it out."
            )
        return super().resolve()

    @contextmanager
    def serving(self, config: Config) -> Iterator[None]:
        """Serve for the length of a `with`, if asked to, and print the address to open."""
        if not self.live:
            yield
            return
        from g1stream.app.live import live

        with live(config) as address:
            where = f"Open connection > Foxglove WebSocket > {address}"
            print(f"Live in Foxglove and Lichtblick: {where}", file=sys.stderr)
            yield
