"""Whole libraries: what is computed, what is not computed again, what becomes of bad files."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

import g1stream
from g1stream.cli.main import main
from g1stream.config import load_config
from g1stream.errors import ConfigError
from g1stream.extras.library.compute import LibraryCase
from g1stream.extras.library.files import LIBRARY
from g1stream.extras.library.processes import Limits
from g1stream.extras.library.run import run_library


def by_name(library):
    return {row["name"]: row for row in library.motions.to_dict("records")}


def test_each_content_is_checked_once(checked):
    run, out = checked
    assert (run.files, run.copies, run.total, run.done, run.failed) == (5, 1, 4, 4, 1)
    assert run.complete
    library = g1stream.open_library(out)
    found = by_name(library)
    assert set(found) == {"copy", "second", "third", "broken"}
    assert found["broken"]["status"] == "broken"
    assert "1 column" in found["broken"]["reason"]
    assert "broken.csv" not in found["broken"]["reason"]  # it is in `path`
    assert found["second"]["frames"] == g1stream.load_motion("demo").trim(1.0, 2.0).n_frames
    joints = library.joints.groupby("key")["joint"].apply(tuple)
    assert set(joints) == {g1stream.JOINT_NAMES}
    assert len(joints) == 3


def test_a_row_says_what_the_physics_of_the_motion_say(checked, motions):
    _, out = checked
    library = g1stream.open_library(out)
    motion = g1stream.load_motion(motions / "below" / "third.npz")
    physics = g1stream.motion_physics(motion)
    row = by_name(library)["third"]
    for support, verdict in physics.verdicts.items():
        assert row[support] == verdict.playable
    for support, peaks in physics.torques.items():
        assert row[f"torque_{support}"] == peaks[0].share
    assert row["max_tilt"] == physics.tilt_rad
    assert row["max_collision"] == max((c.depth_mm for c in physics.collisions), default=0.0)
    assert row["supported"] == physics.supported_share
    joints = library.joints[library.joints["key"] == row["key"]].set_index("joint")
    assert joints["lowest"].to_numpy() == pytest.approx(motion.joint_pos.min(axis=0))
    for peak in physics.torques["free"]:
        assert joints.loc[peak.joint, "torque_free"] == peak.torque_nm


def test_the_example_of_the_docs_on_a_library_with_a_broken_file(
    checked, tmp_path, monkeypatch, capsys
):
    text = (Path(__file__).parents[3] / "docs" / "library.md").read_text()
    (example,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    (tmp_path / "library").symlink_to(checked[1])
    monkeypatch.chdir(tmp_path)
    exec(compile(example, "library.md", "exec"), {})
    fastest = capsys.readouterr().out.splitlines()[-5:]
    assert {line.split()[1] for line in fastest} <= {*g1stream.JOINT_NAMES}


@pytest.mark.slow
def test_only_what_changed_is_computed_again(motions, tmp_path):
    case = g1stream.LibraryCase("check", tmp_path)
    places = [str(motions / "first.npz"), str(motions / "second.csv")]
    assert g1stream.run_library(places[:1], [case], workers=1).done == 1
    run = g1stream.run_library(places, [case], workers=1)
    assert (run.known, run.done, run.complete) == (1, 1, True)
    other = replace(case, config=load_config(over={"safety.max_tilt": 0.4}))
    run = g1stream.run_library(places, [other], workers=1)
    assert (run.known, run.done) == (0, 2)
    assert len(g1stream.open_library(tmp_path).motions) == 2
    # A row that another one has replaced is computed again.
    assert g1stream.run_library(places[:1], [case], workers=1).known == 0
    assert g1stream.run_library(places[:1], [other], workers=1).known == 0
    # What is recorded changes nothing in a check.
    same = replace(other, config=load_config(over={"safety.max_tilt": 0.4, "record.tf_rate": 9.0}))
    assert g1stream.run_library(places, [same], workers=1).known == 2


@pytest.mark.slow
def test_slow_and_huge_motions_are_rows(tmp_path):
    motion = g1stream.load_motion("demo").looped(60)
    motion.save(tmp_path / "long.npz")
    case = g1stream.LibraryCase("check", tmp_path / "out")
    for limits, status in ((Limits(seconds=1e-3), "slow"), (Limits(megabytes=20.0), "huge")):
        run = g1stream.run_library([str(tmp_path)], [case], workers=1, limits=limits)
        assert (run.done, run.failed) == (1, 1)
        (row,) = g1stream.open_library(tmp_path / "out").motions.to_dict("records")
        assert (row["status"], row["limits"]) == (status, str(limits))
        # Within the same limits it would fail again.
        assert g1stream.run_library([str(tmp_path)], [case], workers=1, limits=limits).known == 1


def start(*arguments):
    return subprocess.Popen(
        [sys.executable, "-m", "g1stream", "library", *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def processes_of(pid):
    """The child processes of all its threads."""
    tasks = Path(f"/proc/{pid}/task").iterdir()
    return [int(child) for task in tasks for child in (task / "children").read_text().split()]


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_a_command_that_is_ended_goes_on_where_it_was(cuts, tmp_path, number, until):
    n_motions, out = 100, tmp_path / "out"  # so many that it is not done when the signal comes
    command = ["check", cuts(n_motions), "-o", out, "--workers", 2, "--json"]
    command += ["--fail-if", "frames > 1e9"]
    process = start(*command)
    printed = [json.loads(process.stdout.readline()) for _ in range(5)]
    processes = processes_of(process.pid)
    if number == signal.SIGINT:
        os.killpg(process.pid, number)  # as a terminal does
    else:
        process.kill()
    # Not communicate(), which loses what readline() has read ahead.
    printed += [json.loads(line) for line in process.stdout if line.endswith("}\n")]
    process.wait(60)
    assert process.returncode == (-number if number == signal.SIGKILL else 128 + number)
    assert ("not decided: frames" in process.stderr.read()) == (number != signal.SIGKILL)
    alive = lambda: [pid for pid in processes if Path(f"/proc/{pid}").exists()]  # noqa: E731
    until(lambda: not alive(), "its processes to end")
    kept = set(g1stream.open_library(out).motions["key"])
    assert {row["key"] for row in printed} <= kept
    assert len(kept) < n_motions
    again = start(*command)
    computed = [json.loads(line)["key"] for line in again.communicate(timeout=100)[0].splitlines()]
    assert again.returncode == 0
    assert kept.isdisjoint(computed)
    assert len(kept) + len(computed) == n_motions == len(g1stream.open_library(out).motions)


@pytest.mark.slow
def test_the_command(motions, tmp_path, capsys):
    def run(*flags):
        out = ["-o", str(tmp_path / "out"), "--workers", "1"]
        code = main(["library", "check", str(motions), *out, *flags])
        return code, " ".join(capsys.readouterr().out.split())

    code, out = run("--fail-if", "max_speed > 1000")
    assert code == 1  # of the broken one it cannot be told
    assert "bolted" in out
    assert "cannot be told for 1 row, such as broken" in out
    code, out = run("--fail-if", "ok < 0", "--fail-if", "duration > 0.5")
    assert code == 1
    assert "passed: ok < 0 holds for no row" in out
    assert "holds for 3 rows, such as copy, and cannot be told for 1 row" in out
    for wrong in ("speed > 1", "rmse > 1 * base"):
        assert run("--fail-if", wrong)[0] == 2
    assert run("--sessions")[0] == 2
    for address in ("127.0.0.1", "tcp://127.0.0.1:1"):
        assert run("--cluster", address)[0] == 2


@pytest.mark.slow
def test_a_broken_file_is_one_line_and_one_row_of_the_page_for_all_supports(tmp_path):
    motions, out = tmp_path / "motions", tmp_path / "out"
    motions.mkdir()
    g1stream.load_motion("demo").trim(0.0, 0.5).save(motions / "good.npz")
    (motions / "cut.npz").write_bytes((motions / "good.npz").read_bytes()[:1000])
    command = ("simulate", motions, "-o", out, "--support", "bolted,hanging")
    process = start(*command)
    printed = process.communicate(timeout=200)[0]
    assert process.returncode == 0
    assert printed.count("cut.npz") == 1
    rows = g1stream.open_library(out).motions
    assert dict(rows["status"].value_counts()) == {"ok": 2, "broken": 1}
    assert rows[rows["status"] == "broken"]["support"].isna().all()
    assert "0 computed in 0.0 s, 3 known before" in start(*command).communicate(timeout=200)[0]
    (data,) = re.findall(r'id="data">(.*)</script>\n<script>', (out / "index.html").read_text())
    simulate = json.loads(data)["simulate"]
    place = [column["name"] for column in simulate["columns"]].index("support")
    assert {row[place] for row in simulate["rows"]} == {None, "bolted", "hanging"}


def test_a_library_does_not_hide_its_motions(tmp_path):
    motions = tmp_path / "motions"
    motions.mkdir()
    g1stream.load_motion("demo").trim(0.0, 1.0).save(motions / "a.csv")
    for out in (motions, tmp_path):
        with pytest.raises(ConfigError):
            run_library([str(motions)], [LibraryCase("check", out)])
        assert not (out / LIBRARY).exists()
