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


def test_the_summary_as_json(convert, tmp_path):
    out, base = tmp_path / "out.mcap", ("--base-time", "1970-01-01T00:01Z")
    told = json.loads(convert("demo", out, "--json", "--frames", "10:40", *base).out)
    assert told["path"] == str(out)
    assert told["size"] == out.stat().st_size
    assert told["counts"]["/tf"] == told["frames"] == 30
    assert told["start_ns"] == 60 * 10**9 + 333_333_333


def test_the_output_is_o_or_the_last_argument(convert, tmp_path):
    last, flag = tmp_path / "last.csv", tmp_path / "flag.csv"
    assert convert("demo", "demo", last, "--blend", "1").code == 0
    assert convert("demo", "-o", flag, "demo", "--blend", "1").code == 0
    assert flag.read_bytes() == last.read_bytes()
    assert convert("-o", flag).code == 2
    assert convert("demo", last, "-o", last, "--force").code == 2  # an input is not replaced
    assert flag.read_bytes() == last.read_bytes()


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
        ("demo {tmp}/a.npz --urdf g1_23dof", "--urdf"),
        ("demo {tmp}/a.npz --flat", "*.mcap"),
        ("demo {tmp}/a.npz --to mjlab --flat", "*.mcap"),
        ("demo {tmp}/a.mcap -o {tmp}/a.npz --flat", "*.mcap"),
        ("{spoiled} {tmp}/a --ros2 --speed 2", "--speed"),
        ("demo {tmp}/a.mcap --velocities finite", "--to"),
        ("demo {tmp}/a --to sonic --ros2", "--to"),
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
