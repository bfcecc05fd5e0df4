from dataclasses import replace

import pytest
from cyclonedds.core import Policy
from cyclonedds.core import Qos as CycloneQos

from g1stream.dds.discovery import IDLE, OBSERVER, Endpoint, Qos
from g1stream.dds.local_participants import LocalParticipant
from g1stream.dds.messages import COMMANDS
from g1stream.doctor.facts import Interface, Level, StateFacts, WakeupLatency, WireFacts
from g1stream.doctor.findings import evaluate, explain_no_robot, identify_publisher, qos_mismatch
from g1stream.network import InterfaceFlags
from g1stream.realtime import Grant

UP, LOOPBACK = InterfaceFlags.UP, InterfaceFlags.LOOPBACK
STATE = Endpoint("rt/lowstate", "LowState_", "bridge", "here", "7", "bridge")
SPORT = replace(STATE, topic="rt/sportmodestate", type_name="SportModeState_")
ROBOT_STATE = replace(STATE, topic="rt/lf/lowstate")
ARM = replace(STATE, topic="rt/arm_sdk", type_name="LowCmd_")
READER = replace(ARM, topic="rt/lowcmd")
OBSERVING = CycloneQos(Policy.Userdata(OBSERVER))
RECORDER = Endpoint("rt/lowcmd", "LowCmd_", "gui", "here", "8", "recorder", policies=OBSERVING)
COMING = StateFacts(0.2, received=100)
SILENT = StateFacts(0.2)
POLICY = Endpoint("rt/lowcmd", "LowCmd_", "policy", "here", "9", "policy")
NOT_GRANTED = Grant("SCHED_FIFO", granted=False, detail="no right", cost="delays", remedy="limits")
LATE = WakeupLatency(500.0, 250, 3, median_ns=5_000, worst_ns=9_400_000)
EMPTY = {"writers": (), "readers": (), "states_matched": 0}
PROBLEM, WARNING = Level.PROBLEM, Level.WARNING


def interface(*values):
    return {"host": {"interfaces": (Interface("lo", *values),)}}


def writers(*peers):
    return {"wire": {"writers": peers}}


def elsewhere(domain, interface):
    return {"wire": {"writers": (), "elsewhere": ((domain, interface, "sim"),)}}


def readers(*peers):
    return {"wire": {"readers": peers}}


def policies(peer, *policies):
    return replace(peer, policies=CycloneQos(*policies))


# Changed facts; level and subject of the finding that they lead to, and a value that it names.
CASES = {
    "no such interface": ({"wire": {"interface": "wlan9"}}, PROBLEM, "interface", "wlan9"),
    "interface down": (interface(LOOPBACK), PROBLEM, "interface", "down"),
    "no address": (interface(UP | LOOPBACK, ""), PROBLEM, "interface", "IPv4"),
    "no multicast": (interface(UP), PROBLEM, "interface", "multicast"),
    "uri": ({"host": {"uri": "file://mine.xml"}}, WARNING, "interface", "file://mine.xml"),
    "old cyclone": ({"host": {"cyclonedds": "0.9.1"}}, WARNING, "cyclonedds", "0.9.1"),
    "small buffers": ({"host": {"rmem_max": 212_992}}, WARNING, "sockets", "208 KiB"),
    "slow clock": ({"host": {"clock_source": "hpet"}}, WARNING, "clock", "hpet"),
    "domain of ROS 2": ({"ros_domain": 7}, WARNING, "domain", "ROS_DOMAIN_ID"),
    "not real time": ({"host": {"grants": (NOT_GRANTED,)}}, WARNING, "real time", "delays"),
    "late wake-ups": ({"wakeup_latency": LATE}, WARNING, "wake-up", "3 of 250"),
    "wrong domain": (elsewhere(0, "lo"), PROBLEM, "domain", "domain 0 on lo"),
    "wrong interface": (elsewhere(1, "eth0"), PROBLEM, "interface", "domain 1 on eth0"),
    "an empty domain": ({"wire": EMPTY}, PROBLEM, "publisher", "domain 1 on lo"),
    "other qos": (
        writers(policies(STATE, Policy.Ownership.Exclusive)),
        PROBLEM,
        "QoS",
        "ownership",
    ),
    "clocks differ": ({"state": {"ages_ms": (-5e3, -4e3)}}, WARNING, "LowState", "clock"),
    "lost": ({"state": {"missed": 3}}, WARNING, "tick", "3 LowStates"),
    "wrong CRC": ({"state": {"crc_right": 490}}, PROBLEM, "CRC", "10 of 500"),
    "other robot": ({"state": {"mode_machine": 4}}, PROBLEM, "mode_machine", "4"),
    "motors A and B": ({"state": {"mode_pr": 1}}, PROBLEM, "mode_pr", "A and B"),
    "no subscriber": (readers(), PROBLEM, "LowCmd", "rt/lowcmd"),
    "only a recorder": (readers(RECORDER), PROBLEM, "LowCmd", "rt/lowcmd"),
    "other publisher": (writers(STATE, SPORT, POLICY), WARNING, "LowCmd", "policy (pid 9 on here)"),
}


