import sys

import numpy as np
import pytest

from g1stream.app.session import open_session
from g1stream.dds.messages import LOWCMD, LOWSTATE, REFERENCE, SECONDARY_IMU, SPORTMODESTATE
from g1stream.errors import ConfigError, RecordingError
from g1stream.robot.joints import JOINT_NAMES
from g1stream.session.streams import STREAMS

pandas = pytest.importorskip("pandas", reason="the extra `export` is not installed")
parquet = pytest.importorskip("pyarrow.parquet", reason="the extra `export` is not installed")

SOURCES = (LOWCMD, LOWSTATE, REFERENCE, SPORTMODESTATE, SECONDARY_IMU)


@pytest.fixture
def session(make_sample, on_the_wire, write_session):
    kinds = {kind.source: topic for topic, kind in STREAMS.items()}
    streams = ((kinds[s], [on_the_wire(make_sample(s)) for _ in range(8)]) for s in SOURCES)
    return open_session(write_session(*streams))


def test_a_column_for_each_joint(session):
    table = session.to_dataframe("/lowstate")
    for i, joint in enumerate(JOINT_NAMES):
        np.testing.assert_array_equal(table[f"q.{joint}"], session.measured.q[:, i])
    for i, axis in enumerate("wxyz"):
        expected = session.measured.imu_quat_wxyz[:, i]
        np.testing.assert_array_equal(table[f"imu_quat_wxyz.{axis}"], expected)
    for i, axis in enumerate("xyz"):
        np.testing.assert_array_equal(table[f"gyroscope.{axis}"], session.measured.gyroscope[:, i])
    np.testing.assert_array_equal(table["tick"], session.measured.tick)


def test_times_are_exact_and_in_utc(session):
    table = session.to_dataframe("/reference")
    assert str(table.index.tz) == "UTC"
    np.testing.assert_array_equal(table.index.as_unit("ns").asi8, session.reference.publish_time)
    logged = table["log_time"].dt.as_unit("ns").astype("int64")
    np.testing.assert_array_equal(logged, session.reference.log_time)
    np.testing.assert_array_equal(table["time"], session.reference.time)


@pytest.mark.parametrize("topic", [t for t, kind in STREAMS.items() if kind.source in SOURCES])
def test_nothing_is_left_out(session, topic):
    kind = STREAMS[topic]
    table = session.to_dataframe(topic)
    stream = session.stream(kind)
    width = sum(np.atleast_2d(getattr(stream, name).T).shape[0] for name in kind.wire_fields())
    assert table.shape == (8, width + 2)


def test_parquet_reads_back_with_pyarrow(session, tmp_path):
    paths = session.to_parquet(tmp_path / "tables")
    names = ("lowcmd", "lowstate", "reference", "secondary_imu", "sportmodestate")
    assert sorted((tmp_path / "tables").iterdir()) == sorted(paths)
    assert sorted(path.name for path in paths) == [f"{name}.parquet" for name in names]
    table = parquet.read_table(tmp_path / "tables" / "lowcmd.parquet")
    np.testing.assert_array_equal(
        table["kp.left_knee_joint"].to_numpy(),
        session.command.kp[:, JOINT_NAMES.index("left_knee_joint")],
    )
    stamps = table["publish_time"].cast("timestamp[ns]").to_numpy().astype(np.int64)
    np.testing.assert_array_equal(stamps, session.command.publish_time)


def test_a_topic_without_a_table(session):
    with pytest.raises(RecordingError, match="/tf"):
        session.to_dataframe("/tf")


@pytest.mark.parametrize("package", ["pandas", "pyarrow"])
def test_without_the_extra_it_is_named(session, tmp_path, monkeypatch, package):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ConfigError, match=rf"{package}, which is not installed.*\[export\]"):
        session.to_parquet(tmp_path)
