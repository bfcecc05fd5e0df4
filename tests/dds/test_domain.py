import gc
import os
import socket
import subprocess
import sys
import threading
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace

import pytest
from cyclonedds.core import Entity
from cyclonedds.internal import DDS

from g1stream.dds.discovery import AnnouncedBridge, identify_program
from g1stream.dds.domain import Participant, _renew
from g1stream.dds.endpoints import RawReader, RawWriter
from g1stream.dds.messages import LOWCMD, LOWSTATE, REFERENCE, TOPICS, LowCmd
from g1stream.errors import WireError
from g1stream.network import interfaces, is_loopback

LOWCMD_TYPE = "unitree_hg::msg::dds_::LowCmd_"


def test_interfaces_are_the_kernels():
    assert sorted(interfaces()) == sorted(p.name for p in Path("/sys/class/net").iterdir())
    assert [name for name in interfaces() if is_loopback(name)] == ["lo"]


@pytest.mark.parametrize("domain", [-1, 233])
def test_a_domain_out_of_range_is_refused(domain):
    with pytest.raises(WireError, match=str(domain)):
        Participant(domain, "lo")


@pytest.mark.parametrize("interface", ["eth7", ""])
def test_an_unknown_interface_is_named_with_the_known_ones(domain_id, interface):
    with pytest.raises(WireError) as caught:
        Participant(domain_id, interface)
    assert repr(interface) in caught.value.cause
    assert "lo" in caught.value.remedy


def test_a_process_is_on_one_interface_of_a_domain(domain_id, monkeypatch):
    monkeypatch.setattr("g1stream.network.interfaces", lambda: ["lo", "eth7"])
    with Participant(domain_id, "lo"):
        with pytest.raises(WireError, match=f"uses lo for domain {domain_id}"):
            Participant(domain_id, "eth7")
        with Participant(domain_id, "lo"):
            pass
    assert domain_id not in Participant._domains


def test_an_interface_that_cyclone_cannot_use_is_an_error(domain_id, monkeypatch):
    monkeypatch.setattr("g1stream.network.interfaces", lambda: ["lo", "eth7"])
    with pytest.raises(WireError, match="eth7"):
        Participant(domain_id, "eth7")
    with Participant(domain_id, "lo"), Participant(domain_id, "lo"):
        pass


def test_the_users_own_configuration_is_respected(domain_id, monkeypatch, tmp_path):
    trace = tmp_path / "cyclone.log"
    monkeypatch.setenv(
        "CYCLONEDDS_URI",
        '<CycloneDDS><Domain Id="any"><General><Interfaces><NetworkInterface name="lo"/>'
        f"</Interfaces></General><Tracing><Category>config</Category><OutputFile>{trace}"
        "</OutputFile></Tracing><Discovery><ParticipantIndex>auto</ParticipantIndex>"
        '<Peers><Peer Address="127.0.0.1"/></Peers></Discovery></Domain></CycloneDDS>',
    )
    with Participant(domain_id, "lo") as participant:
        assert participant.uses_environment
        assert len(participant.sockets) >= 3
        assert "127.0.0.1" in trace.read_text()
        monkeypatch.delenv("CYCLONEDDS_URI")
        with pytest.raises(WireError, match="CYCLONEDDS_URI"):  # Cyclone would use it all the same
            Participant(domain_id, "lo")
    with Participant(domain_id, "lo") as participant:
        assert not participant.uses_environment
        monkeypatch.setenv("CYCLONEDDS_URI", "<CycloneDDS/>")
        with pytest.raises(WireError, match="CYCLONEDDS_URI"):
            Participant(domain_id, "lo")


def test_a_domain_whose_sockets_are_shut_down_cannot_be_joined_again(domain_id):
    with Participant(domain_id, "lo") as participant:
        participant.cut_off()
        with pytest.raises(WireError, match="shut down"):
            Participant(domain_id, "lo")
    with Participant(domain_id, "lo"):
        pass


def test_only_the_socket_that_sends_is_replaced(participant):
    """A thread of Cyclone 0.10 that receives would wait for ever at the port of another one."""
    before = {one: os.fstat(one).st_ino for one in participant.sockets}
    for one in before:
        _renew(one)
    (changed,) = [one for one, inode in before.items() if os.fstat(one).st_ino != inode]
    with socket.socket(fileno=os.dup(changed)) as sends:
        assert sends.getsockname()[0] == "127.0.0.1"


def test_a_descriptor_that_is_reused_is_not_a_socket_of_the_domain(participant):
    """Cyclone's own stay as they are: its threads use them."""
    known = participant.sockets
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        number = other.fileno()
        participant._joined.sockets.append((number, os.fstat(number).st_ino))
        assert participant.sockets == [*known, number]
    with Path("/dev/null").open() as reused:
        assert reused.fileno() == number
        assert participant.sockets == known


