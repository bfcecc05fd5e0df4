import resource

import numpy as np
import pandas as pd
import pytest

import g1stream
from g1stream.config import Config, load_config
from g1stream.control.gains import resolve_gains
from g1stream.errors import ConfigError
from g1stream.extras.library import compute
from g1stream.extras.library.compute import Content, Task, contents_of, rows_of
from g1stream.extras.library.files import find_motions
from g1stream.extras.library.library_cli import swept

SHORT = {"stream.ramp": 0.5, "stream.hold": 0.0, "stream.damp": 0.5}


@pytest.mark.slow
def test_a_simulated_row_is_that_of_the_rollout(motions, tmp_path, cluster):
    path, config = motions / "first.npz", load_config(over=SHORT)
    cases = [
        g1stream.library.LibraryCase(
            "simulate", tmp_path, settings, "bolted", values, sessions=True
        )
        for values, settings in swept(config, ["gains.kp=0.5,1"])
    ]
    run = g1stream.library.run_library([str(path)], cases, workers=2)
    assert (run.total, run.done, run.failed) == (2, 2, 0)
    library = g1stream.library.open_library(tmp_path)
    rows = {row["gains.kp"]: row for row in library.motions.to_dict("records")}
    assert set(rows) == {0.5, 1.0}
    assert rows[0.5]["rmse"] > rows[1.0]["rmse"]
    row = rows[1.0]
    metrics = g1stream.rollout(path, support="bolted", config=config).metrics()
    assert row["rmse"] == metrics.tracking.all_joints.rmse_rad
    assert row["mpjpe"] == metrics.body.pelvis_frame.mpjpe_mm
    assert row["torque_use"] == metrics.torque.use
    assert (row["support"], row["variant"]) == ("bolted", "bolted gains.kp=1")
    assert row["success"] is metrics.success.success is True
    joints = library.joints[library.joints["key"] == row["key"]].set_index("joint")
    for name, one in metrics.tracking.joints.items():
        assert joints.loc[name, "rmse"] == one.rmse_rad
        assert joints.loc[name, "torque_p99"] == metrics.torque.joints[name].p99_nm
    # What is recorded changes nothing.
    bare = g1stream.library.LibraryCase("simulate", tmp_path / "bare", config, "bolted")
    g1stream.library.run_library([str(path)], [bare], cluster=cluster)
    (other,) = g1stream.library.open_library(bare.out).motions.to_dict("records")
    for name in ("rmse", "p99", "delay", "mpjpe", "mpjpe_root", "torque_rms", "power", "success"):
        assert other[name] == pytest.approx(row[name], rel=1e-12, nan_ok=True)
    assert pd.isna(other["output"])
    session = g1stream.open_session(tmp_path / row["output"])
    assert session.metrics().tracking.all_joints.rmse_rad == row["rmse"]
    assert (tmp_path / row["report"]).read_text().startswith("<!doctype html>")


@pytest.mark.slow
def test_a_motion_beyond_the_limits_is_refused(tmp_path, cluster):
    motion = g1stream.load_motion("demo").trim(0.0, 2.0).at_speed(40.0)
    motion.save(tmp_path / "fast.npz")
    case = g1stream.library.LibraryCase("simulate", tmp_path / "out", support="bolted")
    run = g1stream.library.run_library([str(tmp_path / "fast.npz")], [case], cluster=cluster)
    (row,) = g1stream.library.open_library(tmp_path / "out").motions.to_dict("records")
    assert (run.failed, row["status"]) == (1, "refused")
    assert "rad/s" in row["reason"]
    assert row["frames"] == motion.n_frames


@pytest.mark.slow
@pytest.mark.parametrize(("name", "fps"), [("csv", 30.0), ("mcap", 30.0), ("sonic", 50.0)])
def test_converted_files_are_a_library_of_the_same_motions(motions, tmp_path, name, fps, cluster):
    case = g1stream.library.LibraryCase("convert", tmp_path, format=name)
    run = g1stream.library.run_library([str(motions)], [case], cluster=cluster)
    assert (run.done, run.failed) == (4, 1)
    rows = g1stream.library.open_library(tmp_path).motions
    outputs = {}
    for row in rows[rows["status"] == "ok"].to_dict("records"):
        before, path = g1stream.load_motion(row["path"]), tmp_path / row["output"]
        after, outputs[str(path)] = g1stream.load_motion(path), row
        assert (after.fps, row["frames"]) == (fps, before.n_frames)
        assert np.abs(before.resample(fps).joint_pos - after.joint_pos).max() < 1e-6
    assert len(outputs) == 3
    assert set(find_motions([str(tmp_path / "converted")])) == {*outputs}