def test_no_problem(healthy):
    assert {finding.level for finding in evaluate(healthy)} == {Level.OK}


@pytest.mark.parametrize("name", CASES)
def test_a_problem_is_found(name, changed):
    change, level, about, value = CASES[name]
    (found,) = [one for one in evaluate(changed(**change)) if one.level]
    assert (found.level, found.about) == (level, about)
    assert value in found.cause
    assert found.remedy


def test_a_guard_that_has_published_nothing_is_not_another_publisher(changed):
    idle = policies(POLICY, Policy.Userdata(IDLE))
    assert not any(one.level for one in evaluate(changed(**writers(STATE, SPORT, idle))))


def test_the_guard_of_a_stream_is_not_another_program(changed):
    log = replace(POLICY, topic="rt/g1stream/log")
    for topics, others in (((POLICY,), 1), ((POLICY, log), 0)):
        facts = changed(wire=EMPTY | {"writers": topics})
        (cause,) = [one.cause for one in evaluate(facts) if one.about == "publisher"]
        assert f"discovered there: {others}" in cause


def test_latency_below_a_period(changed):
    late = WakeupLatency(500.0, 250, missed=0, median_ns=5_000, worst_ns=1_990_000)
    (found,) = [one for one in evaluate(changed(wakeup_latency=late)) if one.about == "wake-up"]
    assert (found.level, found.figures["worst_lateness_us"]) == (Level.OK, 1990.0)


@pytest.mark.parametrize(("interface", "about"), [("lo", "domain"), ("wlan9", "interface")])
def test_a_domain_that_cannot_be_joined_is_one_problem(healthy, interface, about):
    wire = WireFacts(1, interface, join_error="Ten others are there.")
    (found,) = [one for one in evaluate(replace(healthy, wire=wire)) if one.level]
    assert found.about == about


def test_the_searched_places_and_the_programs_are_named(changed):
    inside = LocalParticipant(1, 44, "policy.py", apart=True)
    wire = EMPTY | {
        "searched": ((7, "lo"), (1, "eth0")),
        "unsearched": ("eth1",),
        "local": (LocalParticipant(7, 42, "rviz2"), LocalParticipant(9, 0, "user 1"), inside),
        "writers": (ARM,),
        "readers": (ROBOT_STATE,),
    }
    found = {one.about: one for one in evaluate(changed(wire=wire)) if one.level}
    publisher, containers = found["publisher"], found["containers"]
    for named in ("domain 7 on lo", "domain 1 on eth0", "discovered there: 1", "rviz2 (pid 42)"):
        assert named in publisher.cause
    assert "g1stream doctor --interface eth1" in publisher.remedy
    assert "policy.py" not in publisher.cause
    assert "policy.py (pid 44) in domain 1" in containers.cause
    assert "rviz2" not in containers.cause
    assert containers.level is Level.WARNING


@pytest.mark.parametrize(("wire", "told"), [(EMPTY, False), ({"writers": (STATE,)}, True)])
def test_the_base_is_missing_only_where_there_is_a_publisher(changed, wire, told):
    assert ("base" in {finding.about for finding in evaluate(changed(wire=wire))}) is told


