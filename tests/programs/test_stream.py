"""A stream that nobody answers says why."""

from __future__ import annotations

import json

import pytest
from cyclonedds.core import Policy
from cyclonedds.core import Qos as CycloneQos
from cyclonedds.idl import make_idl_struct
from cyclonedds.idl.types import uint32
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from g1stream.cli.main import main
from g1stream.config import Config
from g1stream.dds import types
from g1stream.dds.domain import Participant
from g1stream.dds.endpoints import RawWriter
from g1stream.dds.topics import LOWCMD, LOWSTATE
from g1stream.programs.stream import stream


@pytest.fixture
def config(domain_id):
    return Config.model_validate({"dds": {"domain": domain_id}, "stream": {"wait": 1.0}})


def test_a_publisher_of_another_type_is_named(domain_id, config):
    other = make_idl_struct("LowState_", "unitree_hg.msg.dds_.LowState_", {"crc": uint32})
    with Participant(domain_id, "lo") as peer:
        writer = DataWriter(peer.entity, Topic(peer.entity, LOWSTATE.name, other))
        summary = stream("demo", config)
        del writer
    assert "no LowState" in summary.stream.reason
    (finding,) = summary.stream.findings
    assert finding.about == "types"
    assert finding.remedy


def test_a_reader_with_other_policies_is_named(domain_id, config):
    with Participant(domain_id, "lo") as peer:
        RawWriter(peer, LOWSTATE)
        topic = Topic(peer.entity, LOWCMD.name, types.LowCmd_)
        durable = CycloneQos(Policy.Reliability.Reliable(0), Policy.Durability.TransientLocal)
        reader = DataReader(peer.entity, topic, durable)
        summary = stream("demo", config)
        del reader
    assert [finding.about for finding in summary.stream.findings] == ["LowState", "QoS"]
    assert "transient local" in summary.stream.findings[1].cause


@pytest.fixture
def short(tmp_path):
    path = tmp_path / "short.toml"
    path.write_text("[stream]\nwait = 1.0\n")
    return str(path)


def test_where_nobody_is_it_leads_to_the_doctor(domain_id, short, capsys, monkeypatch):
    monkeypatch.setattr("g1stream.cli.stream.on_signals", lambda stop: None)
    assert main(["stream", "demo", "--domain", str(domain_id), "--config", short]) == 1
    printed = capsys.readouterr().out
    printed = " ".join(printed.split())
    assert f"no publisher on rt/lowstate in domain {domain_id} on lo" in printed
    assert f"g1stream doctor --domain {domain_id} --interface lo" in printed


def test_it_is_in_the_json(domain_id, short, capsys, monkeypatch):
    monkeypatch.setattr("g1stream.cli.stream.on_signals", lambda stop: None)
    main(["stream", "demo", "--domain", str(domain_id), "--config", short, "--json"])
    stream = json.loads(capsys.readouterr().out)["stream"]
    assert [finding["about"] for finding in stream["findings"]] == ["publisher"]
