"""The SDK's side of the benchmarks, run in the environment of tools/make_sdk_env.py.

Written the way of Unitree's own G1 examples: a subscriber with a handler, a RecurrentThread, a
publisher, and a LowCmd object that is filled motor by motor. The checksum is left out: the wheel
lacks the library for it.

    sdk_side.py operations --domain N     CPU of one of each, us
    sdk_side.py run --domain N --rate HZ --seconds S     a control loop: CPU and lateness
"""

# ruff: noqa: E402  the SDK can be imported only after find_sdk()
from __future__ import annotations

import argparse
import importlib.util
import json
import sys
import time
import types
from collections import Counter
from typing import Any


def find_sdk() -> None:
    """Make the SDK importable: its `__init__` imports a subpackage that its wheel lacks."""
    package = types.ModuleType("unitree_sdk2py")
    spec = importlib.util.find_spec("unitree_sdk2py")
    assert spec
    assert spec.submodule_search_locations
    package.__path__ = list(spec.submodule_search_locations)
    sys.modules["unitree_sdk2py"] = package


find_sdk()

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from unitree_sdk2py.core.channel import (
    ChannelFactoryInitialize,
    ChannelPublisher,
    ChannelSubscriber,
)
from unitree_sdk2py.idl.default import unitree_hg_msg_dds__LowCmd_ as empty_low_cmd
from unitree_sdk2py.idl.default import unitree_hg_msg_dds__LowState_ as empty_low_state
from unitree_sdk2py.idl.unitree_hg.msg.dds_ import LowCmd_, LowState_
from unitree_sdk2py.utils import thread as sdk_thread

N_JOINTS = 29
BURST = 16


class Side:
    """What a controller of the SDK does in a tick."""

    def __init__(self, domain: int) -> None:
        ChannelFactoryInitialize(domain, "lo")
        self.publisher = ChannelPublisher("rt/lowcmd", LowCmd_)
        self.publisher.Init()
        self.subscriber = ChannelSubscriber("rt/lowstate", LowState_)
        self.command = empty_low_cmd()
        self.states = 0
        self.q: list[float] = []
        self.dq: list[float] = []
        self.quaternion: list[float] = []

    def decode(self, state: Any) -> None:
        """Take out what control needs."""
        self.states += 1
        self.q = [state.motor_state[i].q for i in range(N_JOINTS)]
        self.dq = [state.motor_state[i].dq for i in range(N_JOINTS)]
        self.quaternion = list(state.imu_state.quaternion)

    def fill(self) -> None:
        """Set every motor's five numbers."""
        self.command.mode_pr = 0
        self.command.mode_machine = 5
        for i in range(N_JOINTS):
            motor = self.command.motor_cmd[i]
            motor.mode = 1
            motor.q = 0.1
            motor.dq = 0.2
            motor.tau = 0.3
            motor.kp = 40.0
            motor.kd = 1.0

    def publish(self) -> None:
        """Send what was filled."""
        self.publisher.Write(self.command)


def operations(side: Side, domain: int, n: int, pause: float) -> dict[str, float]:
    """CPU of this thread for one of each, us, in bursts with a pause before each.

    Samples are taken with `take(1)`, as the SDK's own handler does; its `Read` costs more.
    """
    participant = DomainParticipant(domain)
    topic = Topic(participant, "rt/lowstate", LowState_)
    reader = DataReader(participant, topic, Qos(Policy.History.KeepLast(BURST)))
    writer = DataWriter(participant, topic)
    state = empty_low_state()
    burst = BURST if pause == 0 else 1
    spent: Counter[str] = Counter()
    clock = time.thread_time_ns
    time.sleep(1.0)  # discovery
    for _ in range(n // burst):
        for _ in range(burst):
            writer.write(state)
        time.sleep(pause)
        start = clock()
        for _ in range(burst):
            side.fill()
        filled = clock()
        for _ in range(burst):
            side.publish()
        written = clock()
        samples = [reader.take(1)[0] for _ in range(burst)]
        taken = clock()
        for sample in samples:
            side.decode(sample)
        decoded = clock()
        spent["fill"] += filled - start
        spent["write"] += written - filled
        spent["take"] += taken - written
        spent["decode"] += decoded - taken
    count = n // burst * burst
    return {name: total / count / 1000.0 for name, total in spent.items()}


class Lateness:
    """Ticks against their absolute deadlines, those of the timer that paces the RecurrentThread."""

    def __init__(self, period: int) -> None:
        self.period = period
        self.start = 0
        self.last = -1
        self.skipped = 0
        self.histogram: Counter[int] = Counter()
        self.maximum = 0
        arm = sdk_thread.timerfd_settime

        def armed(*arguments: Any) -> Any:
            result = arm(*arguments)
            self.start = time.monotonic_ns()
            return result

        sdk_thread.timerfd_settime = armed

    def deadline(self) -> int:
        """The newest deadline that has passed; the ones between it and the last were skipped."""
        k = (time.monotonic_ns() - self.start) // self.period
        self.skipped += max(0, k - self.last - 1)
        self.last = k
        return self.start + k * self.period

    def add(self, deadline: int) -> None:
        """Count a command that is out now."""
        late = time.monotonic_ns() - deadline
        self.maximum = max(self.maximum, late)
        self.histogram[late // 1000] += 1


def run(side: Side, rate: float, seconds: float) -> dict[str, Any]:
    """A control loop at a rate."""
    side.subscriber.Init(side.decode, 10)
    lateness = Lateness(round(1e9 / rate))

    def tick() -> None:
        deadline = lateness.deadline()
        side.fill()
        side.publish()
        lateness.add(deadline)

    time.sleep(1.0)  # discovery
    side.states = 0
    cpu, wall = time.process_time(), time.monotonic()
    thread = sdk_thread.RecurrentThread(interval=1 / rate, target=tick, name="control")
    thread.Start()
    time.sleep(seconds)
    thread.Wait()
    elapsed = time.monotonic() - wall
    return {
        "cpu_percent": 100 * (time.process_time() - cpu) / elapsed,
        "commands": sum(lateness.histogram.values()),
        "states": side.states,
        "skipped": lateness.skipped,
        "max_us": lateness.maximum / 1000.0,
        "histogram_us": dict(lateness.histogram),
    }


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("mode", choices=["operations", "run"])
    parser.add_argument("--domain", type=int, required=True)
    parser.add_argument("--rate", type=float, default=500.0)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("--pause", type=float, default=0.0)
    args = parser.parse_args()
    side = Side(args.domain)
    if args.mode == "operations":
        result: dict[str, Any] = operations(side, args.domain, args.count, args.pause)
    else:
        result = run(side, args.rate, args.seconds)
    print(json.dumps(result), flush=True)


if __name__ == "__main__":
    main()
