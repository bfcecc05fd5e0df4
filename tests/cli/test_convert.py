import json
import os
import pty
import re
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

import g1stream
from g1stream.session.mcap_reader import McapFile

DEMO = Path(__file__).parents[2] / "src" / "g1stream" / "motion" / "demo.csv"
COMMAND = [sys.executable, "-m", "g1stream", "convert"]


@pytest.fixture
def convert(run):
    return lambda *arguments: run("convert", *arguments)


def test_in_a_pipe_it_shows_no_progress_and_says_in_one_line_what_it_wrote(convert, tmp_path):
    out = tmp_path / "out.mcap"
    told = convert("demo", out, "--frames", "10:40")
    size = out.stat().st_size / 1e6
    assert told == (0, f"{out}: 30 frames at 30 Hz, 0.97 s, {size:.1f} MB\n", "")


def test_the_rate_that_a_csv_does_not_keep_is_told(convert, tmp_path):
    done = convert("demo", tmp_path / "fast.csv", "--speed", "2")
    assert done.code == 0
    assert "--fps 60" in done.err


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


def test_the_summary_as_json(convert, tmp_path):
    out, base = tmp_path / "out.mcap", ("--base-time", "1970-01-01T00:01Z")
    told = json.loads(convert("demo", out, "--json", "--frames", "10:40", *base).out)
    assert told["path"] == str(out)
    assert told["size"] == out.stat().st_size
    assert told["counts"]["/tf"] == told["frames"] == 30
    assert told["start_ns"] == 60 * 10**9 + 333_333_333


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


@pytest.mark.slow
def test_on_a_terminal_there_is_a_bar_and_a_summary(tmp_path):
    leader, follower = pty.openpty()
    command = [*COMMAND, "demo", str(tmp_path / "out.mcap"), "--resample", "2000"]
    environment = os.environ | {"TERM": "xterm"}
    with subprocess.Popen(command, stdout=follower, stderr=follower, env=environment):
        os.close(follower)
        shown = b""
        with suppress(OSError):  # that is how a terminal says that nobody writes any more
            while True:
                shown += os.read(leader, 4096)
    os.close(leader)
    assert re.search(rb"[1-9][0-9]* %", shown)
    assert shown.endswith(b" MB\r\n")


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ("{spoiled} {tmp}/a.mcap", "line 2, column 2 (X)"),
        ("demo", "FILE"),
        ("demo {spoiled}", "exists already"),
        ("demo {tmp}/a.mcap --base-time 2026-03-01T12:00:00", "no time zone"),
        ("demo {tmp}/a.mcap --frames 9", "not a range of frames"),
        ("demo {tmp}/a.mcap --urdf {spoiled}", "is not XML"),
        ("demo {tmp}/a.npz --to mjlab --resample 60", "--resample"),
        ("demo {tmp}/a.npz --urdf g1_23dof", "the output"),
        ("demo {tmp}/a.mcap --velocities finite", "--to"),
        ("demo {tmp}/a --to sonic --ros2", "--to"),
        ("demo {tmp}/a.csv --to mjlab", ".npz"),
        ("demo {tmp}/a --to sonic --urdf g1_23dof", "23"),
        ("demo {tmp}/a.mcap --only joints", "tf"),
    ],
)
def test_bad_input_has_a_cause_and_leaves_no_file(convert, tmp_path, arguments, named):
    spoiled = tmp_path / "spoiled.csv"
    spoiled.write_text(DEMO.read_text().replace("\n0,", "\n0,x", 1))
    done = convert(*arguments.format(tmp=tmp_path, spoiled=spoiled).split())
    assert (done.code, done.out) == (2, "")
    assert named in done.err
    assert [*tmp_path.iterdir()] == [spoiled]


def test_a_signal_leaves_no_file(tmp_path):
    header, *lines = DEMO.read_text().splitlines()
    motion = tmp_path / "long.csv"
    rows = (f"{i},{lines[i % len(lines)].split(',', 1)[1]}" for i in range(8000))
    motion.write_text("\n".join((header, *rows)))
    with subprocess.Popen(
        [*COMMAND, str(motion), str(tmp_path / "a.mcap"), "--resample", "500"],
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        end = time.monotonic() + 30
        while not list(tmp_path.glob(".a.mcap.*")) and time.monotonic() < end:
            time.sleep(0.01)
        process.send_signal(signal.SIGTERM)
        _, told = process.communicate(timeout=30)
    assert process.returncode == 128 + signal.SIGTERM
    assert "SIGTERM" in told
    assert list(tmp_path.iterdir()) == [motion]


def test_a_session_without_flags_is_copied_and_with_flags_its_motion_is_converted(
    convert, tmp_path
):
    session = g1stream.rollout("demo", seconds=0.3)
    path, copy, motion = (tmp_path / f"{name}.mcap" for name in ("session", "copy", "motion"))
    session.save(path)
    assert convert(path, copy).code == 0
    again = g1stream.open_session(copy)
    assert again.topics == session.topics
    assert list(again.messages("/lowstate")) == list(session.messages("/lowstate"))
    assert convert(path, motion, "--only", "tf").code == 0
    assert {topic for topic, n in McapFile(motion).counts.items() if n} == {"/tf"}
