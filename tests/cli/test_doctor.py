"""`g1stream doctor`: what it prints and how it exits."""

import json

from g1stream.cli.doctor import render
from g1stream.cli.main import main
from g1stream.dds.domain import Participant
from g1stream.dds.endpoints import RawWriter
from g1stream.dds.messages import LOWSTATE
from g1stream.doctor.facts import ok, problem, warning


def test_the_text_is_the_snapshot(matches_snapshot):
    findings = [
        ok("interface", "lo is up"),
        warning("priority", "SCHED_FIFO is not permitted", "Raise the limit rtprio."),
        problem("LowState", "no publisher on rt/lowstate in domain 1", "Start a bridge."),
    ]
    matches_snapshot("doctor", render(findings))


def doctor(domain, *flags):
    return main(["doctor", "--domain", str(domain), "--seconds", "0.3", *flags])


def test_nobody_there_is_a_problem(domain_id, capsys):
    assert doctor(domain_id) == 2
    printed = capsys.readouterr().out
    assert "problem  " in printed
    assert f"no publisher on rt/lowstate in domain {domain_id}" in printed


def test_json_has_every_finding(domain_id, capsys):
    with Participant(domain_id, "lo") as participant:
        RawWriter(participant, LOWSTATE)
        assert doctor(domain_id, "--json") == 2
    findings = json.loads(capsys.readouterr().out)
    assert all(one.keys() == {"level", "about", "cause", "remedy", "figures"} for one in findings)
    (latency,) = [one for one in findings if one["about"] == "wake-up"]
    assert latency["figures"]["deadlines"] >= 250
    assert [one["level"] for one in findings if one["about"] == "LowState"] == ["problem"]


def test_a_missing_interface_is_a_finding_not_an_error(domain_id, capsys):
    assert doctor(domain_id, "--interface", "nonsense0") == 2
    printed = capsys.readouterr().out
    assert "has no interface nonsense0" in printed
    assert "Choose --interface from" in printed
