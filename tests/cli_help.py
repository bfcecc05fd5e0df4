"""What the help of every command has."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import subprocess


def check_help(command: str, done: subprocess.CompletedProcess[str]) -> None:
    """Check that it has examples and exit codes, and that no line passes 80 columns."""
    assert done.returncode == 0
    assert f"  g1stream {command}" in done.stdout.split("Examples:")[1]
    assert "Exit codes:\n  0  " in done.stdout
    assert max(map(len, done.stdout.splitlines())) <= 80
