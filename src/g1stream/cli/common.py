"""What the subcommands share: flags, how they become a config, signals, and how errors are told."""

from __future__ import annotations

import json
import os
import signal
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Optional, TypeAlias, TypeVar

import tyro

from g1stream.cli.values import flag_name, out_of_range
from g1stream.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Callable

    from g1stream.config import Config
    from g1stream.errors import G1StreamError

__all__ = [
    "EXIT_BAD_INPUT",
    "EXIT_OK",
    "EXIT_STOPPED",
    "Command",
    "Flag",
    "Maybe",
    "WireCommand",
    "announce_wire",
    "exit_code_of_signal",
    "on_signals",
    "print_error",
    "print_json",
    "print_warning",
    "value",
]

EXIT_OK, EXIT_STOPPED, EXIT_BAD_INPUT = 0, 1, 2

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGTSTP, signal.SIGQUIT)


def value(metavar: str, default: str = "") -> Any:
    """How a flag with a value shows in the help: what to write, and what holds without it."""
    hint = f"(default: {default})" if default else ""
    return tyro.conf.arg(metavar=metavar, help_behavior_hint=hint)


Flag: TypeAlias = Annotated[
    bool, tyro.conf.FlagCreatePairsOff, tyro.conf.arg(help_behavior_hint="")
]
"""A switch, off unless given."""

T = TypeVar("T")
Maybe: TypeAlias = Optional[T]  # noqa: UP045
"""`T | None`, in the form that tyro takes without loading a type checker, which costs 40 ms."""


@dataclass(frozen=True, kw_only=True)
class Command:
    """Flags of every subcommand that has settings."""

    #: Flag -> the setting it goes over.
    settings: ClassVar[dict[str, str]] = {"robot": "robot"}

    config: Annotated[Path | None, value("TOML")] = None
    """File with settings; configs/sim.toml lists them all. Flags go over it."""
    robot: Annotated[Path | None, value("URDF", "the built-in 29-joint G1")] = None
    """Description of the robot."""

    def resolve(self) -> Config:
        """The config file, if any, with the flags over it.

        Raises:
            ConfigError: the file or a value does not fit.
        """
        from g1stream.config import load_config  # pydantic costs more than --help may take

        over = self.overrides()
        try:
            return load_config(self.config, over)
        except ConfigError:
            self._blame_a_flag(over)
            raise

    def _blame_a_flag(self, over: dict[str, Any]) -> None:
        """Say so where a setting that does not fit came from a flag."""
        from g1stream.config import load_config

        for field, key in self.settings.items():
            if key not in over:
                continue
            try:
                load_config(over={key: over[key]})
            except ConfigError as error:
                raise out_of_range(flag_name(field), key, over[key]) from error

    def overrides(self) -> dict[str, Any]:
        """The flags that were given, keyed like `stream.rate`."""
        given = {key: getattr(self, flag) for flag, key in self.settings.items()}
        # By identity: 0 is a domain, and equal to False.
        return {
            key: value for key, value in given.items() if value is not None and value is not False
        }

    def run(self) -> int:
        """Do it, and return the exit code."""
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class WireCommand(Command):
    """Flags of every subcommand that goes on DDS."""

    settings: ClassVar[dict[str, str]] = {
        **Command.settings,
        "domain": "dds.domain",
        "interface": "dds.interface",
    }

    domain: Annotated[int | None, value("N", "1, the simulators'; the robot's is 0")] = None
    """DDS domain."""
    interface: Annotated[str | None, value("NAME", "lo, which stays on this machine")] = None
    """Network interface."""


def announce_wire(config: Config, *, commands: bool = True) -> None:
    """Say on standard error where on DDS this goes; with a warning, where a robot may be.

    Args:
        config: where.
        commands: whether what is published moves whoever obeys it.
    """
    from g1stream.dds.domain import is_local_only

    where = f"DDS domain {config.dds.domain} on {config.dds.interface}"
    if os.environ.get("CYCLONEDDS_URI"):
        where = f"DDS domain {config.dds.domain}, where CYCLONEDDS_URI says"
    if commands and not is_local_only(config.dds.interface):
        where = (
            f"WARNING: {where}: whatever listens there will move, a real robot too. "
            "Keep its remote at hand"
        )
    print(f"{where}.", file=sys.stderr)


def on_signals(stop: Callable[[str], None]) -> None:
    """Call `stop` with the signal's name on the terminal's keys, termination and hang-up."""
    for number in _SIGNALS:
        signal.signal(number, lambda received, _: stop(signal.Signals(received).name))


def exit_code_of_signal(reason: str) -> int | None:
    """128 + n where the reason is the name of signal n, as shells have it."""
    names = {number.name: 128 + number for number in _SIGNALS}
    return names.get(reason)


def print_error(error: G1StreamError) -> None:
    """Print the cause and the remedy, a line each, on standard error."""
    print(f"error: {error.cause}\n       {error.remedy}", file=sys.stderr)


def print_warning(text: str) -> None:
    """Print what is wrong and does no harm, on standard error."""
    print(f"warning: {text}", file=sys.stderr)


def print_json(values: Any) -> None:
    """Print values as one JSON document on standard output."""
    print(json.dumps(values, indent=2))
