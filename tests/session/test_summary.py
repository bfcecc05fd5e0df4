import json
import math

import pytest

from g1stream.analysis.summary import Summary, Termination
from g1stream.realtime import Grant
from g1stream.session.records import (
    FeedForwardChange,
    Percentiles,
    PhaseInterval,
    RecorderSummary,
    SessionInfo,
    StreamSummary,
    read_record,
)
from g1stream.types import Phase

STREAM = StreamSummary(
    reason="",
    commands=9500,
    lateness_us=Percentiles(p50=60.0, p99=117.0, p99_9=180.0, max=1734.0),
    lateness_histogram_us={60: 9499, 1733: 1},
    clamped_ticks={"left_knee_joint": 3},
    feedforward_changes=[FeedForwardChange(motion_time_s=1.5, kind="velocity", reason="why")],
    realtime=[Grant("SCHED_FIFO", granted=False, detail="not permitted")],
)


def test_a_record_is_read_back_from_json_as_it_was_written():
    summary = Summary(
        stream=STREAM,
        first_ns=10,
        last_ns=2_000_000_010,
        phases=[PhaseInterval(phase=Phase.PLAY, start_s=3.0, end_s=17.0)],
        termination=Termination(undamped_in=Phase.PLAY),
    )
    values = json.loads(json.dumps(summary.model_dump(mode="json"), allow_nan=False))
    assert values["phases"][0]["phase"] == values["termination"]["undamped_in"] == "PLAY"
    assert values["duration_s"] == 2.0
    assert Summary.model_validate(values) == summary
    assert read_record(StreamSummary, values["stream"], "stream") == (STREAM, [])


def test_fields_of_another_version_are_ignored_or_unknown():
    record, problems = read_record(StreamSummary, {"commands": 3, "new_in_2030": [1]}, "stream")
    assert record == StreamSummary(commands=3)
    assert not problems


@pytest.mark.parametrize(
    ("kind", "field", "value"),
    [
        (StreamSummary, "rate_hz", math.nan),
        (StreamSummary, "commands", "many"),
        (StreamSummary, "clamped_ticks", [0] * 29),
        (StreamSummary, "feedforward_changes", [{}]),
        (StreamSummary, "realtime", 5),
        (RecorderSummary, "lost", {"/lowstate": None}),
        (RecorderSummary, "first_ns", 10**30),
        (SessionInfo, "motion", "dance"),
        (Termination, "undamped_in", ["PLAY"]),
    ],
)
def test_a_value_that_is_not_valid_is_left_out_and_named(kind, field, value):
    record, (problem,) = read_record(kind, {field: value}, "key")
    assert record == kind()
    assert f"key.{field}" in problem


@pytest.mark.parametrize("values", ["text", [1]])
def test_what_is_no_table_is_no_record(values):
    record, (problem,) = read_record(RecorderSummary, values, "recorder")
    assert record is None
    assert "recorder" in problem
    assert read_record(RecorderSummary, None) == (None, [])


def test_a_recording_is_complete_if_nothing_is_known_to_be_missing():
    assert RecorderSummary(lost={"/lowstate": 0}).complete
    for lack in (
        {"lost": {"/lowstate": 1}},
        {"malformed": {"/lowstate": 1}},
        {"dropped_datagrams": 1},
        {"stopped": "The disk is full."},
    ):
        assert not RecorderSummary(**lack).complete
