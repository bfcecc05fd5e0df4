"""The base classes of commands, exit codes, signal handling and printing."""

from __future__ import annotations

import json
import os
import signal
import sys
from contextlib import ExitStack, contextmanager, redirect_stdout
from dataclasses import dataclass, field
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from g1stream.cli.flags import flag, flag_name, lacking
from g1stream.errors import ConfigError
from g1stream.events import QUIET, is_quiet
from g1stream.optional import extension
from g1stream.text import printable

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from g1stream.analysis.summary import Summary
    from g1stream.config import Config

EXIT_OK, EXIT_STOPPED = 0, 1
#: Added to the number of the signal that ended the program, as in a shell.
EXIT_SIGNAL = 128

_S = signal.Signals
_HANDLED = tuple(
    sorted(
        signal.valid_signals()
        - {_S.SIGKILL, _S.SIGSTOP}  # cannot be handled
        - {_S.SIGCHLD, _S.SIGCONT, _S.SIGURG, _S.SIGWINCH}  # do not end a process
        - {_S.SIGPIPE, _S.SIGXFSZ}  # ignored by Python: the write raises an OSError instead
        # Returning would repeat the faulty instruction for ever; the guard process damps.
        - {_S.SIGSEGV, _S.SIGBUS, _S.SIGFPE, _S.SIGILL, _S.SIGTRAP, _S.SIGSYS}
    )
)
"""The signals that end a command with an orderly shutdown."""


@dataclass(frozen=True, kw_only=True)
class Command:
    """A subcommand and its flags."""

    quiet: bool = flag(
        False,
        "Print only warnings, errors, and the output of --json.",
        aliases=("-q",),
    )

    def run(self) -> int:
        """Run the command, and return the exit code."""
        raise NotImplementedError


@contextmanager
def quietly(command: Command) -> Iterator[None]:
    """Suppress all output that --quiet excludes, for the length of a `with`."""
    if not command.quiet:
        yield
        return
    before = os.environ.get(QUIET)
    os.environ[QUIET] = "1"  # for child processes, too
    try:
        with ExitStack() as stack:
            if not getattr(command, "json", False):
                nothing = stack.enter_context(Path(os.devnull).open("w", encoding="utf-8"))
                stack.enter_context(redirect_stdout(nothing))
            yield
    finally:
        os.environ.pop(QUIET)
        if before is not None:
            os.environ[QUIET] = before


def print_note(text: str) -> None:
    """Print a status message on standard error, except with --quiet."""
    if not is_quiet():
        print(printable(text), file=sys.stderr)


@dataclass(frozen=True, kw_only=True)
class SettingsCommand(Command):
    """A subcommand with settings.

    Attributes:
        settings: values of the flags that were given, keyed like `stream.rate`. `parse_flags` sets
            it.
    """

    settings: dict[str, Any] = field(default_factory=dict)

    config: str | None = flag(
        None, "File with settings, or a built-in one: robot, sim. Flags override it.", "TOML"
    )

    def resolve(self) -> Config:
        """The settings from the config file, if any, overridden by the flags."""
        from g1stream.config import load_config, settings

        config, known = load_config(self.config, self.overrides()), settings()
        for key in self.settings:
            about: Any = known[key].json_schema_extra
            for need in about["needs"] if about else ():
                if "." in need and not attrgetter(need)(config):
                    raise lacking(*(flag_name(name.rpartition(".")[2]) for name in (key, need)))
        return config

    def overrides(self) -> dict[str, Any]:
        """The flags that were given, keyed like `stream.rate`."""
        return dict(self.settings)


@dataclass(frozen=True, kw_only=True)
class LiveCommand(SettingsCommand):
    """A subcommand that can serve live data to a viewer."""

    # --live takes no port, because `stream --live dance.csv` would read the motion as its value.
    live: bool = flag(
        False,
        "Serve the data on the DDS domain to Foxglove and Lichtblick on this machine "
        "(extra `live`).",
    )

    live_origin: list[str] = flag(
        (),
        "A web page that may read, beside those on this machine and app.foxglove.dev, such as "
        "https://viewer.example. May be repeated.",
        "ORIGIN",
        shown="none",
        advanced=True,
        needs=("live",),
    )

    @contextmanager
    def serving(self, config: Config) -> Iterator[None]:
        """With --live, serve for the length of a `with`, and print the address to open."""
        if not self.live:
            yield
            return
        with extension("live")(config, origins=self.live_origin) as address:
            where = f"Open connection > Foxglove WebSocket > {address}"
            print_note(f"Live in Foxglove and Lichtblick: {where}")
            yield


