import errno
import os
import subprocess
import sys
import tempfile
from itertools import takewhile
from pathlib import Path

import pytest

from g1stream.errors import RecordingError
from g1stream.files import (
    check_output_path,
    complete_directory,
    complete_file,
    is_session,
    read_file,
)


@pytest.mark.parametrize(
    ("content", "answer"),
    [(b"\x89MCAP0\r\n", True), (b"\x89MCAP1\r\n", True), (b"", False), (b"Frame,X", False)],
)
def test_a_session_file_is_known_by_its_first_bytes(tmp_path, content, answer):
    (tmp_path / "f").write_bytes(content)
    assert is_session(tmp_path / "f") is answer


def test_a_session_directory_is_known_by_its_metadata(tmp_path):
    assert not is_session(tmp_path)
    assert not is_session(tmp_path / "nowhere")
    (tmp_path / "metadata.yaml").touch()
    assert is_session(tmp_path)


def test_nothing_is_read_from_a_pipe(tmp_path):
    os.mkfifo(tmp_path / "pipe")  # opened, one without a writer would block
    assert not is_session(tmp_path / "pipe")


def write(path, **options):
    with complete_file(path, **options) as temporary:
        temporary.write_bytes(b"new")
        assert temporary.parent == path.parent
        assert not path.exists() or path.read_bytes() == b"old"


def test_a_file_gets_its_name_when_it_is_complete(tmp_path):
    write(tmp_path / "f")
    assert (tmp_path / "f").read_bytes() == b"new"
    assert list(tmp_path.iterdir()) == [tmp_path / "f"]


@pytest.mark.parametrize("old", [None, b"old"])
@pytest.mark.parametrize("error", [KeyboardInterrupt, ZeroDivisionError, OSError])
def test_a_failure_leaves_what_was_there(tmp_path, old, error):
    path = tmp_path / "f"
    if old:
        path.write_bytes(old)
    with pytest.raises(RecordingError if error is OSError else error), complete_file(path):
        raise error
    assert [p.read_bytes() for p in tmp_path.iterdir()] == ([old] if old else [])


@pytest.mark.parametrize("target", ["f", "nowhere", "directory"])
@pytest.mark.parametrize("force", [False, True])
def test_no_file_is_written_through_a_link(tmp_path, target, force):
    (tmp_path / "f").write_bytes(b"old")
    (tmp_path / "directory").mkdir()
    (tmp_path / "link").symlink_to(target)
    with pytest.raises(RecordingError) as error:
        write(tmp_path / "link", force=force)
    assert str(tmp_path / "link") in error.value.cause
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "f").read_bytes() == b"old"
    assert not (tmp_path / "nowhere").exists()


def test_a_link_in_the_place_of_the_temporary_file_is_not_followed(tmp_path):
    (tmp_path / "f").write_bytes(b"old")
    (tmp_path / f".new.{os.getpid()}.part").symlink_to("f")
    write(tmp_path / "new")
    assert (tmp_path / "f").read_bytes() == b"old"


def test_a_file_is_read_up_to_a_size(tmp_path):
    (tmp_path / "f").write_bytes(bytes(100))
    assert read_file(tmp_path / "f", 100) == bytes(100)
    with pytest.raises(OSError, match="MiB") as error:
        read_file(tmp_path / "f", 99)
    assert error.value.errno == errno.EFBIG


@pytest.mark.parametrize("name", ["pipe", "/dev/zero", "null\0"])
def test_only_regular_files_are_read(tmp_path, name):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OSError, match=r"regular|null") as error:
        read_file(tmp_path / name)
    assert error.value.errno == errno.EINVAL


def test_a_file_is_replaced_only_when_forced(tmp_path):
    (tmp_path / "f").write_bytes(b"old")
    with pytest.raises(RecordingError) as error:
        write(tmp_path / "f", force=False)
    assert str(tmp_path / "f") in error.value.cause
    assert "--force" in error.value.remedy
    write(tmp_path / "f")
    assert (tmp_path / "f").read_bytes() == b"new"


