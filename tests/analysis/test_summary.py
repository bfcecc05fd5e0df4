import json
import math
from typing import get_args

import numpy as np
import pytest

from g1stream.analysis.summarise import find_problems, message_stats, summarise_run
from g1stream.analysis.summary import Summary
from g1stream.analysis.tracking import compare
from g1stream.app.session import Session, open_session
from g1stream.config import Config
from g1stream.control.stop import REMEDIES
from g1stream.dds.messages import LowCmd, LowState
from g1stream.robot.joints import JOINT_NAMES
from g1stream.session.records import (
    RecorderSummary,
    StreamSummary,
)
from g1stream.session.source import MemorySource
from g1stream.session.streams import LogEvent, Stream
from g1stream.types import Phase, StopKind

T0 = 1_700_000_000_000_000_000
STREAM = StreamSummary(reason="", commands=2500, support="bolted")
RECORDER = RecorderSummary(
    first_ns=1, lost={"/lowstate": 0, "/reference": 0}, absent=["/secondary_imu"]
)
METADATA = {
    "g1stream": "9.9.9",
    "versions": {"numpy": "2.0"},
    "host": "bench",
    "domain": 3,
    "interface": "lo",
    "motion": {"name": "dance", "fps": 30.0, "frames": 121, "sha256": "ab" * 32, "source": None},
    "gains": {"kp": [40.0] * 28 + [100.0], "kd": [1.0] * 28 + [2.0]},
    "config": Config.model_validate({"stream": {"rate": 250.0}, "dds": {"domain": 3}}).model_dump(
        mode="json"
    ),
    "stream": STREAM.model_dump(mode="json"),
    "recorder": RECORDER.model_dump(mode="json"),
}


@pytest.fixture
def summarise(play, write_session):
    def make(*, metadata=METADATA, streams=None, **settings):
        return open_session(write_session(*(streams or play()), metadata, **settings)).summary()

    return make


SHORT = ((Phase.RAMP, 0.1), (Phase.PLAY, 0.5), (Phase.DAMP, 0.2))


def without(*keys):
    return {key: value for key, value in METADATA.items() if key not in keys}


def test_a_session_without_problems(play, summarise, take, tmp_path):
    summary = summarise(derived={"/tf": take(play().reference, [0, 9])})
    assert summary.problems == []
    assert summary.complete
    path = tmp_path / "session.mcap"
    assert summary.files_bytes == {str(path): path.stat().st_size}
    assert (summary.host, summary.domain, summary.interface) == ("bench", 3, "lo")
    assert summary.versions == {"g1stream": "9.9.9", "numpy": "2.0"}
    assert summary.motion.name == "dance"
    assert [one.phase.name for one in summary.phases] == ["RAMP", "PLAY", "HOLD", "DAMP"]
    np.testing.assert_allclose(
        [one.duration_s for one in summary.phases], [0.5, 4.0, 0.3, 0.198], atol=1e-9
    )
    assert summary.settings == {"stream.rate": 250.0, "dds.domain": 3}
    assert summary.gains == {"kp": (40.0, 100.0), "kd": (1.0, 2.0)}
    assert summary.recorder == RECORDER
    assert summary.duration_s == pytest.approx(5.196, abs=3e-3)
    counts = {topic: (stats.count, stats.lost) for topic, stats in summary.topics.items()}
    assert counts == {
        "/lowcmd": (2500, None),
        "/lowstate": (2599, 0),
        "/reference": (2500, 0),
        "/tf": (2, None),
    }
    stats, derived = summary.topics["/lowcmd"], summary.topics["/tf"]
    assert stats.rate_hz == pytest.approx(500.0)
    assert stats.latency_us.p99 == pytest.approx(100.0)
    assert (derived.rate_hz, derived.latency_us) == (None, None)
    termination = summary.termination
    assert (termination.reason, termination.undamped_in) == ("", None)
    assert (termination.played_s, termination.motion_s) == (pytest.approx(4.0), 4.0)


