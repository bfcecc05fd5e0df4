"""What has to be asked, and is told, before anything but loopback is commanded."""

from contextlib import contextmanager

import numpy as np
import pytest

from g1stream.app.arming import inspect_for_arming
from g1stream.app.stream import stream
from g1stream.config import Config, SafetyConfig, load_config
from g1stream.control.plan import plan
from g1stream.control.wire_settings import for_wire
from g1stream.dds.domain import Participant
from g1stream.dds.endpoints import RawWriter
from g1stream.dds.messages import LOWSTATE, LowState
from g1stream.doctor.facts import Level, ok
from g1stream.errors import ConfigError, SafetyError, WireError
from g1stream.extras.onboard.simulated import MotionService
from g1stream.motion.motion import Motion
from g1stream.motion.readers import load_motion
from g1stream.profiles import PROFILES
from g1stream.robot.joints import JOINT_GROUPS, JOINT_NAMES

STILL = Motion.from_arrays(np.zeros((51, 29)), fps=50.0, name="still")
ELSEWHERE = {"dds": {"domain": 0, "interface": "no-such-interface"}}


@pytest.fixture
def still_robot(domain_id, publishing):
    """A robot that stands still with every joint at 0.1 rad, and has a motion service or not."""
    state = LowState()
    state.q[:], state.quaternion[0] = 0.1, 1.0
    state.mode_machine[()] = 5
    sealed = state.seal()

    @contextmanager
    def run(*, crc=sealed[-4:], serves=True):
        with Participant(domain_id, "lo") as participant:
            writer = RawWriter(participant, LOWSTATE)
            service = MotionService(participant) if serves else None

            def publish():
                writer.write(sealed[:-4] + crc)
                if service:
                    service.step(sealed, 1)

            with publishing(publish):
                yield participant

    return run


@pytest.fixture
def config(domain_id, monkeypatch):
    timing = {"wait": 2.0, "ramp": 0.4, "duration": 0.2, "hold": 0, "damp": 0.5}
    # The bridge shares this process.
    slow = PROFILES["simulator"]._replace(max_missed_ticks=1.0, soft_start=0.1)
    monkeypatch.setitem(PROFILES, "simulator", slow)
    patient = {"state_timeout": 1.0}
    return Config.model_validate(
        {"dds": {"domain": domain_id}, "stream": timing, "safety": patient}
    )


@pytest.mark.parametrize("elsewhere", ["interface", "uri"])
def test_unarmed_is_refused_before_a_file_or_the_network_is_touched(elsewhere, monkeypatch):
    monkeypatch.delenv("CYCLONEDDS_URI", raising=False)
    config = Config.model_validate(ELSEWHERE)
    monkeypatch.setattr("g1stream.network.interfaces", lambda: ["lo", config.dds.interface])
    if elsewhere == "uri":
        monkeypatch.setenv("CYCLONEDDS_URI", "<CycloneDDS/>")
        config = Config(profile="robot")
    with pytest.raises(SafetyError) as caught:
        stream("no such file", config)
    assert "--arm" in caught.value.remedy


def test_an_interface_that_does_not_exist_is_refused_before_arming():
    with pytest.raises(WireError) as caught:
        stream("no such file", Config.model_validate(ELSEWHERE))
    assert ELSEWHERE["dds"]["interface"] in caught.value.cause


@pytest.mark.parametrize(
    "config",
    [
        load_config("sim", {"dds.interface": "eth7"}),
        Config.model_validate(Config().model_dump() | ELSEWHERE),  # a dump names its profile
        Config.model_validate(ELSEWHERE | {"profile": "simulator"}),
    ],
)
def test_the_limits_of_a_simulator_are_refused_where_there_may_be_a_robot(monkeypatch, config):
    monkeypatch.delenv("CYCLONEDDS_URI", raising=False)
    monkeypatch.setattr("g1stream.network.interfaces", lambda: ["lo", config.dds.interface])
    assert config.safety.max_joint_speed == 60.0
    with pytest.raises(ConfigError, match="simulator") as caught:
        stream("demo", config, arm=lambda report: pytest.fail("asked"))
    assert "network-simulator" in caught.value.remedy
    asked = Config.model_validate(config.model_dump() | {"profile": "network-simulator"})
    assert for_wire(asked) == asked


def test_a_config_uri_is_a_network_where_there_may_be_a_robot(monkeypatch):
    monkeypatch.setenv("CYCLONEDDS_URI", "<CycloneDDS/>")
    with pytest.raises(ConfigError):
        for_wire(Config())


@pytest.mark.parametrize(
    "config",
    [
        load_config("robot").model_copy(update={"safety": SafetyConfig(deadman="R1")}),
        Config().model_copy(update={"profile": "robot", "safety": SafetyConfig(deadman="R1")}),
    ],
)
def test_the_limits_of_a_robot_are_used_however_its_settings_were_made(config):
    assert config.safety.max_joint_speed == 60.0
    used = for_wire(config)
    assert used.safety.max_joint_speed == 10.0
    assert used.safety.deadman == "R1"


