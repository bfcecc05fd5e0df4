"""`g1stream`: the list of commands, the choice of one, and errors as exit codes."""

from __future__ import annotations

import os
import signal
import sys
from difflib import get_close_matches
from importlib import import_module
from typing import TYPE_CHECKING, Final

from g1stream.errors import ConfigError, G1StreamError

if TYPE_CHECKING:
    from collections.abc import Sequence

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
    "convert": ("convert", "Convert", "Convert a motion file into an MCAP for Foxglove or Rerun."),
    "info": ("info", "Info", "Print what is in a session file, and how well it went."),
    "motion": ("motion", "Inspect", "Check a motion file: frames, joints, limits."),
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
    try:
        code = _run(arguments)
        sys.stdout.flush()
    except KeyboardInterrupt:
        return 128 + signal.SIGINT
    except G1StreamError as error:
        print(f"error: {error.cause}\n       {error.remedy}", file=sys.stderr)
        return 2
    except BrokenPipeError:
        # The reader of our output is gone; what is buffered must not fail again at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    return code


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
