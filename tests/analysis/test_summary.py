"""The summary of a session file, against other people's readers and the text itself."""

import json
import re

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from scipy.interpolate import make_interp_spline

from g1stream.analysis.summary import render, summarise
from g1stream.robot.joints import JOINT_GROUPS
from g1stream.session.session import open_session

METADATA = {
    "motion": {"name": "dance"},
    "stream": {
        "reason": "",
        "commands": 2500,
        "rate_hz": 499.987,
        "nominal_rate_hz": 500.0,
        "lateness_us": {"p50": 12.0, "p99": 80.0, "p99.9": 310.0, "max": 1234.567},
        "lateness_histogram_us": {"12": 2500},
        "skipped_ticks": 3,
        "worst_work_us": 400.0,
        "states": 2400,
        "clamped_ticks": [0] * 14 + [81] + [0] * 14,
        "feedforward": "dynamics",
        "support": "bolted",
        "saturated_ticks": [0] * 18 + [7] + [0] * 10,
    },
    "recorder": {"counts": {}, "missing": {"/lowstate": 4, "/reference": 0}, "duration_s": 5.0},
}


@pytest.fixture
def summary_of(play, write_session):
    """The summary of a session of a late, sagging robot."""

    def make(metadata=METADATA, **how):
        streams = play(0.04, np.linspace(-0.02, 0.05, 29))
        return summarise(open_session(write_session(*streams, metadata, **how)))

    return make


def _lines(text, name):
    """The words of the line, or of the wrapped lines, that begin with a name."""
    found = re.search(rf"^{name}  .*(\n {{11}}.*)*", text, re.MULTILINE)
    return " ".join(found.group().split()) if found else None


def test_rmse_by_group_as_other_readers_see_the_file(play, write_session):
    path = write_session(*play(0.04, np.linspace(-0.02, 0.05, 29)))
    seen = {"/reference": [], "/lowstate": []}
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages(topics=list(seen)):
            seen[channel.topic].append((message.publish_time, decoded))
    start = seen["/reference"][0][0]
    times = np.array([stamp - start for stamp, _ in seen["/reference"]]) / 1e9
    asked = make_interp_spline(times, np.array([m.q for _, m in seen["/reference"]]), k=1)
    played = times[[m.phase == 2 for _, m in seen["/reference"]]]
    after = times[np.searchsorted(times, played[-1]) + 1]
    states = [(stamp - start) / 1e9 for stamp, _ in seen["/lowstate"]]
    q = np.array([[motor.q for motor in m.motor_state[:29]] for _, m in seen["/lowstate"]])
    inside = (states >= played[0]) & (states < after)
    error = asked(np.array(states)[inside]) - q[inside]

    figures = summarise(open_session(path)).as_dict()
    assert figures["tracking"]["compared_states"] == len(error) == 2000
    for group, joints in JOINT_GROUPS.items():
        expected = np.sqrt(np.mean(error[:, list(joints)] ** 2))
        assert figures["tracking"]["rmse_rad_by_group"][group] == pytest.approx(expected, rel=1e-9)


def test_the_dict_is_json_with_everything_in_it(summary_of):
    figures = summary_of().as_dict()
    assert json.loads(json.dumps(figures, allow_nan=False)) == figures
    assert figures["motion"] == "dance"
    assert figures["tracking"]["compared_s"] == pytest.approx(4.0)
    assert figures["tracking"]["delay_s"] == pytest.approx(0.04, abs=1e-4)
    assert figures["tracking"]["joints"]["left_knee_joint"]["mean_rad"] == pytest.approx(
        0.02 - 0.07 * 3 / 28, abs=2e-5
    )
    assert figures["loop"] == {
        "reason": "",
        "commands": 2500,
        "rate_hz": 499.987,
        "nominal_rate_hz": 500.0,
        "lateness_us": METADATA["stream"]["lateness_us"],
        "skipped_ticks": 3,
        "clamped_ticks": {"waist_pitch_joint": 81},
        "feedforward": "dynamics",
        "support": "bolted",
        "feedforward_events": [],
        "saturated_ticks": {"left_elbow_joint": 7},
    }
    assert figures["missing"] == {"/lowstate": 4, "/reference": 0}
    assert figures["counts"] == {"/lowcmd": 2500, "/lowstate": 2599, "/reference": 2500}
    assert figures["streams"]["/lowcmd"]["rate_hz"] == pytest.approx(500.0)
    assert figures["streams"]["/lowcmd"]["latency_us"]["p99"] == pytest.approx(100.0)
    assert figures["notes"] == []