def test_tracking_is_the_sessions(play, write_session):
    longer = play(0.04, np.linspace(-0.02, 0.05, 29), ((Phase.RAMP, 0.5), (Phase.PLAY, 6.0)))
    session = open_session(write_session(*longer, METADATA))
    assert session.summary().tracking == session.tracking().summary()
    errors = session.summary().tracking.all_joints
    assert errors.delay_s == pytest.approx(0.04, abs=1e-4)
    assert errors.delay_ci95_s == session.tracking().delay.ci95 > 0


@pytest.mark.parametrize(
    ("kind", "fields", "named"),
    [
        (StreamSummary, {"reason": "SIGINT"}, ["SIGINT"]),
        (StreamSummary, {"commands": 10_000, "skipped_ticks": 120}, ["120 ticks"]),
        (StreamSummary, {"commands": 10_000, "skipped_ticks": 12}, None),
        (
            StreamSummary,
            {
                "commands": 10_000,
                "skipped_ticks": 12,
                "lateness_us": {"p50": 20.0, "p99": 90.0, "p99_9": 900.0, "max": 24_000.0},
            },
            ["12 ticks"],
        ),
        (StreamSummary, {"clamped_ticks": {"left_knee_joint": 40}}, None),
        (StreamSummary, {"saturated_ticks": {"left_elbow_joint": 8}}, ["left_elbow_joint 8"]),
        (StreamSummary, {"time_scale": 0.5}, ["0.50", "2.0 times"]),
        (StreamSummary, {"findings": [{"about": "x", "cause": "C.", "remedy": "R."}]}, ["C. R."]),
        (RecorderSummary, {"lost": {"/lowstate": 7}}, ["7 samples", "/lowstate"]),
        (RecorderSummary, {"malformed": {"/lowstate": 1}}, ["1 malformed", "/lowstate"]),
        (RecorderSummary, {"dropped_datagrams": 5}, ["5 datagrams"]),
        (RecorderSummary, {"stopped": "The disk is full."}, ["The disk is full."]),
        (RecorderSummary, {"clock_steps": [{"step_ns": -2_000_000_000}]}, ["-2.000 s"]),
    ],
)
def test_a_problem_is_a_sentence(kind, fields, named):
    """What a robot does not notice is none."""
    record = {"stream" if kind is StreamSummary else "recorder": kind.model_validate(fields)}
    problems = [*find_problems(Summary(first_ns=1, **record))]
    assert len(problems) == (named is not None)
    assert all(word in problems[0] for word in named or ())


def test_gaps_and_clocks_that_differ_are_problems(play, take, summarise):
    reference, measured = play()
    measured.publish_time[:] -= 2_500_000_000
    summary = summarise(streams=(take(reference, np.r_[0:900, 950:2500]), measured))
    gaps = {topic: stats.gaps for topic, stats in summary.topics.items()}
    assert gaps == {"/lowcmd": 1, "/reference": 1, "/lowstate": 0}
    assert summary.topics["/lowstate"].clock_offset_s == pytest.approx(2.5, abs=1e-3)
    assert len(summary.problems) == 2


@pytest.mark.parametrize("kind", get_args(StopKind))
def test_what_to_do_follows_from_the_kind_of_the_stop_and_not_from_its_words(kind):
    stream = StreamSummary(reason="any words", stop=kind)
    (problem,) = find_problems(Summary(stream=stream))
    assert problem == f"The stream ended early: any words. {REMEDIES.get(kind, '')}".strip()
    assert REMEDIES.keys() < {*get_args(StopKind)}


