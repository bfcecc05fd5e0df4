import os
import re
import subprocess
import sys

import numpy as np
import pytest
from mcap.writer import Writer

from g1stream.app.session import open_session
from g1stream.dds.layout import members
from g1stream.dds.messages import (
    LOWCMD,
    LOWSTATE,
    ODOMMODESTATE,
    POLICY,
    REFERENCE,
    SECONDARY_IMU,
    SPORTMODESTATE,
    encode_samples,
)
from g1stream.errors import RecordingError
from g1stream.session.streams import LogEvent
from g1stream.session.writer import SessionWriter
from written_sessions import stock_reader

T0 = 1_700_000_000_000_000_000
STEP = 70_000_000
DELAY = 123_456
IMU = {
    "imu_quat_wxyz": "quaternion",
    "gyroscope": "gyroscope",
    "accelerometer": "accelerometer",
}


@pytest.fixture
def cdr(golden):
    kinds = ("lowcmd", "lowstate")
    return {f"/{kind}": [bytes.fromhex(g["cdr"]) for g in golden[kind]] for kind in kinds}


def test_samples_are_what_the_official_sdk_serialised(golden, cdr, write_session):
    session = open_session(write_session(*cdr.items()))
    measured, states = session.measured, golden["lowstate"]
    # In the field order of the IDL: mode, q, dq, ddq, tau_est, ...
    motors = np.array([[m[:5] for m in s["motor_state"][:29]] for s in states], dtype=np.float64)
    for i, values in enumerate((measured.q, measured.dq, measured.ddq, measured.tau), start=1):
        assert values.dtype == np.float64
        np.testing.assert_array_equal(values, motors[:, :, i])
    for name, field in IMU.items():
        expected = [s["imu_state"][field] for s in states]
        np.testing.assert_array_equal(getattr(measured, name), expected)
    assert measured.tick.tolist() == [s["tick"] for s in states]
    motors = np.array([[m[:6] for m in c["motor_cmd"][:29]] for c in golden["lowcmd"]])
    for i, name in enumerate(("mode", "q", "dq", "tau", "kp", "kd")):
        np.testing.assert_array_equal(getattr(session.command, name), motors[:, :, i])


@pytest.mark.parametrize(
    ("source", "attribute", "fields"),
    [
        (REFERENCE, "reference", {name: name for name in members(REFERENCE.idl_type)}),
        (SPORTMODESTATE, "base", {"position": "position", "velocity": "velocity"}),
        (SECONDARY_IMU, "torso_imu", IMU),
    ],
)
def test_samples_are_what_cyclonedds_serialised(
    cdr, make_sample, on_the_wire, write_session, source, attribute, fields
):
    sent = [make_sample(source) for _ in range(3)]
    topic = next(topic for topic, of in TOPICS.items() if of == source)
    states = ("/lowstate", cdr["/lowstate"])
    path = write_session(states, (topic, [on_the_wire(s) for s in sent]))
    stream = getattr(open_session(path), attribute)
    for name, field in fields.items():
        np.testing.assert_array_equal(getattr(stream, name), [getattr(s, field) for s in sent])


@pytest.mark.parametrize("close", [True, False])
def test_what_surrounds_the_samples_also_of_a_file_that_was_never_closed(cdr, write_session, close):
    session = open_session(write_session(*cdr.items(), close=close))
    assert session.complete is close
    assert session.topics == {"/lowcmd": 6, "/lowstate": 6, "/log": 1}
    assert session.metadata == {"domain": 1, "versions": {"g1stream": "0.1.0"}, "at_end": close}
    assert session.attachments == {"motion.csv": b"Frame,X\n"}
    assert session.log == [LogEvent(T0, "WARNING", "stream", "late by 3 ms")]
    assert session.log[0].time_ns == T0
    assert session.base is session.torso_imu is None
    assert list(session.replay_bytes("/lowstate")) == cdr["/lowstate"]


def test_a_missing_topic_is_named_with_those_there_are(cdr, write_session):
    session = open_session(write_session(("/lowcmd", cdr["/lowcmd"])))
    for read in (lambda: session.measured, lambda: next(session.replay_bytes("/lowstate"))):
        with pytest.raises(RecordingError, match=r"/lowstate.*/log, /lowcmd"):
            read()


def test_samples_of_another_layout_are_refused(cdr, write_session):
    path = write_session(("/lowstate", [cdr["/lowstate"][0][:-4]]))
    with pytest.raises(RecordingError, match=r"/lowstate .* 2088 bytes.* 2092"):
        _ = open_session(path).measured.q


@pytest.mark.parametrize(
    ("name", "content"), [("nowhere.mcap", None), ("empty.mcap", ""), ("motion.npz", "Frame,X\n")]
)
def test_what_is_no_mcap_file_is_named(tmp_path, name, content):
    if content is not None:
        (tmp_path / name).write_text(content)
    with pytest.raises(RecordingError, match=re.escape(name)):
        open_session(tmp_path / name)


@pytest.mark.parametrize("topics", [[], ["/camera"]])
def test_an_mcap_without_our_topics(tmp_path, topics):
    path = tmp_path / "other.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        for topic in topics:
            writer.add_message(writer.register_channel(topic, "json", 0), T0, b"{}", T0)
        writer.finish()
    with pytest.raises(RecordingError) as error:
        open_session(path)
    for name in (path.name, "/reference", "/lowcmd", "/lowstate", *topics):
        assert name in error.value.cause


