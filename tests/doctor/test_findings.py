"""Each thing that can be wrong leads to a finding that names it, and nothing else does."""

from dataclasses import replace

import pytest

from g1stream.doctor.facts import Interface, Peer, Punctuality, Qos
from g1stream.doctor.finding import Level
from g1stream.doctor.findings import examine
from g1stream.doctor.peers import mismatch, our_program, recognise
from g1stream.realtime import Grant

STATE = Peer("rt/lowstate", "LowState_", who="python (pid 7 on here)", participant="bridge")
SPORT = Peer("rt/sportmodestate", "SportModeState_", participant="bridge")
ROBOTS = Peer("rt/lf/lowstate", "LowState_", participant="bridge")
ARM = Peer("rt/arm_sdk", "LowCmd_", participant="bridge")
REFUSED = Grant("SCHED_FIFO", granted=False, detail="no right", cost="delays", remedy="limits.conf")

# What is changed, the level it leads to, and what must be said.
CASES = {
    "no such interface": ({"interface": "wlan9"}, Level.PROBLEM, "wlan9"),
    "interface down": (
        {"host": {"interfaces": (Interface("lo", up=False),)}},
        Level.PROBLEM,
        "lo is down",
    ),
    "no address": (
        {"host": {"interfaces": (Interface("lo", address=""),)}},
        Level.PROBLEM,
        "no IPv4 address",
    ),
    "no multicast": (
        {"host": {"interfaces": (Interface("lo", multicast=False),)}},
        Level.PROBLEM,
        "no multicast",
    ),
    "uri": ({"host": {"uri": "file://mine.xml"}}, Level.WARNING, "file://mine.xml"),
    "old cyclone": ({"host": {"cyclonedds": "0.9.1"}}, Level.WARNING, "0.9.1"),
    "small buffers": ({"host": {"rmem_max": 212_992}}, Level.WARNING, "208 KiB"),
    "slow clock": ({"host": {"clock_source": "hpet"}}, Level.WARNING, "hpet"),
    "not real time": ({"host": {"grants": (REFUSED,)}}, Level.WARNING, "without it, delays"),
    "unpunctual": (
        {"punctuality": Punctuality(500.0, 250, 3, usual_ns=5_000, worst_ns=9_400_000)},
        Level.WARNING,
        "3 of 250 deadlines at 500 Hz were missed by a whole period, 9.40 ms late at worst",
    ),
    "wrong domain": (
        {"wire": {"writers": (), "elsewhere": ((0, "lo", "sim"),)}},
        Level.PROBLEM,
        "in domain 1 on lo; in domain 0 on lo, sim does",
    ),
    "wrong interface": (
        {"wire": {"writers": (), "elsewhere": ((1, "eth0", "sim"),)}},
        Level.PROBLEM,
        "; in domain 1 on eth0, sim does",
    ),
    "other type": (
        {"wire": {"writers": (Peer("rt/lowstate", "Other_", same_type=False),)}},
        Level.PROBLEM,
        "a type of another structure, Other_",
    ),
    "other qos": (
        {"wire": {"writers": (Peer("rt/lowstate", "LowState_", qos=Qos(exclusive=True)),)}},
        Level.PROBLEM,
        "ownership",
    ),
    "unmatched": ({"wire": {"states_matched": 0}}, Level.PROBLEM, "its type must be"),
    "silent": ({"state": {"received": 0}}, Level.PROBLEM, "silent"),
    "clocks differ": ({"state": {"ages_ms": (-5e3, -4e3)}}, Level.WARNING, "clock"),
    "lost": ({"state": {"missed": 3}}, Level.WARNING, "3 LowStates did not arrive"),
    "wrong checksum": ({"state": {"crc_right": 490}}, Level.PROBLEM, "10 of 500"),
    "other robot": ({"state": {"mode_machine": 4}}, Level.PROBLEM, "4: not a robot"),
    "nobody listens": ({"wire": {"readers": ()}}, Level.PROBLEM, "nobody reads rt/lowcmd"),
    "demanding listener": (
        {"wire": {"readers": (Peer("rt/lowcmd", "LowCmd_", qos=Qos(durability=1)),)}},
        Level.PROBLEM,
        "transient local",
    ),
    "second writer": (
        {"wire": {"writers": (STATE, SPORT, Peer("rt/lowcmd", "LowCmd_", who="policy (pid 9)"))}},
        Level.WARNING,
        "policy (pid 9)",
    ),
}


def worst(findings):
    return max(finding.level for finding in findings)


def test_all_well(healthy):
    assert worst(examine(healthy)) is Level.OK


@pytest.mark.parametrize("name", CASES)
def test_what_is_wrong_is_said(name, changed):
    change, level, text = CASES[name]
    findings = examine(changed(**change))
    (said,) = [one for one in findings if text in one.cause and one.level]
    assert said.level is level is worst(findings)
    assert said.remedy