def test_the_report_is_about_this_robot_and_motion(still_robot, config, tap):
    reports = []
    with still_robot(), tap(config.dds.domain) as commands, pytest.raises(SafetyError):
        stream("demo", config, arm=lambda report: reports.append(report) or False)
    assert commands == []
    (report,) = reports
    assert (report.domain, report.interface) == (config.dds.domain, "lo")
    assert report.tilt == 0.0
    way = load_motion("demo").joint_pos[0] - 0.1
    assert report.furthest.distance == pytest.approx(way[np.abs(way).argmax()], abs=1e-6)
    assert report.furthest.joint == JOINT_NAMES[np.abs(way).argmax()]
    assert report.limbs[0].distance == pytest.approx(way[np.abs(way[:6]).argmax()], abs=1e-6)
    least = 1.875 * abs(report.furthest.distance) / config.constants.ramp_speed
    assert report.ramp == pytest.approx(max(config.stream.ramp, least))
    peak = 1.875 * abs(report.furthest.distance) / report.ramp
    assert report.peak_speed == pytest.approx(peak)
    assert [limb.limb for limb in report.limbs] == list(JOINT_GROUPS)
    assert report.limbs[0].kp == (40.0, 100.0)
    assert report.limits["state_timeout"] == 1.0
    assert report.wider == tuple(config.wider_than_robot())
    assert ("safety.state_timeout", 1.0, 0.1, "s") in report.wider
    assert report.motion_service == ok("motion service", "no mode is active")
    about = {one.about for one in report.findings}
    assert {"publisher", "LowState", "mode_machine"} <= about
    assert "motors" not in about


def test_what_no_robot_has_confirmed_is_a_warning(still_robot, config, monkeypatch):
    """Motor numbers, and a motion service that does not answer; a CRC may not be provided."""
    monkeypatch.setattr("g1stream.control.receiver.SERVICE_TIMEOUT", 0.5)
    config = config.model_copy(update={"robot": "g1_23dof"})
    with still_robot(crc=bytes(4), serves=False) as participant:
        report = inspect_for_arming(participant, plan(STILL, for_wire(config), simulated=True))
    assert "motors" in {one.about for one in report.findings}
    assert report.motion_service.level is Level.WARNING
    assert report.furthest.distance == pytest.approx(-0.1)


def test_no_pose_is_taken_from_a_state_with_a_wrong_crc(still_robot, config):
    with still_robot(crc=b"\1\2\3\4") as participant, pytest.raises(WireError):
        inspect_for_arming(participant, plan(STILL, for_wire(config), simulated=True))


@pytest.mark.parametrize(
    ("onboard", "via", "remedy"), [("ai", "lowcmd", "release"), (None, "arm_sdk", "restore")]
)
def test_a_mode_that_does_not_fit_is_refused_before_anybody_is_asked(
    bridge, config, onboard, via, remedy
):
    config = load_config(over=config.model_dump() | {"stream.via": via})
    with bridge(onboard), pytest.raises(SafetyError) as caught:
        stream("demo", config, arm=lambda report: pytest.fail("asked"))
    assert "active" in caught.value.cause
    assert f"g1stream robot {remedy}" in caught.value.remedy
    assert f"--domain {config.dds.domain}" in caught.value.remedy


def test_arms_need_an_active_mode_on_loopback_too(bridge, config):
    config = load_config(over=config.model_dump() | {"stream.via": "arm_sdk"})
    with bridge(None), pytest.raises(SafetyError, match="active") as caught:
        stream("demo", config)
    assert "g1stream robot restore" in caught.value.remedy


def test_without_a_robot_there_is_nothing_to_arm(config, monkeypatch):
    monkeypatch.setattr("g1stream.control.receiver.SERVICE_TIMEOUT", 0.5)
    with pytest.raises(WireError):
        stream("demo", config, arm=lambda report: pytest.fail("asked"))


def test_armed_starts_with_damping(bridge, config, tap):
    with bridge(), tap(config.dds.domain) as commands:
        summary = stream("demo", config, arm=lambda report: True)
    assert summary.termination.reason == ""
    stiffness = [float(one.command.kp.max()) for one in commands]
    soft = next(i for i, kp in enumerate(stiffness) if kp)
    # The 0.1 s are between deadlines, which the first command may be late for.
    damped = commands[soft].stamp - commands[0].stamp
    assert damped + 1e3 * summary.stream.lateness_us.max >= 0.09e9
    assert set(stiffness[soft:]) == {100.0, 0.0}
    assert stiffness[-1] == 0.0
