import json
import subprocess
import sys
import threading
import time
from importlib.metadata import version

import pytest
from cyclonedds.core import Policy
from cyclonedds.core import Qos as CycloneQos
from cyclonedds.idl import make_idl_struct
from cyclonedds.idl.types import uint32
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from g1stream.dds import types
from g1stream.dds.discovery import AnnouncedBridge, Qos
from g1stream.dds.domain import Participant
from g1stream.dds.endpoints import RawReader, RawWriter
from g1stream.dds.messages import LOWCMD, LOWSTATE, LowState
from g1stream.doctor.facts import Interface
from g1stream.doctor.inspection import inspect_domain
from g1stream.network import InterfaceFlags

SHOWS_TYPES = not version("cyclonedds").startswith("0.10.")
LO = Interface("lo", InterfaceFlags.UP | InterfaceFlags.LOOPBACK)


def test_an_empty_domain(domain_id):
    facts = inspect_domain(domain_id, "lo", [LO], 0.2)
    assert not facts.writers
    assert not facts.state.received
    assert domain_id not in {domain for domain, *_ in (*facts.elsewhere, *facts.searched)}


COUNT = """
import json
from pathlib import Path
from g1stream.config import Config
from g1stream.doctor.inspection import diagnose
def sent():
    return int(Path("/proc/self/net/dev").read_text().split("eth0:")[1].split()[9])
before = sent()
findings = diagnose(Config(), 0.3)
print(json.dumps([sent() - before, [one.remedy for one in findings]]))
"""


def test_nothing_is_sent_on_an_interface_that_was_not_asked_for(network_namespace):
    netns = network_namespace(
        "link set lo up",
        "link add eth0 type veth peer name robot",
        "link set eth0 addrgenmode none",  # no neighbour discovery of IPv6
        "addr add 10.77.0.1/24 dev eth0",
        "link set eth0 up",
        "link set robot up",
    )
    command = ["ip", "netns", "exec", netns, sys.executable, "-c", COUNT]
    run = subprocess.run(command, capture_output=True, text=True, check=True)
    sent, remedies = json.loads(run.stdout)
    assert sent == 0
    assert any("--interface eth0" in one for one in remedies)


def test_silent_publisher(domain_id):
    with Participant(domain_id, "lo") as peer:
        RawWriter(peer, LOWSTATE)
        RawReader(peer, LOWCMD)
        facts = inspect_domain(domain_id, "lo", [LO], 0.5)
    assert facts.states_matched == 1
    assert facts.state.received == 0
    (writer,) = facts.writers
    assert writer.same_type is not False
    assert writer.qos == Qos(reliable=True)
    assert {reader.topic for reader in facts.readers} == {"rt/lowcmd"}


@pytest.mark.parametrize(
    ("user_data", "missed"), [(AnnouncedBridge("hanging").user_data, 2), (b"", None)]
)
def test_what_is_published(domain_id, user_data, missed):
    state = LowState()
    state.mode_machine[()] = 5
    state.rpy[:] = 0.1
    with Participant(domain_id, "lo") as peer:
        writer = RawWriter(peer, LOWSTATE, depth=100, user_data=user_data)

        def publish():
            while not writer.matched:
                time.sleep(0.001)
            for tick in (2, 4, 6, 12):
                state.tick[()] = tick
                writer.write(state.seal())

        thread = threading.Thread(target=publish)
        thread.start()
        facts = inspect_domain(domain_id, "lo", [LO], 1.0)
        thread.join()
    said = facts.state
    assert (said.received, said.tick_step, said.tick_jumps, said.missed) == (4, 2, 1, missed)
    assert (said.crc_right, said.crc_zero, said.mode_machine) == (4, 0, 5)
    assert said.has_rpy
    assert 0.0 <= said.ages_ms[0] <= said.ages_ms[1]


def test_another_type(domain_id):
    other = make_idl_struct("LowState_", "unitree_hg.msg.dds_.LowState_", {"crc": uint32})
    with Participant(domain_id, "lo") as peer:
        writer = DataWriter(peer.entity, Topic(peer.entity, LOWSTATE.name, other))
        facts = inspect_domain(domain_id, "lo", [LO], 0.5)
        del writer
    # Cyclone 0.10.2 does not show the types that others announce.
    (writer,) = facts.writers
    assert writer.same_type is (False if SHOWS_TYPES else None)
    assert facts.states_matched == 0


def test_other_policies(domain_id):
    with Participant(domain_id, "lo") as peer:
        topic = Topic(peer.entity, LOWSTATE.name, types.LowState_)
        writer = DataWriter(peer.entity, topic, CycloneQos(Policy.Partition(["lab"])))
        topic = Topic(peer.entity, LOWCMD.name, types.LowCmd_)
        durable = CycloneQos(Policy.Reliability.Reliable(0), Policy.Durability.TransientLocal)
        reader = DataReader(peer.entity, topic, durable)
        facts = inspect_domain(domain_id, "lo", [LO], 0.5)
        del writer, reader
    assert facts.states_matched == 0
    assert facts.writers[0].qos.partitions == ("lab",)
    assert facts.readers[0].qos == Qos(reliable=True, durability=1)


PUBLISHER = """
from g1stream.dds.domain import Participant
from g1stream.dds.endpoints import RawWriter
from g1stream.dds.messages import LOWSTATE
participant = Participant({}, "lo")
writer = RawWriter(participant, LOWSTATE)
"""


def test_a_publisher_in_any_domain_is_found(claim_domain, monkeypatch, stranger):
    """No domain is guessed: those of the programs of this machine are searched."""
    monkeypatch.setattr("g1stream.doctor.inspection._DISCOVERY_S", 2.0)  # of a busy machine
    here, there = claim_domain(), claim_domain()
    pid = stranger(PUBLISHER.format(there))
    facts = inspect_domain(here, "lo", [LO], 0.2)
    assert (there, "lo") in facts.searched
    (owner,) = [owner for domain, _, owner in facts.elsewhere if domain == there]
    assert f"pid {pid} " in owner
    assert pid in {one.pid for one in facts.local if one.domain == there}


@pytest.mark.parametrize(
    ("policies", "expected"),
    [
        ([Policy.Reliability.BestEffort, Policy.Durability.Volatile], Qos()),
        ([Policy.Deadline(5_000_000)], Qos(deadline=5_000_000)),
        ([Policy.Ownership.Exclusive], Qos(exclusive=True)),
        ([Policy.Durability.Persistent], Qos(durability=3)),
        ([Policy.DataRepresentation(False, True)], Qos(xcdr1=False)),
    ],
)
def test_policies(policies, expected):
    assert Qos.of(CycloneQos(*policies)) == expected