@pytest.mark.parametrize(
    ("topic", "ours"), [("/scene", True), ("/scene", False), ("/measured/tf", True)]
)
def test_what_is_left_of_a_session_is_named(tmp_path, topic, ours):
    with SessionWriter(tmp_path / "left.mcap") as writer:
        writer.add_metadata({"started_ns": 1, "domain": 171, "interface": "lo"} if ours else {})
        writer.write(topic, b"", 1, 1)
    with pytest.raises(RecordingError) as caught:
        open_session(writer.path)
    nothing = ours and topic == "/scene"
    assert ("Nothing was recorded" in caught.value.cause) is nothing
    assert ("g1stream doctor --domain 171" in caught.value.remedy) is nothing
    assert ("/measured/tf" in caught.value.cause) is (topic != "/scene")


TOPICS = {
    "/lowcmd": LOWCMD,
    "/lowstate": LOWSTATE,
    "/reference": REFERENCE,
    "/policy": POLICY,
    "/sportmodestate": SPORTMODESTATE,
    "/secondary_imu": SECONDARY_IMU,
}


@pytest.fixture
def sent(make_sample, on_the_wire):
    return {
        name: [on_the_wire(make_sample(topic)) for _ in range(17)] for name, topic in TOPICS.items()
    }


def test_the_bytes_come_back_with_their_times(sent, write_session):
    session = open_session(write_session(*sent.items()))
    times = session.times
    assert list(times) == sorted([*TOPICS, "/log"])
    for topic, samples in sent.items():
        assert list(session.replay_bytes(topic)) == samples
        np.testing.assert_array_equal(times[topic].publish_time, T0 + STEP * np.arange(17))
        np.testing.assert_array_equal(times[topic].log_time, times[topic].publish_time + DELAY)
    assert list(session.replay_bytes()) == sent["/lowcmd"]


def passes_doctor(path):
    """Check a file with pymcap-cli."""
    program = "from sys import exit; from pymcap_cli.cli import main; exit(main())"
    command = [sys.executable, "-c", program, "doctor", str(path)]
    result = subprocess.run(command, check=False, capture_output=True, text=True, timeout=60)
    assert result.returncode == 0, result.stdout
    assert "passed" in result.stdout


@pytest.mark.parametrize("share", [0.35, 0.99])
def test_a_copy_of_a_cut_file_has_its_index_and_every_message(
    write_session, make_sample, on_the_wire, tmp_path, share
):
    sent = {
        f"/{topic.name[3:]}": [on_the_wire(make_sample(topic)) for _ in range(40)]
        for topic in (LOWCMD, LOWSTATE)
    }
    path, whole = write_session(*sent.items(), close=False), tmp_path / "whole.mcap"
    os.truncate(path, int(path.stat().st_size * share))
    killed = open_session(path)
    before = {topic: list(killed.messages(topic)) for topic in killed.topics}
    killed.save(whole)
    copied = open_session(whole)
    assert copied.complete
    assert not copied.closed
    assert {topic: list(copied.messages(topic)) for topic in copied.topics} == before
    reader = stock_reader(whole, validate_crcs=True)
    summary = reader.get_summary()
    assert summary.statistics.message_count == sum(map(len, before.values()))
    assert len(summary.chunk_indexes) == summary.statistics.chunk_count
    assert [one.name for one in reader.iter_attachments()] == ["motion.csv"]
    assert any("did not close the file" in one for one in copied.summary().problems)
    passes_doctor(whole)


def test_a_g1_has_other_topics_for_state_and_base(tmp_path):
    """As ros2 bag records them: its /sportmodestate has another type, of 16 bytes."""
    path, stamps = tmp_path / "g1.mcap", T0 + 50_000_000 * np.arange(20)
    heights = np.linspace(0.7, 0.8, 20)
    state = {"motor_state.q": np.tile(heights[:, None], 29)}
    base = {"position": np.column_stack([heights, heights, heights])}
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        for topic, kind, data in (
            (
                "/lf/lowstate",
                "unitree_hg::msg::dds_::LowState_",
                encode_samples(LOWSTATE, state, 20),
            ),
            (
                "/odommodestate",
                "unitree_go/msg/SportModeState",
                encode_samples(ODOMMODESTATE, base, 20),
            ),
            ("/sportmodestate", "unitree_hg/msg/SportModeState", np.zeros((30, 20), np.uint8)),
        ):
            schema = writer.register_schema(kind, "ros2msg", b"")
            channel = writer.register_channel(topic, "cdr", schema)
            for sample, stamp in zip(data, stamps, strict=False):
                writer.add_message(channel, int(stamp), sample.tobytes(), int(stamp))
        writer.finish()
    session = open_session(path)
    np.testing.assert_allclose(session.measured.q[:, 3], heights, atol=1e-6)
    np.testing.assert_allclose(session.base.position[:, 2], heights, atol=1e-6)
    summary = session.summary()
    assert summary.topics["/lowstate"].rate_hz == pytest.approx(20.0)
    assert summary.log == {
        "/lowstate": "read from /lf/lowstate",
        "/sportmodestate": "read from /odommodestate",
    }
    assert session.topics["/sportmodestate (unitree_hg/msg/SportModeState)"] == 20
