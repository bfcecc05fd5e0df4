import json

import pytest

from g1stream.cli.doctor import render
from g1stream.cli.main import main
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


@pytest.mark.alone  # the robot of another test, in another domain, would be found
def test_nobody_there_is_a_problem(domain_id, capsys):
    assert doctor(domain_id) == 2
    assert f"no publisher on rt/lowstate in domain {domain_id}" in capsys.readouterr().out
    assert doctor(domain_id, "--json") == 2
    findings = json.loads(capsys.readouterr().out)
    assert [one["level"] for one in findings if one["about"] == "publisher"] == ["problem"]
    assert all(one.keys() == {"level", "about", "cause", "remedy", "figures"} for one in findings)


def test_a_missing_interface_is_a_finding_not_an_error(domain_id, capsys):
    assert doctor(domain_id, "--interface", "nonsense0") == 2
    printed = capsys.readouterr().out
    assert "has no interface nonsense0" in printed
    assert "Choose --interface from" in printed
