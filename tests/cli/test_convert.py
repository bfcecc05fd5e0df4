"""`g1stream convert` as a user meets it: output, exit codes, bad input, signals, a terminal."""

from __future__ import annotations

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

DEMO = Path(__file__).parents[2] / "src" / "g1stream" / "motion" / "demo.csv"
COMMAND = [sys.executable, "-m", "g1stream", "convert"]


def run(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*COMMAND, *map(str, arguments)], capture_output=True, text=True, timeout=60, check=False
    )


@pytest.fixture
def out(tmp_path):
    return tmp_path / "out.mcap"


def test_in_a_pipe_it_shows_no_progress_and_says_in_one_line_what_it_wrote(out):
    done = run("demo", out, "--frames", "10:40")
    size = out.stat().st_size / 1e6
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == f"{out}: 30 frames at 30 Hz, 0.97 s, {size:.1f} MB\n"


def test_the_rate_that_a_csv_does_not_keep_is_told(tmp_path):
    done = run("demo", tmp_path / "fast.csv", "--speed", "2")
    assert done.returncode == 0
    assert "--fps 60" in done.stderr


@pytest.mark.parametrize("flags", [("m.csv",), ("m.npz", "--to", "mjlab"), ("m.mcap",)])
def test_what_a_file_does_not_say_is_told(tmp_path, flags):
    """Rate and orders of a CSV without a header; nothing for one that is asked for or named."""
    name, *to = flags
    path = tmp_path / "bare.csv"
    rows = np.loadtxt(DEMO, delimiter=",", skiprows=1)
    rows[:, 8:] *= 0.1  # too calm for joint limits to tell the order
    np.savetxt(path, rows[:, 1:], "%.6f", delimiter=",")
    done = run(path, tmp_path / name, *to, "--quiet")
    assert done.returncode == 0
    assert [line.split(":")[:3] for line in done.stderr.splitlines()] == [
        ["warning", " bare.csv", f" {subject}"]
        for subject in ("joint order", "pelvis", "frame rate")
    ]
    order, *others = (line.split(": ", 3)[3] for line in done.stderr.splitlines())
    assert order.startswith("motor: ")
    assert others == ["the columns before the joints, xyzw, assumed.", "30 fps, assumed."]
    done = run(DEMO, tmp_path / name, *to, "--fps", "30", "--force")
    assert (done.returncode, done.stderr) == (0, "")


def test_an_assumed_set_of_23_joints_is_told_once(tmp_path):
    path = tmp_path / "bare.csv"
    np.savetxt(path, np.zeros((5, 23)), "%.1f", delimiter=",")
    done = run(path, tmp_path / "m.npz", "--to", "mjlab")
    assert done.returncode == 0
    (told,) = (line for line in done.stderr.splitlines() if "joint order" in line)
    assert "motor, without the six wrists" in told
    assert "--joint-order motor-23dof" in told


def test_the_summary_as_json(out):
    done = run("demo", out, "--json", "--frames", "10:40", "--base-time", "1970-01-01T00:01Z")
    told = json.loads(done.stdout)
    assert told["path"] == str(out)
    assert told["size"] == out.stat().st_size
    assert told["counts"]["/tf"] == told["frames"] == 30
    assert told["start_ns"] == 60 * 10**9 + 333_333_333


@pytest.mark.parametrize(("name", "out"), [("mjlab", "m.npz"), ("sonic", "m"), ("gmr", "m.pkl")])
def test_what_another_program_reads(tmp_path, name, out):
    done = run("demo", tmp_path / out, "--to", name, "--frames", "10:40", "--json")
    assert (done.returncode, done.stderr) == (0, "")
    told = json.loads(done.stdout)
    n_frames, fps = (30, 30) if name == "gmr" else (49, 50)
    assert told == {"path": str(tmp_path / out), "format": name, "frames": n_frames, "fps": fps}
    motion = g1stream.load_motion(tmp_path / out)
    assert (motion.n_frames, motion.fps) == (n_frames, fps)
    assert run("demo", tmp_path / out, "--to", name).returncode == 2
    assert g1stream.load_motion(tmp_path / out).n_frames == n_frames


