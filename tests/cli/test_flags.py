import re
from contextlib import nullcontext
from dataclasses import MISSING, dataclass
from pathlib import Path
from typing import Literal

import pytest

from g1stream.cli.command import Command, announce_wire
from g1stream.cli.flags import argument, flag, flag_name, parse_flags
from g1stream.cli.main import load_command
from g1stream.cli.record import Record
from g1stream.cli.sim import Sim
from g1stream.cli.stream import Stream
from g1stream.config import Config, settings
from g1stream.errors import ConfigError

CLASSES = {"stream": Stream, "record": Record, "sim": Sim}


def resolved(command, *arguments):
    given = [*arguments, *{"stream": ["x"], "record": ["-o", "x"]}.get(command, [])]
    return parse_flags(CLASSES[command], command, "", given).resolve()


@pytest.mark.slow
@pytest.mark.parametrize("command", CLASSES)
def test_every_setting_with_a_flag_is_one(command):
    for key, setting in settings().items():
        if command not in (setting.json_schema_extra or {}).get("flag", ()):
            continue
        table, _, name = key.rpartition(".")
        given = [flag_name(f"no_{name}" if setting.default is True else name)]
        if setting.annotation is not bool:
            example = setting.examples[0] if setting.examples else setting.default
            given.append(str(example))
        if (table == "record" or name == "require_record") and command == "stream":
            given += ["--record", "y.mcap"]
        if name in ("stand", "rehearse"):
            given += ["--policy", "x.onnx"]
        if name == "live_port":
            given.append("--live")
        config = resolved(command, *given)
        value = getattr(getattr(config, table), name) if table else getattr(config, name)
        if setting.annotation is bool:
            assert value is not setting.default
        else:
            assert str(value) == given[1]


def test_flags_go_over_a_file_and_a_shipped_one_is_found_by_its_name(tmp_path):
    config = tmp_path / "five.toml"
    config.write_text("[dds]\ndomain = 5\n")
    assert resolved("stream", "--config", str(config), "--domain", "0").dds.domain == 0
    assert resolved("stream", "--config", str(config)).dds.domain == 5
    assert resolved("sim", "--config", "robot").dds.domain == 0


@pytest.mark.parametrize(
    ("command", "arguments", "named"),
    [
        ("stream", ("--rate", "9"), "--rate cannot be 9"),
        ("stream", ("--rate=abc",), "--rate cannot be abc"),
        ("stream", ("--domain", "1.5"), "--domain cannot be 1.5"),
        ("stream", ("--duration", "0"), "--duration cannot be 0"),
        ("stream", ("--feedforward", "torque"), "'velocity'"),
        ("stream", ("--fps", "0"), "--fps cannot be 0"),
        ("stream", ("--speed", "inf"), "--speed cannot be inf"),
        ("stream", ("--meshes",), "--meshes"),
        ("stream", ("--force",), "--force"),
        ("stream", ("--yes", "eth9"), "--arm"),
        ("stream", ("--require-record",), "--require-record"),
        ("stream", ("--rehearse", "1"), "--policy"),
        ("stream", ("--clamp", "--anyway"), "--anyway"),
        ("sim", ("--live-port", "9000"), "--live-port"),
        ("sim", ("--live-origin", "https://viewer.example"), "--live-origin"),
    ],
)
def test_a_value_that_is_not_accepted_is_named_with_its_flag(command, arguments, named):
    with pytest.raises(ConfigError) as caught:
        resolved(command, *arguments)
    assert named in caught.value.cause


