"""A recorder of LowCmd and LowState that is not ours, run in the environment of Unitree's SDK.

    bag_side.py OUT

It writes what `ros2 bag record /lowcmd /lowstate` writes to an MCAP file: the samples as they are
on the wire, with ROS 2 definitions of unitree_hg, at the time of their receipt. SIGINT ends it.
"""

from __future__ import annotations

import signal
import sys
import threading
import time
from pathlib import Path
from typing import Final

from cyclonedds._clayer import ddspy_take
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from mcap.writer import Writer
from unitree_sdk2py.idl.unitree_hg.msg.dds_ import LowCmd_, LowState_

DOMAIN: Final = 1
SEPARATOR: Final = "=" * 80 + "\nMSG: unitree_hg/"
MOTOR_CMD: Final = """MotorCmd
uint8 mode
float32 q
float32 dq
float32 tau
float32 kp
float32 kd
uint32 reserve
"""
LOW_CMD: Final = """uint8 mode_pr
uint8 mode_machine
unitree_hg/MotorCmd[35] motor_cmd
uint32[4] reserve
uint32 crc
"""
IMU_STATE: Final = """IMUState
float32[4] quaternion
float32[3] gyroscope
float32[3] accelerometer
float32[3] rpy
int16 temperature
"""
MOTOR_STATE: Final = """MotorState
uint8 mode
float32 q
float32 dq
float32 ddq
float32 tau_est
int16[2] temperature
float32 vol
uint32[2] sensor
uint32 motorstate
uint32[4] reserve
"""
LOW_STATE: Final = """uint32[2] version
uint8 mode_pr
uint8 mode_machine
uint32 tick
unitree_hg/IMUState imu_state
unitree_hg/MotorState[35] motor_state
uint8[40] wireless_remote
uint32[4] reserve
uint32 crc
"""
TOPICS: Final = {
    "lowcmd": (LowCmd_, "LowCmd", (LOW_CMD, MOTOR_CMD)),
    "lowstate": (LowState_, "LowState", (LOW_STATE, IMU_STATE, MOTOR_STATE)),
}


def main() -> None:
    ended = threading.Event()
    signal.signal(signal.SIGINT, lambda *_: ended.set())
    participant, counts = DomainParticipant(DOMAIN), dict.fromkeys(TOPICS, 0)
    with Path(sys.argv[1]).open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2", library="bag_side")
        readers = {}
        for name, (kind, schema, parts) in TOPICS.items():
            text = SEPARATOR.join(parts).encode()
            number = writer.register_schema(f"unitree_hg/msg/{schema}", "ros2msg", text)
            channel = writer.register_channel(f"/{name}", "cdr", number)
            queue = Qos(Policy.History.KeepLast(500))
            readers[name] = (
                channel,
                DataReader(participant, Topic(participant, f"rt/{name}", kind), queue),
            )
        while not ended.wait(0.001):
            for name, (channel, reader) in readers.items():
                for data, about in ddspy_take(reader._ref, 200):
                    if about.valid_data:
                        now = time.time_ns()
                        writer.add_message(channel, now, bytes(data), now, counts[name])
                        counts[name] += 1
        writer.finish()  # type: ignore[no-untyped-call]


if __name__ == "__main__":
    main()
