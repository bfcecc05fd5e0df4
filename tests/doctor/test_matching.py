"""Matching of endpoints, and the reasons why a streamer finds no robot."""

from dataclasses import replace

import pytest

from g1stream.doctor.facts import Level, Peer, Qos, StateFacts, WireFacts
from g1stream.doctor.findings import evaluate
from g1stream.doctor.matching import explain_no_robot, identify_publisher, qos_mismatch

STATE = Peer("rt/lowstate", "LowState_", owner="bridge (pid 7 on here)", participant="bridge")
SPORT = Peer("rt/sportmodestate", "SportModeState_", participant="bridge")
ROBOT_STATE = Peer("rt/lf/lowstate", "LowState_", participant="bridge")
ARM = Peer("rt/arm_sdk", "LowCmd_", participant="bridge")
READER = Peer("rt/lowcmd", "LowCmd_", owner="bridge (pid 7 on here)")
RECORDER = replace(READER, owner="recorder (pid 8 on here)", observer=True)
COMING = StateFacts(0.2, received=100)
SILENT = StateFacts(0.2)

# What is in the domain; what the finding is about, and values that it must name.
CASES = {
    "other type": (
        WireFacts((replace(STATE, same_type=False, type_name="Mine_"),), (READER,)),
        "types",
        ("bridge (pid 7 on here)", "rt/lowstate", "Mine_"),
    ),
    "other QoS": (
        WireFacts((replace(STATE, qos=Qos(partitions=("lab",))),), (READER,)),
        "QoS",
        ("bridge (pid 7 on here)", "rt/lowstate", "lab"),
    ),
    "unmatched": (
        WireFacts((STATE,), (READER,), SILENT),
        "types",
        ("bridge (pid 7 on here)", "rt/lowstate"),
    ),
    "silent": (
        WireFacts((STATE,), (READER,), replace(SILENT, malformed=3), 1),
        "LowState",
        ("0.2 s", "3 samples"),
    ),
    "reader of another type": (
        WireFacts((STATE,), (replace(READER, same_type=False),), COMING, 1),
        "types",
        ("bridge (pid 7 on here)", "rt/lowcmd"),
    ),
    "demanding reader": (
        WireFacts((STATE,), (replace(READER, qos=Qos(durability=1)),), COMING, 1),
        "QoS",
        ("bridge (pid 7 on here)", "rt/lowcmd", "durability"),
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_the_doctor_has_the_same_finding(name, healthy):
    wire, about, values = CASES[name]
    (finding,) = explain_no_robot(1, "lo", wire)
    assert (finding.level, finding.about) == (Level.PROBLEM, about)
    assert all(value in finding.cause for value in values)
    assert finding in evaluate(replace(healthy, wire=wire))


def test_a_reader_whose_type_is_not_announced():
    """Who has a writer knows whether it matches; the doctor must not have one."""
    wire = WireFacts((STATE,), (READER, RECORDER), COMING, 1, commands_matched=0)
    (finding,) = explain_no_robot(1, "lo", wire)
    assert finding.about == "types"
    assert READER.owner in finding.cause
    assert RECORDER.owner not in finding.cause


@pytest.mark.parametrize(
    ("wire", "about"),
    [
        (WireFacts(readers=(READER,)), "publisher"),
        (WireFacts((STATE,), (RECORDER,), COMING, 1), "LowCmd"),
    ],
)
def test_an_empty_domain_leads_to_the_doctor(wire, about):
    (finding,) = explain_no_robot(7, "eth0", wire)
    assert finding.about == about
    assert "domain 7 on eth0" in finding.cause
    assert "g1stream doctor --domain 7 --interface eth0" in finding.remedy


def test_a_robot_that_appears_too_late():
    wire = WireFacts((STATE,), (READER,), COMING, 1, commands_matched=1)
    (finding,) = explain_no_robot(1, "lo", wire)
    assert (finding.level, finding.about) == (Level.WARNING, "wire")


def test_a_recorder_does_not_act_on_commands(changed):
    (found,) = [one for one in evaluate(changed(wire={"readers": (RECORDER,)})) if one.level]
    assert (found.level, found.about) == (Level.PROBLEM, "LowCmd")


@pytest.mark.parametrize(
    ("offered", "requested", "policy"),
    [
        (Qos(reliable=True), Qos(), ""),
        (Qos(durability=1), Qos(), ""),
        (Qos(deadline=10), Qos(), ""),
        (Qos(partitions=("a", "b")), Qos(partitions=("b",)), ""),
        (Qos(), Qos(reliable=True), "reliable"),
        (Qos(), Qos(durability=1), "durability"),
        (Qos(), Qos(deadline=2_000_000), "2 ms"),
        (Qos(), Qos(exclusive=True), "ownership"),
        (Qos(partitions=("a",)), Qos(), "partition a"),
        (Qos(xcdr1=False), Qos(), "XCDR2"),
    ],
)
def test_qos(offered, requested, policy):
    reason = qos_mismatch(offered, requested)
    assert policy in reason
    assert bool(reason) == bool(policy)


def test_publishers_are_identified(changed):
    other_reader = (replace(ARM, participant="other"), ROBOT_STATE)
    elsewhere = (STATE, SPORT, replace(ROBOT_STATE, participant="other"))
    log = Peer("rt/g1stream/log", "", participant="bridge")
    expected = [
        ("own bridge", changed(wire={"writers": (STATE, log)})),
        ("robot", changed(wire={"writers": (STATE, SPORT, ROBOT_STATE)})),
        ("robot", changed(wire={"writers": (STATE, SPORT), "readers": (ARM,)})),
        ("Python", changed(state={"tick_step": None, "crc_zero": 500, "has_rpy": False})),
        ("C++", changed()),
        ("C++", changed(wire={"writers": elsewhere, "readers": other_reader})),
        ("unknown", changed(state={"has_motor_modes": True})),
        ("unknown", changed(wire={"writers": (STATE,)})),
    ]
    for name, facts in expected:
        assert name in identify_publisher(facts.wire)
    assert identify_publisher(WireFacts()) == ""