@pytest.mark.parametrize(
    ("arguments", "cause", "remedy"),
    [
        (["x", "--domian", "3"], "flag --domian", "--domain"),
        (["--domian=3"], "--domian", "--domain"),
        (["x", "-z"], "-z", "--help"),
        (["x", "--domain"], "--domain", "--help"),
        (["x", "--duration", "--arm"], "--duration", "--help"),
        (["x", "--arm=yes"], "yes", "--help"),
    ],
)
def test_flags_and_arguments_that_do_not_exist_or_are_missing(arguments, cause, remedy, capsys):
    with pytest.raises(ConfigError) as caught:
        parse_flags(Stream, "stream", "", arguments)
    assert cause in caught.value.cause
    assert remedy in caught.value.remedy
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("command", "wrong", "near"),
    [
        ("convert", "--floating-root", None),  # the opposite of --no-floating-root
        ("convert", "--no-floating-rot", "--no-floating-root"),
        ("convert", "--topics", None),
        ("convert", "--output", "--out"),
        ("sim", "--self-collision", None),
        ("sim", "--no-meshes", None),
        ("plot", "--joint", "--joints"),
        ("plot", "--to", None),
        ("info", "-x", None),
    ],
)
def test_a_hint_is_a_flag_that_is_spelt_nearly_so_and_means_no_opposite(command, wrong, near):
    with pytest.raises(ConfigError) as caught:
        parse_flags(load_command(command), command, "", [wrong])
    assert re.findall("--[-a-z]*(?=;)", caught.value.remedy) == ([near] if near else [])


def test_an_argument_that_is_missing_is_named():
    with pytest.raises(ConfigError) as caught:
        parse_flags(Several, "several", "", ["--with", "x"])
    assert "BASE" in caught.value.cause


def test_flags_are_also_known_with_underscores_and_values_after_an_equals_sign():
    given = ("--scale_time", "--record=-x.mcap", "--rate=250", "--start", "0.5")
    config = resolved("stream", *given)
    assert config.stream.rate == 250.0
    assert config.stream.beyond_limits == "scale-time"
    assert config.stream.start == 0.5


@dataclass(frozen=True, kw_only=True)
class Several(Command):
    """A command with arguments of any number, and flags that may be repeated."""

    base: tuple[str, ...] = argument("What is given.", "BASE...")
    other: tuple[str, ...] = flag(MISSING, "What must be, too.", "OTHER...", aliases=("--with",))
    sweep: list[str] = flag((), "May be repeated.", "NAME=A,B")


def test_a_flag_can_be_required():
    with pytest.raises(ConfigError) as caught:
        parse_flags(Several, "several", "", ["session.mcap"])
    assert "--with" in caught.value.cause


def test_a_gains_file_goes_over_the_configs_entry_by_entry(tmp_path):
    config, gains = tmp_path / "config.toml", tmp_path / "gains.toml"
    config.write_text('[gains.kp]\n"*" = 20\n"*_knee_joint" = 30\n[gains.kd]\n"*" = 7\n')
    gains.write_text('[kp]\n"*" = 50\n')
    config = resolved("stream", "--config", str(config), "--gains", str(gains))
    assert list(config.gains.kp.items()) == [("*_knee_joint", 30.0), ("*", 50.0)]
    assert config.gains.kd == {"*": 7.0}


@pytest.mark.parametrize(
    ("interface", "uri", "how", "warned"),
    [
        ("lo", "", {}, ""),
        ("eth0", "", {"commands": False}, ""),
        ("eth0", "", {}, "rt/lowcmd"),
        ("lo", "file:///etc/cyclone.xml", {}, "rt/lowcmd"),
        ("eth0", "", {"via": "arm_sdk"}, "rt/arm_sdk"),
    ],
)
def test_what_may_move_a_robot_is_announced_with_a_warning(
    monkeypatch, capsys, interface, uri, how, warned
):
    monkeypatch.setenv("CYCLONEDDS_URI", uri)
    via = {"via": how.pop("via", "lowcmd")}
    config = Config.model_validate({"dds": {"interface": interface}, "stream": via})
    announce_wire(config, **how)
    told = capsys.readouterr().err
    assert ("WARNING" in told) == bool(warned)
    assert warned in told


def test_a_flag_may_be_repeated_among_arguments_of_any_number():
    given = ["--sweep", "gains.kp=1,2", "motions", "--with", "x", "--sweep=stream.rate=250"]
    command = parse_flags(Several, "several", "", given)
    assert command.sweep == ["gains.kp=1,2", "stream.rate=250"]
    assert (command.base, command.other) == (("motions",), ("x",))
    assert not parse_flags(Several, "several", "", ["motions", "--with", "x", "y"]).sweep