def test_a_broken_configuration_of_the_user_is_an_error(domain_id, monkeypatch):
    monkeypatch.setenv("CYCLONEDDS_URI", "<CycloneDDS><Domain><Nonsense/></Domain></CycloneDDS>")
    with pytest.raises(WireError, match=f"domain {domain_id}.*CYCLONEDDS_URI"):
        Participant(domain_id, "lo")


def possessions():
    """What a process holds that a participant might leave behind."""
    gc.collect()  # cyclonedds' built-in readers and their conditions refer to each other
    return (
        len(list(Path("/proc/self/fd").iterdir())),
        len(list(Path("/proc/self/task").iterdir())),
        len(Entity._entities),
        len(Participant._domains),
    )


def test_closing_leaves_nothing_behind(domain_id):
    before = possessions()
    for _ in range(4):
        with Participant(domain_id, "lo") as participant:
            for topic in TOPICS:
                RawWriter(participant, topic)
                RawReader(participant, topic)
    assert possessions() == before


def test_closing_closes_what_somebody_still_holds(domain_id, until):
    before = possessions()
    with Participant(domain_id, "lo") as observer:
        reader, writer = RawReader(observer, LOWCMD), RawWriter(observer, LOWCMD)
        with Participant(domain_id, "lo") as participant:
            held = [RawWriter(participant, LOWCMD), RawReader(participant, LOWCMD)]
            until(lambda: reader.matched == writer.matched == 2, "two matches each")
        until(lambda: reader.matched == writer.matched == 1, "their departure")
        assert len(observer.writers(LOWCMD.name)) == 0
    assert len(held) == 2
    assert possessions() == before


def test_closing_what_is_closed_is_no_error(domain_id):
    with Participant(domain_id, "lo") as participant:
        for entity in (RawWriter(participant, LOWCMD), RawReader(participant, LOWCMD), participant):
            entity.close()
            entity.close()
    participant.close()


def test_two_participants_share_a_domain_and_the_last_one_ends_it(domain_id):
    first, second = Participant(domain_id, "lo"), Participant(domain_id, "lo")
    writer, reader = RawWriter(second, LOWCMD), RawReader(second, LOWCMD)
    first.close()
    assert domain_id in Participant._domains
    assert writer.write(LowCmd().tobytes())
    assert reader.take_latest() is not None
    second.close()
    assert domain_id not in Participant._domains


def test_a_participant_knows_cyclones_threads_and_sockets(domain_id, until):
    def name(thread):
        return Path(f"/proc/self/task/{thread}/comm").read_text().strip()

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        with Participant(domain_id, "lo") as first, Participant(domain_id, "lo") as second:
            assert first.threads == second.threads
            assert first.sockets == second.sockets
            until(lambda: {"gc", "recv", "tev"} <= set(map(name, first.threads)), "their names")
            assert threading.get_native_id() not in first.threads
            assert stranger.fileno() not in first.sockets
            ports = set()
            for descriptor in first.sockets:
                with socket.socket(fileno=os.dup(descriptor)) as one:
                    ports.add(one.getsockname()[1])
        # Version 0.10 has no sockets for multicast on loopback.
        assert {7400 + 250 * domain_id + offset for offset in (10, 11)} < ports


def test_a_participant_that_is_cut_off_closes_and_prints_nothing(domain_id, capfd):
    before = possessions()
    with Participant(domain_id, "lo") as participant:
        RawWriter(participant, LOWCMD)
        for descriptor in participant.sockets:
            with suppress(OSError), socket.socket(fileno=os.dup(descriptor)) as one:
                one.shutdown(socket.SHUT_WR)
        participant.cut_off()
    assert capfd.readouterr().err.count("ddsi_udp_conn_write") == 0
    assert possessions() == before
    with Participant(domain_id, "lo"):  # as before
        assert DDS._dll_handle.dds_get_log_mask()