def test_late_by_less_than_a_period_is_on_time(changed):
    late = Punctuality(500.0, 250, missed=0, usual_ns=5_000, worst_ns=1_990_000)
    (said,) = [one for one in examine(changed(punctuality=late)) if one.about == "punctuality"]
    assert said.level is Level.OK
    assert said.figures == {
        "rate_hz": 500.0,
        "deadlines": 250,
        "missed_deadlines": 0,
        "median_lateness_us": 5.0,
        "worst_lateness_us": 1990.0,
    }


def test_a_domain_that_cannot_be_joined(healthy):
    (problem,) = [
        one
        for one in examine(replace(healthy, wire=None, cannot_join="Ten others are there."))
        if one.level
    ]
    assert problem.cause == "Ten others are there."


def test_an_interface_that_is_none_is_one_problem(healthy):
    facts = replace(healthy, interface="wlan9", wire=None, cannot_join="No such interface.")
    (problem,) = [one for one in examine(facts) if one.level]
    assert "no interface wlan9" in problem.cause


def test_nobody_there_is_not_another_domain(changed):
    (problem,) = [
        one
        for one in examine(changed(wire={"writers": (), "readers": (), "states_matched": 0}))
        if one.level
    ]
    assert "nobody publishes rt/lowstate in domain 1 on lo" in problem.cause
    assert "in domain 1 on lo; no other programs are there" in problem.cause
    assert "g1stream sim" in problem.remedy


def test_where_else_nobody_is_is_said(changed):
    looked = {"searched": ((0, "lo"), (2, "lo"), (1, "eth0"))}
    peers = {"writers": (ARM,), "readers": (ROBOTS,), "states_matched": 0}
    findings = examine(changed(wire=looked | peers))
    (problem,) = [one for one in findings if one.about == "publisher"]
    assert problem.cause.endswith(
        "on lo, nor in domains 0, 2 on it, nor on eth0; 1 other program is there"
    )


def test_of_nobody_it_is_not_said_what_he_does_not_provide(changed):
    gone = {"writers": (), "readers": (), "states_matched": 0}
    assert "base" not in {one.about for one in examine(changed(wire=gone))}
    mute = {"writers": (STATE,)}
    assert "position and velocity not provided" in {
        one.cause for one in examine(changed(wire=mute))
    }


@pytest.mark.parametrize(
    ("written", "read", "program"),
    [
        ({"rt/lowstate", "rt/g1stream/log"}, {"rt/lowcmd"}, "g1stream sim"),
        (
            {"rt/lowcmd", "rt/g1stream/reference", "rt/g1stream/log"},
            {"rt/lowstate"},
            "g1stream stream",
        ),
        (set(), {"rt/lowcmd", "rt/g1stream/log", "rt/g1stream/reference"}, "g1stream record"),
        ({"rt/lowstate"}, {"rt/lowcmd"}, ""),
        (set(), {"rt/lowcmd"}, ""),
    ],
)
def test_our_programs_are_known_by_their_topics(written, read, program):
    assert our_program(written, read) == program


@pytest.mark.parametrize(
    ("offered", "requested", "why"),
    [
        (Qos(reliable=True), Qos(), ""),
        (Qos(durability=1), Qos(), ""),
        (Qos(deadline=10), Qos(), ""),
        (Qos(partitions=("a", "b")), Qos(partitions=("b",)), ""),
        (Qos(), Qos(reliable=True), "reliable"),
        (Qos(), Qos(durability=1), "durability"),
        (Qos(), Qos(deadline=2_000_000), "every 2 ms"),
        (Qos(), Qos(exclusive=True), "ownership"),
        (Qos(partitions=("a",)), Qos(), "partition a"),
        (Qos(xcdr1=False), Qos(), "XCDR2"),
    ],
)
def test_mismatch(offered, requested, why):
    assert (why in mismatch(offered, requested)) if why else not mismatch(offered, requested)


def test_bridges_are_told_apart(changed):
    silent = {"tick_step": None, "crc_zero": 500, "has_rpy": False}
    named = {
        "own bridge": changed(
            wire={"writers": (STATE, Peer("rt/g1stream/log", "", participant="bridge"))}
        ),
        "robot": changed(wire={"writers": (STATE, SPORT, ROBOTS)}),
        "a robot": changed(wire={"writers": (STATE, SPORT), "readers": (ARM,)}),
        "Python simulator": changed(state=silent),
        "C++ simulator": changed(),
        "unitree_mujoco's C++": changed(
            wire={
                "writers": (STATE, SPORT, replace(ROBOTS, participant="other")),
                "readers": (replace(ARM, participant="other"), ROBOTS),
            }
        ),
        "unknown": changed(state={"has_motor_modes": True}),
    }
    for name, facts in named.items():
        assert name in recognise(facts.wire)
