"""A file system that fills up, the real thing: a small tmpfs."""

from __future__ import annotations

import subprocess
from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import pytest

from g1stream.errors import RecordingError
from g1stream.session.writer import SessionWriter
from written_sessions import stock_reader

MS = 1_000_000
SIZE = 3 * 2**20


@pytest.fixture
def small_disk(tmp_path):
    """A directory that holds 3 MiB."""
    place = tmp_path / "disk"
    place.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={SIZE}", "none", str(place)]
    done = subprocess.run(mount, capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip(f"no small file system can be mounted here: {done.stderr.strip()}")
    yield place
    subprocess.run(["umount", str(place)], check=True)


def fill(writer, seconds):
    """500 messages a second of 2 kB that do not compress."""
    noise = np.random.default_rng(3).integers(0, 256, (20, 25, 2096), dtype=np.uint8)
    for batch in range(20 * seconds):
        times = (batch * 50 + 2 * np.arange(25)) * MS
        writer.write_batch("/lowstate", noise[batch % 20], times, times)


def stamps(path, topic="/lowstate"):
    found = stock_reader(path, validate_crcs=True).iter_messages(topics=[topic])
    return [message.log_time for _, _, message in found]


@contextmanager
def filled(path):
    """A writer whose disk has just filled up."""
    with SessionWriter(path) as writer:
        with pytest.raises(RecordingError, match="No space left on device"):
            fill(writer, 10)
        yield writer


def test_a_full_disk_leaves_a_whole_file_with_its_index_and_last_words(small_disk):
    with filled(small_disk / "s.mcap") as writer:
        taken = writer.counts["/lowstate"]
        writer.write("/log", b"the disk is full", 10**12, 10**12)
        writer.add_metadata({"recorder": {"stopped": "the disk is full"}})
    assert stamps(small_disk / "s.mcap") == [2 * MS * i for i in range(taken)]
    assert taken * 2096 > SIZE / 3
    assert stamps(small_disk / "s.mcap", "/log") == [10**12]
    reader = stock_reader(small_disk / "s.mcap")
    assert [m.name for m in reader.iter_metadata()] == ["g1stream"]
    assert reader.get_summary().statistics.message_count == taken + 1


@pytest.mark.parametrize("size", range(SIZE, SIZE + 2**17, 2**15 + 77))
def test_a_chunk_is_begun_only_if_the_end_of_the_file_fits_behind_it(tmp_path, monkeypatch, size):
    """A disk of which all is known; a file that grew beyond it would have failed."""
    path = tmp_path / "s.mcap"
    kib = 2**10

    def statvfs(_):
        free = max(0, size - path.stat().st_size) // kib
        return SimpleNamespace(f_blocks=size // kib, f_bavail=free, f_frsize=kib)

    monkeypatch.setattr("g1stream.session.mcap_writer.os.statvfs", statvfs)
    with filled(path) as writer:
        noise = np.random.default_rng(4).integers(0, 256, 2**17, dtype=np.uint8).tobytes()
        writer.write("/log", noise, 10**12, 10**12)
        writer.flush(last=True)
        with pytest.raises(RecordingError, match="No space left"):  # noqa: PT012
            for _ in range(100):
                writer.add_metadata({"words": "more " * 2000})
    assert path.stat().st_size <= size
    assert stamps(path, "/log") == [10**12]
    assert stock_reader(path).get_summary().metadata_indexes
