"""A robot that comes when a stream has just given up is not blamed for anything."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from threading import Event

import pytest

from g1stream.app import stream as program
from g1stream.app.stream import stream
from g1stream.config import Config
from g1stream.dds.domain import Participant
from g1stream.dds.endpoints import RawReader, RawWriter
from g1stream.dds.messages import LOWCMD, LOWSTATE, LowState
from g1stream.doctor.facts import Level


@pytest.fixture
def late_bridge(domain_id, monkeypatch):
    """It comes while the wire is listened to."""
    stop, looks, kept = Event(), program.inspect_participant, []
    state = LowState().seal()

    def publish(writer):
        while not stop.wait(0.002):
            writer.write(state, time.time_ns())

    with Participant(domain_id, "lo") as bridge, ThreadPoolExecutor(1) as pool:

        def inspect_participant(participant, seconds):
            kept.append(RawReader(bridge, LOWCMD))
            pool.submit(publish, RawWriter(bridge, LOWSTATE))
            return looks(participant, seconds)

        monkeypatch.setattr(program, "inspect_participant", inspect_participant)
        yield
        stop.set()


def test_a_late_robot_is_only_a_warning(domain_id, late_bridge):
    config = Config.model_validate({"dds": {"domain": domain_id}, "stream": {"wait": 1.0}})
    (finding,) = stream("demo", config).stream.findings
    assert finding.level is Level.WARNING
    assert finding.about == "wire"