def met(writer=STATE, reader=READER, state=COMING, matched=1, domain=1, interface="lo", **more):
    """A domain with a writer of LowState and a reader of LowCmd."""
    return WireFacts(domain, interface, (writer,), (reader,), state, matched, **more)


OWNER = "bridge (pid 7 on here)"

# What is in the domain; what the finding is about, and values that it must name.
MISMATCHES = {
    "other type": (
        met(replace(STATE, type_id="other", type_name="Mine_"), state=SILENT, matched=0),
        "types",
        (OWNER, "rt/lowstate", "Mine_"),
    ),
    "other QoS": (
        met(policies(STATE, Policy.Partition(["lab"])), state=SILENT, matched=0),
        "QoS",
        (OWNER, "rt/lowstate", "lab"),
    ),
    "unmatched": (met(state=SILENT, matched=0), "types", (OWNER, "rt/lowstate")),
    "silent": (met(state=replace(SILENT, malformed=3)), "LowState", ("0.2 s", "3 samples")),
    "reader of another type": (
        met(reader=replace(READER, type_id="other")),
        "types",
        (OWNER, "rt/lowcmd"),
    ),
    "demanding reader": (
        met(reader=policies(READER, Policy.Durability.TransientLocal)),
        "QoS",
        (OWNER, "rt/lowcmd", "durability"),
    ),
}


@pytest.mark.parametrize("name", MISMATCHES)
def test_the_doctor_has_the_same_finding(name, healthy):
    wire, about, values = MISMATCHES[name]
    (finding,) = explain_no_robot(wire)
    assert (finding.level, finding.about) == (Level.PROBLEM, about)
    assert all(value in finding.cause for value in values)
    assert finding in evaluate(replace(healthy, wire=wire))


def test_a_reader_whose_type_is_not_announced():
    """Who has a writer knows whether it matches; the doctor must not have one."""
    wire = replace(met(commands_matched=0), readers=(READER, RECORDER))
    (finding,) = explain_no_robot(wire)
    assert finding.about == "types"
    assert OWNER in finding.cause
    assert "recorder (pid 8 on here)" not in finding.cause


def test_an_empty_domain_is_what_the_doctor_says_of_it(healthy):
    wire = WireFacts(7, "eth0", readers=(READER,), elsewhere=((3, "eth0", "sim"),))
    (finding,) = explain_no_robot(wire)
    assert finding.remedy == "Use --domain 3."
    assert finding in evaluate(replace(healthy, wire=wire))


def test_a_robot_without_a_subscriber_leads_to_the_doctor():
    (finding,) = explain_no_robot(met(reader=RECORDER, domain=7, interface="eth0"))
    assert finding.about == "LowCmd"
    assert "domain 7 on eth0" in finding.cause
    assert "g1stream doctor --domain 7 --interface eth0" in finding.remedy


def test_a_robot_that_appears_too_late():
    (finding,) = explain_no_robot(met(commands_matched=1))
    assert (finding.level, finding.about) == (Level.WARNING, "wire")


def test_the_controller_that_moves_the_arms_for_us_is_not_to_be_ended(changed):
    """It publishes on rt/lowcmd, keeps the robot on its feet, and reads rt/arm_sdk."""
    wire = {"writers": (STATE, SPORT, POLICY), "readers": (READER, ARM)}
    assert {one.level for one in evaluate(changed(wire=wire, via="arm_sdk"))} == {Level.OK}
    for wrong in ({"writers": (STATE, SPORT, replace(ARM, participant="policy"))}, {"readers": ()}):
        (found,) = [one for one in evaluate(changed(wire=wire | wrong, via="arm_sdk")) if one.level]
        assert "rt/arm_sdk" in found.cause
    (waited,) = explain_no_robot(met(), COMMANDS["arm_sdk"])
    assert "rt/arm_sdk" in waited.cause


@pytest.mark.parametrize(
    ("offered", "requested", "policy"),
    [
        (Qos(reliable=True, durability=1, deadline=10), Qos(), ""),
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
    log = replace(STATE, topic="rt/g1stream/log")
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
    assert identify_publisher(WireFacts(1, "lo")) == ""