def test_flags_are_those_of_an_interface_in_this_network_namespace(network_namespace):
    """/sys still shows the host's, and a name says nothing."""
    netns = network_namespace(
        "link set lo name loop0", "link add lo type veth peer name far", "link set lo up"
    )
    code = (
        "from g1stream.dds.domain import is_loopback as f; print([f(n) for n in ('lo', 'loop0')])"
    )
    command = ["nsenter", f"--net=/run/netns/{netns}", sys.executable, "-c", code]
    found = subprocess.run(command, capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[False, True]"


def test_those_that_are_there_are_found_among_many_that_have_left(domain_id, until, monkeypatch):
    monkeypatch.setattr("g1stream.dds.domain._AT_ONCE", 4)
    with Participant(domain_id, "lo") as observer, Participant(domain_id, "lo") as other:
        for _ in range(20):
            gone = [RawWriter(other, LOWCMD) for _ in range(2)]
            until(lambda: observer.writers(LOWCMD.name), "its discovery")
            for one in gone:
                one.close()
            until(lambda: not observer.writers(LOWCMD.name), "its departure")
        held = [RawWriter(other, topic) for topic in TOPICS]
        until(lambda: len(observer.writers()) == len(held), "all of them")
        assert len(observer._writers._reader.read(1024)) <= 2 * len(held)


def test_another_process_is_listed_with_its_id(domain_id, peer_on, until):
    with Participant(domain_id, "lo") as participant:
        assert participant.writers(LOWCMD.name) == participant.readers(LOWCMD.name) == []
        with peer_on(domain_id) as peer:
            until(lambda: participant.writers(LOWCMD.name), "its writer in discovery")
            until(lambda: participant.readers(LOWCMD.name), "its reader in discovery")
            (writer,) = participant.writers(LOWCMD.name)
            (reader,) = participant.readers(LOWCMD.name)
            for endpoint in (writer, reader):
                assert (endpoint.topic, endpoint.type_name) == (LOWCMD.name, LOWCMD_TYPE)
                assert endpoint.pid == str(peer.pid)
                assert endpoint.process in sys.executable
                assert f"pid {peer.pid} on {endpoint.host}" in participant.owner(endpoint)
            assert writer.participant == reader.participant
            until(lambda: participant.writers(REFERENCE.name), "its writer of references")
            assert participant.readers(LOWSTATE.name) == []
        until(lambda: not participant.writers(LOWCMD.name), "its departure")
        assert participant.readers(LOWCMD.name) == []


def test_own_endpoints_are_left_out(domain_id, until):
    with Participant(domain_id, "lo") as one, Participant(domain_id, "lo") as other:
        RawWriter(one, LOWCMD)
        RawReader(one, LOWSTATE)
        until(lambda: other.writers(LOWCMD.name), "the writer in discovery")
        until(lambda: other.readers(LOWSTATE.name), "the reader in discovery")
        assert one.writers(LOWCMD.name) == one.readers(LOWSTATE.name) == []
        assert [e.pid for e in other.writers(LOWCMD.name)] == [str(os.getpid())]


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
        (set(), {"rt/lowcmd"}, ""),
    ],
)
def test_our_programs_are_identified_by_their_topics(written, read, program):
    assert identify_program(written, read) == program


def test_on_loopback_samples_go_to_their_readers_alone(domain_id, peer_on, until):
    """Who merely shares the domain is not woken by them: nothing comes by multicast."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as bystander:
        bystander.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        bystander.bind(("", 7400 + 250 * domain_id + 1))  # of all (RTPS 2.5, section 9.6.2)
        group = socket.inet_aton("239.255.0.1") + socket.inet_aton("127.0.0.1")
        bystander.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, group)
        bystander.setblocking(False)
        with Participant(domain_id, "lo") as here, peer_on(domain_id), peer_on(domain_id):
            writer = RawWriter(here, LOWCMD)
            until(lambda: writer.matched == 2, "two readers")  # one alone is never sent multicast
            assert writer.write(LowCmd().seal())
        with pytest.raises(BlockingIOError):
            bystander.recv(65536)


def test_a_bridge_is_discovered_and_forgotten(domain_id, until):
    announced = AnnouncedBridge("hanging", "g1_29dof", 700.0)
    with Participant(domain_id, "lo") as ours:

        def found():
            return AnnouncedBridge.by(ours.writers(LOWSTATE.name))

        assert found() is None
        with Participant(domain_id, "lo") as bridge:
            writer = RawWriter(bridge, LOWSTATE, user_data=announced.user_data)
            until(lambda: found() == announced, "the bridge to say how it holds")
            RawReader(ours, LOWSTATE)
            until(lambda: writer.matched, "the reader of LowState to match")
        until(lambda: found() is None, "the bridge to be gone")


@pytest.mark.parametrize(
    ("texts", "expected"),
    [
        ([""], None),
        (["somebody else's"], None),
        (["g1stream.bridge="], None),
        *(([f"g1stream.bridge=bolted;{rate};g1"], None) for rate in ("0.5", "inf", "fast")),
        (["g1stream.bridge=bolted;700;my;own;g1"], AnnouncedBridge("bolted", "my;own;g1", 700.0)),
        (["g1stream.bridge=bolted;700;g1", "g1stream.bridge=hanging;700;g1"], None),
    ],
)
def test_what_a_writer_announces(texts, expected):
    assert AnnouncedBridge.by([SimpleNamespace(user_data=t.encode()) for t in texts]) == expected
