"""`g1stream completion`: prints a script for shell completion of commands, flags and files."""

from __future__ import annotations

from argparse import ArgumentParser
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from g1stream.cli.command import EXIT_OK, Command
from g1stream.cli.flags import argument, command_parser
from g1stream.cli.main import COMMANDS, load_command
from g1stream.errors import ConfigError

if TYPE_CHECKING:
    from argparse import Action

#: A value whose metavar contains one of these words may also be a path.
_FILES = ("FILE", "TOML", "ONNX", "URDF", "MOTION", "SESSION", "OTHER")


@dataclass(frozen=True, kw_only=True)
class Completion(Command):
    """Prints the script. Generate it again after an update, and after an extra was installed.

    Examples:
      g1stream completion bash > ~/.local/share/bash-completion/completions/g1stream
      g1stream completion zsh > ~/.zfunc/_g1stream
      g1stream completion fish > ~/.config/fish/completions/g1stream.fish

    In zsh, fpath must contain the directory: put `fpath+=~/.zfunc` before `compinit` in ~/.zshrc.

    Exit codes:
      0  printed
      2  bad input
    """

    shell: Literal["bash", "zsh", "fish"] = argument("The shell.", "SHELL")

    def run(self) -> int:
        """Print the script, and return the exit code."""
        import shtab

        script = shtab.complete(_parser_of_all(shtab.FILE, shtab.DIRECTORY), self.shell)
        # shtab's comment names a directory that bash-completion does not read.
        print(script.replace("/share/bash_completion/", "/share/bash-completion/completions/"))
        return EXIT_OK


def _parser_of_all(file: Any, directory: Any) -> ArgumentParser:
    """A parser with all installed commands as its subcommands.

    `file` and `directory` define how a shell completes paths.
    """
    root = ArgumentParser("g1stream")
    root.add_argument("--version", action="store_true", help="show the version and exit")

    def made(prog: str, parser: ArgumentParser) -> ArgumentParser:
        del prog
        return parser

    parser_class: Any = made  # argparse only calls it
    subcommands: Any = root.add_subparsers(parser_class=parser_class)
    for name, row in COMMANDS.items():
        with suppress(ConfigError):  # its extra is not installed
            parser = command_parser(load_command(name), name, row.purpose)
            for action in parser._actions:  # argparse has no public list of them
                _complete(action, file, directory)
            subcommands.add_parser(name, help=row.purpose, parser=parser)
    return root


def _complete(action: Action, file: Any, directory: Any) -> None:
    """Set what completes the value of a flag or an argument."""
    metavar = str(action.metavar or "")
    if metavar.startswith("{"):
        action.choices = metavar.strip("{}").split(",")
        action.type = None
    elif metavar == "DIR":
        action.complete = directory  # type: ignore[attr-defined]
    elif action.type is Path or any(word in metavar for word in _FILES):
        action.complete = file  # type: ignore[attr-defined]
