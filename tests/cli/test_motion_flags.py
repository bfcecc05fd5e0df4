import json
from pathlib import Path

import pytest

from g1stream.app.session import open_session
from g1stream.cli.convert import Convert
from g1stream.cli.demo import Demo
from g1stream.cli.flags import parse_flags
from g1stream.cli.main import main
from g1stream.cli.motion import Motion as MotionCommand
from g1stream.cli.motion_flags import MotionFlags
from g1stream.cli.stream import Stream
from g1stream.errors import ConfigError, RecordingError
from g1stream.motion.motion import Motion
from g1stream.motion.readers import load_motion
from g1stream.session.records import MotionInfo

COMMANDS = {"stream": Stream, "motion": MotionCommand, "convert": Convert, "demo": Demo}
CHANGES = ["--mirror", "--on-floor", "--speed", "0.5"]
CHANGES += ["--repeat", "2", "--blend", "1", "--root", "fix"]


def parsed(name: str, *arguments: str):
    return parse_flags(COMMANDS[name], name, "", arguments)


@pytest.fixture(scope="module")
def demo() -> Motion:
    return load_motion("demo")


@pytest.mark.parametrize("name", COMMANDS)
def test_every_change_is_made_and_named(name, demo):
    given = [] if name == "demo" else ["demo", "out.npz"]
    motion = parsed(name, *given, *CHANGES).load(["demo"])
    part = demo.mirrored().on_floor().at_speed(0.5)
    expected = part.looped(2, blend=1.0).fixed_root()
    assert motion.operations == expected.operations
    assert len(motion.operations) == 5
    assert motion.content_sha256 == expected.content_sha256


def test_without_flags_a_motion_is_as_it_is_in_the_file(demo):
    motion = parsed("stream", "demo").load(["demo"])
    assert motion.operations == ()
    assert motion.content_sha256 == demo.content_sha256


@pytest.mark.parametrize(
    "arguments",
    [
        ("a.csv", "b.npz", "--blend", "1", "--mirror"),
        ("a.csv", "--blend", "1", "--mirror", "b.npz"),
        ("--mirror", "a.csv", "--blend=1", "b.npz"),
        ("--mirror", "a.csv", "--blend=1", "--", "b.npz"),
    ],
)
def test_motions_and_flags_in_any_order(arguments):
    command = parsed("stream", *arguments)
    assert command.motions == ("a.csv", "b.npz")
    assert (command.blend, command.mirror) == (1.0, True)


def test_several_motions_become_one_file(tmp_path, demo):
    demo.frames(0, 30).save(tmp_path / "a.csv")
    demo.frames(60, 90).save(tmp_path / "b.npz")
    out = tmp_path / "both.npz"
    assert main(["convert", *(str(tmp_path / n) for n in ("a.csv", "b.npz", "both.npz"))]) == 0
    assert load_motion(out).n_frames == 30 + 14 + 30
    with pytest.raises(RecordingError, match="is the input"):
        parsed("convert", "demo", str(out), str(out), "--force").run()


def test_what_was_done_is_in_the_metadata(tmp_path, demo):
    out = tmp_path / "out.mcap"
    assert main(["convert", "demo", str(out), "--start", "1", "--duration", "1", "--mirror"]) == 0
    operations = ["mirrored", "trimmed to 1 to 2 s"]
    assert open_session(out).metadata["motion"]["operations"] == operations
    assert MotionInfo.from_motion(demo.mirrored().trim(1, 2)).operations == operations


@pytest.mark.parametrize("name", ["motion", "convert"])
@pytest.mark.parametrize(
    ("flags", "start", "end"),
    [
        (("--start", "2"), 2, None),
        (("--duration", "3"), 0, 3),
        (("--start", "1", "--duration", "4", "--speed", "2", "--repeat", "2"), 1, 5),
    ],
)
def test_a_part_of_the_whole_as_stream_plays_it(name, demo, flags, start, end):
    """The part is that of the motion as it is played: after its speed and its repetition."""
    whole = demo.at_speed(2.0).looped(2, blend=0.5) if "--speed" in flags else demo
    motion = parsed(name, "demo", "out.npz", *flags).load(["demo"])
    assert motion.content_sha256 == whole.trim(start, end).content_sha256


def test_the_report_is_about_the_changed_motion(run):
    done = run("motion", "demo", "--start", "1", "--duration", "2", "--mirror", "--json")
    assert json.loads(done.out)["n_frames"] == 61


def test_a_session_at_no_speed_is_refused(capsys):
    assert main(["stream", "session.mcap", "--speed", "0"]) == 2
    assert "--speed" in capsys.readouterr().err


@pytest.mark.parametrize("command", [("stream", "demo"), ("demo",), ("motion", "demo", "demo")])
def test_motions_are_read_for_the_robot_of_the_parameters(command, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    Path("g1.toml").write_text('robot = "g1_23dof"\n')
    Path("config.toml").write_text('params = "g1.toml"\n')
    robots = []

    def load(self, motions, robot=None):
        robots.append(robot)
        raise ConfigError("That is enough.", "Nothing.")

    monkeypatch.setattr(MotionFlags, "load", load)
    assert main([*command, "--config", "config.toml"]) == 2
    assert [robot.name for robot in robots] == ["g1_23dof"]