def test_the_flags_of_what_another_program_reads(tmp_path):
    """Velocities and the robot's bodies."""
    found = {}
    for flags in ((), ("--velocities", "finite"), ("--urdf", "g1_29dof")):
        path = tmp_path / "m.npz"
        done = run("demo", path, "--to", "mjlab", "--frames", "10:40", "--force", *flags)
        assert done.returncode == 0
        with np.load(path) as file:
            found[flags] = file["joint_vel"], file["body_pos_w"][:, 15]
    ours, finite, other = found.values()
    assert np.abs(ours[0] - finite[0]).max() > 1e-3
    assert (ours[1] == finite[1]).all()
    assert (ours[0] == other[0]).all()
    assert np.linalg.norm(ours[1] - other[1], axis=1).max() > 0.005  # the waists differ


@pytest.mark.slow
def test_on_a_terminal_there_is_a_bar_and_a_summary(out):
    leader, follower = pty.openpty()
    environment = {**os.environ, "TERM": "xterm"}
    with subprocess.Popen(
        [*COMMAND, "demo", str(out), "--resample", "2000"],
        stdout=follower,
        stderr=follower,
        env=environment,
    ):
        os.close(follower)
        shown = b""
        with suppress(OSError):  # that is how a terminal says that nobody writes any more
            while True:
                shown += os.read(leader, 4096)
    os.close(leader)
    assert re.search(rb"[1-9][0-9]* %", shown)
    assert shown.endswith(b" MB\r\n")


def test_a_warning_changes_no_exit_code(tmp_path, out):
    header, *lines = DEMO.read_text().splitlines()
    cells = lines[7].split(",")
    cells[4:8] = [str(2.24 * float(cell)) for cell in cells[4:8]]
    path = tmp_path / "norm.csv"
    path.write_text("\n".join([header, *lines[:7], ",".join(cells), *lines[8:]]))
    converted = run(path, out)
    assert converted.returncode == 0
    assert "frame 7, line 9" in converted.stderr


def spoiled(tmp_path: Path, old: str, new: str, name: str = "spoiled.csv") -> Path:
    path = tmp_path / name
    path.write_text(DEMO.read_text().replace(old, new, 1))
    return path


CASES = {
    "a word for a number": (
        lambda tmp: [spoiled(tmp, "\n0,", "\n0,x"), tmp / "a.mcap"],
        "line 2, column 2 (X)",
    ),
    "no output": (lambda tmp: ["demo"], "FILE"),
    "a file that is there": (lambda tmp: ["demo", spoiled(tmp, "", "")], "exists already"),
    "a time without a zone": (
        lambda tmp: ["demo", tmp / "a.mcap", "--base-time", "2026-03-01T12:00:00"],
        "no time zone",
    ),
    "no range": (lambda tmp: ["demo", tmp / "a.mcap", "--frames", "9"], "not a range of frames"),
    "no URDF": (lambda tmp: ["demo", tmp / "a.mcap", "--urdf", DEMO], "is not XML"),
    "a rate for a format that has its own": (
        lambda tmp: ["demo", tmp / "a.npz", "--to", "mjlab", "--resample", "60"],
        "--resample",
    ),
    "a URDF for a motion file": (
        lambda tmp: ["demo", tmp / "a.npz", "--urdf", "g1_23dof"],
        "the output",
    ),
    "velocities for a session": (
        lambda tmp: ["demo", tmp / "a.mcap", "--velocities", "finite"],
        "--to",
    ),
    "a format and a bag": (
        lambda tmp: ["demo", tmp / "a", "--to", "sonic", "--ros2"],
        "--to",
    ),
    "the name of another format": (
        lambda tmp: ["demo", tmp / "a.csv", "--to", "mjlab"],
        ".npz",
    ),
    "a robot of 23 joints": (
        lambda tmp: ["demo", tmp / "a", "--to", "sonic", "--urdf", "g1_23dof"],
        "23",
    ),
    "an unknown compression": (
        lambda tmp: ["demo", tmp / "a.mcap", "--compression", "zip"],
        "zstd",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_bad_input_has_a_cause_a_remedy_and_leaves_no_file(case, tmp_path):
    arguments, word = CASES[case]
    given = arguments(tmp_path)
    before = sorted(tmp_path.iterdir())
    done = run(*given)
    assert done.returncode == 2
    assert word in done.stderr
    assert "Traceback" not in done.stderr
    assert done.stdout == ""
    assert sorted(tmp_path.iterdir()) == before


def test_a_signal_leaves_no_file(tmp_path):
    header, *lines = DEMO.read_text().splitlines()
    motion = tmp_path / "long.csv"
    rows = (f"{i},{lines[i % len(lines)].split(',', 1)[1]}" for i in range(20_000))
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
