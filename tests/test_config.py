import importlib.util
import json
import os
import re
import subprocess
import sys
import tracemalloc
import zipfile
from functools import partial
from pathlib import Path

import pytest
from hatchling.builders.wheel import WheelBuilder

from g1stream.config import (
    SHIPPED,
    Config,
    DdsConfig,
    SafetyConfig,
    load_config,
    read_toml,
    settings,
)
from g1stream.control.gains import read_gains
from g1stream.control.lowstate import LONGEST_INTERVAL
from g1stream.errors import ConfigError
from g1stream.profiles import PROFILES
from g1stream.robot.parameters import load_parameters

ROOT = Path(__file__).parents[1]


@pytest.fixture
def write(tmp_path):
    """Write a TOML file and give its path."""
    path = tmp_path / "settings.toml"

    def write(text):
        path.write_text(text)
        return path

    return write


def error_of(path, over=None):
    with pytest.raises(ConfigError) as caught:
        load_config(path, over)
    for sentence in (caught.value.cause, caught.value.remedy):
        assert re.fullmatch(r"[A-Z].*\.", sentence), sentence
    return caught.value


@pytest.mark.parametrize("name", ["none.toml", "."])
def test_what_cannot_be_read(tmp_path, name):
    error = error_of(tmp_path / name)
    assert f"{tmp_path / name} cannot be read" in error.cause
    assert "robot, sim" in error.remedy


@pytest.mark.parametrize(
    ("text", "place"),
    [(b"[dds]\n\ndomain: 1", "line 3"), (b"a = " + b"[" * 5000, ""), (b"\xff\xfe", "decode")],
)
def test_not_toml(tmp_path, text, place):
    path = tmp_path / "settings.toml"
    path.write_bytes(text)
    error = error_of(path)
    assert f"{path} is not valid TOML" in error.cause
    assert place in error.cause


@pytest.mark.parametrize(
    ("text", "unknown", "choices"),
    [
        ("foo = 1", "foo", list(Config.model_fields)),
        ("[dds]\nDomain = 1", "dds.Domain", ["domain", "interface"]),
        ("[gains.ki]\n'*' = 1.0", "gains.ki", ["kp", "kd"]),
    ],
)
def test_an_unknown_setting_is_named_with_the_known_ones(write, text, unknown, choices):
    path = write(text)
    error = error_of(path)
    assert error.cause == f"There is no setting {unknown} in {path}."
    for choice in choices:
        assert choice in error.remedy


@pytest.mark.parametrize("table", ["stream", "gains.kp"])
def test_a_table_that_is_none(write, table):
    error = error_of(write(f"{table} = 3"), {"stream.rate": 100.0})  # which does not hide it
    assert f"The setting {table} = 3 in " in error.cause
    assert "is not a table" in error.cause
    assert f"[{table}]" in error.remedy


#: Of the wrong type or out of range.
UNFIT = {
    "dds.domain": ["1.0", "'1'", "true", "[1]", "-1", "233"],
    "dds.interface": ["1", "true", "''"],
    "stream.rate": ["'500'", "true", "[500.0]", "9.99", "2000.1", "nan", "inf"],
    "stream.wait": ["0.9", "86401.0"],
    "stream.ramp": ["0.0", "-1.0", "61.0"],
    "stream.hold": ["-0.1", "86401.0"],
    "stream.damp": ["0.49", "10.1"],
    "stream.start": ["-0.001", "inf"],
    "stream.duration": ["'10'", "false", "0.0", "-1.0", "nan"],
    "stream.loop": ["1", "'yes'", "0.0"],
    "stream.feedforward": ["'torque'", "true", "1"],
    "stream.preview": ["-0.01", "0.2"],
    "realtime.priority": ["-1", "100"],
    "realtime.cpu": ["1.5", "'3'", "-1"],
    "safety.mode_machine": ["5", "['5']", "[5, true]", "[5.5]", "[]"],
    "safety.position_margin": ["-0.1", "0.6"],
    "safety.state_timeout": ["0.0", "inf"],
    "safety.max_tilt": ["0.0", "3.3", "nan"],
    "safety.max_joint_speed": ["0.0", "inf", "nan"],
    "gains.kp.'*'": ["-1.0", "501.0", "nan", "'60'"],
    "gains.kd.'*'": ["-1.0", "51.0", "nan"],
    "record.tf_rate": ["0.0", "2001.0"],
    "sim.support": ["'Bolted'", "1"],
    "sim.rate": ["49.0", "1001.0"],
    "sim.duration": ["0.0"],
    "robot": ["3", "true", "2024-01-01"],
}


@pytest.mark.parametrize("setting", UNFIT)
def test_a_value_that_does_not_fit(write, setting):
    for value in UNFIT[setting]:
        path = write(f"{setting} = {value}")
        error = error_of(path)
        assert f"The setting {setting.replace(chr(39), '')}" in error.cause, value
        assert f" in {path} " in error.cause


