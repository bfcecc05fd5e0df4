"""Which motion files go into a session file, for whoever writes one."""

from pathlib import Path

import pytest

from g1stream.motion.motion import Motion
from g1stream.programs.convert import convert
from g1stream.session import attachments
from g1stream.session.attachments import attach_motion
from g1stream.session.mcap_reader import McapFile
from g1stream.session.motions import load_motion


class Writer:
    def __init__(self):
        self.attached = []

    def attach(self, *attachment):
        self.attached.append(attachment)


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("walk.csv", "text/csv"),
        ("WALK.CSV", "text/csv"),
        ("walk.npz", "application/octet-stream"),
    ],
)
def test_a_motion_file_is_attached_as_what_it_is(tmp_path, name, kind):
    (tmp_path / name).write_bytes(b"1,2")
    writer = Writer()
    attach_motion(writer, tmp_path / name, 7)
    assert writer.attached == [(name, kind, b"1,2", 7)]


def test_a_session_is_not(tmp_path):
    (tmp_path / "earlier.MCAP").write_bytes(b"1,2")
    writer = Writer()
    attach_motion(writer, tmp_path / "earlier.MCAP", 7)
    assert not writer.attached


def test_a_large_one_is_not(tmp_path, monkeypatch):
    monkeypatch.setattr(attachments, "LARGEST_MOTION", 2)
    (tmp_path / "walk.csv").write_bytes(b"1,2")
    writer = Writer()
    attach_motion(writer, tmp_path / "walk.csv", 7)
    assert not writer.attached


@pytest.mark.parametrize("source", [None, "gone.csv", "."])
def test_what_is_no_file_is_not(tmp_path, source):
    writer = Writer()
    attach_motion(writer, source and tmp_path / source, 7)
    assert not writer.attached


def test_a_motion_whose_file_is_gone_is_converted_all_the_same(tmp_path):
    path = tmp_path / "walk.csv"
    path.write_bytes(Path(load_motion("demo").source).read_bytes())
    motion: Motion = load_motion(path)
    path.unlink()
    convert(motion, tmp_path / "walk.mcap")
    attached = [one.name for one in McapFile(tmp_path / "walk.mcap").attachments()]
    assert attached == ["robot.urdf"]
