import json
from pathlib import Path

import numpy as np
import pytest

import g1stream

DEMO = Path(g1stream.load_motion("demo").source)


@pytest.fixture
def convert(run):
    return lambda *arguments: run("convert", *arguments)


@pytest.mark.parametrize("flags", [("m.csv",), ("m.npz", "--to", "mjlab"), ("m.mcap",)])
def test_what_a_file_does_not_say_is_told(convert, tmp_path, flags):
    """Rate and orders of a CSV without a header; nothing for one that is asked for or named."""
    name, *to = flags
    path = tmp_path / "bare.csv"
    rows = np.loadtxt(DEMO, delimiter=",", skiprows=1)
    rows[:, 8:] *= 0.1  # too calm for joint limits to tell the order
    np.savetxt(path, rows[:, 1:], "%.6f", delimiter=",")
    done = convert(path, tmp_path / name, *to, "--quiet")
    assert (done.code, done.out) == (0, "")
    order, pelvis, rate = (line.split(": ", 3)[1:] for line in done.err.splitlines())
    assert order[:2] == ["bare.csv", "joint order"]
    assert order[2].startswith("motor: ")
    assert pelvis[1:] == ["pelvis", "the columns before the joints, xyzw, assumed."]
    assert rate[1:] == ["frame rate", "30 fps, assumed."]
    done = convert(DEMO, tmp_path / name, *to, "--fps", "30", "--force")
    assert (done.code, done.err) == (0, "")


def test_an_assumed_set_of_23_joints_is_told_once(convert, tmp_path):
    path = tmp_path / "bare.csv"
    np.savetxt(path, np.zeros((5, 23)), "%.1f", delimiter=",")
    done = convert(path, tmp_path / "m.npz", "--to", "mjlab")
    assert done.code == 0
    (told,) = (line for line in done.err.splitlines() if "joint order" in line)
    assert "--joint-order motor-23dof" in told


@pytest.mark.parametrize(("name", "out"), [("mjlab", "m.npz"), ("sonic", "m"), ("gmr", "m.pkl")])
def test_what_another_program_reads(convert, tmp_path, name, out):
    done = convert("demo", tmp_path / out, "--to", name, "--frames", "10:40", "--json")
    assert (done.code, done.err) == (0, "")
    told = json.loads(done.out)
    n_frames, fps = (30, 30) if name == "gmr" else (49, 50)
    assert told == {"path": str(tmp_path / out), "format": name, "frames": n_frames, "fps": fps}
    motion = g1stream.load_motion(tmp_path / out)
    assert (motion.n_frames, motion.fps) == (n_frames, fps)
    assert convert("demo", tmp_path / out, "--to", name).code == 2
    assert g1stream.load_motion(tmp_path / out).n_frames == n_frames


def test_the_flags_of_what_another_program_reads(convert, tmp_path):
    """Velocities and the robot's bodies."""
    found = {}
    for flags in ((), ("--velocities", "finite"), ("--urdf", "g1_29dof")):
        path = tmp_path / "m.npz"
        done = convert("demo", path, "--to", "mjlab", "--frames", "10:40", "--force", *flags)
        assert done.code == 0
        with np.load(path) as file:
            found[flags] = file["joint_vel"], file["body_pos_w"][:, 15]
    ours, finite, other = found.values()
    assert np.abs(ours[0] - finite[0]).max() > 1e-3
    assert (ours[1] == finite[1]).all()
    assert (ours[0] == other[0]).all()
    assert np.linalg.norm(ours[1] - other[1], axis=1).max() > 0.005  # the waists differ


@pytest.mark.parametrize(
    ("arguments", "named"),
    [("{tmp}/a.csv --to mjlab", ".npz"), ("{tmp}/a --to sonic --urdf g1_23dof", "23")],
)
def test_bad_input_has_a_cause_and_leaves_no_file(convert, tmp_path, arguments, named):
    done = convert("demo", *arguments.format(tmp=tmp_path).split())
    assert (done.code, done.out) == (2, "")
    assert named in done.err
    assert not [*tmp_path.iterdir()]
