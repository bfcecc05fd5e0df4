"""What info says of sessions whose figures are known."""

import json

import numpy as np
import pytest

from g1stream.analysis.info import describe
from g1stream.analysis.info_text import render_info
from g1stream.analysis.summary import summarise
from g1stream.config import Config
from g1stream.session.session import LogEvent, open_session
from g1stream.session.writer import SessionWriter, SplitLimits

METADATA = {
    "g1stream": "9.9.9",
    "host": "bench",
    "domain": 3,
    "interface": "lo",
    "motion": {"name": "dance", "fps": 30.0, "frames": 121, "sha256": "ab" * 32, "source": None},
    "gains": {"kp": [40.0] * 28 + [100.0], "kd": [1.0] * 28 + [2.0]},
    "config": Config.model_validate({"stream": {"rate": 250.0}, "dds": {"domain": 3}}).model_dump(
        mode="json"
    ),
    "stream": {"reason": "", "commands": 2500, "rate_hz": 500.0, "skipped_ticks": 0},
    "recorder": {"missing": {"/reference": 0, "/lowstate": 0}, "absent": ["rt/secondary_imu"]},
}


@pytest.fixture
def info(play, write_session):
    def look(*, metadata=METADATA, **settings):
        return describe(open_session(write_session(*play(), metadata, **settings)))

    return look


def test_a_session_in_which_all_is_well(info):
    found = info()
    assert found.problems == []
    assert found.complete
    assert [span.phase.name for span in found.phases] == ["RAMP", "PLAY", "HOLD", "DAMP"]
    np.testing.assert_allclose(
        [span.duration_s for span in found.phases], [0.5, 4.0, 0.3, 0.198], atol=1e-9
    )
    assert found.settings == {"stream.rate": 250.0, "dds.domain": 3}
    assert found.gains == {"kp": (40.0, 100.0), "kd": (1.0, 2.0)}
    assert found.absent == ["rt/secondary_imu"]
    assert found.loop.commands == 2500
    stats = found.streams["/reference"]
    assert stats.rate == pytest.approx(500.0)
    assert stats.latency.p50 == pytest.approx(100.0)
    assert found.counts == {"/lowcmd": 2500, "/lowstate": 2599, "/reference": 2500}
    assert found.duration == pytest.approx(5.196, abs=3e-3)


def test_it_is_one_screen(info):
    text = render_info(info())
    lines = text.splitlines()
    assert len(lines) < 40
    assert max(map(len, lines)) <= 100
    for said in (
        "dance",
        "bench",
        "domain 3 on lo",
        "PLAY 4.00 s",
        "nothing is amiss",
        "/lowstate",
    ):
        assert said in text


def test_json_says_the_same(info):
    found = info()
    values = json.loads(json.dumps(found.as_dict()))
    assert values["streams"]["/lowcmd"]["rate_hz"] == pytest.approx(500.0)
    assert values["phases"][1] == {"phase": "PLAY", "duration_s": pytest.approx(4.0)}
    assert values["problems"] == []


@pytest.mark.parametrize(
    ("noted", "told"),
    [("dance", "motion not recorded"), ({"name": "dance"}, "motion dance, ? frames at ? fps")],
)
def test_a_motion_of_somebody_elses_kind_is_told_as_far_as_known(info, noted, told):
    found = info(metadata=METADATA | {"motion": noted, "config": "none"})
    assert found.settings is None
    assert told in _words(render_info(found))


def test_a_killed_recorder_is_told(info):
    found = info(close=False)
    assert not found.complete
    assert any("not closed" in problem for problem in found.problems)
    assert any("did not get to say" in problem for problem in found.problems)
    assert "not closed" in render_info(found)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"recorder": {"missing": {"/lowstate": 7}}}, "never came: /lowstate 7"),
        ({"recorder": {"stopped": "The disk is full."}}, "stopped early: The disk is full."),
        ({"recorder": {"clock": {"steps": [{"step_ns": -2_000_000_000}]}}}, "set by -2.000 s"),
        ({"stream": {"reason": "SIGINT", "skipped_ticks": 0}}, "ended early: SIGINT"),
        ({"stream": {"reason": "", "skipped_ticks": 12}}, "skipped 12 ticks"),
        (
            {"stream": {"clamped_ticks": [1, 2, 3, 40, 5, *[0] * 24]}},
            "Joint targets were held at their limits, ticks: left_knee_joint 40, "
            "left_ankle_pitch_joint 5, left_hip_yaw_joint 3 and 2 more joints.",
        ),
        (
            {"stream": {"saturated_ticks": [*[0] * 27, 8, 9]}},
            "Feed-forward torques were held at their limits, ticks: right_wrist_yaw_joint 9, "
            "right_wrist_pitch_joint 8.",
        ),
    ],
)
def test_what_is_amiss_is_told(info, change, told):
    found = info(metadata=METADATA | change)
    assert any(told in problem for problem in found.problems)
    assert "nothing is amiss" not in render_info(found)


