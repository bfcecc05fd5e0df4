"""A program of ours run as a child of another, and how the two speak.

The child prints one JSON object a line on its standard output; the parent writes such lines to the
child's standard input. When that input ends, the parent is done or gone, and the child finishes: so
no child outlives its parent, however the parent ended.
"""

from __future__ import annotations

import json
import os
import queue
import subprocess
import sys
import threading
import time
from contextlib import suppress
from typing import IO, TYPE_CHECKING, Any, Final

from g1stream.errors import ConfigError, G1StreamError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

__all__ = ["Child", "ChildError", "ParentLine"]

_PIECE: Final = 1 << 16
_NOT_FOR_PEOPLE: Final = "Leave out --attached; it is for programs that start this one."


class ChildError(G1StreamError):
    """A program started as a child did not do its part."""


class Child:
    """A g1stream command running as a child process.

    Args:
        command: the arguments after `g1stream`.
        greeting: the first line that the child is sent: what it is to do, its `config` above all.

    Attributes:
        name: the subcommand.
    """

    def __init__(self, command: Sequence[str], greeting: Mapping[str, Any]) -> None:
        self.name = command[0]
        # A session of its own: Ctrl-C in the terminal is for the parent, who ends the child.
        self._process = subprocess.Popen(
            [sys.executable, "-m", "g1stream", *command, "--attached"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            errors="replace",
            start_new_session=True,
        )
        self._lines: queue.Queue[dict[str, Any] | None] = queue.Queue()
        threading.Thread(target=self._read, daemon=True).start()
        self.send(greeting)

    def _read(self) -> None:
        try:
            for line in _lines(_pipe(self._process.stdout).fileno()):
                message = _object(line)
                if message is not None:  # else they are some library's own words
                    self._lines.put(message)
        finally:
            self._lines.put(None)

    @property
    def alive(self) -> bool:
        """Whether the process still runs."""
        return self._process.poll() is None

    def send(self, message: Mapping[str, Any]) -> None:
        """Write one line to the child; a child that is gone hears nothing."""
        pipe = _pipe(self._process.stdin)
        try:
            pipe.write(json.dumps(message) + "\n")
            pipe.flush()
        except (BrokenPipeError, ValueError):
            return

    def wait_for(self, event: str, timeout: float) -> dict[str, Any]:
        """The child's line whose `event` is this one; lines before it are passed over.

        Raises:
            ChildError: the child ended or said an error first, or the time ran out.
        """
        end = time.monotonic() + timeout
        while True:
            try:
                message = self._lines.get(timeout=max(0.0, end - time.monotonic()))
            except queue.Empty:
                raise ChildError(
                    f"g1stream {self.name} did not come to {event!r} within {timeout:g} s.",
                    f"Run g1stream {self.name} by itself to see what holds it up.",
                ) from None
            if message is None:
                raise ChildError(
                    f"g1stream {self.name} ended with exit code {self._process.wait()}.",
                    f"Run g1stream {self.name} by itself to see why.",
                )
            if message.get("event") == "error":
                raise ChildError(message["cause"], message["remedy"])
            if message.get("event") == event:
                return message

    def finish(self, timeout: float = 30.0) -> dict[str, Any]:
        """Tell the child to end, and return its last word (`event` "done").

        Raises:
            ChildError: it did not end well or in time; it is gone all the same.
        """
        try:
            with suppress(BrokenPipeError):  # it is gone: what it did not say tells why
                _pipe(self._process.stdin).close()
            done = self.wait_for("done", timeout)
            self._process.wait(timeout)
        except subprocess.TimeoutExpired as error:
            raise ChildError(
                f"g1stream {self.name} did not end in order: {error}.", "Look at what it printed."
            ) from error
        finally:
            self.kill()
        return done

    def kill(self) -> None:
        """End the process if it still runs: it is asked first, and then made to."""
        if not self.alive:
            return
        self._process.terminate()
        try:
            self._process.wait(5.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


class ParentLine:
    """The child's side: what the parent says, and whether it is still there.

    Attributes:
        gone: set when the parent is done or gone.
    """

    def __init__(self) -> None:
        self.gone = threading.Event()
        self._lines: queue.Queue[bytes] = queue.Queue()
        threading.Thread(target=self._read, name="parent", daemon=True).start()

    def _read(self) -> None:
        try:
            for line in _lines(sys.stdin.fileno()):
                self._lines.put(line)
        finally:
            self._lines.put(b"")
            self.gone.set()

    def received(self) -> list[dict[str, Any]]:
        """The lines that came since the last call; one cut off with its parent is left out."""
        messages = []
        while not self._lines.empty():
            messages.append(_object(self._lines.get()))
        return [message for message in messages if message is not None]

    def greeting(self, timeout: float = 10.0) -> dict[str, Any]:
        """The first line, which says what to do: an object in which `config` is one too.

        Raises:
            ConfigError: none comes in time, or it does not say that.
        """
        try:
            line = self._lines.get(timeout=timeout)
        except queue.Empty:
            line = b""
        if not line:
            raise ConfigError("Nothing was described on standard input.", _NOT_FOR_PEOPLE)
        greeting = _object(line)
        if greeting is None:
            raise ConfigError(
                "The first line on standard input is not a JSON object.", _NOT_FOR_PEOPLE
            )
        if not isinstance(greeting.get("config"), dict):
            raise ConfigError(
                "The first line on standard input has no object 'config'.", _NOT_FOR_PEOPLE
            )
        return greeting

    @staticmethod
    def say(event: str, **values: Any) -> None:
        """Print one line for the parent."""
        sys.stdout.write(json.dumps({"event": event, **values}) + "\n")
        sys.stdout.flush()


def _lines(descriptor: int) -> Iterator[bytes]:
    """The lines that come from a pipe; the last may lack its end.

    Read from the descriptor itself: an interpreter that ends while a thread waits inside a buffered
    file dies over the lock of that file.
    """
    rest = b""
    while data := os.read(descriptor, _PIECE):
        *whole, rest = (rest + data).split(b"\n")
        yield from (line + b"\n" for line in whole)
    if rest:
        yield rest


def _object(line: bytes) -> dict[str, Any] | None:
    """The JSON object in a line; None where it holds something else."""
    try:
        message = json.loads(line)
    except (ValueError, RecursionError):
        return None
    return message if isinstance(message, dict) else None


def _pipe(pipe: IO[str] | None) -> IO[str]:
    if pipe is None:
        raise RuntimeError("a child is always started with pipes")
    return pipe
