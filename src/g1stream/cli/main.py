"""`g1stream`: pick the subcommand and turn errors into exit codes."""

from __future__ import annotations

import inspect
import sys
from typing import TYPE_CHECKING, Annotated, Any, Union

import tyro

from g1stream._version import __version__
from g1stream.cli.common import EXIT_BAD_INPUT, Command, print_error
from g1stream.cli.demo import Demo
from g1stream.cli.motion import Inspect
from g1stream.cli.record import Record
from g1stream.cli.sim import Sim
from g1stream.cli.stream import Stream
from g1stream.errors import G1StreamError

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["main"]

_COMMANDS: dict[str, type[Command]] = {
    "demo": Demo,
    "stream": Stream,
    "sim": Sim,
    "record": Record,
    "motion": Inspect,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a subcommand.

    Args:
        arguments: what follows `g1stream`; the process's own if left out.

    Returns:
        The exit code: 0 all went well, 1 something stopped it, 2 bad input; 128 + n for a signal n.
    """
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    if arguments == ["--version"]:
        print(f"g1stream {__version__}")
        return 0
    try:
        return _parse(arguments).run()
    except G1StreamError as error:
        print_error(error)
        return EXIT_BAD_INPUT


def _parse(arguments: Sequence[str]) -> Command:
    choices: Any = tuple(
        Annotated[
            command,
            tyro.conf.subcommand(
                name, prefix_name=False, description=inspect.cleandoc(command.__doc__ or "")
            ),
        ]
        for name, command in _COMMANDS.items()
    )
    any_of_them: Any = Union[choices]  # noqa: UP007
    command: Command = tyro.cli(
        any_of_them,
        prog="g1stream",
        description="Play a reference motion on a Unitree G1 over DDS, and know how well it went.",
        args=arguments or ["--help"],
        config=(tyro.conf.OmitArgPrefixes,),
    )
    return command
