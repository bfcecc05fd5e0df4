import json
import os
import pickle
import re
import signal
import socket
import subprocess
import sys
import time
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import psutil
import pytest

import g1stream
from g1stream.cli.main import main
from g1stream.config import load_config
from g1stream.errors import ConfigError
from g1stream.extras.library.compute import LibraryCase
from g1stream.extras.library.files import LIBRARY
from g1stream.extras.library.run import LibraryRun, run_library
from g1stream.extras.library.table import condition_value, open_library
from g1stream.extras.library.workers import Limits, open_workers
from g1stream.session.writer import SessionWriter
from g1stream.testing import SyntheticSession


def by_name(library):
    return {row["name"]: row for row in library.motions.to_dict("records")}


def test_each_content_is_checked_once(checked):
    run, out = checked
    assert (run.files, run.copies, run.total, run.done, run.failed) == (5, 1, 4, 4, 1)
    assert run.complete
    library = open_library(out)
    found = by_name(library)
    assert set(found) == {"copy", "second", "third", "broken"}
    assert found["broken"]["status"] == "broken"
    assert "line 2, column 1" in found["broken"]["reason"]
    assert "broken.csv" not in found["broken"]["reason"]  # it is in `path`
    assert found["second"]["frames"] == g1stream.load_motion("demo").trim(1.0, 2.0).n_frames
    joints = library.joints.groupby("key")["joint"].apply(tuple)
    assert set(joints) == {g1stream.JOINT_NAMES}
    assert len(joints) == 3


def test_a_row_says_what_the_physics_of_the_motion_say(checked, motions):
    library = open_library(checked[1])
    motion = g1stream.load_motion(motions / "below" / "third.npz")
    physics = g1stream.physics.motion_physics(motion)
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


