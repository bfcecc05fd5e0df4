"""`g1stream`: pick the subcommand and turn errors into exit codes."""

from __future__ import annotations

import inspect
import os
import signal
import sys
from importlib import import_module
from typing import TYPE_CHECKING, Annotated, Any, Protocol, Union

import tyro

from g1stream._version import __version__
from g1stream.cli.common import EXIT_BAD_INPUT, EXIT_STOPPED, print_error
from g1stream.cli.values import reading
from g1stream.errors import G1StreamError

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["main"]


class _Command(Protocol):
    def run(self) -> int:
        """Do it, and return the exit code."""


#: Subcommand -> the module of this package and the class in it. Only that of the command asked for
#: is imported, and only its flags are made a parser of: that takes a fifth of the time of all.
_COMMANDS = {
    "demo": ("demo", "Demo"),
    "stream": ("stream", "Stream"),
    "sim": ("sim", "Sim"),
    "record": ("record", "Record"),
    "replay": ("replay", "Replay"),
    "convert": ("convert", "Convert"),
    "info": ("info", "Info"),
    "motion": ("motion", "Inspect"),
    "doctor": ("doctor", "Doctor"),
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a subcommand.

    Args:
        arguments: what follows `g1stream`; the process's own if left out.

    Returns:
        The exit code: 0 all went well, 1 something stopped it, 2 bad input; 128 + n for a signal n.
    """
    # Our matrices are small; a pool of BLAS threads would only cost every start 50 ms of CPU.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    if arguments == ["--version"]:
        print(f"g1stream {__version__}")
        return 0
    try:
        code = _parse(arguments).run()
        sys.stdout.flush()
    except KeyboardInterrupt:
        return 128 + signal.SIGINT
    except G1StreamError as error:
        print_error(error)
        return EXIT_BAD_INPUT
    except BrokenPipeError:
        # Whoever read our output is gone; nor can what is buffered still be told at the exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_STOPPED
    return code


def _parse(arguments: Sequence[str]) -> _Command:
    """The subcommand that is asked for, with its flags; ends the process where that is none."""
    if arguments and arguments[0] in _COMMANDS:
        name, *rest = arguments
        kind = _load(name)
        return _cli(kind, f"g1stream {name}", inspect.cleandoc(kind.__doc__ or ""), rest)
    choices: Any = tuple(
        Annotated[
            _load(name),
            tyro.conf.subcommand(
                name, prefix_name=False, description=inspect.cleandoc(_load(name).__doc__ or "")
            ),
        ]
        for name in _COMMANDS
    )
    return _cli(
        Union[choices],  # noqa: UP007
        "g1stream",
        "Play a reference motion on a Unitree G1 over DDS, and know how well it went.",
        arguments or ["--help"],
    )


def _cli(kind: Any, program: str, description: str, arguments: Sequence[str]) -> _Command:
    with reading(arguments):
        command: _Command = tyro.cli(
            kind,
            prog=program,
            description=description,
            args=arguments,
            config=(tyro.conf.OmitArgPrefixes,),
        )
    return command


def _load(name: str) -> Any:
    module, kind = _COMMANDS[name]
    return getattr(import_module(f"g1stream.cli.{module}"), kind)