def announce_wire(config: Config, *, commands: bool = True) -> None:
    """Print the DDS domain and interface on standard error, with a warning off loopback."""
    from g1stream.dds.messages import COMMANDS
    from g1stream.network import is_local_only

    where = f"DDS domain {config.dds.domain} on {config.dds.interface}"
    if os.environ.get("CYCLONEDDS_URI"):
        where = f"DDS domain {config.dds.domain}, on the interface in CYCLONEDDS_URI"
    if commands and not is_local_only(config.dds.interface):
        where = (
            f"WARNING: {where}: every subscriber of {COMMANDS[config.stream.via].name} will move, "
            "including a real robot. "
            "Keep its remote at hand"
        )
        print(f"{printable(where)}.", file=sys.stderr)
    else:
        print_note(f"{where}.")


def yes_flag(*needs: str, advanced: bool = False) -> Any:
    """The flag --yes of commands that ask before they move a robot."""
    text = "Confirm in advance, with the name of the interface in use."
    return flag(None, text, "INTERFACE", advanced=advanced, needs=needs)


def confirmed(interface: str, yes: str | None) -> bool:
    """Ask on the terminal whether to command what is on an interface, unless --yes names it."""
    if yes is not None:
        if yes == interface:
            return True
        raise ConfigError(
            f"The flag --yes names {yes}, but the interface in use is {interface}.",
            f"Check which robot you mean. --yes {interface} confirms this one.",
        )
    if not sys.stdin.isatty():
        raise ConfigError(
            "Confirmation needs a terminal, and standard input is none.",
            f"Run it on a terminal, or confirm in advance with --yes {interface}.",
        )

    def end(number: int) -> None:
        raise SystemExit(EXIT_SIGNAL + number)

    with on_signals(end):  # nothing moves yet, so a signal only ends the question
        print(f"Type {interface} to continue: ", end="", file=sys.stderr, flush=True)
        return sys.stdin.readline().strip() == interface


@contextmanager
def on_signals(stop: Callable[[int], None]) -> Iterator[None]:
    """Call `stop` with the number of each signal that would end or stop the process, in a `with`.

    A signal with a handler from outside Python keeps it, because Python could not restore it.
    `python -X faulthandler` installs one for SIGABRT.
    """
    before = {
        number: signal.signal(number, lambda received, _: stop(received))
        for number in _HANDLED
        if signal.getsignal(number) is not None
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def print_warning(*texts: str) -> None:
    """Print warnings on standard error."""
    for text in texts:
        print(f"warning: {printable(text)}", file=sys.stderr)


def print_lines(text: str, file: TextIO | None = None) -> None:
    """Print lines, on standard output by default, with terminal control characters escaped."""
    print("\n".join(map(printable, text.split("\n"))), file=file)


def print_verdict(text: str, *, failed: bool, file: TextIO | None = None) -> None:
    """Print the verdict on a condition; --quiet leaves out those that are met."""
    print_lines(text, sys.stderr if failed and is_quiet() else file)


def print_json(values: Any) -> None:
    """Print values as one JSON document on standard output."""
    print(json.dumps(values, indent=2))


def print_result(values: Any, text: str, *, as_json: bool) -> None:
    """Print a result as text, or with `as_json` its values as one JSON document."""
    if as_json:
        print_json(values)
    else:
        print_lines(text)


def print_summary(summary: Summary, *, as_json: bool, details: bool = False) -> None:
    """Print a summary: its result, with `details` all of it, or as one JSON document."""
    text = summary.details if details else str(summary)
    print_result(summary.model_dump(mode="json"), text, as_json=as_json)


def exit_code(summary: Summary) -> int:
    """The exit code of a run.

    0 if the motion was played as asked and the recording is complete. 128 + n if signal n ended
    the stream. 1 if something else ended it, or if a recording lacks samples, received none or has
    no summary from its recorder.
    """
    recorder, stream = summary.recorder, summary.stream
    if summary.termination.reason:
        number = stream.signal if stream else None
        return EXIT_SIGNAL + number if number else EXIT_STOPPED
    if recorder is None:
        return EXIT_STOPPED if summary.files_bytes else EXIT_OK
    return EXIT_OK if recorder.complete and recorder.first_ns is not None else EXIT_STOPPED
