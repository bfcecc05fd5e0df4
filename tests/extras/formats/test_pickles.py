import enum
import gzip
import os
import pickle
import struct
import tracemalloc
import zipfile
import zlib
from collections import Counter, OrderedDict
from pathlib import Path

import joblib
import numpy as np
import pytest

import g1stream
from g1stream.errors import MotionError
from g1stream.extras.formats.arrays import read_arrays
from known_arrays import (
    assert_motion,
    gmr,
    opened,
)

DATA = Path(__file__).parents[2] / "data"


@pytest.mark.parametrize(("protocol", "xyzw"), [(2, True), (4, False), (5, True)])
def test_gmr_pickle(pkl, motion, protocol, xyzw):
    """The quaternion order is told by how the pelvis stands."""
    path = pkl(pickle.dumps(gmr(motion, xyzw=xyzw), protocol=protocol))
    assert_motion(g1stream.load_motion(path), motion)


@pytest.mark.parametrize("compress", [zlib.compress, gzip.compress])
def test_compressed_pickle_of_one_named_motion(pkl, motion, compress):
    arrays = gmr(motion)
    arrays["dof"] = arrays.pop("dof_pos").tolist()
    path = pkl(compress(pickle.dumps({"dance": arrays})))
    assert_motion(g1stream.load_motion(path), motion)


@pytest.mark.parametrize("compress", [0, 3])
def test_joblib(tmp_path, motion, compress):
    path = tmp_path / "motion.pkl"
    joblib.dump({"dance": gmr(motion)}, path, compress=compress)
    assert_motion(g1stream.load_motion(path), motion)


class Command:
    """Runs a command where it is unpickled."""

    def __init__(self, mark):
        self.mark = mark

    def __reduce__(self):
        return os.system, (f"touch {self.mark}",)


class Mode(enum.Enum):
    FAST = "fast"


def test_a_pickle_runs_nothing_and_other_objects_are_left_out(pkl, tmp_path, motion):
    mark = tmp_path / "mark"
    more = {"mode": Mode.FAST, "command": Command(mark), "counts": Counter("aab"), "set": {1}}
    path = pkl(pickle.dumps(gmr(motion) | more))
    assert_motion(g1stream.load_motion(path), motion)
    assert set(more) <= set(opened(path).evidence.not_used)
    pkl(pickle.dumps({"dof": Command(mark)}))
    with pytest.raises(MotionError, match="system"):
        g1stream.load_motion(path)
    assert not mark.exists()


def test_lists_that_share_lists_are_not_unfolded(pkl, monkeypatch):
    value = [0.0] * 100
    for _ in range(8):
        value = [value] * 100
    monkeypatch.setattr("g1stream.extras.formats.pickles.UNPACKED", 2**20)
    with pytest.raises(MotionError, match="1 MiB"):
        opened(pkl(pickle.dumps({"dof": value})))


def many_encodings():
    """A small pickle that asks for the same large text to be encoded again and again."""
    text = b"X" + struct.pack("<I", 1_000_000) + b"a" * 1_000_000
    start = b"\x80\x02c_codecs\nencode\nq\0" + text + b"q\1X\6\0\0\0latin1q\2"
    return start + b"](" + b"h\0h\1h\2\x86R" * 2_000 + b"e."


class Call:
    """Pickled as a call of a function, which may have state after it."""

    def __init__(self, *call):
        self.call = call

    def __reduce__(self):
        return self.call


def many_copies(kind):
    """A small pickle that asks for the same large value to be copied again and again."""
    if kind == "dict":
        call = OrderedDict, (dict.fromkeys(range(20_000)),)
    elif kind == "text":
        scalar, _ = np.float64(0.0).__reduce__()
        call = scalar, (np.dtype("<U99999"), "".ljust(99_999).encode("utf-32-le"))
    else:
        array, arguments, _ = np.zeros(1).__reduce__()
        call = array, arguments, (1, (1000,), np.dtype("O"), False, [" " * 1000] * 1000)
    return pickle.dumps([Call(*call) for _ in range(12_000)])


@pytest.mark.parametrize(
    "content",
    [
        b"\x80\x05\x96" + struct.pack("<Q", 2**40),  # a bytearray of a terabyte
        b"\x80\x04\x8e" + struct.pack("<Q", 2**60) + b"abc",
        b"\x80\x04cos\nsystem\n.",
        b"\x80\x02(S'x'\nios\nsystem\n.",
        many_encodings(),
        *map(many_copies, ("dict", "text", "texts")),
    ],
    ids=["bytearray", "bytes", "global", "instance", "encodings", "dict", "text", "texts"],
)
def test_hostile_pickles(pkl, content):
    path = pkl(content)
    tracemalloc.start()
    try:
        with pytest.raises(MotionError):
            opened(path)
        assert tracemalloc.get_traced_memory()[1] < 2**30
    finally:
        tracemalloc.stop()


def test_a_file_of_pytorch(motion):
    """Written by PyTorch 2.13, with the arrays of ProtoMotions: frames 60 to 63 of the demo."""
    file = opened(DATA / "protomotions.pt")
    assert file.evidence.used["joint order"].startswith("motor")
    found = file.motion()
    assert found.fps == 50.0
    np.testing.assert_array_equal(found.joint_pos, motion.joint_pos[60:64].astype(np.float32))
    half = 0.3 * np.arange(4) / 50.0
    expected = np.stack([np.cos(half), 0 * half, 0 * half, np.sin(half)], axis=1)
    np.testing.assert_allclose(found.root_quat_wxyz, expected, rtol=0, atol=1e-6)
    _, tensors = read_arrays((DATA / "protomotions.pt").read_bytes())
    np.testing.assert_array_equal(tensors["transposed"], np.arange(6.0).reshape(2, 3).T)
    assert tensors["contacts"].dtype == np.bool_
    assert tensors["fps_tensor"] == 50.0


def tensor_file(path, offset, shape, strides, numbers=bytes(16)):
    """A tensor as PyTorch pickles it, in a storage of four numbers."""
    shape, strides = (b"(%bt" % b"".join(b"I%d\n" % n for n in one) for one in (shape, strides))
    storage = b"(Vstorage\nctorch\nFloatStorage\nV0\nVcpu\nI4\ntQ"
    arguments = b"(%bI%d\n%b%bI00\n}t" % (storage, offset, shape, strides)
    pickled = b"}Vq\nctorch._utils\n_rebuild_tensor_v2\n%bRs." % arguments
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("a/data.pkl", pickled)
        archive.writestr("a/data/0", numbers)
    return path


def test_tensors_are_within_their_storage(tmp_path):
    path = tensor_file(tmp_path / "a.pt", 0, (2, 2), (2, 1))
    assert read_arrays(path.read_bytes())[1]["q"].shape == (2, 2)
    for arguments in (
        (1, (2, 2), (2, 1)),
        (0, (3, 2), (2, 1)),
        (-1, (2, 2), (2, 1)),
        (0, (2, 2), (-2, 1)),
        (0, (10**9, 2), (0, 0)),
        (0, (-2, 2), (2, 1)),
    ):
        with pytest.raises(MotionError, match="tensor"):
            opened(tensor_file(path, *arguments))
    with pytest.raises(MotionError):
        opened(tensor_file(path, 0, (2, 2), (2, 1), b"abc"))
