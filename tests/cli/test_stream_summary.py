"""What is said of a motion that was played."""

from __future__ import annotations

import numpy as np
import pytest

from g1stream.cli.stream_summary import exit_code, summary
from g1stream.control.feedforward import Change
from g1stream.control.report import LoopReport
from g1stream.motion.limits import Interval
from g1stream.programs.outcome import StreamOutcome

KNEE = 3
SAID = {"paths": ["s.mcap"], "path": "s.mcap", "stopped": "", "missing": {}, "malformed": {}}


def outcome(interval=None, recording=None, **counted):
    report = LoopReport(2_000_000, np.zeros(29, dtype=np.int64))
    report.commands = 10
    report.lateness.add(1000)
    for name, value in counted.items():
        setattr(report, name, value)
    wire = {"states_received": 9, "states_missed": 0}
    return StreamOutcome(
        "walk", report, recording, wire, [], interval or Interval(0.0, 131.5, 131.5)
    )


@pytest.mark.parametrize(
    ("interval", "told"),
    [
        (Interval(0.0, 131.5, 131.5), "walk: played to its end"),
        (Interval(0.0, 6.0, 131.5), "walk: played 6.0 of 131.5 s"),
        (Interval(2.0, 6.0, 131.5), "walk: played 6.0 of 131.5 s, from 2.0 s on"),
        (Interval(2.0, 129.5, 131.5), "walk: played from 2.0 s to its end"),
        (Interval(1.1, 5.3 - 1.1, 5.3), "walk: played from 1.1 s to its end"),  # 5.299999999999999
        (Interval(0.0, 300.0, 131.5, loop=True), "played for 300.0 s, again and again"),
    ],
)
def test_how_much_was_played(interval, told):
    assert told in summary(outcome(interval)).splitlines()[0]


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ([], "feed-forward  dynamics (bolted)"),
        (
            [Change(2.13, "velocity", "the IMU is odd")],
            "dynamics (bolted) until 2.1 s of the motion, then velocity: the IMU is odd",
        ),
        (
            [Change(2.13, "velocity", "the IMU is odd"), Change(3.0, "dynamics", "")],
            "then velocity: the IMU is odd; 1 change after that, the last at 3.0 s to dynamics",
        ),
    ],
)
def test_what_the_feed_forward_did(changes, told):
    done = outcome(feedforward="dynamics", support="bolted", feedforward_changes=changes)
    (line,) = [line for line in summary(done).splitlines() if "feed-forward" in line]
    assert line.endswith(told)
    events = done.as_dict()["loop"]["feedforward_events"]
    assert [tuple(event.values()) for event in events] == changes
    assert all(list(event) == ["motion_time", "kind", "reason"] for event in events)


def test_velocity_alone_has_no_support_to_name():
    assert "feed-forward  velocity\n" in summary(outcome(feedforward="velocity", support="free"))


def test_joints_that_were_held_are_named():
    clamped = np.zeros(29, dtype=np.int64)
    clamped[[0, KNEE, 7, 12]] = 1, 20, 2, 4
    done = outcome(clamped=clamped)
    assert (
        "27 joint targets held at the joint's limit: left_knee_joint 20, waist_yaw_joint 4, "
        "right_hip_roll_joint 2 and 1 more joint" in summary(done)
    )
    loop = done.as_dict()["loop"]
    assert loop["clamped_ticks"][KNEE] == loop["clamped_joints"]["left_knee_joint"] == 20
    assert loop["saturated_joints"] == {}


def test_the_histogram_comes_last():
    said = outcome().as_dict()
    assert [*said][-1] == "loop"
    assert [*said["loop"]][-1] == "lateness_histogram_us"


def test_one_tick_is_singular():
    assert "1 tick skipped" in summary(outcome(skipped=1))


def test_a_recording_that_lacks_something_is_a_failure():
    whole = {**SAID, "dropped_datagrams": 0}
    assert exit_code(outcome(recording=whole)) == 0
    assert exit_code(outcome(recording={**whole, "missing": {"/lowstate": 1}})) == 1
    assert exit_code(outcome(reason="SIGTERM")) == 143


@pytest.mark.parametrize(
    ("lack", "told"),
    [
        ({"missing": {"/lowstate": 3}}, "missing from /lowstate: 3"),
        ({"malformed": {"/lowstate": 2}}, "malformed on /lowstate: 2"),
        ({"dropped_datagrams": 1}, "1 datagram came that the kernel had no room for"),
        ({"stopped": "the disk is full"}, "it ended early: the disk is full"),
    ],
)
def test_no_failure_is_without_its_reason(lack, told):
    done = outcome(recording={**SAID, "dropped_datagrams": 0, **lack})
    assert exit_code(done) == 1
    assert told in summary(done)
    assert exit_code(outcome(recording={**SAID, "dropped_datagrams": 0})) == 0
