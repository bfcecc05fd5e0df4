"""`g1stream`: the list of commands, the choice of one, and errors as exit codes."""

from __future__ import annotations

import os
import shutil
import signal
import sys
from contextlib import contextmanager, suppress
from difflib import get_close_matches
from importlib import import_module
from io import TextIOWrapper
from pathlib import Path
from textwrap import TextWrapper
from typing import TYPE_CHECKING, Any, Final, TextIO, cast

from g1stream.errors import ConfigError, G1StreamError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

__all__ = ["main"]

#: Command -> the module and class of it, imported only when it runs, and its purpose.
_COMMANDS: Final = {
    "demo": ("demo", "Demo", "Simulate a G1 on this machine, play a motion, record and compare."),
    "stream": ("stream", "Stream", "Play a motion on the robot or simulator that listens on DDS."),
    "sim": ("sim", "Sim", "Simulate a G1 on DDS: a MuJoCo bridge on the topics of the robot."),
    "record": ("record", "Record", "Record what is on DDS into a session file (MCAP)."),
    "replay": ("stream", "Replay", "Play a recorded session again."),
    "learn": ("learn", "Learn", "Learn from sessions of a motion to follow it more closely."),
    "identify": ("identify", "Identify", "Tell which robot a session was recorded on."),
    "convert": (
        "convert",
        "Convert",
        "Convert a motion into MCAP, CSV, NPZ, or a session into a ROS 2 bag.",
    ),
    "library": ("library", "Library", "Check, simulate or convert many motions at once."),
    "info": ("info", "Info", "Print what is in a session file, and how well it went."),
    "report": ("report", "Report", "Write a page on sessions: tables, figures, events."),
    "plot": ("plot", "Plot", "Plot joints of a session: PNG, SVG or PDF."),
    "compare": ("compare", "Compare", "Compare sessions of a motion: what got better or worse."),
    "render": (
        "render",
        "Render",
        "Make a video of a session: the robot, and its reference as a ghost.",
    ),
    "repair": ("repair", "Repair", "Write the index of a session whose recorder was killed."),
    "layout": ("layout", "Layout", "Write a layout of a viewer that shows sessions."),
    "motion": ("motion", "Inspect", "Check a motion file: frames, joints, limits, physics."),
    "robot": ("robot", "Robot", "Show, release or restore the robot's own controller."),
    "doctor": ("doctor", "Doctor", "Find what keeps robot and g1stream apart, or the loop late."),
}

_HELP: Final = """\
usage: g1stream [-h] [--version] COMMAND ...

Play a reference motion on a Unitree G1 over DDS, and know how well it went.

commands:
{commands}

options:
  -h, --help  show this help message and exit
  --version   show the version and exit

`g1stream COMMAND --help` shows the flags of a command, examples and exit codes.

exit codes:
  0        as asked
  1        stopped, or a check failed
  2        bad input; nothing was done
  128 + n  ended by signal n, such as 130 after Ctrl-C
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command.

    Args:
        arguments: what follows `g1stream`; the process's own if left out.

    Returns:
        The exit code: 0 as asked, 1 stopped, 2 bad input, 128 + n after signal n.
    """
    # Our matrices are small; a pool of BLAS threads would only cost every start 50 ms of CPU.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    for stream in (sys.stdout, sys.stderr):  # what the terminal's encoding lacks is escaped
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    with _lenient_output() as output:
        try:
            code = _run(arguments)
        except KeyboardInterrupt:
            return 128 + signal.SIGINT
        except G1StreamError as error:
            print(_error_text(error), file=sys.stderr)
            return 2
        output.flush()
        return code or int(output.failed)


def _error_text(error: G1StreamError) -> str:
    """Cause and remedy: wrapped on a terminal; elsewhere a line each, for scripts to search."""
    lines = [f"error: {error.cause}", f"       {error.remedy}"]
    if sys.stderr.isatty():
        wrapper = TextWrapper(
            shutil.get_terminal_size().columns,
            subsequent_indent=" " * 7,
            break_long_words=False,
            break_on_hyphens=False,
        )
        lines = [part for line in lines for part in wrapper.wrap(line)]
    return "\n".join(lines)


class _Output:
    """Standard output or error: what cannot be written is dropped, and the program goes on.

    Attributes:
        failed: whether something was dropped.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self.failed = False

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        if not self.failed:
            try:
                return self._stream.write(text)
            except OSError as error:
                self._fail(error)
        return len(text)

    def flush(self) -> None:
        if not self.failed:
            try:
                self._stream.flush()
            except OSError as error:
                self._fail(error)

    def _fail(self, error: OSError) -> None:
        self.failed = True
        # What is buffered must not fail again at exit.
        with suppress(OSError), Path(os.devnull).open("w") as nothing:
            os.dup2(nothing.fileno(), self._stream.fileno())
        if self is sys.stdout and not isinstance(error, BrokenPipeError):  # that is `| head`
            print(f"error: standard output cannot be written: {error.strerror}", file=sys.stderr)


@contextmanager
def _lenient_output() -> Iterator[_Output]:
    """Let no output fail, neither on a full disk nor on a terminal or pipe that is closed.

    Yields:
        Standard output.
    """
    # A closed descriptor would be given to the next file that is opened, and printed into.
    while (descriptor := os.open(os.devnull, os.O_RDWR)) <= 2:
        pass
    os.close(descriptor)
    before = sys.stdout, sys.stderr
    output, errors = (
        _Output(stream or os.fdopen(number, "w", closefd=False))
        for number, stream in enumerate(before, start=1)
    )
    sys.stdout, sys.stderr = cast("TextIO", output), cast("TextIO", errors)
    try:
        yield output
    finally:
        output.flush()
        errors.flush()
        sys.stdout, sys.stderr = before


def _run(arguments: Sequence[str]) -> int:
    if not arguments or arguments[0] in ("-h", "--help"):
        lines = [f"  {name:<8} {purpose}" for name, (_, _, purpose) in _COMMANDS.items()]
        print(_HELP.format(commands="\n".join(lines)), end="")
        return 0
    name, *rest = arguments
    if name == "--version":
        from g1stream._version import __version__

        print(f"g1stream {__version__}")
        return 0
    if name not in _COMMANDS:
        close = get_close_matches(name, _COMMANDS, 3) or list(_COMMANDS)
        raise ConfigError(f"There is no command {name}.", f"Choose from {', '.join(close)}.")
    from g1stream.cli.flags import parse_flags

    module, kind, purpose = _COMMANDS[name]
    command = getattr(import_module(f"g1stream.cli.{module}"), kind)
    code: int = parse_flags(command, name, purpose, rest).run()
    return code