def test_whole_numbers_do_for_others(write):
    assert load_config(write("[stream]\nrate = 100")).stream.rate == 100.0


def test_flags_go_over_the_file_and_the_file_over_the_defaults(write):
    path = write("[stream]\nrate = 100.0\nramp = 5.0\n[dds]\ndomain = 7\n")
    over = {"stream.rate": 250.0, "sim.support": "hanging", "robot": Path("my.urdf")}
    config = load_config(path, over)
    assert (config.stream.rate, config.stream.ramp, config.stream.hold) == (250.0, 5.0, 1.0)
    assert (config.dds.domain, config.sim.support) == (7, "hanging")
    assert config.robot == Path("my.urdf")


def test_flags_not_given_change_nothing(write):
    path = write("[stream]\nrate = 100.0")
    assert load_config(path, {"stream.rate": None, "robot": None}) == load_config(path)


def test_a_table_goes_over_the_files_entry_by_entry(write):
    path = write("[gains.kp]\n'*' = 10.0")
    config = load_config(path, {"gains": {"kd": {"*": 2.0}}})
    assert (config.gains.kp, config.gains.kd) == ({"*": 10.0}, {"*": 2.0})


def test_a_bad_flag_is_not_blamed_on_the_file(write):
    path = write("[stream]\nrate = 100.0")
    error = error_of(path, {"stream.rate": 1.0})
    assert "stream.rate = 1.0 " in error.cause
    assert str(path) not in error.cause
    error = error_of(path, {"gains": {"kp": {"*": -1.0}}})
    assert str(path) not in error.cause


def test_settings_cannot_be_changed_in_passing():
    config = Config()
    with pytest.raises(ValueError, match="frozen"):
        config.stream.rate = 1.0


def test_a_config_survives_json():
    """As it does on its way to the recorder."""
    config = load_config("robot", {"robot": Path("my.urdf")})
    assert Config.model_validate(json.loads(json.dumps(config.model_dump(mode="json")))) == config


def test_a_shipped_file_is_found_by_name_unless_there_is_a_file_of_that_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert load_config("robot") == load_config(SHIPPED / "robot.toml") != Config()
    Path("robot").write_text("[dds]\ndomain = 7\n")
    assert load_config("robot").dds.domain == 7


def test_the_shipped_files_are_made_of_the_fields():
    path = ROOT / "tools" / "make_configs.py"
    spec = importlib.util.spec_from_file_location("make_configs", path)
    tool = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tool)
    assert {name: tool.config_toml(name) for name in ("sim", "robot")} == {
        path.stem: path.read_text() for path in SHIPPED.glob("*.toml")
    }, "run tools/make_configs.py"


#: Every value of sim.toml as if a user had given it.
ACTIVE = re.sub(r"^#(?=\w+ = )", "", (SHIPPED / "sim.toml").read_text(), flags=re.MULTILINE)


def test_sim_toml_is_the_defaults_and_its_examples_are_accepted(write):
    assert load_config("sim") == Config()
    with_examples = load_config(write(ACTIVE))
    for key in settings():
        table, _, name = key.rpartition(".")
        owner = getattr(with_examples, table) if table else with_examples
        assert getattr(owner, name) is not None, key


def test_configs_are_in_the_root_of_the_repository():
    for path in SHIPPED.glob("*.toml"):
        assert (ROOT / "configs" / path.name).samefile(path)


