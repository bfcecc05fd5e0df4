"""`g1stream`: lists and runs the commands, and maps errors to exit codes."""

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
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TextIO, cast

from g1stream.errors import ConfigError, G1StreamError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from g1stream.cli.command import Command


class _Row(NamedTuple):
    """A command.

    Attributes:
        purpose: one sentence for the list of commands.
        extra: the extra that has it; empty for a command of the core.
    """

    purpose: str
    extra: str = ""


COMMANDS: Final = {
    "demo": _Row("Simulate a G1 on this machine, play a motion, record and compare."),
    "stream": _Row("Play a motion on the robot or simulator on DDS."),
    "sim": _Row("Simulate a G1 on DDS: a MuJoCo bridge on the robot's topics."),
    "record": _Row("Record the DDS topics into a session file (MCAP)."),
    "convert": _Row("Convert a motion into MCAP, CSV or NPZ, a session into a ROS 2 bag."),
    "library": _Row("Check many motions, or simulate rollouts of them.", "library"),
    "info": _Row("Print a session's contents and its tracking error."),
    "attach": _Row("Find where in a recording of another program a motion was played.", "attach"),
    "report": _Row("Write an HTML page about sessions: tables, figures, events.", "report"),
    "plot": _Row("Plot joints of a session: PNG, SVG or PDF."),
    "compare": _Row("Compare sessions of the same motion: improvements and regressions.", "report"),
    "simulate": _Row("Simulate a session's commands, and compare with the measured robot.", "fit"),
    "fit": _Row("Identify friction, armature, delay and masses from sessions.", "fit"),
    "render": _Row("Make a video of a session: the robot, and its reference as a ghost.", "video"),
    "layout": _Row("Write a viewer layout for sessions.", "layout"),
    "motion": _Row("Check a motion file: frames, joints, limits."),
    "policy": _Row("Show the inputs and outputs of a learned policy.", "policy"),
    "physics": _Row("Compute the torques and forces that a motion needs.", "physics"),
    "robot": _Row("Show, release or restore the robot's own controller.", "onboard"),
    "doctor": _Row("Diagnose the DDS connection to the robot and this machine's timing."),
}
"""The commands. To add one, add a row."""

#: Bad input: a file, a flag, a setting or the wire.
EXIT_BAD_INPUT: Final = 2

_HELP: Final = """\
usage: g1stream [-h] [--version] COMMAND ...

Play a reference motion on a Unitree G1 over DDS and measure the tracking error.

commands:
{commands}

options:
  -h, --help  show this help message and exit
  --version   show the version and exit

`g1stream COMMAND --help` shows the flags of a command, examples and exit codes.

exit codes:
  0        success
  1        stopped, or a check failed
  2        bad input, nothing was done
  128 + n  ended by signal n, such as 130 after Ctrl-C
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command."""
    # The matrices are small; starting a pool of BLAS threads would only cost 50 ms of CPU.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Otherwise `import mujoco` loads GLFW, for which it runs two interpreters.
    os.environ.setdefault("MUJOCO_GL", "disabled")
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    for stream in (sys.stdout, sys.stderr):  # escape characters outside the terminal's encoding
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    output, errors = _Output(sys.stdout), _Output(sys.stderr)
    sys.stdout, sys.stderr = cast("TextIO", output), cast("TextIO", errors)
    try:
        code = _run(arguments)
    except KeyboardInterrupt:
        return 128 + signal.SIGINT
    except G1StreamError as error:
        print(_error_text(error), file=sys.stderr)
        return EXIT_BAD_INPUT
    except Exception as error:
        if not (fault := _fault_of_cyclonedds() or _fault_of_memory(error)):
            raise
        print(_error_text(fault), file=sys.stderr)
        return EXIT_BAD_INPUT
    finally:
        output.flush()
        errors.flush()
        sys.stdout, sys.stderr = output.stream, errors.stream
    return code or int(output.failed)


