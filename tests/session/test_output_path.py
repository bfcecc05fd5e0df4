"""Where a recording may be put; in a directory that is locked, by somebody whom locks stop."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from itertools import takewhile
from pathlib import Path

import pytest

from g1stream.errors import RecordingError
from g1stream.session.output_path import check_free, create

AS_NOBODY = """
import os, sys
from pathlib import Path
from g1stream.errors import RecordingError
from g1stream.programs.recorder_child import refuse_path
from g1stream.session.earlier_parts import earlier_files
from g1stream.session.offline import OfflineWriter
from g1stream.session.output_path import create
from g1stream.session.session import open_session
os.getuid() or os.setuid(65534)
path = Path(sys.argv[1])
try:
    {}
except RecordingError as error:
    print(error)
"""


@pytest.fixture
def said_of(tmp_path):
    """What is said of doing something in a directory that has a mode, in which s_001.mcap is."""
    locked = tmp_path / "locked"
    locked.mkdir()
    (locked / "s_001.mcap").touch()
    temporary = Path(tempfile.gettempdir())
    for parent in takewhile(lambda path: path != temporary, (tmp_path, *tmp_path.parents)):
        parent.chmod(0o755)

    def said(mode, what, name):
        locked.chmod(mode)
        command = [sys.executable, "-c", AS_NOBODY.format(what), str(locked / name)]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout

    yield said
    locked.chmod(0o755)


@pytest.mark.parametrize("what", ["create(path, force=False)", "create(path, force=True)"])
@pytest.mark.parametrize("mode", [0o555, 0o444, 0o000])
def test_a_directory_that_may_not_be_written_is_said(said_of, mode, what):
    assert "cannot be made: Permission denied. Choose" in said_of(mode, what, "s.mcap")


@pytest.mark.parametrize("mode", [0o444, 0o000])
def test_a_directory_in_which_nothing_can_be_looked_at_is_said(said_of, mode):
    said = said_of(mode, "OfflineWriter(path)", "s.mcap")
    assert "cannot be made: Permission denied. Choose another place" in said


@pytest.mark.parametrize("name", ["s.mcap", "s_001.mcap"])
@pytest.mark.parametrize("mode", [0o311, 0o000])
def test_a_directory_that_may_not_be_listed_is_said_of_a_session(said_of, mode, name):
    said = said_of(mode, "open_session(path)", name)
    assert said.startswith("The directory ")
    assert "cannot be read: Permission denied. Parts of the session are looked for" in said


@pytest.mark.parametrize("force", [False, True])
@pytest.mark.parametrize("mode", [0o311, 0o000])
def test_a_directory_that_may_not_be_listed_takes_no_parts(said_of, mode, force):
    said = said_of(mode, f"earlier_files(path, force={force})", "s.mcap")
    assert "cannot be read: Permission denied. Parts of the session are looked for" in said


@pytest.mark.parametrize("allowed", [create, check_free])
def test_what_is_there_is_refused_with_the_way_out(tmp_path, allowed):
    path = tmp_path / "s.mcap"
    path.write_bytes(b"precious")
    with pytest.raises(RecordingError, match=r"s\.mcap exists already\. Choose .*--force"):
        allowed(path, force=False)
    with pytest.raises(RecordingError, match="is a directory"):
        allowed(tmp_path, force=True)
    with pytest.raises(RecordingError, match=r"does not exist\. Make it: mkdir -p"):
        allowed(tmp_path / "nowhere" / "s.mcap", force=True)
    with pytest.raises(RecordingError, match="cannot be made: Not a directory"):
        allowed(path / "s.mcap", force=True)
    assert path.read_bytes() == b"precious"
