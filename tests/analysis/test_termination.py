"""How sessions ended: as asked, early, or because the streamer was gone."""

import json

import pytest

from g1stream.analysis.info import describe
from g1stream.analysis.info_text import render_info
from g1stream.session.session import open_session
from g1stream.types import Phase

ITS_OWN = {"config": {}, "recorder": {"missing": {}}}
"""What the streamer's own recorder notes, where the streamer told nothing at its end."""


@pytest.fixture
def cut_off(play, take, write_session):
    """What info says of references that end in PLAY and states that go on for `silence` s."""

    def make(silence, metadata):
        reference, measured = play(phases=((Phase.RAMP, 0.5), (Phase.PLAY, 4.0)))
        end = reference.publish_time[-1] - 2_000_000_000
        heard = take(measured, measured.publish_time <= end + silence * 1e9)
        asked = take(reference, reference.publish_time <= end)
        return describe(open_session(write_session(asked, heard, metadata)))

    return make


@pytest.mark.parametrize(
    ("silence", "metadata"),
    [
        (0.1, ITS_OWN),  # which was left behind
        (1.0, {"domain": 3, "interface": "lo"}),  # somebody else's, which heard the robot alone
    ],
)
def test_a_streamer_that_vanished_is_told_first(cut_off, silence, metadata):
    found = cut_off(silence, metadata)
    assert found.problems[0].startswith("The streamer vanished in PLAY, without DAMP")
    values = json.loads(json.dumps(found.as_dict()))
    assert values["ending"]["vanished_in"] == "PLAY"
    assert values["problems"][0] == found.problems[0]
    text = render_info(found)
    assert "ended        in PLAY: the streamer vanished" in text
    assert "nothing is amiss" not in text


@pytest.mark.parametrize(
    ("silence", "metadata"),
    [
        (0.1, {}),  # somebody else's, which may have been ended first
        (0.1, ITS_OWN | {"recorder": {"stopped": "The disk is full."}}),
        (1.0, ITS_OWN | {"stream": {"reason": ""}}),
    ],
)
def test_a_recording_that_may_have_ended_first_accuses_nobody(cut_off, silence, metadata):
    found = cut_off(silence, metadata)
    assert found.ending.vanished_in is None
    assert not any("vanished" in problem for problem in found.problems)
