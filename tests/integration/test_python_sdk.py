"""LowCmd and LowState between g1stream and a process of Unitree's Python SDK, over real DDS."""

import json
import os
import signal
import subprocess
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from cyclonedds.idl import make_idl_struct
from cyclonedds.idl.types import uint32

from g1stream.dds.domain import Participant
from g1stream.dds.endpoints import RawReader, RawWriter
from g1stream.dds.messages import (
    LOWCMD,
    LOWSTATE,
    SECONDARY_IMU,
    SPORTMODESTATE,
    LowState,
    Message,
    Topic,
)
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS
from threads import in_thread

TOPICS = {
    "lowcmd": LOWCMD,
    "lowstate": LOWSTATE,
    "secondary_imu": SECONDARY_IMU,
    "sportmodestate": SPORTMODESTATE,
}

DATA = Path(__file__).parents[1] / "data"
#: A checkout of unitree_sdk2_python; its wheel has no examples.
SDK = os.environ.get("UNITREE_SDK2_PYTHON", "")

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
    from g1stream.extras.onboard.motion_service import ApiId
    from g1stream.extras.onboard.simulated import MotionService

    with Participant(domain_id, "lo") as participant:
        service = MotionService(participant, "ai")

        def serve(stop):
            while not stop.wait(0.002):
                service.step(LowState().seal(), time.time_ns())

        with in_thread(serve):
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
    assert [(one["code"], one["data"] and json.loads(one["data"])) for one in answers] == [
        (0, {"form": "0", "name": "ai"}),
        (0, ""),
        (0, {"form": "0", "name": ""}),
        (7004, ""),
        (0, ""),
        (0, {"form": "0", "name": "normal"}),
        (3203, ""),
    ]


def test_sdk_moves_the_arms_of_a_robot_that_stands(sdk_on, domain_id, running, until):
    elbow, state = JOINT_NAMES.index("left_elbow_joint"), LowState()
    with (
        running("sim", "--domain", domain_id, "--onboard", "ai", "--support", "follow"),
        Participant(domain_id, "lo") as participant,
    ):
        reader = RawReader(participant, LOWSTATE)

        def measured():
            if sample := reader.take_latest():
                state.load(sample.data)
            return state.q

        until(reader.take_latest, "the simulator")
        peer = sdk_on("arm_sdk-writer")
        for weight, angle in ((1.0, 0.8), (0.0, 0.0)):
            motors = [[1, 0.8 * (joint == elbow), 0, 0, 60.0, 1.5, 0] for joint in range(N_JOINTS)]
            motors += [[0, weight * (slot == N_JOINTS), 0, 0, 0, 0, 0] for slot in range(29, 35)]
            peer.tell({"motor_cmd": motors})
            until(lambda angle=angle: abs(measured()[elbow] - angle) < 0.1, f"the elbow at {angle}")
        assert np.abs(measured()[:12]).max() < 0.1


@pytest.mark.skipif(not SDK, reason="set UNITREE_SDK2_PYTHON to a checkout of unitree_sdk2_python")
def test_the_sdks_own_arm_example_drives_our_bridge(domain_zero, running, sdk_python, tmp_path):
    # The environment of the SDK, in which another test of this file runs, cannot read sessions.
    from g1stream.app.session import open_session

    example = Path(SDK) / "example" / "g1" / "high_level" / "g1_arm7_sdk_dds_example.py"
    roll, path = JOINT_NAMES.index("left_shoulder_roll_joint"), tmp_path / "s.mcap"
    where = ("--domain", domain_zero)
    with (
        running("sim", *where, "--onboard", "ai", "--support", "follow"),
        running("record", "-o", path, *where) as recorder,
    ):
        done = subprocess.run(
            [sdk_python, example, "lo"],
            input="\n",
            capture_output=True,
            text=True,
            check=False,
            timeout=60,
            env={**os.environ, "PYTHONPATH": SDK},
        )
        recorder.send_signal(signal.SIGINT)
        recorder.communicate(timeout=30)
    assert "Done!" in done.stdout, done.stderr
    session = open_session(path)
    q = session.measured.q
    assert session.topics["/arm_sdk"] > 900  # 21 s at 50 Hz
    assert q[:, roll].max() == pytest.approx(np.pi / 2, abs=0.2)
    assert np.abs(q[-1]).max() < 0.1  # handed back
    assert np.abs(q[:, :12]).max() < 0.1


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
