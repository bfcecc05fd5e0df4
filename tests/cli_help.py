"""What the help of every command has."""

import pytest

from g1stream.cli.main import main


def check_help(command, monkeypatch, capsys):
    """Check that both have examples and exit codes, and that no line passes 80 columns."""
    monkeypatch.setenv("COLUMNS", "80")
    for flag in ("--help", "--help-all"):
        with pytest.raises(SystemExit) as ended:
            main([command, flag])
        shown = capsys.readouterr().out
        assert not ended.value.code
        assert f"  g1stream {command}" in shown.split("Examples:")[1]
        assert "Exit codes:\n  0  " in shown
        assert max(map(len, shown.splitlines())) <= 80
