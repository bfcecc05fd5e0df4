"""What the commands share: settings under flags, exit codes, signals and output."""

from __future__ import annotations

import json
import os
import signal
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from g1stream.cli.flags import flag, given_settings

if TYPE_CHECKING:
    from collections.abc import Callable

    from g1stream.config import Config
    from g1stream.session.summary import Summary

__all__ = [
    "EXIT_BAD_INPUT",
    "EXIT_OK",
    "EXIT_STOPPED",
    "Command",
    "SettingsCommand",
    "announce_wire",
    "exit_code",
    "exit_code_of_signal",
    "on_signals",
    "print_json",
    "print_summary",
    "print_warning",
]

EXIT_OK, EXIT_STOPPED, EXIT_BAD_INPUT = 0, 1, 2

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGTSTP, signal.SIGQUIT)


@dataclass(frozen=True, kw_only=True)
class Command:
    """A subcommand and its flags."""

    def run(self) -> int:
        """Run it, and return the exit code."""
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class SettingsCommand(Command):
    """A subcommand that has settings; `parse_flags` adds a field for each with a flag on it."""

    config: str | None = flag(
        None,
        "File with settings, or a name: robot, sim. Flags override it.",
        "TOML",
    )

    def resolve(self) -> Config:
        """The config file, if any, with the flags over it.

        Raises:
            ConfigError: the file or a value does not fit.
        """
        from g1stream.config import load_config

        return load_config(self.config, self.overrides())

    def overrides(self) -> dict[str, Any]:
        """The flags that were given, keyed like `stream.rate`."""
        return given_settings(self)


def announce_wire(config: Config, *, commands: bool = True) -> None:
    """Print on standard error where on DDS this goes; with a warning, where a robot may be.

    Args:
        config: where.
        commands: whether what is published moves a robot.
    """
    from g1stream.dds.domain import is_local_only

    where = f"DDS domain {config.dds.domain} on {config.dds.interface}"
    if os.environ.get("CYCLONEDDS_URI"):
        where = f"DDS domain {config.dds.domain}, on the interface in CYCLONEDDS_URI"
    if commands and not is_local_only(config.dds.interface):
        where = (
            f"WARNING: {where}: every subscriber of rt/lowcmd will move, a real robot too. "
            "Keep its remote at hand"
        )
    print(f"{where}.", file=sys.stderr)


def on_signals(stop: Callable[[str], None]) -> None:
    """Call `stop` with the signal's name on the terminal's keys, termination and hang-up."""
    for number in _SIGNALS:
        signal.signal(number, lambda received, _: stop(signal.Signals(received).name))


def exit_code_of_signal(reason: str) -> int | None:
    """128 + n where the reason is the name of signal n, as in a shell."""
    names = {number.name: 128 + number for number in _SIGNALS}
    return names.get(reason)


def print_warning(text: str) -> None:
    """Print a warning on standard error."""
    print(f"warning: {text}", file=sys.stderr)


def print_json(values: Any) -> None:
    """Print values as one JSON document on standard output."""
    print(json.dumps(values, indent=2))


def print_summary(summary: Summary, *, as_json: bool) -> None:
    """Print a summary, as text or as one JSON document."""
    if as_json:
        print_json(summary.model_dump(mode="json"))
    else:
        print(summary)


def exit_code(summary: Summary) -> int:
    """The exit code of a run: 0 where it went as asked and was recorded completely.

    128 + n where signal n ended the stream; 1 where something else did, where a recording is known
    to lack samples or received none, or where its recorder wrote no summary.
    """
    reason, recorder = summary.termination.reason, summary.recorder
    if reason:
        return exit_code_of_signal(reason) or EXIT_STOPPED
    if recorder is None:
        return EXIT_STOPPED if summary.files_bytes else EXIT_OK
    return EXIT_OK if recorder.complete and recorder.first_ns is not None else EXIT_STOPPED