def test_a_built_wheel_finds_its_configs(tmp_path):
    (wheel,) = WheelBuilder(str(ROOT)).build(directory=str(tmp_path), versions=["standard"])
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path / "installed")
    installed = tmp_path / "installed" / "g1stream" / "configs"
    assert {path.name for path in installed.iterdir()} == {"robot.toml", "sim.toml"}
    done = subprocess.run(
        [sys.executable, "-m", "g1stream", "motion", "demo", "--config", "robot", "--json"],
        env={**os.environ, "PYTHONPATH": str(tmp_path / "installed")},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    margin = json.loads(done.stdout)["streamed"]["position_margin"]
    assert margin == load_config("robot").safety.position_margin > 0.0


@pytest.mark.parametrize("interface", ["eth0", "wlan0"])
def test_on_a_network_what_is_not_given_is_the_robots(write, interface):
    robot = load_config("robot")
    given = {"dds": {"interface": interface}}
    config = Config.model_validate(
        given | {"safety": {"max_torque": 1.4}, "stream": {"feedforward": None, "rate": 250.0}}
    )
    assert config.profile == "robot"
    assert config.safety == robot.safety.model_copy(update={"max_torque": 1.4})
    assert config.stream == robot.stream.model_copy(update={"rate": 250.0})
    assert Config.model_validate(config.model_dump()) == config
    text = f"[dds]\ninterface = '{interface}'\n[safety]\nmax_torque = 1.4\n[stream]\nrate = 250"
    assert load_config(write(text)) == config
    made = Config(dds=DdsConfig(interface=interface), safety=SafetyConfig(max_torque=1.4))
    assert made.safety == config.safety
    assert [(one.key, one.value, one.robot) for one in config.wider_than_robot()] == [
        ("safety.max_torque", 1.4, 1.1)
    ]
    assert Config(profile="robot").safety == robot.safety  # a rehearsal on the loopback
    assert load_config("sim", {"dds.interface": interface}).profile == "simulator"


def test_each_value_that_is_less_careful_than_the_robots_is_named(write):
    """A copy of the whole sim.toml, without its profile, on a network."""
    config = load_config(write(ACTIVE.replace("profile =", "#")), {"dds.interface": "eth0"})
    assert config.profile == "robot"
    simulator, robot = load_config("sim"), load_config("robot")
    differ = {
        f"{name}.{key}"
        for name in ("stream", "safety")
        for key, value in getattr(simulator, name)
        if value != getattr(getattr(robot, name), key)
    }
    as_a_robot = {"stream.feedforward"}  # its example is its value
    wider = {one.key for one in config.wider_than_robot()}
    assert wider == differ - as_a_robot
    assert len(wider) == 10
    careful = {"safety.max_tilt": 0.4, "stream.ramp": 9.0}
    assert load_config("robot", careful).wider_than_robot() == []
    dangerous = {"safety.allow_second_writer": True, "safety.stop_buttons": ["select"]}
    found = load_config("robot", dangerous).wider_than_robot()
    assert {one.key for one in found} == set(dangerous)


def test_robot_toml_is_more_careful_than_the_defaults():
    default, robot = Config(), load_config("robot")
    assert (robot.dds.domain, robot.dds.interface) == (0, "eth0")
    assert robot.stream.feedforward != "dynamics"
    assert robot.stream.ramp > default.stream.ramp
    assert robot.stream.damp > default.stream.damp
    assert robot.safety.position_margin > default.safety.position_margin
    assert robot.safety.state_timeout == LONGEST_INTERVAL
    assert default.safety.state_timeout == 0.5
    assert robot.safety.tilt_limit("hanging") < default.safety.tilt_limit("free")
    assert robot.safety.max_joint_speed < default.safety.max_joint_speed
    assert robot.safety.mode_machine == (5,)
    assert not robot.safety.allow_second_writer
    for safety in (default.safety, robot.safety):
        assert safety.stop_buttons == ("L2+B", "select")
        assert safety.motor_fault_mask == 0xFFFFFFFF


def test_the_constants_of_a_robot_are_as_careful_as_a_simulators():
    """A robot's value is smaller; voltage and soft start are larger, and the time scale is 1."""
    simulator, robot = PROFILES["simulator"], PROFILES["robot"]
    assert PROFILES["network-simulator"] == simulator
    for name in set(robot._fields) - {"min_voltage", "soft_start", "time_scale"}:
        assert getattr(robot, name) < getattr(simulator, name)
    assert robot.min_voltage > simulator.min_voltage >= 40.0
    assert robot.soft_start > simulator.soft_start
    assert robot.time_scale == 1.0
    # Unitree's own thresholds.
    assert (simulator.max_casing_temperature, simulator.max_winding_temperature) == (85.0, 120.0)
    assert Config(dds=DdsConfig(interface="eth0")).constants == robot


@pytest.mark.parametrize(
    "text",
    [
        ".".join("a" * 100_000) + " = 1",
        f"[{'.'.join('a' * 100_000)}]",
        f"x = {{ {'.'.join('a' * 100_000)} = 1 }}",
        '"=".' * 50_000 + "a = 1",
        "x = " + "{a = " * 5000,
        f"live_port = {'9' * 4000}",
        f"live_port = 0x{'f' * 4000}",
        f"live_port = -{'9' * 20}",
        f"[safety]\nmax_tilt = [{'9' * 4000}]",
    ],
)
def test_a_toml_file_that_costs_much_is_refused_before_it_does(tmp_path, text):
    path = tmp_path / "hostile.toml"
    path.write_text(text)
    tracemalloc.start()
    for read in (load_config, load_parameters, read_gains, partial(read_toml, what="policy file")):
        with pytest.raises(ConfigError, match="not valid TOML"):
            read(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 50e6


def test_the_dots_of_numbers_and_the_largest_integers_are_read(tmp_path):
    path = tmp_path / "long.toml"
    path.write_text(f"x = {[0.5] * 128}\ny = {2**63 - 1}\n")
    assert read_toml(path) == {"x": [0.5] * 128, "y": 2**63 - 1}
