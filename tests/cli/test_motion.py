import json
from dataclasses import replace
from pathlib import Path

import pytest

from g1stream.cli.main import main
from g1stream.cli.motion import render
from g1stream.dds.messages import Reference
from g1stream.motion.check import check_motion
from g1stream.motion.limits import JointPeak
from g1stream.motion.readers import find_motion, load_motion
from g1stream.robot.model import G1
from g1stream.session.writer import SessionWriter
from g1stream.types import Phase

DEMO = Path(__file__).parents[2] / "src" / "g1stream" / "motion" / "demo.csv"


@pytest.fixture
def leaping(tmp_path):
    """The demo with a wrist that jumps to its limit: the spline overshoots, the frames do not."""
    header, *lines = DEMO.read_text().splitlines()
    rows = [line.split(",") for line in lines]
    place = header.split(",").index("left_wrist_roll_joint")
    for i, row in enumerate(rows):
        row[place] = "1.972222" if i > 100 else "1.5"
    path = tmp_path / "leaping.csv"
    path.write_text("\n".join([header, *(",".join(row) for row in rows)]))
    return path


def test_the_text_is_the_snapshot(matches_snapshot):
    """No problem, and one of each kind."""
    reader = find_motion("demo").open()
    evidence, good = reader.evidence, check_motion(reader.motion(), G1.default())
    joint = JointPeak("left_knee_joint", 4.0, 3.0, 2.8798, 12)
    fast = JointPeak("waist_yaw_joint", 5.0, 40.0, 32.0, 3)
    leap = replace(
        good,
        name="leap",
        frames_beyond=(joint,),
        streamed=replace(good.streamed, motion="leap", held=(joint,), speeds=(fast,)),
        warnings=("leap: 3 quaternions were normalised.",),
        suspicion="frame 120 were a spike of 2.40 rad",
    )
    texts = render(good, evidence, 1.0), render(leap, evidence, 0.4), render(good, None, 1.0)
    matches_snapshot("motion", "\n\n".join(texts))


def test_a_motion_beyond_a_limit_is_not_passed(run, tmp_path):
    motion = load_motion("demo")
    path = tmp_path / "fast.csv"
    replace(motion, fps=30.0, joint_pos=1.5 * motion.joint_pos).save(path)
    done = run("motion", path, "--json")
    assert done.code == 1
    assert json.loads(done.out)["within_limits"] is False


def test_a_session(run, tmp_path):
    path, message = tmp_path / "session.mcap", Reference()
    message.phase[()], message.root_quat_wxyz[0] = Phase.PLAY, 1.0
    with SessionWriter(path) as writer:
        for i in range(100):
            message.motion_time[()] = 0.002 * i
            writer.write("/reference", message.tobytes(), 2_000_000 * i, 2_000_000 * i)
    done = run("motion", path, "--json")
    assert (done.code, done.err) == (0, "")
    report = json.loads(done.out)
    assert report["file"]["used"]["file"].startswith("a session")
    assert report["within_limits"] is True
    assert (report["n_frames"], report["fps"]) == (100, 500.0)
    assert report["fastest"]["value"] == 0.0


@pytest.mark.parametrize(
    ("name", "content"),
    [
        *(
            ("clip.csv", content)
            for content in (b"", b"\x89PNG\r\n\x1a\n", b"\x89MCAP0\r\nnothing")
        ),
        *(("clip.mcap", content) for content in (b"", None)),
    ],
)
def test_what_cannot_be_read_is_bad_input(run, tmp_path, name, content):
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    done = run("motion", path)
    assert (done.code, done.out) == (2, "")
    assert "session" in done.err


def test_the_speed_is_the_one_that_is_streamed(run):
    report = json.loads(run("motion", "demo", "--json").out)
    streamed = max(speed["value"] for speed in report["streamed"]["speeds"])
    assert set(report["fastest"]) == {"joint", "time", "value", "limit", "count"}
    assert report["streamed"]["rate"] == 500.0
    assert streamed > report["fastest"]["value"]


@pytest.mark.parametrize(("rate", "margin", "least"), [(500.0, 0.0, 1), (50.0, 0.1, 500)])
def test_held_targets_are_a_warning(run, leaping, tmp_path, rate, margin, least):
    """Nothing but the overshoot without a margin; with one, most of 14 s."""
    path = tmp_path / "config.toml"
    path.write_text(f"[stream]\nrate = {rate}\n[safety]\nposition_margin = {margin}\n")
    done = run("motion", leaping, "--config", path, "--json")
    report = json.loads(done.out)
    streamed = report["streamed"]
    held = next(one for one in streamed["held"] if one["joint"] == "left_wrist_roll_joint")
    assert (streamed["rate"], streamed["position_margin"]) == (rate, margin)
    assert held["limit"] == pytest.approx(1.972222 - margin, abs=1e-5)
    assert held["count"] > least
    assert report["n_held"] >= held["count"]
    assert (done.code, report["within_limits"]) == (0, True)


def test_quiet_tells_problems_alone_each_on_its_lines(tmp_path, capsys):
    demo = load_motion("demo")
    path = replace(demo, joint_pos=demo.joint_pos * 3.0).save(tmp_path / "wild.csv")
    for name, code in ((str(path), 1), ("demo", 0)):
        assert main(["motion", name, "--quiet"]) == code
        out, err = capsys.readouterr()
        assert out == ""
        assert bool(err) == bool(code)
        assert "\\n" not in err  # a line break that was escaped
