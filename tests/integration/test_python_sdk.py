"""LowCmd and LowState between g1stream and a process of Unitree's Python SDK, over real DDS."""

import json
import threading
import time
from functools import partial
from pathlib import Path

import pytest
from cyclonedds.idl import make_idl_struct
from cyclonedds.idl.types import uint32

from g1stream.dds.domain import Participant
from g1stream.dds.endpoints import RawReader, RawWriter
from g1stream.dds.messages import LowState, Message
from g1stream.dds.motion_switcher import ApiId
from g1stream.dds.topics import LOWCMD, LOWSTATE, SECONDARY_IMU, SPORTMODESTATE, Topic
from g1stream.sim.onboard import MotionService

TOPICS = {
    "lowcmd": LOWCMD,
    "lowstate": LOWSTATE,
    "secondary_imu": SECONDARY_IMU,
    "sportmodestate": SPORTMODESTATE,
}

DATA = Path(__file__).parents[1] / "data"

each_topic = pytest.mark.parametrize("name", TOPICS)
either_order = pytest.mark.parametrize("first", ["sdk", "ours"])


@pytest.fixture
def sdk_on(start_peer, domain_id):
    """Start a reader or writer of the SDK on the test's domain, and wait until it is there."""

    def start(mode):
        peer = start_peer("python_peer.py", mode, "--domain", str(domain_id))
        peer.wait_ready()
        return peer

    return start


@pytest.mark.parametrize("what", ["types", "samples"])
def test_golden_data_is_the_sdks(what, start_peer):
    """Where the SDK cannot run, tests/dds holds our wire to these files alone."""
    known = json.loads((DATA / f"sdk_{what}.json").read_text())
    assert start_peer("python_peer.py", what).next_report() == {"event": what, "data": known}


def send_until_seen(writer, data, peer):
    """Write a sample until the peer reports one that is new to it, and return its report."""
    for _ in range(600):
        writer.write(data)
        report = peer.next_report(within=0.05)
        if report:
            return report
    pytest.fail(f"the SDK does not receive our {writer.topic.name}\n{peer.errors()}")


@each_topic
@either_order
def test_sdk_reads_every_field_of_ours(name, first, sdk_on, domain_id, golden):
    peer = sdk_on(f"{name}-reader") if first == "sdk" else None
    with Participant(domain_id, "lo") as participant:
        writer = RawWriter(participant, TOPICS[name])
        peer = peer or sdk_on(f"{name}-reader")
        for sample in golden[name]:
            report = send_until_seen(writer, bytes.fromhex(sample["cdr"]), peer)
            assert report["fields"] == {k: v for k, v in sample.items() if k != "cdr"}
            assert report.get("crc_ok", "crc" not in sample)


@each_topic
@either_order
def test_we_read_every_byte_of_the_sdks(name, first, sdk_on, domain_id, golden, until):
    peer = sdk_on(f"{name}-writer") if first == "sdk" else None
    received = set()
    with Participant(domain_id, "lo") as participant:
        reader = RawReader(participant, TOPICS[name], depth=100)
        peer = peer or sdk_on(f"{name}-writer")

        def arrives(data):
            received.update(sample.data for sample in reader.take())
            return data in received

        for sample in golden[name]:
            peer.tell({k: v for k, v in sample.items() if k not in ("cdr", "crc")})
            until(partial(arrives, bytes.fromhex(sample["cdr"])), f"the SDK's {name}")
    assert received == {bytes.fromhex(sample["cdr"]) for sample in golden[name]}


def test_sdk_outlives_our_coming_and_going(sdk_on, domain_id, golden):
    peer = sdk_on("lowcmd-reader")
    for sample in golden["lowcmd"][:3]:
        with Participant(domain_id, "lo") as participant:
            writer = RawWriter(participant, LOWCMD)
            report = send_until_seen(writer, bytes.fromhex(sample["cdr"]), peer)
            assert report["fields"]["crc"] == sample["crc"]


@each_topic
def test_discovery_shows_the_sdks_process(name, sdk_on, domain_id, until):
    with Participant(domain_id, "lo") as participant:
        peer = sdk_on(f"{name}-writer")
        topic = TOPICS[name].name
        until(lambda: participant.writers(topic), "the SDK's writer in discovery")
        (writer,) = participant.writers(topic)
        assert writer.type_name == TOPICS[name].message.idl_type.__idl_typename__.replace(".", "::")
        assert writer.pid == str(peer.process.pid)
        assert participant.readers(topic) == []


def test_sdk_calls_our_motion_service(sdk_on, domain_id):
    stop = threading.Event()
    with Participant(domain_id, "lo") as participant:
        service = MotionService(participant, "ai")

        def serve():
            while not stop.wait(0.002):
                service.step(LowState().seal(), time.time_ns())

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            peer = sdk_on("motion-switcher")
            answers = []
            for call in (
                [ApiId.CHECK_MODE, "{}"],
                [ApiId.RELEASE_MODE, "{}"],
                [ApiId.CHECK_MODE, "{}"],
                [ApiId.SELECT_MODE, '{"name": "dance"}'],
                [ApiId.SELECT_MODE, '{"name": "normal"}'],
                [ApiId.CHECK_MODE, "{}"],
                [1004, "{}"],
            ):
                peer.tell(call)
                answers.append(peer.next_report())
        finally:
            stop.set()
            thread.join()
    assert [(one["code"], one["data"] and json.loads(one["data"])) for one in answers] == [
        (0, {"form": "0", "name": "ai"}),
        (0, ""),
        (0, {"form": "0", "name": ""}),
        (7004, ""),
        (0, ""),
        (0, {"form": "0", "name": "normal"}),
        (3203, ""),
    ]


def test_sdk_refuses_another_type_and_lives_on(sdk_on, domain_id, golden, until):
    class Other(Message):
        idl_type = make_idl_struct("LowCmd_", "unitree_hg.msg.dds_.LowCmd_", {"crc": uint32})

    peer = sdk_on("lowcmd-reader")
    with Participant(domain_id, "lo") as participant:
        writer = RawWriter(participant, Topic(LOWCMD.name, Other))
        until(lambda: participant.readers(LOWCMD.name), "the SDK's reader in discovery")
        # Matching, where it happens, comes with discovery.
        time.sleep(0.5)
        assert writer.matched == 0
    with Participant(domain_id, "lo") as participant:
        writer = RawWriter(participant, LOWCMD)
        report = send_until_seen(writer, bytes.fromhex(golden["lowcmd"][1]["cdr"]), peer)
        assert report["fields"]["crc"] == golden["lowcmd"][1]["crc"]