def test_the_text_says_what_the_figures_are(summary_of):
    summary = summary_of()
    text, figures = render(summary), summary.as_dict()["tracking"]
    for group, rmse in figures["rmse_rad_by_group"].items():
        row = _lines(text, group.replace("_", " "))
        assert f"{rmse:.4f} {np.degrees(rmse):.3f}" in row
    assert f"{figures['rmse_rad']:.4f}" in _lines(text, "all joints")
    assert figures["worst_joint"] in _lines(text, "all joints")
    assert _lines(text, "motion") == "motion dance"
    assert _lines(text, "ended") == "ended at the motion's end"
    assert "40.0 ms behind the reference" in _lines(text, "delay")
    expected = "commands 2500 at 499.99 Hz (500 asked for), 3 ticks skipped"
    assert _lines(text, "commands") == expected
    assert _lines(text, "lateness") == "lateness p50 12 us, p99 80 us, p99.9 310 us, max 1235 us"
    assert _lines(text, "limits").endswith("waist_pitch_joint 81")
    assert _lines(text, "torques").endswith("left_elbow_joint 7")
    assert _lines(text, "feedforward") == "feedforward dynamics (bolted)"
    assert (
        _lines(text, "compared") == "compared 2000 states with the reference, over 4.00 s of PLAY"
    )
    assert _lines(text, "/lowcmd") == "/lowcmd 2500 500.0 0 2.0 100 100 100 100"
    assert _lines(text, "missing").startswith("missing /lowstate 4, /reference 0")
    assert _lines(text, "note") is None


def test_no_line_is_too_long_and_columns_are_aligned(summary_of):
    everything = {"clamped_ticks": [12345] * 29, "reason": "somebody else writes rt/lowcmd: " * 4}
    text = render(summary_of({**METADATA, "stream": {**METADATA["stream"], **everything}}))
    lines = text.splitlines()
    assert max(map(len, lines)) <= 100
    assert not any(line != line.rstrip() for line in lines)
    for i, rule in enumerate(lines):
        if set(rule) == {"-", " "}:
            for line in (lines[i - 1], *lines[i + 1 : i + 4]):
                gaps = {k for k, (a, b) in enumerate(zip(rule, line, strict=False)) if a == " "}
                assert all(line[k] == " " for k in gaps)


def test_what_was_not_recorded_is_said(summary_of):
    summary = summary_of({})
    assert (summary.motion, summary.loop, summary.missing) == (None, None, None)
    text = render(summary)
    for name in ("motion", "ended", "feedforward", "commands", "lateness", "missing"):
        assert _lines(text, name) == f"{name} not recorded"
    assert _lines(text, "all joints") is not None


def test_the_file_is_named_as_it_was_given(summary_of, tmp_path):
    assert _lines(render(summary_of()), "session") == f"session {tmp_path / 'session.mcap'}"


def test_topics_that_are_derived_have_figures_too(play, write_session, take):
    reference, measured = play()
    path = write_session(reference, measured, derived={"/tf": take(reference, slice(0, 2500, 5))})
    text = render(summarise(open_session(path)))
    assert _lines(text, "/tf") == "/tf 500 100.0 0 10.0 100 100 100 100"


@pytest.mark.parametrize(
    ("frames", "reason", "ended"),
    [
        (121, "", "ended at the motion's end"),
        (301, "", "ended as asked; played 4.0 of 10.0 s"),
        (301, "SIGINT", "ended early: SIGINT; played 4.0 of 10.0 s"),
        (31, "", "ended as asked; played 4.0 s, the motion of 1.0 s repeatedly"),
    ],
)
def test_how_much_was_played(summary_of, frames, reason, ended):
    motion = {"name": "dance", "fps": 30.0, "frames": frames}
    stream = {**METADATA["stream"], "reason": reason}
    summary = summary_of({**METADATA, "motion": motion, "stream": stream})
    assert _lines(render(summary), "ended") == ended
    figures = summary.as_dict()["ending"]
    assert figures == {
        "reason": reason,
        "vanished_in": None,
        "played_s": pytest.approx(4.0),
        "motion_s": pytest.approx((frames - 1) / 30),
        "start_s": 0.0,
    }


@pytest.mark.parametrize(
    ("start", "ended"),
    [
        (6.0, "ended at the motion's end; played from 6.0 s to its end"),
        (2.0, "ended as asked; played 4.0 of 10.0 s, from 2.0 s on"),
        (8.0, "ended as asked; played 4.0 s, the motion of 10.0 s repeatedly"),
    ],
)
def test_where_it_was_to_begin_counts(summary_of, start, ended):
    motion = {"name": "dance", "fps": 30.0, "frames": 301}
    config = {"stream": {"start": start}}
    summary = summary_of({**METADATA, "motion": motion, "config": config})
    assert _lines(render(summary), "ended") == ended
    assert summary.as_dict()["ending"]["start_s"] == start


