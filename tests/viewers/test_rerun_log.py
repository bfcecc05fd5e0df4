"""Sessions in Rerun recordings, read back with Rerun's own reader."""

from __future__ import annotations

from collections import Counter
from types import SimpleNamespace

import numpy as np
import pytest

from g1stream.dds.messages import LowState
from g1stream.errors import RecordingError
from g1stream.foxglove.encoders import encode_log
from g1stream.robot.joints import JOINT_GROUPS, JOINT_NAMES
from g1stream.robot.kinematics import forward_kinematics
from g1stream.robot.model import G1
from g1stream.robot.visuals import read_visuals
from g1stream.session.session import Session, open_session
from g1stream.session.source import MemorySource

pytest.importorskip("rerun", reason="Rerun needs Python 3.11")

T0 = 1_700_000_000_000_000_000
POSITION, QUATERNION = "Transform3D:translation", "Transform3D:quaternion"


@pytest.fixture(autouse=True)
def primitives(monkeypatch):
    """Shapes of a known number."""
    monkeypatch.setattr("g1stream.viewers.rerun_log.with_shapes", lambda robot: robot)


@pytest.fixture
def saved(tmp_path):
    """Saves a session and gives what is in the recording: by entity, its rows by column."""

    def save(session):
        from rerun.chunk import RrdReader

        reader = RrdReader(session.to_rerun(tmp_path / "session.rrd"))
        rows, static = {}, Counter()
        for chunk in reader.stream():
            path = chunk.entity_path.strip("/")
            if chunk.is_static:
                static.update((path, name) for name in chunk.to_record_batch().schema.names)
                continue
            table = chunk.to_record_batch()
            for name in table.schema.names:
                values = _values(table.column(name))
                rows.setdefault(path, {}).setdefault(name, []).append(values)
        names = {entry.application_id for entry in reader.blueprints()}
        arrays = {p: {n: np.concatenate(v) for n, v in c.items()} for p, c in rows.items()}
        return SimpleNamespace(rows=arrays, static=static, blueprints=names)

    return save


def _values(column):
    """A column of N rows as (N,) times, or (N, K) values."""
    if hasattr(column.type, "unit"):
        return column.cast("int64").to_numpy()
    values = column
    while hasattr(values.type, "value_type"):
        values = values.flatten()
    return values.to_numpy(zero_copy_only=False).reshape(len(column), -1)


@pytest.fixture
def session(play, write_session):
    offset = np.linspace(-0.02, 0.05, 29)
    return open_session(write_session(*play(0.01, offset)))


def _ns(stream):
    return np.round(stream.time * 1e9).astype(np.int64)


def test_joints_are_those_of_the_session_at_both_times(session, saved):
    rows = saved(session).rows
    columns = {
        "position/reference": (session.reference, session.reference.q),
        "position/measured": (session.measured, session.measured.q),
        "torque/feed-forward": (session.reference, session.reference.tau),
        "torque/estimated": (session.measured, session.measured.tau),
    }
    for joint, name in enumerate(JOINT_NAMES):
        for what, (stream, values) in columns.items():
            found = rows[f"joints/{name}/{what}"]
            order = np.argsort(found["time"], kind="stable")
            np.testing.assert_array_equal(found["time"][order], _ns(stream))
            np.testing.assert_array_equal(found["log_time"][order], stream.log_time)
            np.testing.assert_array_equal(found["Scalars:scalars"][order, 0], values[:, joint])
        limit = session.robot.torque_limit[joint]
        limits = rows[f"joints/{name}/torque/limits"]["Scalars:scalars"]
        assert np.unique(limits, axis=0).tolist() == [[limit, -limit]]


def test_errors_are_those_of_the_summary(session, saved):
    tracking, rows = session.tracking(), saved(session).rows
    in_play = np.isin(rows["joints/left_knee_joint/error"]["time"], _ns(tracking))
    errors = [rows[f"joints/{name}/error"]["Scalars:scalars"][:, 0] for name in JOINT_NAMES]
    q = np.stack(errors, axis=1)[in_play]
    np.testing.assert_allclose(np.sqrt((q**2).mean(axis=0)), tracking.rmse, rtol=1e-9)
    everywhere = np.stack(errors, axis=1)
    for limb, joints in JOINT_GROUPS.items():
        found = rows[f"error/{limb}"]
        same = np.isin(rows["joints/left_knee_joint/error"]["time"], found["time"])
        rms = np.sqrt((everywhere[same][:, list(joints)] ** 2).mean(axis=1))
        assert 300 < len(rms) < 600  # 100 a second
        np.testing.assert_allclose(found["Scalars:scalars"][:, 0], rms)


