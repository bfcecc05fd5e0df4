"""What `simulate` makes of a motion."""

from __future__ import annotations

import pytest

import g1stream
from g1stream.config import load_config


@pytest.mark.slow
def test_a_simulated_row_is_that_of_the_rollout(motions, tmp_path):
    path = motions / "first.npz"
    config = load_config(over={"stream.ramp": 1.0})
    cases = [
        g1stream.LibraryCase("simulate", tmp_path, config, support, sessions=True)
        for support in ("bolted", "hanging")
    ]
    run = g1stream.run_library([str(path)], cases, workers=2)
    assert (run.total, run.done, run.failed) == (2, 2, 0)
    library = g1stream.open_library(tmp_path)
    rows = {row["support"]: row for row in library.motions.to_dict("records")}
    assert set(rows) == {"bolted", "hanging"}
    row = rows["bolted"]
    metrics = g1stream.rollout(path, support="bolted", config=config).metrics()
    assert row["rmse"] == metrics.tracking.all_joints.rmse_rad
    assert row["mpjpe"] == metrics.body.pelvis_frame.mpjpe_mm
    assert row["torque_use"] == metrics.torque.use
    assert row["success"] is metrics.success.success is True
    joints = library.joints[library.joints["key"] == row["key"]].set_index("joint")
    for name, one in metrics.tracking.joints.items():
        assert joints.loc[name, "rmse"] == one.rmse_rad
        assert joints.loc[name, "torque_p99"] == metrics.torque.joints[name].p99_nm
    session = g1stream.open_session(tmp_path / row["output"])
    assert session.metrics().tracking.all_joints.rmse_rad == row["rmse"]
    assert (tmp_path / row["report"]).read_text().startswith("<!doctype html>")


@pytest.mark.slow
def test_a_motion_beyond_the_limits_is_refused(tmp_path):
    motion = g1stream.load_motion("demo").trim(0.0, 2.0).at_speed(40.0)
    motion.save(tmp_path / "fast.npz")
    case = g1stream.LibraryCase("simulate", tmp_path / "out", support="bolted")
    run = g1stream.run_library([str(tmp_path / "fast.npz")], [case], workers=1)
    (row,) = g1stream.open_library(tmp_path / "out").motions.to_dict("records")
    assert (run.failed, row["status"]) == (1, "refused")
    assert "rad/s" in row["reason"]
    assert row["frames"] == motion.n_frames
