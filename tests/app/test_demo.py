import pytest

from g1stream.app import demo as program
from g1stream.config import Config
from g1stream.errors import ConfigError, RecordingError, WireError


class StartedError(Exception):
    """The simulator would be up."""


@pytest.fixture(autouse=True)
def starts(monkeypatch):
    """Plays the demo as far as its simulator, and gives the settings with which it would start."""
    started = []

    def start(_, config):
        started.append(config)
        raise StartedError

    monkeypatch.setattr(program, "_publishers", lambda *_: [])
    monkeypatch.setattr(program, "Child", start)
    monkeypatch.delenv("CYCLONEDDS_URI", raising=False)

    def play(out, **settings):
        with pytest.raises(StartedError):
            program.demo("demo", out, Config.model_validate(settings))
        return started.pop()

    return play


@pytest.mark.parametrize("name", ["session.mcap", "tracking.png"])
def test_files_that_are_there_are_refused_before_the_start(tmp_path, name):
    there = tmp_path / name
    there.write_text("precious")
    with pytest.raises(RecordingError, match=f"{name} exists already") as caught:
        program.demo("demo", tmp_path)
    assert "--force" in caught.value.remedy
    assert there.read_text() == "precious"
    with pytest.raises(StartedError):
        program.demo("demo", tmp_path, force=True)


def test_a_demo_that_plays_nothing_leaves_no_directory(tmp_path, monkeypatch):
    class Failing:
        def __init__(self, *_):
            pass

        def wait_until_ready(self):
            raise StartedError

        def kill(self):
            pass

    monkeypatch.setattr(program, "Child", Failing)
    for out in (tmp_path, tmp_path / "made"):
        with pytest.raises(StartedError):
            program.demo("demo", out)
    assert list(tmp_path.iterdir()) == []


def test_a_demo_does_not_leave_the_machine(tmp_path, monkeypatch):
    elsewhere = Config.model_validate({"dds": {"interface": "eth7"}})
    with pytest.raises(ConfigError, match="eth7 is not the loopback") as caught:
        program.demo("demo", tmp_path / "out", elsewhere)
    assert "g1stream stream" in caught.value.remedy
    monkeypatch.setenv("CYCLONEDDS_URI", "<CycloneDDS/>")
    with pytest.raises(ConfigError, match="CYCLONEDDS_URI is set"):
        program.demo("demo", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_it_avoids_domains_that_are_taken_unless_one_is_asked_for(starts, tmp_path, monkeypatch):
    others = {1: ["g1stream sim"], 2: ["unitree_mujoco"]}
    monkeypatch.setattr(program, "_publishers", lambda domain, _: others.get(domain, []))
    for given in ({}, {"domain": 3}):
        assert starts(tmp_path, dds=given).dds.domain == 3
    with pytest.raises(WireError, match="unitree_mujoco"):
        program.demo("demo", tmp_path, Config.model_validate({"dds": {"domain": 2}}))


POLICY = {"policy": "p.onnx"}


@pytest.mark.parametrize(
    ("sim", "stream", "balanced"),
    [
        ({"support": "feet"}, {}, "feet"),
        ({}, {"support": "feet"}, "feet"),
        ({}, POLICY, None),  # a policy balances by itself
        ({"support": "free"}, POLICY, None),
        ({"support": "feet"}, POLICY, None),
    ],
)
def test_on_its_feet_nothing_holds_the_robot(starts, tmp_path, sim, stream, balanced):
    played = starts(tmp_path, sim=sim, stream=stream)
    assert (played.sim.support, played.stream.support) == ("free", balanced)


@pytest.mark.parametrize("stream", [{"support": "feet"}, POLICY])
def test_a_robot_that_is_held_does_not_stand(tmp_path, stream):
    config = Config.model_validate({"sim": {"support": "hanging"}, "stream": stream})
    with pytest.raises(ConfigError, match="hanging"):
        program.demo("demo", tmp_path, config)
