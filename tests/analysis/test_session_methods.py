import numpy as np
import pytest

import g1stream
from g1stream.app.session import Session
from g1stream.errors import RecordingError
from g1stream.session.mcap_reader import Messages
from g1stream.session.source import MemorySource
from g1stream.session.writer import SessionWriter
from g1stream.testing import SyntheticSession
from g1stream.types import Phase
from known_sessions import write_known

LATE = 0.02


@pytest.fixture(scope="module")
def session(play, tmp_path_factory):
    reference, measured = play(LATE)
    path = tmp_path_factory.mktemp("methods") / "session.mcap"
    return g1stream.open_session(
        write_known(path, reference, measured, derived={"/tf": reference[::5]})
    )


def test_a_phase_selects_the_samples_published_in_it(session):
    play = session.sel(phase="PLAY")
    whole = session.reference
    np.testing.assert_array_equal(play.reference.q, whole.q[whole.phase == Phase.PLAY])
    assert [one.phase for one in play.phases] == [Phase.PLAY]
    assert len(play.command) == len(play.reference) == 2000
    inside = (session.measured.time >= 0.0) & (session.measured.time < 4.0)
    np.testing.assert_array_equal(play.measured.q, session.measured.q[inside])
    np.testing.assert_array_equal(play.measured.time, session.measured.time[inside])


def test_a_time_range_includes_both_ends(session):
    part = session.sel(time=slice(1.0, 2.0))
    np.testing.assert_allclose(part.reference.time[[0, -1]], [1.0, 2.0])
    assert len(part.reference) == 501
    assert len(part.sel(time=slice(1.9, None)).reference) == 51
    assert len(session.sel("PLAY", time=slice(3.9, 10.0)).reference) == 50


def test_messages_times_and_the_log_are_selected_too(session):
    part = session.sel(time=slice(1.0, 2.0))
    stamps = [message.publish_time for message in part.messages("/tf")]
    np.testing.assert_array_equal(stamps, part.times["/tf"].publish_time)
    assert len(stamps) == 101
    assert list(part.replay_bytes()) == list(session.replay_bytes())[750:1251]
    assert part.log == []


def test_the_tracking_is_shown_in_one_line(session):
    shown = repr(session.tracking())
    assert "\n" not in shown
    assert len(shown) < 120
    assert f"{session.tracking().overall:.4f} rad" in shown


def test_tracking_of_a_part(session):
    whole, part = session.tracking(), session.sel(time=slice(1.0, 2.0)).tracking()
    assert whole.delay.seconds == pytest.approx(LATE, abs=1e-4)
    inside = (whole.motion_time >= 1.0) & (whole.motion_time <= 2.0)
    np.testing.assert_allclose(part.error, whole.error[inside], atol=1e-9)


def test_an_empty_part_is_not_saved(session, tmp_path):
    part = session.sel(time=slice(50.0, None))
    with pytest.raises(RecordingError, match=r"-0\.5 to 4\.5 s"):
        part.save(tmp_path / "part.mcap")
    assert not list(tmp_path.glob("part*"))


class LongSource(MemorySource):
    """A session that is read in batches of half a second, and counts the messages that were."""

    read = 0

    def batches(self, topics):
        for topic, whole in super().batches(topics):
            for i in range(0, len(whole.data), 250):
                part = slice(i, i + 250)
                self.read += len(whole.data[part])
                yield topic, Messages(*(values[part] for values in whole))


def test_a_session_is_saved_as_it_is_read(tmp_path, monkeypatch):
    """The memory that it takes does not grow with its length."""
    source, ahead = LongSource(), []
    SyntheticSession(12.0).write(source)
    write_batch, written = SessionWriter.write_batch, [0]

    def write(writer, topic, payloads, log_times, publish_times):
        written[0] += len(payloads)
        ahead.append(source.read - written[0])
        write_batch(writer, topic, payloads, log_times, publish_times)

    session = Session(source)
    monkeypatch.setattr(SessionWriter, "write_batch", write)
    source.read = 0
    path = session.save(tmp_path / "long.mcap")
    assert written[0] == source.read == sum(source.topics.values()) > 20_000
    assert max(ahead) < 2.0 * 500 * len(source.topics)  # 2 s
    saved = g1stream.open_session(path)
    for topic in source.topics:
        assert list(saved.messages(topic)) == list(session.messages(topic))


def test_an_unknown_phase_is_named_beside_those_there_are(session):
    with pytest.raises(RecordingError, match=r"JUMP.*PLAY"):
        session.sel("JUMP")


def test_without_a_topic_the_joints_in_play_are_side_by_side(session):
    pytest.importorskip("pandas", reason="the extra `export` is not installed")
    found, table = session.tracking(), session.to_dataframe()
    assert table.index.name == "time"
    np.testing.assert_array_equal(table.index, found.time)
    assert len(table.columns) == 3 * 29
    for what in ("reference", "measured", "error"):
        expected = getattr(found, what)[:, 3]
        np.testing.assert_array_equal(table[f"{what}.left_knee_joint"], expected)