@pytest.mark.parametrize("odd", ["dance", 7, ["dance"], None])
def test_a_motion_of_somebody_elses_kind_is_as_good_as_none(summary_of, odd):
    summary = summary_of({"motion": odd, "config": odd})
    assert summary.motion is None
    assert summary.ending.motion is None


@pytest.mark.parametrize(
    ("events", "said"),
    [
        (
            [{"motion_time": 2.13, "kind": "velocity", "reason": "the pelvis swings"}],
            "dynamics (bolted) until 2.1 s of the motion, then velocity: the pelvis swings",
        ),
        (
            [
                {"motion_time": 2.13, "kind": "velocity", "reason": "the IMU is silent"},
                {"motion_time": 3.0, "kind": "dynamics", "reason": ""},
            ],
            "dynamics (bolted) until 2.1 s of the motion, then velocity: the IMU is silent; "
            "1 change after that, the last at 3.0 s to dynamics",
        ),
        ([{"kind": "velocity"}], "dynamics (bolted) until ? s of the motion, then velocity"),
        (
            [{"motion_time": 1.0}, {}],
            "dynamics (bolted) until 1.0 s of the motion, then ?; 1 change after that, the last "
            "at ? s to ?",
        ),
    ],
)
def test_a_torque_that_was_given_up_is_told(summary_of, events, said):
    summary = summary_of({"stream": {**METADATA["stream"], "feedforward_events": events}})
    assert _lines(render(summary), "feedforward") == f"feedforward {said}"
    assert summary.as_dict()["loop"]["feedforward_events"] == events


def test_velocity_alone_has_no_support_to_name(summary_of):
    summary = summary_of({"stream": {**METADATA["stream"], "feedforward": "velocity"}})
    assert _lines(render(summary), "feedforward") == "feedforward velocity"


def test_a_streamer_that_told_only_a_part(summary_of):
    told = {"reason": "SIGINT", "commands": 1, "rate_hz": None, "lateness_us": {"max": 0.0}}
    summary = summary_of({"stream": told})
    json.dumps(summary.as_dict(), allow_nan=False)
    text = render(summary)
    assert _lines(text, "ended") == "ended early: SIGINT"
    assert _lines(text, "commands") == "commands 1 at ? Hz (? asked for), ? ticks skipped"
    assert _lines(text, "lateness") == "lateness not recorded"


def test_a_recorder_that_was_killed(summary_of):
    summary = summary_of(close=False)
    assert summary.tracking is not None
    assert _lines(render(summary), "missing") == "missing not recorded"
    assert "not closed by its recorder" in _lines(render(summary), "note")


def test_a_session_without_a_robot(play, write_session):
    summary = summarise(open_session(write_session(reference=play().reference)))
    json.dumps(summary.as_dict(), allow_nan=False)
    text = render(summary)
    assert _lines(text, "tracking") == "tracking not recorded"
    assert "no messages on /lowstate." in _lines(text, "note")


def test_a_session_without_a_streamer(play, write_session):
    text = render(summarise(open_session(write_session(measured=play().measured))))
    assert "no messages on /reference." in _lines(text, "note")
    assert _lines(text, "/lowstate").startswith("/lowstate 2599 500.0")


def test_a_session_that_ended_before_play(play, take, write_session):
    streams = [take(stream, slice(0, 200)) for stream in play()]
    summary = summarise(open_session(write_session(*streams)))
    assert summary.tracking is None
    assert "no state came while the motion was played" in _lines(render(summary), "note")


def test_a_robot_that_stands_still(play, take, write_session):
    reference, measured = play()
    measured.q[:] = 0.0
    text = render(summarise(open_session(write_session(reference, measured))))
    assert _lines(text, "delay").startswith("delay not determined")


def test_a_robot_that_is_ahead(play, write_session):
    text = render(summarise(open_session(write_session(*play(-0.0107)))))
    assert "10.7 ms ahead of the reference" in _lines(text, "delay")


def test_clocks_that_differ_and_holes_are_noted(play, take, write_session):
    reference, measured = play()
    at = (reference.publish_time - reference.publish_time[0]) / 1e9
    measured.publish_time[:] -= 2_500_000_000
    path = write_session(take(reference, (at <= 2.0) | (at >= 2.3)), measured)
    text = render(summarise(open_session(path)))
    notes = " ".join(text[text.index("\nnote") :].split())
    assert "off the recorder's clock: /lowstate by -2.500 s." in notes
    assert "fell into holes of the reference: 150." in notes
    assert _lines(text, "/reference").split()[3:5] == ["1", "300.0"]
