"""The file under a recording: whole pieces or none."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from itertools import takewhile
from pathlib import Path

import pytest

from g1stream.recording.places import create


def test_a_piece_that_fails_is_taken_back(tmp_path):
    output = create(tmp_path / "x", force=False)
    output.write(b"whole")
    output.settle()
    output.write(b"half")
    output.take_back()
    output.write(b"!")
    output.close()
    assert (tmp_path / "x").read_bytes() == b"whole!"


@pytest.mark.parametrize("mode", [0o555, 0o444])
def test_a_directory_that_may_not_be_written_is_said(tmp_path, mode):
    locked = tmp_path / "locked"
    locked.mkdir(mode=mode)
    code = (
        "import os, sys\n"
        "from pathlib import Path\n"
        "from g1stream.recording.places import create\n"
        "os.getuid() or os.setuid(65534)\n"
        "create(Path(sys.argv[1]), force=False)\n"
    )
    temporary = Path(tempfile.gettempdir())
    for parent in takewhile(lambda path: path != temporary, (tmp_path, *tmp_path.parents)):
        parent.chmod(0o755)
    command = [sys.executable, "-c", code, str(locked / "s.mcap")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert "cannot be made: Permission denied" in done.stderr