@pytest.mark.parametrize(("step_s", "ended"), [(3600, True), (-3600, False)])
def test_a_clock_that_was_set_changes_no_duration(play, summarise, step_s, ended):
    """In the middle of PLAY; a killed recorder has noted it, too."""
    reference, measured = play()
    for stream in (reference, measured):
        behind = stream.publish_time - T0 > 2_000_000_000
        stream.publish_time[behind] += step_s * 10**9
        stream.log_time[behind] += step_s * 10**9
    steps = {"clock_steps": [{"at_ns": T0, "step_ns": step_s * 10**9}]}
    metadata = METADATA | steps if ended else without("recorder", "stream") | steps
    summary = summarise(streams=(reference, measured), metadata=metadata)
    lengths = {one.phase: one.duration_s for one in summary.phases}
    assert lengths[Phase.PLAY] == pytest.approx(4.0, abs=3e-3)
    assert summary.termination.played_s == pytest.approx(4.0, abs=3e-3)
    assert summary.duration_s == pytest.approx(5.196, abs=5e-3)
    assert summary.tracking.compared_s == pytest.approx(4.0, abs=3e-3)
    assert summary.tracking.all_joints.rmse_rad < 1e-3
    assert summary.topics["/lowstate"].rate_hz == pytest.approx(500.0, abs=0.1)


@pytest.mark.parametrize("step_s", [0.05, -0.05, 2.0])
def test_a_robot_whose_clock_is_set_in_play_is_followed_further(play, summarise, step_s):
    reference, measured = play(0.012)
    behind = measured.publish_time - T0 > 2_000_000_000
    measured.publish_time[behind] += round(step_s * 1e9)
    summary = summarise(streams=(reference, measured), metadata=METADATA)
    followed, (step,) = summary.tracking.all_joints, summary.topics["/lowstate"].clock_steps
    assert followed.delay_s == pytest.approx(0.012, abs=2e-4)
    assert followed.rmse_rad == pytest.approx(compare(*play(0.012)).overall, rel=0.01)
    assert step.step_ns == pytest.approx(step_s * 1e9, abs=1e6)
    assert any("clock of the publisher of /lowstate" in one for one in summary.problems)


@pytest.mark.parametrize(("since", "left_out"), [(2.0, True), (4.1, False)])
def test_ankles_and_waist_that_are_motors_a_and_b_are_not_compared(
    play, write_session, since, left_out
):
    """From within PLAY on, or after it. The robot is where it has to be, but tells its motors."""
    reference, measured = play()
    motors = measured.publish_time - T0 > round(1e9 * since)
    measured.mode_pr[motors] = 1
    for name in ("left_ankle_pitch_joint", "left_ankle_roll_joint", "waist_roll_joint"):
        measured.q[motors, JOINT_NAMES.index(name)] += 0.55
    session = open_session(write_session(reference, measured, METADATA))
    missing = {*JOINT_NAMES} - {*session.summary().tracking.joints}
    ankles = {
        f"{side}_ankle_{axis}_joint" for side in ("left", "right") for axis in ("pitch", "roll")
    }
    assert missing == ((ankles | {"waist_pitch_joint", "waist_roll_joint"}) if left_out else set())
    assert session.tracking().overall < 1e-3
    assert any("mode_pr" in one for one in session.summary().problems)


@pytest.mark.parametrize(("delay", "possible"), [(-0.012, False), (-0.003, True), (0.01, True)])
def test_a_robot_is_not_ahead_of_its_commands(play, summarise, delay, possible):
    stream = METADATA["stream"] | {"preview_s": 0.0}
    summary = summarise(streams=play(delay), metadata=METADATA | {"stream": stream})
    assert any("impossible" in one for one in summary.problems) != possible


@pytest.mark.parametrize(
    ("topic", "wrong", "every", "share"),
    [
        ("/lowcmd", "crc", 4, "25 %"),
        ("/lowcmd", "mode_machine", 4, "25 %"),
        ("/arm_sdk", "crc", 1, "All"),
        ("/arm_sdk", "mode_machine", 4, None),  # which does not matter there
    ],
)
def test_commands_that_the_robot_ignores_are_a_problem(topic, wrong, every, share):
    source, command, state = MemorySource(), LowCmd(), LowState()
    state.quaternion[0] = 1.0
    for i in range(8):
        command.mode_machine[()] = 9 * (wrong == "mode_machine" and i % every == 0)
        command.seal()
        if wrong == "crc" and i % every == 0:
            command.crc[()] = 0
        times = T0 + 2_000_000 * i, T0 + 2_000_000 * i
        source.write("/lowstate", state.seal(), *times)
        source.write(topic, command.tobytes(), *times)
    problems = [one for one in Session(source).summary().problems if topic in one]
    assert len(problems) == (share is not None)
    assert all(one.startswith(share) for one in problems)


