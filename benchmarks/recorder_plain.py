"""A recorder as it is commonly written on the SDK: the peer in the recorder's benchmark.

A callback for each sample, cyclonedds' own classes, a protobuf message object for each and the
stock writer. It records the joints only, which is less than g1stream does.
"""

from __future__ import annotations

import argparse
import json
import signal
import threading
import time
from pathlib import Path
from typing import Any

from cyclonedds.core import Listener, Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic as CycloneTopic
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from mcap_protobuf.writer import Writer

from g1stream.dds.domain import Participant
from g1stream.dds.messages import LOWCMD, LOWSTATE, REFERENCE
from g1stream.robot.joints import JOINT_NAMES


class Plain(Listener):  # type: ignore[misc]
    """Writes each sample of one topic as it comes."""

    def __init__(self, topic: str, writer: Writer, lock: threading.Lock) -> None:
        super().__init__()
        self.topic, self.writer, self.lock, self.count = topic, writer, lock, 0

    def on_data_available(self, reader: Any) -> None:
        """Take what came, make messages of it and write them."""
        for sample in reader.take(64):
            now = time.time_ns()
            message = JointStates()
            message.timestamp.FromNanoseconds(now)
            for i, name in enumerate(JOINT_NAMES):
                joint = message.joints.add(name=name)
                q, dq, tau = _values(sample, i)
                joint.position, joint.velocity, joint.effort = q, dq, tau
            with self.lock:
                self.writer.write_message(self.topic, message, now, now)
                self.count += 1


def _values(sample: Any, i: int) -> tuple[float, float, float]:
    if hasattr(sample, "motor_cmd"):
        motor = sample.motor_cmd[i]
        return motor.q, motor.dq, motor.tau
    if hasattr(sample, "motor_state"):
        motor = sample.motor_state[i]
        return motor.q, motor.dq, motor.tau_est
    return sample.q[i], sample.dq[i], sample.tau[i]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("--domain", type=int, required=True)
    arguments = parser.parse_args()
    stop = threading.Event()
    signal.signal(signal.SIGINT, lambda *_: stop.set())
    qos = Qos(Policy.Reliability.BestEffort, Policy.History.KeepLast(4096))
    lock = threading.Lock()
    with (
        arguments.file.open("wb") as file,
        Writer(file) as writer,
        Participant(arguments.domain, "lo") as participant,
    ):
        listeners = [Plain(topic.name, writer, lock) for topic in (LOWCMD, LOWSTATE, REFERENCE)]
        readers = [
            DataReader(
                participant.entity,
                CycloneTopic(participant.entity, topic.name, topic.message.idl_type),
                qos,
                listener,
            )
            for topic, listener in zip((LOWCMD, LOWSTATE, REFERENCE), listeners, strict=True)
        ]
        stop.wait()
        for reader in readers:
            reader.set_listener(None)
        counts = [listener.count for listener in listeners]
    print(json.dumps({"recorded": sum(counts)}), flush=True)


if __name__ == "__main__":
    main()
