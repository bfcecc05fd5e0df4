"""Flags over files: what is given counts, zero and all."""

from __future__ import annotations

from pathlib import Path

import pytest

from g1stream.cli.common import announce_wire
from g1stream.cli.stream import Stream
from g1stream.config import Config


def test_zero_is_a_domain(tmp_path):
    config = tmp_path / "five.toml"
    config.write_text("[dds]\ndomain = 5\n")
    assert Stream(motion="demo", domain=0, config=config).resolve().dds.domain == 0
    assert Stream(motion="demo", config=config).resolve().dds.domain == 5


def test_a_gains_file_goes_over_the_configs_entry_by_entry(tmp_path):
    config, gains = tmp_path / "config.toml", tmp_path / "gains.toml"
    config.write_text('[gains.kp]\n"*" = 20\n"*_knee_joint" = 30\n[gains.kd]\n"*" = 7\n')
    gains.write_text('[kp]\n"*" = 50\n')
    resolved = Stream(motion="demo", config=config, gains=Path(gains)).resolve().gains
    assert list(resolved.kp.items()) == [("*_knee_joint", 30.0), ("*", 50.0)]
    assert resolved.kd == {"*": 7.0}


def wire(interface):
    return Config.model_validate({"dds": {"interface": interface}})


def test_this_machine_alone_is_no_reason_to_warn(monkeypatch, capsys):
    monkeypatch.delenv("CYCLONEDDS_URI", raising=False)
    announce_wire(wire("lo"))
    assert "WARNING" not in capsys.readouterr().err


@pytest.mark.parametrize(("interface", "uri"), [("eth0", ""), ("lo", "file:///etc/cyclone.xml")])
def test_beyond_this_machine_is_announced_loudly(monkeypatch, capsys, interface, uri):
    monkeypatch.setenv("CYCLONEDDS_URI", uri)
    announce_wire(wire(interface))
    assert "WARNING" in capsys.readouterr().err


def test_who_commands_nobody_does_not_warn_of_what_moves(monkeypatch, capsys):
    monkeypatch.delenv("CYCLONEDDS_URI", raising=False)
    announce_wire(wire("eth0"), commands=False)
    assert capsys.readouterr().err == "DDS domain 1 on eth0.\n"