def test_the_example_of_the_docs(checked, tmp_path, monkeypatch, capsys):
    text = (Path(__file__).parents[3] / "docs" / "library.md").read_text()
    (example,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    (tmp_path / "library").symlink_to(checked[1])
    monkeypatch.chdir(tmp_path)
    exec(example, {})
    fastest = capsys.readouterr().out.splitlines()[-5:]
    assert {line.split()[1] for line in fastest} <= {*g1stream.JOINT_NAMES}


@pytest.mark.slow
def test_only_what_changed_is_computed_again(motions, tmp_path, cluster):
    case = LibraryCase("check", tmp_path)
    places = [str(motions / "first.npz"), str(motions / "second.csv")]
    assert run_library(places[:1], [case], cluster=cluster).done == 1
    run = run_library(places, [case], cluster=cluster)
    assert (run.known, run.done, run.complete) == (1, 1, True)
    other = replace(case, config=load_config(over={"safety.max_tilt": 0.4}))
    run = run_library(places, [other], cluster=cluster)
    assert (run.known, run.done) == (0, 2)
    assert len(open_library(tmp_path).motions) == 2
    # A row that another one has replaced is computed again.
    assert run_library(places[:1], [case], cluster=cluster).known == 0
    assert run_library(places[:1], [other], cluster=cluster).known == 0
    # What is recorded changes nothing in a check.
    same = replace(other, config=load_config(over={"safety.max_tilt": 0.4, "record.tf_rate": 9.0}))
    assert run_library(places, [same], cluster=cluster).known == 2


@pytest.mark.slow
def test_slow_and_huge_motions_are_rows(tmp_path, cluster):
    g1stream.load_motion("demo").looped(60).save(tmp_path / "long.npz")
    case = LibraryCase("check", tmp_path / "out")
    for limits, status in ((Limits(seconds=1e-3), "slow"), (Limits(megabytes=20.0), "huge")):
        run = run_library([str(tmp_path)], [case], cluster=cluster, limits=limits)
        assert (run.done, run.failed) == (1, 1)
        (row,) = open_library(tmp_path / "out").motions.to_dict("records")
        assert (row["status"], row["limits"]) == (status, str(limits))
        # Within the same limits it would fail again.
        assert run_library([str(tmp_path)], [case], cluster=cluster, limits=limits).known == 1


def start(*arguments):
    return subprocess.Popen(
        [sys.executable, "-m", "g1stream", "library", *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def processes_of(pid):
    children = psutil.Process(pid).children()
    return [one.pid for one in children if "spawn_main" in " ".join(one.cmdline())]


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_a_command_that_is_ended_goes_on_where_it_was(many, tmp_path, number, until, cluster):
    process = start(
        *("check", many, "-o", tmp_path, "--workers", 2, "--json", "--fail-if", "frames > 1e9")
    )
    printed = [json.loads(process.stdout.readline()) for _ in range(3)]
    processes = processes_of(process.pid)
    if number == signal.SIGINT:
        os.killpg(process.pid, number)  # as a terminal does
    else:
        process.send_signal(number)
    # Not communicate(), which loses what readline() has read ahead.
    printed += [json.loads(line) for line in process.stdout if line.endswith("}\n")]
    process.wait(60)
    assert process.returncode == (-number if number == signal.SIGKILL else 128 + number)
    assert ("not decided: frames" in process.stderr.read()) == (number != signal.SIGKILL)
    alive = lambda: [pid for pid in processes if Path(f"/proc/{pid}").exists()]  # noqa: E731
    until(lambda: not alive(), "its processes to end")
    kept = open_library(tmp_path).motions
    assert {row["key"] for row in printed} <= {*kept["key"]}
    # A few of the others are enough: each takes its time.
    others = sorted({str(path) for path in many.iterdir()} - {*kept["path"]})[:10]
    assert others
    places = [*kept["path"], *others]
    again = run_library(places, [LibraryCase("check", tmp_path)], cluster=cluster)
    assert (again.complete, again.known, again.done) == (True, len(kept), len(others))
    assert {*open_library(tmp_path).motions["path"]} == {*places}


@pytest.mark.slow
def test_ctrl_c_while_the_workers_start_is_no_error(many, tmp_path, until):
    process = start("check", many, "-o", tmp_path, "--workers", 2)
    until(lambda: processes_of(process.pid), "a worker to start")
    time.sleep(0.1)  # it imports
    os.killpg(process.pid, signal.SIGINT)
    _, errors = process.communicate(timeout=100)
    assert process.returncode == 128 + signal.SIGINT
    assert "Traceback" not in errors


@pytest.mark.slow
def test_processes_that_are_killed_lose_nothing(many, tmp_path):
    some = sorted(many.iterdir())[:40]
    process = start("check", *some, "-o", tmp_path, "--workers", 2, "--json")
    process.stdout.readline()
    processes = processes_of(process.pid)
    assert len(processes) == 2
    for pid in processes:
        os.kill(pid, signal.SIGKILL)
    _, errors = process.communicate(timeout=100)
    assert process.returncode == 0, errors
    assert "Traceback" not in errors  # of Dask, whose log messages are not for a user
    assert list(open_library(tmp_path).motions["status"]) == ["ok"] * 40


@pytest.mark.slow
def test_a_fall_fails_a_condition_on_the_error_before_it(tmp_path, cluster):
    demo = g1stream.load_motion("demo")
    demo.trim(0.0, 3.0).save(tmp_path / "falls.npz")
    given = ["library", "simulate", str(tmp_path / "falls.npz"), "-o", str(tmp_path / "out")]
    given += ["--support", "free", "--cluster", cluster, "--fail-if", "rmse > 100"]
    assert main(given) == 1
    (row,) = open_library(tmp_path / "out").motions.to_dict("records")
    assert (row["status"], row["completed"], row["rmse"] < 100) == ("ok", False, True)
    assert condition_value(row, "played") == row["progress"] < 0.9
    assert main([*given, "--fail-if", "played < 0.1"]) == 0


@pytest.mark.slow
def test_the_command(motions, tmp_path, capsys, cluster):
    def run(*arguments):
        out = str(tmp_path / "out")
        code = main(["library", "check", str(motions), "-o", out, "--cluster", cluster, *arguments])
        return code, *capsys.readouterr()

    code, out, _ = run("--fail-if", "max_speed > 1000")
    assert code == 1  # of the broken one it cannot be told
    assert "bolted" in out
    assert "is unknown for 1 row, such as broken" in out
    code, out, _ = run("--fail-if", "ok < 0", "--fail-if", "duration > 0.5")
    assert code == 1
    words = " ".join(out.split())
    assert "passed: ok < 0 holds for no row" in words
    assert "holds for 3 rows, such as copy, and is unknown for 1 row" in words
    (motions / "broken.csv").rename(tmp_path / "broken.csv")
    try:
        assert run("--fail-if", "max_speed > 1000")[0] == 0
        assert run("--fail-if", "max_speed > 0.001")[0] == 1
        code, out, err = run("-q", "--fail-if", "max_speed > 0.001", "--fail-if", "ok < 0")
        assert (code, out, err.count("FAILED: max_speed > 0.001")) == (1, "", 1)
        assert "passed" not in err
    finally:
        (tmp_path / "broken.csv").rename(motions / "broken.csv")
    assert run("--fail-if", "speed > 1")[0] == 2
    assert run("--fail-if", "rmse > 1 * base")[0] == 2
    assert run("--sessions")[0] == 2
    for address in ("127.0.0.1", "tls://127.0.0.1:1", "tcp://127.0.0.1:1"):
        assert run("--cluster", address)[0] == 2


@pytest.mark.parametrize(
    ("address", "trusted"),
    [
        *(("tcp://10.1.2.3:8786", False), ("head:8786", False), ("tcp://head:8786", False)),
        *(("tcp://127.0.0.1.example:1", False), ("tcp://[fe80::1]:1", False), ("ws://h:1", False)),
        *(("tcp://127.0.0.1:1", True), ("localhost:1", True), ("tcp://[::1]:1", True)),
        ("127.0.0.1", True),
    ],
)
@pytest.mark.parametrize("insecure", [False, True])
def test_a_scheduler_elsewhere_needs_tls_or_so_many_words(
    address, trusted, insecure, tmp_path, monkeypatch, capsys
):
    asked = []

    @contextmanager
    def client(_, cluster, *__):
        asked.append(cluster)
        raise ConfigError("That is enough.", "")
        yield

    monkeypatch.setattr("g1stream.extras.library.workers._client", client)
    g1stream.load_motion("demo").trim(0.0, 1.0).save(tmp_path / "a.npz")
    given = ["library", "check", str(tmp_path / "a.npz"), "-o", str(tmp_path / "out")]
    given += ["--cluster", address] + ["--cluster-insecure"] * insecure
    for scheme in (address, f"tls://{address.rpartition('://')[2]}"):
        given[given.index("--cluster") + 1] = scheme
        assert main(given) == 2
        allowed = trusted or insecure or scheme.startswith("tls:")
        assert asked == [scheme] * allowed
        assert ("--cluster-insecure" in capsys.readouterr().err) is not allowed
        asked.clear()


def test_what_never_answers_is_no_scheduler(monkeypatch):
    monkeypatch.setattr("g1stream.extras.library.workers._TIMEOUT", 1.0)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        address = f"tcp://127.0.0.1:{silent.getsockname()[1]}"
        with pytest.raises(ConfigError, match="no answer within 1 s"), open_workers(1, address):
            pass


def test_the_rate_is_that_of_all_rows_that_are_done():
    run = LibraryRun(computing=True, keys=set(map(str, range(30))), done=10, failed=8, elapsed=4.0)
    fraction, text = run.status()
    assert fraction == pytest.approx(1 / 3)
    assert "2.5 a second, 0:08 min left" in text
    run.done = 0
    assert "left" not in run.status()[1]


def test_a_broken_file_has_a_row_though_its_copy_was_repaired(tmp_path, cluster):
    motions, out = tmp_path / "motions", tmp_path / "out"
    motions.mkdir()
    for name in ("a.csv", "b.csv"):
        (motions / name).write_text("1\n2\n")
    case = LibraryCase("check", out)
    assert run_library([str(motions)], [case], cluster=cluster).done == 1
    assert list(by_name(open_library(out))) == ["a"]
    g1stream.load_motion("demo").trim(0.0, 1.0).save(motions / "a.csv", force=True)
    for _ in range(2):
        run_library([str(motions)], [case], cluster=cluster)
    found = by_name(open_library(out))
    assert {name: row["status"] for name, row in found.items()} == {"a": "ok", "b": "broken"}


@pytest.mark.slow
def test_a_broken_file_is_one_line_and_one_row_for_all_values_of_a_sweep(tmp_path, capsys):
    motions, out, config = (tmp_path / name for name in ("motions", "out", "short.toml"))
    motions.mkdir()
    config.write_text("[stream]\nramp = 0.5\nhold = 0.0\ndamp = 0.5\n")
    g1stream.load_motion("demo").trim(0.0, 0.5).save(motions / "good.npz")
    (motions / "cut.npz").write_bytes((motions / "good.npz").read_bytes()[:1000])
    session = tmp_path / "session.mcap"
    with SessionWriter(session) as writer:
        SyntheticSession(1.0).write(writer)
    (motions / "half.mcap").write_bytes(session.read_bytes()[:1000])
    command = ["library", "simulate", str(motions), "-o", str(out), "--config", str(config)]
    command += ["--sweep", "stream.rate=500,250,100", "--workers", "1"]
    assert main(command) == 0
    printed = capsys.readouterr().out
    assert printed.count("cut.npz") == printed.count("half.mcap") == 1
    assert re.findall(r"stream\.rate=(\d+)", printed) == ["500", "250", "100"]
    assert "failed: 2 broken" in printed
    rows = open_library(out).motions
    assert list(rows["status"].value_counts()[["ok", "broken"]]) == [3, 2]
    assert sorted(rows["stream.rate"].dropna()) == [100.0, 250.0, 500.0]
    broken = rows[rows["status"] == "broken"]
    assert broken[["support", "stream.rate"]].isna().all(axis=None)
    assert "5 of 5 rows, 3 motions\n  5 computed" in printed
    assert main(command) == 0
    assert "0 computed in 0.0 s, 5 known before" in capsys.readouterr().out


def test_a_library_does_not_hide_its_motions(tmp_path):
    motions = tmp_path / "motions"
    motions.mkdir()
    g1stream.load_motion("demo").trim(0.0, 1.0).save(motions / "a.csv")
    for out in (motions, tmp_path):
        with pytest.raises(ConfigError):
            run_library([str(motions)], [LibraryCase("check", out)])
        assert not (out / LIBRARY).exists()


@pytest.mark.slow
def test_a_file_that_cannot_be_written_is_tried_again(motions, tmp_path, cluster):
    source, case = str(motions / "second.csv"), LibraryCase("convert", tmp_path, format="npz")
    (tmp_path / "converted").write_text("in the way")
    assert run_library([source], [case], cluster=cluster).failed == 1
    (tmp_path / "converted").unlink()
    again = run_library([source], [case], cluster=cluster)
    assert (again.known, again.done, again.failed) == (0, 1, 0)


def test_each_motion_of_a_file_has_a_row(tmp_path, cluster):
    demo = g1stream.load_motion("demo")
    part = {"dof": demo.joint_pos[:40], "root_pos": demo.root_pos[:40], "fps": 30}
    part["root_quat_wxyz"] = demo.root_quat_wxyz[:40]
    path = tmp_path / "several.pkl"
    path.write_bytes(pickle.dumps({"../one": part, "two": part}))
    for place, names in ((tmp_path, {"../one", "two"}), (f"{path}:two", {"two"})):
        out = tmp_path.with_name(f"{tmp_path.name} {len(names)}")
        case = LibraryCase("convert", out, format="npz")
        run = run_library([str(place)], [case], cluster=cluster)
        rows = by_name(open_library(out))
        assert (run.files, run.done, run.failed) == (1, len(names), 0)
        assert all((out / row["output"]).parent.name == "converted" for row in rows.values())
        assert {name: row["path"] for name, row in rows.items()} == {
            n: f"{path}:{n}" for n in names
        }