def test_a_part_that_cannot_be_read_is_told(play, tmp_path):
    reference = play().reference
    with SessionWriter(tmp_path / "s", limits=SplitLimits(duration=1)) as writer:
        for i in range(2):
            times = reference.log_time[i], reference.publish_time[i]
            writer.write("/lowcmd", bytes(8), *times)
            writer.flush_if_due(int(times[0]))
    assert [p for p in describe(open_session(tmp_path / "s")).problems if "Part" in p] == []
    writer.paths[1].write_bytes(b"")
    found = describe(open_session(tmp_path / "s"))
    assert any("Part 1" in p and str(writer.paths[1]) in p for p in found.problems)
    assert not found.complete
    writer.paths[1].unlink()
    found = describe(open_session(tmp_path / "s"))
    assert any("Part 1" in p and str(writer.paths[1]) not in p for p in found.problems)


def test_gaps_are_told(play, take, write_session):
    reference, measured = play()
    holed = take(reference, np.r_[0:900, 950:2500])
    found = describe(open_session(write_session(holed, measured, METADATA)))
    assert found.problems == [
        "Gaps: /lowcmd 1 (longest 102.0 ms), /reference 1 (longest 102.0 ms)."
    ]


def test_warnings_that_differ_in_numbers_only_are_told_once(play, write_session):
    path = write_session(*play(), METADATA, close=False)
    session = open_session(path)
    events = [(2, "phase"), (3, "7 ticks late"), (3, "9 ticks late"), (4, "the end")]
    levels = {2: "INFO", 3: "WARNING", 4: "ERROR"}
    session.log = [LogEvent(0, levels[level], "stream", text) for level, text in events]
    problems = describe(session).problems
    assert problems[-2:] == ["stream: 9 ticks late (the last of 2 such)", "stream: the end"]


def test_somebody_elses_session(play, write_session):
    _, measured = play()
    found = describe(open_session(write_session(None, measured, {})))
    assert found.phases == []
    assert found.motion is None
    assert found.settings is None
    assert "not recorded" in render_info(found)


def _words(text):
    return " ".join(text.split())


def test_it_says_how_closely_the_robot_followed(play, write_session):
    path = write_session(*play(0.04, np.linspace(-0.02, 0.05, 29)), METADATA)
    found, summary = describe(open_session(path)), summarise(open_session(path))
    figures = json.loads(json.dumps(found.as_dict()))["tracking"]
    assert figures == summary.as_dict()["tracking"]
    assert figures["delay_s"] == pytest.approx(0.04, abs=1e-4)
    assert (figures["compared_states"], figures["compared_s"]) == (2000, pytest.approx(4.0))
    text = _words(render_info(found))
    assert f"all joints {figures['rmse_rad']:.4f}" in text
    assert f"{figures['worst_joint']} " in text
    assert "the robot is 40.0 ms behind the reference" in text
    assert "2000 states with the reference, over 4.00 s of PLAY" in text


def test_states_in_a_hole_of_the_reference_are_told(play, take, write_session):
    reference, measured = play()
    holed = take(reference, np.r_[0:900, 1050:2500])
    text = render_info(describe(open_session(write_session(holed, measured, METADATA))))
    assert "151 left out, in holes of the reference" in _words(text)


def test_it_says_what_commands_carried(info):
    told = {"reason": "", "feedforward": "dynamics", "support": "hanging"}
    event = {"motion_time": 2.1, "kind": "velocity", "reason": "the pelvis swings"}
    found = info(metadata=METADATA | {"stream": {**told, "feedforward_events": [event]}})
    said = (
        "feedforward dynamics (hanging) until 2.1 s of the motion, then velocity: the pelvis swings"
    )
    assert said in _words(render_info(found))
    loop = json.loads(json.dumps(found.as_dict()))["loop"]
    assert (loop["feedforward"], loop["support"]) == ("dynamics", "hanging")
    assert loop["feedforward_events"] == [event]


UNTOLD = {key: value for key, value in METADATA.items() if key != "stream"}


def test_what_a_killed_streamers_commands_carried_is_in_the_log(play, write_session):
    session = open_session(write_session(*play(), UNTOLD))
    told = "feed-forward: dynamics of a robot that is held bolted"
    session.log = [LogEvent(0, "INFO", "stream", told)]
    found = describe(session)
    assert "feedforward dynamics of a robot that is held bolted" in _words(render_info(found))
    assert found.as_dict()["feedforward_log"] == [told]
