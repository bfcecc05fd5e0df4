import base64
import csv
import gzip
import io
import json
import re
import sys
from html.parser import HTMLParser

import numpy as np
import pytest

import g1stream
from g1stream.app.session import open_session
from g1stream.cli.demo import _write_page
from g1stream.errors import ConfigError, RecordingError
from g1stream.extras.report.page import numbers, to_csv


class Page(HTMLParser):
    """The values in the tables of a page, by key, and as they are shown; its text; its scripts."""

    def __init__(self, text):
        super().__init__()
        self.values, self.shown, self.texts, self.scripts = {}, {}, [], []
        self._key, self._in = None, []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self._in.append(tag)
        found = dict(attributes)
        if tag == "data":
            self._key = found["data-key"]
            self.values[self._key] = json.loads(found["value"])
        if tag == "script":
            self.scripts.append(found.get("id"))

    def handle_endtag(self, tag):
        while self._in and self._in.pop() != tag:
            pass

    def handle_data(self, data):
        if "data" in self._in:
            self.shown[self._key] = data
        if not {"script", "style"} & set(self._in):
            self.texts.append(data)


def figures(text):
    packed = re.search(r'id="figures">([^<]+)<', text)[1]
    return json.loads(gzip.decompress(base64.b64decode(packed)))


def floats(text):
    return np.frombuffer(base64.b64decode(text), dtype="<f4")


def at(values, key):
    for part in key.split("."):
        values = values[int(part) if isinstance(values, list) else part]
    return values


def assert_values(page, values):
    """Every value of a page is that of the JSON."""
    assert page.values == {key: at(values, key) for key in page.values}


@pytest.fixture
def path(play, write_session):
    return write_session(
        *play(0.04, 0.1), {"motion": {"name": "dance"}, "versions": {"numpy": "9"}}
    )


def test_the_tables_are_the_json_and_a_video_beside_the_session_is_shown(path, tmp_path):
    path.with_suffix(".mp4").write_bytes(b"film")
    text = g1stream.report.report(path, tmp_path / "report.html").read_text()
    assert f"data:video/mp4;base64,{base64.b64encode(b'film').decode()}" in text
    page, values = Page(text), numbers(path)
    assert len(page.values) > 29 * 5
    assert_values(page, values)
    for joint, one in values["sessions"][0]["metrics"]["tracking"]["joints"].items():
        key = f"sessions.0.metrics.tracking.joints.{joint}"
        assert page.shown[f"{key}.rmse_rad"] == f"{np.degrees(one['rmse_rad']):.3f}"
        assert page.values[f"{key}.max_abs_rad"] == one["max_abs_rad"]
    words = " ".join(page.texts)
    for what in ("dance", "numpy 9", "RAMP 0.50 s"):
        assert what in words


def test_the_numbers_are_the_sessions(path):
    (one,) = numbers(path)["sessions"]
    session = open_session(path)
    assert one["metrics"] == json.loads(session.metrics().model_dump_json())
    assert one["summary"] == json.loads(session.summary().model_dump_json())
    rows = list(csv.DictReader(io.StringIO(to_csv(path))))
    assert {row["session"] for row in rows} == {str(path)}
    told = {row["key"]: row["value"] for row in rows}
    knee = one["metrics"]["tracking"]["joints"]["left_knee_joint"]
    assert float(told["tracking.joints.left_knee_joint.rmse_rad"]) == knee["rmse_rad"]


@pytest.mark.slow
def test_headings_are_printed_as_they_are_written(tmp_path):
    session = g1stream.rollout("demo", seconds=6.0)  # long enough for the delay's interval
    text = g1stream.report.report(session, tmp_path / "report.html").read_text(encoding="utf-8")
    heads = re.findall(r"<th[^>]*>([^<]*)", text)
    assert "± 95 %" in heads
    assert not [head for head in heads if "\\" in head]


def test_the_figures_lose_no_peak(play, write_session, tmp_path):
    reference, measured = play(phases=((1, 0.5), (2, 9.0), (4, 0.2)))
    measured.q[4321, 7] += 0.5
    path = write_session(reference, measured)
    (drawn,) = figures(g1stream.report.report(path, tmp_path / "report.html").read_text())
    error = open_session(path).tracking().error[:, 7]
    (line,) = drawn["signals"]["error"]["lines"]
    shown = floats(line["joints"][7]["y"])
    assert len(shown) < len(error) / 2
    assert np.abs(shown).max() == pytest.approx(np.degrees(np.abs(error).max()))
    assert len(floats(line["joints"][7]["x"])) == len(shown)
    assert drawn["first_joint"] == int(open_session(path).tracking().max_abs.argmax())


@pytest.mark.slow
def test_what_is_shown_of_physics_and_pelvis_depends_on_how_a_robot_was_held(short, tmp_path):
    path = tmp_path / "walk.csv"
    g1stream.load_motion("demo").frames(0, 24).save(path)
    whole, part = g1stream.load_motion(path), g1stream.load_motion(path).frames(0, 18)
    rollouts = [
        g1stream.rollout(motion, support=support, seconds=0.5, config=short)
        for motion, support in ((whole, "bolted"), (part, "follow"))
    ]
    page = Page(g1stream.report.report(rollouts, tmp_path / "report.html").read_text())
    values = numbers(rollouts)
    assert_values(page, values)
    attached, reference = (one["physics"] for one in values["sessions"])
    frames = round(0.5 * whole.fps) + 1  # of an attached motion with that of its end
    played = g1stream.physics.motion_physics(whole, frames=range(frames))
    assert attached == json.loads(played.model_dump_json())
    assert reference["frames"] == frames - 1
    torques, body = (
        [{key.split(".")[4] for key in page.values if f"sessions.{i}.{of}." in key} for i in (0, 1)]
        for of in ("physics.torques", "metrics.body")
    )
    assert torques == [{"bolted"}, {"follow"}]
    assert not any(".physics.feet." in key for key in page.values)
    of_pelvis = {"world", "root_relative", "pelvis", "terminations", "mjlab"}
    assert not body[0] & of_pelvis
    assert of_pelvis <= body[1]
    assert "pelvis_frame" in body[0]
    assert values["sessions"][0]["metrics"]["body"]["world"] is not None


