"""The exit code of a run follows from its summary."""

import json

import pytest

from g1stream.cli.command import exit_code, print_summary
from g1stream.session.summary import RecorderSummary, Summary, Termination


@pytest.mark.parametrize(
    ("reason", "recorder", "code"),
    [
        ("", None, 0),
        ("", {}, 0),
        ("", {"lost": {"/lowstate": 0}}, 0),
        ("", {"lost": {"/lowstate": 1}}, 1),
        ("", {"malformed": {"/lowstate": 1}}, 1),
        ("", {"dropped_datagrams": 1}, 1),
        ("", {"stopped": "The disk is full."}, 1),
        ("", {"first_ns": None}, 1),
        ("no LowState came within 1 s", None, 1),
        ("SIGINT", None, 130),
        ("SIGTERM", {"lost": {"/lowstate": 1}}, 143),
        (None, {}, 0),
    ],
)
def test_the_exit_code(reason, recorder, code):
    received = None if recorder is None else RecorderSummary(**{"first_ns": 1, **recorder})
    assert exit_code(Summary(termination=Termination(reason=reason), recorder=received)) == code


def test_a_file_without_the_recorders_summary_is_not_complete():
    assert exit_code(Summary(files_bytes={"s.mcap": 10}, termination=Termination(reason=""))) == 1


def test_json_is_the_record(capsys):
    summary = Summary(host="bench", recorder=RecorderSummary(lost={"/lowstate": 2}))
    print_summary(summary, as_json=True)
    assert Summary.model_validate(json.loads(capsys.readouterr().out)) == summary