def test_an_imu_that_sends_zeros_is_a_problem(play, summarise):
    reference, measured = play()
    measured.imu_quat_wxyz[:100] = 0.0
    (problem,) = summarise(streams=(reference, measured)).problems
    assert f"100 of {len(measured)}" in problem


def test_a_killed_recorder(summarise):
    summary = summarise(close=False)
    assert summary.complete is False
    assert summary.recorder is summary.stream is summary.motion is None
    assert summary.tracking is not None
    assert len(summary.problems) == 1


def test_another_programs_recording(play, summarise):
    summary = summarise(metadata={}, streams=(None, play().measured))
    assert summary.phases == []
    assert summary.tracking is summary.settings is summary.gains is None
    assert summary.termination.played_s is None
    assert summary.topics["/lowstate"].rate_hz == pytest.approx(500.0)


@pytest.mark.parametrize("odd", ["dance", ["dance"], {"stream": {"start": "x"}}])
def test_hostile_metadata_is_a_problem_and_no_traceback(play, summarise, odd):
    keys = ("motion", "config", "gains", "host", "versions", "stream", "recorder", "domain")
    summary = summarise(metadata=dict.fromkeys(keys, odd), streams=play(phases=SHORT))
    assert len(summary.problems) >= 3
    assert str(summary)
    json.dumps(summary.model_dump(mode="json"), allow_nan=False)


@pytest.mark.parametrize("start", [2.5, math.nan, "x", None])
def test_where_the_motion_was_to_begin(play, summarise, start):
    metadata = METADATA | {"config": {"stream": {"start": start}}}
    summary = summarise(metadata=metadata, streams=play(phases=SHORT))
    assert summary.termination.start_s == (2.5 if start == 2.5 else 0.0)


def test_a_policy_plays_a_motion_that_was_cut_at_its_start(play, summarise):
    stream = {"start": 2.5, "policy": "dance.onnx"}
    metadata = METADATA | {"config": {"stream": stream}}
    assert summarise(metadata=metadata, streams=play(phases=SHORT)).termination.start_s == 0.0


def test_warnings_that_differ_in_numbers_only_are_one_problem(play, write_session):
    session = open_session(write_session(*play(phases=SHORT), without("stream")))
    events = [("WARNING", "7 late"), ("WARNING", "9 late"), ("ERROR", "the end")]
    session.log = [LogEvent(0, level, "stream", text) for level, text in events]
    *_, late, end = session.summary().problems
    assert "9 late" in late
    assert "2" in late
    assert "the end" in end


def test_of_two_motions_in_one_session_no_tracking_is_claimed(play, summarise):
    summary = summarise(streams=play(phases=SHORT * 2))
    assert summary.tracking is summary.termination.played_s is None
    assert sum("2 motions" in problem for problem in summary.problems) == 1


ITS_OWN = {"config": {}, "recorder": {}}
"""What a stream's own recorder notes where the stream told nothing at its end."""


@pytest.mark.parametrize(
    ("silence", "metadata", "undamped_in"),
    [
        (0.1, ITS_OWN, Phase.PLAY),  # the recorder outlived it
        (1.0, {"domain": 3}, Phase.PLAY),  # another recorder heard the robot alone
        (0.1, {}, None),  # another recorder may have been ended first
        (0.1, ITS_OWN | {"recorder": {"stopped": "The disk is full."}}, None),
        (1.0, ITS_OWN | {"stream": {"reason": ""}}, None),
    ],
)
def test_a_stream_that_ended_without_damp(play, take, summarise, silence, metadata, undamped_in):
    reference, measured = play(phases=((Phase.RAMP, 0.1), (Phase.PLAY, 1.5)))
    end = reference.publish_time[-1] - 1_000_000_000
    heard = take(measured, measured.publish_time <= end + silence * 1e9)
    asked = take(reference, reference.publish_time <= end)
    summary = summarise(streams=(asked, heard), metadata=metadata)
    assert summary.termination.undamped_in is undamped_in
    assert bool(summary.termination.reason) is (undamped_in is not None)
    assert ("without DAMP" in "".join(summary.problems[:1])) is (undamped_in is not None)