def test_a_file_that_appears_in_the_meantime_is_not_replaced(tmp_path):
    def slowly():
        with complete_file(tmp_path / "f", force=False) as temporary:
            temporary.write_bytes(b"new")
            (tmp_path / "f").write_bytes(b"old")

    with pytest.raises(RecordingError):
        slowly()
    assert [p.read_bytes() for p in tmp_path.iterdir()] == [b"old"]


@pytest.mark.parametrize("name", ["nowhere/f", ".", "pipe", "file/f"])
def test_paths_where_no_file_can_be(tmp_path, name):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "file").touch()
    with pytest.raises(RecordingError) as error:
        check_output_path(tmp_path / name, force=True)
    assert str((tmp_path / name).parent if "/" in name else tmp_path / name) in error.value.cause


AS_NOBODY = """
import os, sys
from pathlib import Path
from g1stream.errors import RecordingError
from g1stream.files import check_output_path
from g1stream.session.source import SessionFiles
from g1stream.session.writer import SessionWriter
os.getuid() or os.setuid(65534)
path = Path(sys.argv[1])
for statement in sys.argv[2:]:
    try:
        print(eval(statement))
    except RecordingError as error:
        print(error)
"""


@pytest.fixture
def locked(tmp_path):
    """Runs statements as another user in a directory of some mode with a recording `s` in it."""
    directory = tmp_path / "locked"
    (directory / "s").mkdir(parents=True)
    (directory / "s" / "metadata.yaml").touch()
    (directory / "s.mcap").touch()
    temporary = Path(tempfile.gettempdir())
    for parent in takewhile(lambda path: path != temporary, (tmp_path, *tmp_path.parents)):
        parent.chmod(0o755)

    def run(mode, *statements):
        directory.chmod(mode)
        command = [sys.executable, "-c", AS_NOBODY, str(directory / "s.mcap"), *statements]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        return done.stdout.lower().splitlines()

    yield run
    directory.chmod(0o755)


@pytest.mark.parametrize("mode", [0o555, 0o444, 0o000])
def test_a_directory_that_may_not_be_written(locked, mode):
    refused = locked(
        mode,
        "check_output_path(path, force=True)",
        "check_output_path(path.with_name('new'), force=True)",
        "SessionWriter(path, force=True)",
        "SessionWriter(path.with_name('new'))",
    )
    assert ["permission" in line for line in refused] == [True] * 4


def test_a_directory_that_may_not_be_read(locked):
    refused = locked(0o000, "SessionFiles(path)", "SessionFiles(path.with_name('s'))")
    assert ["permission denied" in line for line in refused] == [True] * 2


def write_directory(path, text, *, force=False):
    """A text, or an error that ends it half way."""
    with complete_directory(path, ("a", "b"), force=force) as temporary:
        (temporary / "a").write_text(str(text))
        assert not path.exists() or force
        if not isinstance(text, str):
            raise text


def test_a_directory_gets_its_name_when_it_is_complete(tmp_path):
    path = tmp_path / "d"
    write_directory(path, "first")
    write_directory(path, "second", force=True)
    assert [one.name for one in tmp_path.iterdir()] == ["d"]
    assert [(one.name, one.read_text()) for one in path.iterdir()] == [("a", "second")]


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError])
def test_a_failure_leaves_the_directory_that_was_there(tmp_path, error):
    path = tmp_path / "d"
    write_directory(path, "first")
    with pytest.raises(RecordingError if error is OSError else error):
        write_directory(path, error, force=True)
    assert [one.name for one in tmp_path.iterdir()] == ["d"]
    assert (path / "a").read_text() == "first"


@pytest.mark.parametrize("kind", ["taken", "a file", "a link", "others", "no parent"])
def test_directories_that_are_not_replaced(tmp_path, kind):
    path = tmp_path / "d"
    if kind == "a file":
        path.write_text("mine")
    elif kind == "a link":
        (tmp_path / "elsewhere").mkdir()
        path.symlink_to(tmp_path / "elsewhere")
    elif kind == "no parent":
        path = tmp_path / "gone" / "d"
    else:
        path.mkdir()
        (path / ("mine" if kind == "others" else "a")).write_text("mine")
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(RecordingError):
        write_directory(path, "new", force=kind != "taken")
    assert sorted(tmp_path.rglob("*")) == before
