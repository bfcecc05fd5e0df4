from dataclasses import replace

import pytest
from cyclonedds.core import Policy, Qos

from g1stream.dds.discovery import Endpoint
from g1stream.doctor.facts import Facts, HostFacts, Interface, StateFacts, WakeupLatency, WireFacts
from g1stream.network import InterfaceFlags
from g1stream.realtime import Grant

RELIABLE = Qos(Policy.Reliability.Reliable(0))
PYTHON = {"host": "here", "pid": "7", "process": "python"}
BRIDGE = {"participant": "bridge", "policies": RELIABLE, **PYTHON}


@pytest.fixture
def healthy():
    host = HostFacts(
        interfaces=(
            Interface("lo", InterfaceFlags.UP | InterfaceFlags.LOOPBACK),
            Interface("eth0", InterfaceFlags.UP | InterfaceFlags.MULTICAST, "192.168.123.5"),
        ),
        uri="",
        cyclonedds="11.0.1",
        rmem_max=4 << 20,
        clock_source="tsc",
        grants=(Grant("SCHED_FIFO", granted=True, detail="priority 50"),),
    )
    state = StateFacts(
        seconds=1.0,
        received=500,
        ages_ms=(0.1, 0.4),
        tick_step=2,
        missed=0,
        crc_right=500,
        mode_machine=5,
        has_rpy=True,
    )
    wire = WireFacts(
        1,
        "lo",
        writers=(
            Endpoint("rt/lowstate", "LowState_", **BRIDGE),
            Endpoint("rt/sportmodestate", "SportModeState_", **BRIDGE),
        ),
        readers=(Endpoint("rt/lowcmd", "LowCmd_", "bridge", **PYTHON),),
        state=state,
        states_matched=1,
    )
    latency = WakeupLatency(500.0, 250, missed=0, median_ns=5_000, worst_ns=90_000)
    return Facts(wire, host, (0, 5), latency)


@pytest.fixture
def changed(healthy):
    """The healthy facts with some values of the host, the wire or the LowStates replaced."""

    def change(host=None, wire=None, state=None, **other):
        new_host = replace(healthy.host, **(host or {}))
        new_state = replace(healthy.wire.state, **(state or {}))
        new_wire = replace(healthy.wire, state=new_state, **(wire or {}))
        return replace(healthy, **({"host": new_host, "wire": new_wire} | other))

    return change
