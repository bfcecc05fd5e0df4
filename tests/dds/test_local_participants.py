import subprocess
import sys

import pytest

from g1stream.dds.domain import Participant
from g1stream.dds.local_participants import domains_of_ports, local_participants

PLAIN = "from cyclonedds.domain import DomainParticipant; participant = DomainParticipant({})"


def found_in(domain):
    return [one for one in local_participants() if one.domain == domain]


@pytest.mark.parametrize(
    ("general", "index"),
    [("", "none"), ("<General><AllowMulticast>false</AllowMulticast></General>", "auto")],
)
def test_a_program_that_is_not_ours(claim_domain, stranger, monkeypatch, general, index):
    """Without the unicast ports of RTPS, or with them alone."""
    domain = claim_domain()
    discovery = f"<Discovery><ParticipantIndex>{index}</ParticipantIndex></Discovery>"
    uri = f"<CycloneDDS><Domain>{general}{discovery}</Domain></CycloneDDS>"
    monkeypatch.setenv("CYCLONEDDS_URI", uri)
    pid = stranger(PLAIN.format(domain))
    (found,) = found_in(domain)
    assert (found.pid, found.apart) == (pid, False)
    assert f"pid {pid}" in str(found)


def test_sockets_that_a_child_shares_belong_to_the_process_that_made_them(claim_domain, stranger):
    """As a stream's guard shares those of the stream."""
    domain = claim_domain()
    code = f"""
import os, subprocess
{PLAIN.format(domain)}
for descriptor in map(int, os.listdir("/proc/self/fd")):
    try:
        os.set_inheritable(descriptor, True)
    except OSError:
        pass
# It ends with its standard input, when the process that shares its sockets is killed.
child = subprocess.Popen(["cat"], stdin=subprocess.PIPE, close_fds=False)
"""
    pid = stranger(code)
    (found,) = found_in(domain)
    assert found.pid == pid


def test_this_process_and_what_it_started_are_left_out(domain_id):
    code = f"{PLAIN.format(domain_id)}; print(flush=True); input()"
    started = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {code!r}])"
    with (
        Participant(domain_id, "lo"),
        subprocess.Popen(
            [sys.executable, "-c", started], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        ) as child,
    ):
        child.stdout.readline()
        assert found_in(domain_id) == []
        child.communicate(b"\n")


def test_another_network_namespace(claim_domain, stranger):
    unshare = ("unshare", "--map-root-user", "--net")
    if subprocess.run([*unshare, "true"], check=False, capture_output=True).returncode:
        pytest.skip("this user may not make a network namespace")
    domain = claim_domain()
    up = "import subprocess; subprocess.run(['ip', 'link', 'set', 'lo', 'up'], check=True)\n"
    pid = stranger(up + PLAIN.format(domain), *unshare)
    (found,) = found_in(domain)
    assert (found.pid, found.apart) == (pid, True)


@pytest.mark.parametrize(
    ("ports", "domains"),
    [
        ([7400], {0}),  # discovery by multicast
        ([7400 + 250 * 232], {232}),
        ([7400 + 250 * 3 + 10 + 18, 7400 + 250 * 3 + 11 + 18], {3}),  # participant 9
        ([7410], set()),  # one port alone is anybody's
        ([7411, 7412], set()),  # the first has to be even
        ([7401], set()),
        ([53, 7399, 7400 + 250 * 233], set()),
    ],
)
def test_the_ports_of_a_domain(ports, domains):
    assert domains_of_ports(ports) == domains


def test_a_process_that_may_not_be_seen(tmp_path):
    """As root's are for others: its socket is known, and whose it is."""
    (tmp_path / "self" / "net").mkdir(parents=True)
    (tmp_path / "self" / "ns").mkdir()
    (tmp_path / "self" / "ns" / "net").touch()
    line = " 1: 00000000:1CE8 00000000:0000 {} 00000000:00000000 00:00000000 00000000 33 0 7 2 0 0"
    for state, expected in (("07", [(0, 0, "a program of user 33")]), ("01", [])):
        (tmp_path / "self" / "net" / "udp").write_text(f"header\n{line.format(state)}\n")
        found = [(one.domain, one.pid, one.command) for one in local_participants(tmp_path)]
        assert found == expected