class _Output:
    """Standard output or standard error. The program goes on if it is closed, as a terminal can be.

    Attributes:
        stream: the wrapped stream.
        failed: whether a write failed for another reason than a reader that stopped reading.
    """

    def __init__(self, stream: TextIO | None) -> None:
        # Without a descriptor, the next file that is opened would get it, and the output, too.
        self.stream = stream or Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115
        self.failed = self._closed = False

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)

    def write(self, text: str) -> int:
        if not self._closed:
            with self._lenient():
                return self.stream.write(text)
        return len(text)

    def flush(self) -> None:
        if not self._closed:
            with self._lenient():
                self.stream.flush()

    @contextmanager
    def _lenient(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self._closed, self.failed = True, not isinstance(error, BrokenPipeError)
            if self.failed and sys.stderr is not self:
                print(f"error: the output cannot be written: {error.strerror}", file=sys.stderr)
            # Buffered text must not fail again at exit.
            with suppress(OSError), Path(os.devnull).open("w") as nothing:
                os.dup2(nothing.fileno(), self.stream.fileno())


def _fault_of_cyclonedds() -> G1StreamError | None:
    """The reason why DDS cannot be used; None if cyclonedds can be imported."""
    try:
        import_module("cyclonedds.core")
    except Exception as error:  # cyclonedds raises its own if its C library is missing
        return ConfigError(
            f"cyclonedds, which DDS needs, cannot be imported: {error}.",
            "Install it: pip install 'cyclonedds>=0.10.2,<12'. If it is installed, "
            "LD_LIBRARY_PATH or CYCLONEDDS_HOME, which ROS 2 sets, may select another library.",
        )
    return None


def _fault_of_memory(error: Exception) -> G1StreamError | None:
    """The error for a library or an array without memory; None if memory is not the cause."""
    cannot_load = isinstance(error, ImportError) and not isinstance(error, ModuleNotFoundError)
    if not (cannot_load or isinstance(error, MemoryError)):
        return None
    return ConfigError(
        f"A library cannot be loaded: {error}." if cannot_load else "There is too little memory.",
        "Check this process's memory limit with `ulimit -v`. If it is unlimited, "
        "install g1stream into a virtual environment of its own.",
    )


def _error_text(error: G1StreamError) -> str:
    """Cause and remedy: wrapped on a terminal, otherwise a line each so that scripts can search."""
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


def _run(arguments: Sequence[str]) -> int:
    if not arguments or arguments[0] in ("-h", "--help"):
        lines = [f"  {name:<10} {row.purpose}" for name, row in COMMANDS.items()]
        print(_HELP.format(commands="\n".join(lines)), end="")
        return 0
    name, *rest = arguments
    if name == "--version":
        from g1stream._version import __version__

        print(f"g1stream {__version__}")
        return 0
    if name not in COMMANDS:
        about = (
            other for other, row in COMMANDS.items() if f" {name}" in f" {row.purpose.lower()}"
        )
        close = dict.fromkeys([*get_close_matches(name, COMMANDS, 3, 0.7), *about]) or COMMANDS
        raise ConfigError(f"There is no command {name}.", f"Choose from {', '.join(close)}.")
    from g1stream.cli.command import quietly
    from g1stream.cli.flags import parse_flags

    command = parse_flags(load_command(name), name, COMMANDS[name].purpose, rest)
    with quietly(command):
        return command.run()


def load_command(name: str) -> type[Command]:
    """The class of a command: `Record` of cli/record.py, `Compare` of extras/report/compare_cli.py.

    Raises:
        ConfigError: the command's extra is not installed.
    """
    from g1stream.optional import load_object

    extra = COMMANDS[name].extra
    module = f"extras.{extra}.{name}_cli" if extra else f"cli.{name}"
    where = f"g1stream.{module}:{name.capitalize()}"
    command: type[Command] = load_object(where, f"g1stream {name} needs")
    return command