def test_the_summary_of_a_part_of_a_session(play, write_session, tmp_path):
    session = open_session(write_session(*play(), METADATA))
    part = session.sel(phase="PLAY")
    summary = part.summary()
    saved = open_session(part.save(tmp_path / "part.mcap")).summary()
    assert [one.selected for one in (session.summary(), summary, saved)] == [False, True, True]
    assert [one.phase for one in summary.phases] == [Phase.PLAY]
    assert summary.topics["/reference"].count == 2000
    assert session.sel(time=slice(100.0, None)).summary().first_ns is None


def test_a_run_is_summarised_without_reading_its_file(tmp_path):
    path = tmp_path / "s.mcap"
    path.write_bytes(bytes(10))
    recorder = RecorderSummary(
        path=str(path),
        first_ns=10,
        last_ns=2_000_000_010,
        counts={"/lowstate": 5, "/tf": 3},
        lost={"/lowstate": 2, "/lowcmd": 0},
    )
    summary = summarise_run(Config(), recorder=recorder)
    assert summary.files_bytes == {str(path): 10}
    assert summary.duration_s == 2.0
    assert {t: (s.count, s.lost) for t, s in summary.topics.items()} == {
        "/lowstate": (5, 2),
        "/tf": (3, None),
    }
    assert len(summary.problems) == 1
    assert len(summarise_run(Config(), recorder=RecorderSummary()).problems) == 1


def stream(published, latency):
    """A stream from publish times and latencies, ns."""
    published = T0 + np.asarray(published, dtype=np.int64)
    return Stream(log_time=published + np.asarray(latency), publish_time=published)


def test_rate_gaps_and_longest_interval():
    intervals = np.full(1000, 2_000_000)
    # One is just no gap, two are.
    intervals[[100, 500, 800]] = 6_000_000, 6_000_001, 45_000_000
    # Of 0, 1, ..., 1000 us the percentiles are the numbers themselves.
    latency = 1000 * np.random.default_rng(2).permutation(1001)
    stats = message_stats(stream(np.cumsum([0, *intervals]), latency), lost=7)
    assert (stats.count, stats.lost) == (1001, 7)
    assert stats.gaps == 2
    assert stats.longest_interval_s == pytest.approx(0.045)
    assert stats.rate_hz == pytest.approx(1000 / (997 * 0.002 + 0.006 + 0.006000001 + 0.045))
    assert [*vars(stats.latency_us).values()] == pytest.approx([500.0, 990.0, 999.0, 1000.0])
    single = message_stats(stream([0], 70_000))
    assert (single.rate_hz, single.longest_interval_s, single.gaps) == (None, None, 0)
    assert single.latency_us.max == pytest.approx(70.0)


@pytest.mark.parametrize(
    ("latency", "offset"),
    [(0, 0), (20_000_000, 0), (-1000, -1000), (20_000_001, 20_000_001)],
)
def test_clocks_that_cannot_agree_differ(latency, offset):
    assert stream([0, 1000, 2000], latency).clock_offset == offset


def test_a_clock_set_once_or_a_slow_start_is_no_other_clock():
    latency = np.full(1000, 60_000)
    latency[:20] = 90_000_000
    latency[500] = -5_000_000
    assert stream(np.arange(1000) * 2_000_000, latency).clock_offset == 0


def test_messages_that_overtook_each_other(take):
    straight, swapped = stream(np.arange(100) * 2_000_000, 60_000), np.arange(100)
    swapped[[40, 41]] = 41, 40
    assert message_stats(take(straight, swapped)) == message_stats(straight)