def test_the_physics_of_nothing(play, write_session, tmp_path):
    twice = ((1, 0.2), (2, 0.5), (3, 0.2), (2, 0.5), (4, 0.2))
    without = play()._replace(reference=None)
    cases = {"Several motions": play(phases=twice), "has no /reference": without}
    for reason, streams in cases.items():
        path = write_session(*streams, name=f"{reason.replace('/', '')}.mcap")
        assert numbers(path)["sessions"][0]["physics"] is None
        page = g1stream.report.report(path, path.with_suffix(".html")).read_text()
        section = page.partition("Physics of the motion")[2].partition("<h3>")[0]
        assert reason in section


@pytest.mark.parametrize("lacks", ["reference", "measured"])
def test_a_session_that_lacks_something_says_so(play, write_session, tmp_path, lacks):
    streams = play()._asdict() | {lacks: None}
    path = write_session(**streams)
    text = g1stream.report.report(path, tmp_path / "report.html").read_text()
    reason = numbers(path)["sessions"][0]["metrics"]["missing"]["tracking"]
    assert reason in " ".join(Page(text).texts)
    (drawn,) = figures(text)
    assert len(drawn["signals"]["q"]["lines"]) == 1
    assert 'data-figure="joint"' in text
    assert 'data-figure="rmse_deg"' not in text


@pytest.mark.slow
def test_the_session_of_a_killed_recorder(play, write_session, tmp_path):
    path = write_session(*play(), close=False)
    page = Page(g1stream.report.report(path, tmp_path / "report.html").read_text())
    assert "did not close the file" in " ".join(page.texts)
    assert "sessions.0.metrics.tracking.all_joints.rmse_rad" in page.values


def test_a_converted_motion(tmp_path):
    g1stream.convert("demo", tmp_path / "motion.mcap")
    text = g1stream.report.report(tmp_path / "motion.mcap", tmp_path / "report.html").read_text()
    page = Page(text)
    assert "no messages on /reference and /lowstate" in " ".join(page.texts)
    assert 'class="verdict "' in text  # neither good nor bad
    (session,) = numbers(tmp_path / "motion.mcap")["sessions"]
    motion = g1stream.physics.motion_physics(g1stream.load_motion("demo"))
    assert session["physics"]["frames"] == motion.frames
    assert session["physics"]["tilt_rad"] == pytest.approx(motion.tilt_rad)
    assert {key.split(".")[2] for key in page.values} == {"physics"}
    (drawn,) = figures(text)
    assert [len(drawn["signals"][one]["lines"]) for one in ("q", "error", "tau")] == [1, 0, 0]


def test_no_text_of_a_file_becomes_markup(play, write_session, tmp_path):
    evil = "</script><script>alert(1)</script>"
    metadata = {"motion": {"name": evil}, "stream": {"reason": evil}, "versions": {evil: "1"}}
    path = write_session(*play(), metadata, name="<b>&amp.mcap")
    text = g1stream.report.report(path, tmp_path / "report.html").read_text()
    assert evil not in text
    assert Page(text).scripts == ["plotly", "figures", None]
    assert "<b>" not in text


def test_what_cannot_be_written(path, tmp_path):
    out = tmp_path / "report.html"
    out.write_text("older")
    with pytest.raises(RecordingError):
        g1stream.report.report(path, out)
    with pytest.raises(RecordingError, match=r"nowhere\.mcap"):  # before the page that is there
        g1stream.report.report([path, tmp_path / "nowhere.mcap"], out)
    with pytest.raises(ConfigError):
        g1stream.report.report([], out, force=True)
    assert out.read_text() == "older"
    g1stream.report.report(path, out, force=True)
    assert out.read_text().startswith("<!doctype html>")


def test_a_session_is_not_replaced_by_its_page(path, tmp_path):
    copy = tmp_path / "session.html"
    copy.write_bytes(path.read_bytes())
    for page in (tmp_path / "page.pdf", tmp_path / "page"):
        with pytest.raises(ConfigError):
            g1stream.report.report(copy, page)
        assert not page.exists()
    with pytest.raises(RecordingError):
        g1stream.report.report(copy, copy, force=True)
    assert copy.read_bytes() == path.read_bytes()


@pytest.mark.parametrize("package", ["jinja2", "plotly.offline"])
def test_a_demo_without_a_package_of_the_extra_says_how_to_install_it(
    path, tmp_path, monkeypatch, capsys, package
):
    monkeypatch.setitem(sys.modules, package, None)
    page = tmp_path / "report.html"
    _write_page(path, page)
    printed = capsys.readouterr()
    assert "g1stream[report]" in printed.err
    assert printed.out == ""  # where the summary may be JSON
    assert not page.exists()