@dataclass(frozen=True, kw_only=True)
class Advanced(Command):
    """A command with a flag that few need."""

    usual: float = flag(1.0, "Everybody's.")
    special: Path | None = flag(None, "For a few.", advanced=True)


def helped(kind, name, *arguments, capsys):
    with pytest.raises(SystemExit) as ended:
        parse_flags(kind, name, "", arguments)
    assert not ended.value.code
    return capsys.readouterr().out


def test_what_few_need_is_in_the_whole_help_only(capsys):
    short = helped(Advanced, "advanced", "--help", capsys=capsys)
    whole = helped(Advanced, "advanced", "--help-all", capsys=capsys)
    assert "--usual NUMBER" in short
    assert "--special" not in short
    assert "--help-all" in short
    assert "--special FILE" in whole
    assert parse_flags(Advanced, "advanced", "", ["--special", "x"]).special == Path("x")
    assert "--help-all" not in helped(Several, "several", "--help", capsys=capsys)


def test_the_whole_help_has_every_setting_with_its_table(capsys):
    whole = helped(Stream, "stream", "--help-all", capsys=capsys)
    assert "[safety]" in whole
    for key, setting in settings().items():
        if "stream" in (setting.json_schema_extra or {}).get("flag", ()):
            name = key.rpartition(".")[2]
            assert flag_name(f"no_{name}" if setting.default is True else name) in whole


@dataclass(frozen=True, kw_only=True)
class Combined(Command):
    """A command with flags that need or exclude others."""

    action: Literal["show", "make"] = argument("What to do.", "ACTION")
    files: tuple[str, ...] = argument("Files, the last one an output.", "FILE... OUT")
    out: Path | None = flag(None, "Written.")
    force: bool = flag(False, "Replace it.", needs=("out", "files=*.mcap"))
    raw: bool = flag(False, "As it is.", needs=("files=*.mcap",))
    size: int = flag(1, "Made.", needs=("action=make", "absent"), excludes=("out",))


@pytest.mark.parametrize(
    ("arguments", "refused"),
    [
        (["make", "a", "--size", "2"], None),
        (["show", "a", "--size", "2"], "--size needs ACTION make."),
        (["make", "a", "--force", "--out", "x"], None),
        (["make", "a", "b.MCAP", "--force"], None),
        (["make", "a.mcap", "b", "--force"], "--force needs --out or OUT *.mcap."),
        (["make", "a", "--raw", "--out=b.mcap"], None),
        (["make", "a.mcap", "--raw", "--out=b"], "--raw needs OUT *.mcap."),
        (["make", "a", "--size=2", "--out=x"], "--size cannot be combined with --out."),
    ],
)
def test_a_flag_needs_or_excludes_others(arguments, refused):
    with pytest.raises(ConfigError) if refused else nullcontext() as caught:
        parse_flags(Combined, "combined", "", arguments)
    assert (caught.value.cause if refused else None) == refused


@pytest.mark.parametrize("policy", ["policy = 'x.onnx'", ""])
def test_a_settings_file_may_have_what_a_flag_needs(tmp_path, policy):
    config = tmp_path / "policy.toml"
    config.write_text(f"[stream]\nramp = 1.0\n{policy}\n")
    with nullcontext() if policy else pytest.raises(ConfigError, match="--stand needs --policy"):
        assert resolved("stream", "--config", str(config), "--stand", "1").stream.stand == 1.0


def test_the_help_says_what_a_flag_needs(capsys):
    text = helped(Combined, "combined", "--help", capsys=capsys)
    assert "(needs --out or OUT *.mcap)" in text
    assert "(needs ACTION make; default: 1)" in text


def test_the_simulator_of_a_robot_on_its_feet_holds_nothing():
    config = resolved("sim", "--support", "feet")
    assert (config.sim.support, config.sim.held_by) == ("feet", "free")
    assert resolved("sim", "--support", "hanging").sim.held_by == "hanging"