@pytest.mark.parametrize("factor", [np.degrees(1.0), 1.0])
def test_a_motion_in_another_unit_is_refused(tmp_path, factor):
    """Degrees or centimetres: nothing of it can be judged."""
    demo = g1stream.load_motion("demo").frames(0, 60)
    root = demo.root_pos * (1.0 if factor > 1.0 else 100.0)
    wrong = g1stream.Motion.from_arrays(factor * demo.joint_pos, root, fps=30)
    path = wrong.save(tmp_path / "wrong.npz")
    case = g1stream.library.LibraryCase("check", tmp_path)
    (content,) = (one for _, one in contents_of(str(path)))
    row = rows_of(Task(str(path), content, case)).motion
    assert (row.status, row.bolted) == ("refused", None)
    assert row.looks_like in row.reason
    assert row.frames == 60


def test_joints_that_the_robot_lacks_are_in_the_row(tmp_path):
    path = g1stream.load_motion("demo").frames(30, 60).save(tmp_path / "part.npz")
    for name in ("g1_23dof", "g1_29dof"):
        config = load_config(over={"robot": name})
        case = g1stream.library.LibraryCase("check", tmp_path, config)
        row = rows_of(Task(str(path), Content("0"), case)).motion
        assert row.status == "ok"
        assert ("waist_roll" in (row.causes or "")) == (name == "g1_23dof")


@pytest.mark.parametrize("bug", [False, True])
def test_an_error_for_lack_of_memory_is_no_bug(tmp_path, monkeypatch, bug):
    """MuJoCo's are no `MemoryError`."""
    before = soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
    limit = 2**40
    calls = []

    def check(*_):
        calls.append(resource.getrlimit(resource.RLIMIT_DATA)[0])
        if bug or calls[-1] == limit:
            raise ValueError("Could not allocate memory")

    monkeypatch.setitem(compute._COMPUTE, "check", check)
    path = g1stream.load_motion("demo").save(tmp_path / "one.npz")
    task = Task(str(path), Content("0"), g1stream.library.LibraryCase("check", tmp_path))
    try:
        resource.setrlimit(resource.RLIMIT_DATA, (limit, hard))
        row = rows_of(task).motion
        assert resource.getrlimit(resource.RLIMIT_DATA) == (limit, hard)
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, before)
    assert (row.status, calls) == ("error" if bug else "huge", [limit, 2 * limit])
    assert rows_of(task).motion.status == ("error" if bug else "ok")  # without a limit, once
    assert calls[2:] == [soft]


def test_every_combination_of_a_sweep():
    config = load_config(over={"gains.kp": {"left_knee_joint": 80.0}})
    found = list(swept(config, ["gains.kp=0.5,2", "stream.feedforward=none,velocity"]))
    assert [values for values, _ in found] == [
        {"gains.kp": factor, "stream.feedforward": kind}
        for factor in (0.5, 2.0)
        for kind in ("none", "velocity")
    ]
    before, after = (resolve_gains(one.gains) for one in (config, found[-1][1]))
    assert after.kp == pytest.approx(2.0 * before.kp)
    assert after.kp[3] == 160.0
    assert after.kd == pytest.approx(before.kd)
    assert found[-1][1].stream.feedforward == "velocity"
    assert list(swept(Config(), [])) == [({}, Config())]
    assert len(list(swept(Config(), ["stream.rate=250,250.0,500"]))) == 2


@pytest.mark.parametrize(
    "sweeps",
    [
        *(["speed=1"], ["stream.rate"], ["stream.rate=1,fast"], ["stream.rate=1"]),
        *(["gains.kp=much"], ["stream.rate=250", "stream.rate=500"]),
    ],
)
def test_what_is_no_sweep(sweeps):
    with pytest.raises(ConfigError):
        list(swept(Config(), sweeps))


def test_a_row_depends_on_the_content_of_the_parameters(tmp_path):
    def fingerprint(content, name, command="simulate"):
        (tmp_path / name).write_text(content)
        config = load_config(over={"params": tmp_path / name if content else None})
        return g1stream.library.LibraryCase(command, tmp_path, config, "bolted").fingerprint

    first, other = "[friction]\nlegs = 0.3\n", "[friction]\nlegs = 0.4\n"
    assert fingerprint(first, "a.toml") == fingerprint(first, "b.toml")
    assert fingerprint(first, "a.toml") != fingerprint(other, "c.toml")
    assert fingerprint(first, "a.toml") != fingerprint("", "none")
    assert fingerprint(first, "a.toml", "check") != fingerprint(other, "c.toml", "check")
    assert fingerprint(first, "a.toml", "convert") == fingerprint("", "none", "convert")
