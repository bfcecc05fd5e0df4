"""Why a streamer waited in vain, in the words of the doctor's own findings."""

from dataclasses import replace

import pytest

from g1stream.doctor.endpoint_mismatches import unanswered
from g1stream.doctor.facts import Peer, Qos, StateFacts, WireFacts
from g1stream.doctor.finding import Level
from g1stream.doctor.findings import examine

STATE = Peer("rt/lowstate", "LowState_", who="bridge (pid 7 on here)")
READER = Peer("rt/lowcmd", "LowCmd_", who="bridge (pid 7 on here)")
RECORDER = replace(READER, who="recorder (pid 8 on here)", only_looks=True)
COMING = StateFacts(0.2, received=100)
SILENT = StateFacts(0.2)

CASES = {
    "other type": (
        WireFacts((replace(STATE, same_type=False, type_name="Mine_"),), (READER,)),
        "bridge (pid 7 on here) has rt/lowstate with a type of another structure, Mine_",
    ),
    "other QoS": (
        WireFacts((replace(STATE, qos=Qos(partitions=("lab",))),), (READER,)),
        "bridge (pid 7 on here) does not match on rt/lowstate: the writer is in partition lab",
    ),
    "unmatched": (
        WireFacts((STATE,), (READER,), SILENT),
        "bridge (pid 7 on here) does not match on rt/lowstate though its policies fit",
    ),
    "silent": (
        WireFacts((STATE,), (READER,), replace(SILENT, malformed=3), 1),
        "matched, but silent for 0.2 s; 3 samples were no LowState",
    ),
    "reader of another type": (
        WireFacts((STATE,), (replace(READER, same_type=False),), COMING, 1),
        "bridge (pid 7 on here) has rt/lowcmd with a type of another structure",
    ),
    "demanding reader": (
        WireFacts((STATE,), (replace(READER, qos=Qos(durability=1)),), COMING, 1),
        "bridge (pid 7 on here) does not match on rt/lowcmd: the reader asks for durability",
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_the_doctor_would_say_the_same(name, healthy):
    wire, told = CASES[name]
    (finding,) = unanswered(1, "lo", wire)
    assert told in finding.cause
    assert finding in examine(replace(healthy, wire=wire))


def test_a_reader_whose_type_does_not_show():
    """Whoever has a writer of its own knows more than the doctor, who must not have one."""
    wire = WireFacts((STATE,), (READER, RECORDER), COMING, 1, commands_matched=0)
    (finding,) = unanswered(1, "lo", wire)
    assert "bridge (pid 7 on here) does not match on rt/lowcmd though" in finding.cause


@pytest.mark.parametrize(
    ("wire", "told"),
    [
        (WireFacts(readers=(READER,)), "nobody publishes rt/lowstate in domain 7 on eth0"),
        (WireFacts((STATE,), (RECORDER,), COMING, 1), "nobody reads rt/lowcmd in domain 7 on eth0"),
    ],
)
def test_where_nobody_is_the_doctor_looks_further(wire, told):
    (finding,) = unanswered(7, "eth0", wire)
    assert told in finding.cause
    assert "g1stream doctor --domain 7 --interface eth0" in finding.remedy


def test_who_comes_too_late():
    (finding,) = unanswered(1, "lo", WireFacts((STATE,), (READER,), COMING, 1, commands_matched=1))
    assert "by now" in finding.cause


def test_a_recorder_obeys_nothing(changed):
    """Also for the doctor: with nobody but a recorder there, commands would move nothing."""
    (said,) = [one for one in examine(changed(wire={"readers": (RECORDER,)})) if one.level]
    assert said.level is Level.PROBLEM
    assert "nobody reads rt/lowcmd" in said.cause
