import os
import tempfile
import threading
from functools import partial
from hashlib import sha256
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from zipfile import ZipFile

import pytest

from g1stream.errors import ConfigError, MotionError, RecordingError
from g1stream.extras.library.files import content_hash, find_motions, local_copy

NAMES = ["broken.csv", "first.npz", "second.csv", "below/copy.npz", "below/third.npz"]


def test_motions_below_a_directory_and_a_named_file_whatever_its_name(motions, checked):
    found = find_motions([str(motions), str(motions / "first.npz")])
    assert [path.removeprefix(f"{motions}/") for path in found] == NAMES
    assert find_motions([str(motions / "notes.txt")]) == [str(motions / "notes.txt")]
    assert find_motions([str(checked[1])]) == []  # a library


def test_urls_are_those_of_fsspec(motions):
    pytest.importorskip("fsspec")
    found = find_motions([f"file://{motions}"])
    assert {url.removeprefix(f"file://{motions}/") for url in found} == {*NAMES}
    (url,) = find_motions([f"file://{motions}/first.npz"])
    with local_copy(url) as path:
        assert path.name == "first.npz"
        assert path.read_bytes() == (motions / "first.npz").read_bytes()
        assert path.parent != motions
    assert not path.exists()
    assert content_hash(url) == sha256((motions / "first.npz").read_bytes()).hexdigest()


def test_hidden_directories_and_libraries_below_a_url_are_left_out(tmp_path):
    pytest.importorskip("fsspec")
    root = tmp_path / ".root"
    names = [
        ".cache/x.npz",
        "lib/.g1stream-library",
        "lib/converted/y.npz",
        "library.npz",
        "b/z.csv",
    ]
    for name in names:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).touch()
    found = find_motions([f"file://{root}"])
    assert found == [f"file://{root}/b/z.csv", f"file://{root}/library.npz"]


@pytest.fixture
def served(motions):
    """The URL of the motions on a web server of Python's on loopback."""
    pytest.importorskip("aiohttp")
    handler = partial(SimpleHTTPRequestHandler, directory=motions)
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


def test_motions_on_a_web_server(motions, served):
    assert set(find_motions([f"{served}/"])) == {f"{served}/{name}" for name in NAMES}
    with local_copy(f"{served}/first.npz") as path:
        assert path.read_bytes() == (motions / "first.npz").read_bytes()
    (motions / "below" / ".g1stream-library").touch()
    assert find_motions([f"{served}/below/"]) == []
    (motions / "below" / ".g1stream-library").unlink()
    with pytest.raises(ConfigError):
        find_motions([f"{served}/gone.npz"])
    with pytest.raises(MotionError):
        content_hash(f"{served}/gone.npz")


def test_motions_in_a_zip_file_and_in_memory(motions, tmp_path):
    fsspec = pytest.importorskip("fsspec")
    with ZipFile(tmp_path / "all.zip", "w") as archive:
        archive.write(motions / "first.npz", "in/first.npz")
    (url,) = find_motions([f"zip://in::file://{tmp_path}/all.zip"])
    content = (motions / "first.npz").read_bytes()
    assert content_hash(url) == sha256(content).hexdigest()
    with local_copy(url) as path:
        assert (path.name, path.read_bytes()) == ("first.npz", content)
    fsspec.filesystem("memory").pipe("/motions/first.npz", content)
    (url,) = find_motions(["memory://motions"])
    assert content_hash(url) == sha256(content).hexdigest()


def test_a_copy_that_cannot_be_written_is_no_fault_of_the_url(motions, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", "/dev/full")
    with pytest.raises(RecordingError), local_copy(f"file://{motions}/first.npz"):
        pass


def test_what_is_no_file_is_not_opened(tmp_path):
    os.mkfifo(tmp_path / "pipe.csv")
    (tmp_path / "gone.csv").symlink_to(tmp_path / "nowhere")
    assert find_motions([str(tmp_path)]) == []
    for name in ("pipe.csv", "gone.csv"):
        with pytest.raises(MotionError):
            content_hash(str(tmp_path / name))


def test_a_recording_in_parts_is_one_motion(tmp_path):
    bag = tmp_path / "bag"
    bag.mkdir()
    for name in ("metadata.yaml", "bag_0.mcap", "bag_1.mcap"):
        (bag / name).write_text(name)
    assert find_motions([str(tmp_path)]) == [str(bag)]
    assert content_hash(str(bag)) == sha256(b"bag_0.mcapbag_1.mcapmetadata.yaml").hexdigest()


@pytest.mark.parametrize("place", ["nowhere", "file:///nowhere/at/all.csv", "nosuch://x"])
def test_places_that_do_not_exist(place):
    with pytest.raises(ConfigError):
        find_motions([place])