def test_robots_stand_as_the_session_says(session, saved):
    rows, robot = saved(session).rows, session.robot
    measured, reference = session.measured, session.reference
    for name, stream, link in (
        ("measured", measured, "left_rubber_hand"),
        ("ghost", reference, "left_knee_link"),
        ("reference", reference, "right_ankle_roll_link"),
    ):
        found = rows[f"{name}/{link}"]
        chosen = np.searchsorted(_ns(stream), np.sort(found["time"]))
        q, still = stream.q[chosen], (np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
        poses, number = forward_kinematics(robot, q, *still), robot.link_index(link)
        order = np.argsort(found["time"])
        np.testing.assert_allclose(found[POSITION][order], poses.pos[:, number], atol=1e-6)
        xyzw = np.roll(poses.quat_wxyz[:, number], -1, axis=-1)
        np.testing.assert_allclose(found[QUATERNION][order], xyzw, atol=1e-6)
    ghost = rows["ghost"]
    before = ghost["time"] < _ns(reference)[0]
    sizes = ghost["Transform3D:scale"][:, 0]
    assert before.any()
    assert sizes[before].max() < 0.01 < sizes[~before].min() == 1.0


def test_bodies_phases_and_blueprint_are_there_once(session, saved):
    found = saved(session)
    links = Counter(visual.link for visual in read_visuals(session.robot))
    shapes = Counter(
        path.split("/")[1]
        for (path, name), _ in found.static.items()
        if path.startswith("measured/") and name.endswith(("half_sizes", "lengths"))
    )
    assert shapes == links
    assert max(found.static[key] for key in found.static if "half_sizes" in key[1]) == 1
    phases = found.rows["phase"]
    assert phases["StateChange:state"][:, 0].tolist() == [p.phase.name for p in session.phases]
    starts = [p.start_s for p in session.phases]
    np.testing.assert_allclose(phases["time"] / 1e9, starts, atol=1e-9)
    assert found.blueprints == {"g1stream"}


@pytest.mark.parametrize("only", ["reference", "measured"])
def test_what_a_session_does_not_have_is_left_out(play, write_session, saved, only):
    played = play()._asdict()
    rows = saved(open_session(write_session(**{only: played[only]}))).rows
    joints = {path.rpartition("/")[2] for path in rows if path.startswith("joints/")}
    if only == "reference":
        assert joints == {"reference", "feed-forward"}
        assert "measured/pelvis" not in rows
    else:
        assert joints == {"measured", "estimated", "limits"}
        assert "ghost/pelvis" not in rows
        assert "phase" not in rows


def test_events_are_logged_by_program(saved):
    source = MemorySource("events")
    source.write("/lowstate", LowState().seal(), T0, T0)
    events = [(4, "stream", "late"), (3, "record", "lost"), (2, "stream", "RAMP -> PLAY")]
    for number, event in enumerate(events):
        source.write("/log", encode_log(T0 + number, *event), T0 + 10 + number, T0 + number)
    rows = saved(Session(source)).rows
    stream, record = rows["log/stream"], rows["log/record"]
    assert stream["TextLog:text"][:, 0].tolist() == ["late", "RAMP -> PLAY"]
    assert stream["TextLog:level"][:, 0].tolist() == ["ERROR", "INFO"]
    assert record["TextLog:level"][:, 0].tolist() == ["WARN"]
    assert stream["time"].tolist() == [0, 2]
    assert stream["log_time"].tolist() == [T0 + 10, T0 + 12]


def test_nothing_is_replaced_without_force(session, tmp_path):
    there = tmp_path / "there.rrd"
    there.write_text("mine")
    with pytest.raises(RecordingError):
        session.to_rerun(there)
    assert there.read_text() == "mine"
    with pytest.raises(RecordingError):
        session.to_rerun(tmp_path / "missing" / "out.rrd")
    assert {path.name for path in tmp_path.iterdir()} == {"there.rrd", "session.mcap"}


def test_meshes_are_embedded_where_they_are_installed(session, saved, monkeypatch):
    monkeypatch.undo()
    from g1stream.robot.meshes import with_shapes

    shapes = with_shapes(session.robot)
    if shapes is G1.default():
        pytest.skip("needs the extra `meshes`")
    found = saved(session).static
    meshes = Counter(path.split("/")[0] for path, name in found if name == "Asset3D:blob")
    assert meshes == dict.fromkeys(("measured", "ghost", "reference"), len(read_visuals(shapes)))
