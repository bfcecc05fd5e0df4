"""A summary on standard output, and the exit code that follows from it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from g1stream.cli.command import EXIT_OK, EXIT_STOPPED, exit_code_of_signal, print_json

if TYPE_CHECKING:
    from g1stream.session.summary import Summary

__all__ = ["exit_code", "print_summary"]


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
