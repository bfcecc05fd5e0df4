"""What each part of a tick takes of the CPU, without the wire.

    python benchmarks/tick.py [--count 2000] [--json]

Each part is measured back to back, and after a pause of 2 ms, as in a loop at 500 Hz, when the
caches hold other things. "Sleep" is the clock's wait for the next deadline itself.
"""

from __future__ import annotations

import argparse
import json
import time
from itertools import count
from typing import TYPE_CHECKING

import numpy as np

import sides
from g1stream.clock import SystemClock
from g1stream.config import Config
from g1stream.control.command import Composer
from g1stream.control.feedforward import FeedForward
from g1stream.control.gains import resolve_gains
from g1stream.control.limits import CommandLimits
from g1stream.control.lowstate import LowStateChecks
from g1stream.control.reading import ImuReading, Reading
from g1stream.control.receiver import Receiver
from g1stream.control.sources import HeldTorques, Moment
from g1stream.control.targets import Targets, Timing
from g1stream.dds.messages import LowState
from g1stream.motion.readers import load_motion
from g1stream.motion.trajectory import Trajectory
from g1stream.realtime import on_time
from g1stream.robot.model import G1
from g1stream.types import Phase

if TYPE_CHECKING:
    from collections.abc import Callable

PERIOD = 0.002
TICK = 2_000_000  # ns
PAUSE = 0.002


def parts() -> dict[str, Callable[[int], object]]:
    """Name -> one part of tick k."""
    robot, config = G1.default(), Config()
    targets = Targets(Trajectory(load_motion("demo")), start=0.0, moved=robot.present)
    timing = Timing(wait=0, ramp=10**9, play=None, hold=0, damp=0)
    checks = LowStateChecks(robot, robot.present, config.safety, config.constants)
    limits, limit = CommandLimits(robot, config.safety), np.full(29, 100.0)
    composer = Composer(
        limits, resolve_gains(config.gains), Receiver(TICK, 0.5), robot.present, robot.present
    )
    imu = ImuReading(*(np.array(one) for one in ([1.0, 0, 0, 0], [0.0] * 3, [0.0, 0.0, 9.81])))
    target = targets.at(Phase.PLAY, 0, timing, targets.first)
    at_target = LowState()
    at_target.q[:] = target.q
    at_target.quaternion[:], at_target.accelerometer[:] = imu.quat_wxyz, imu.accelerometer
    measured = Reading.from_low_state(at_target, 0)

    def torque(support: str) -> Callable[[int], object]:
        source = HeldTorques(config, robot, simulated=True)
        feed = FeedForward(source, limit=limit, period=PERIOD)
        feed.begin(target, support)
        moment = Moment(Phase.PLAY, 1.0, target, measured, 0.001)
        return lambda _: feed.command(moment)

    state = LowState()
    state.mode_machine[()], state.motor_mode = 5, 1
    state.quaternion[:], state.accelerometer[:] = imu.quat_wxyz, imu.accelerometer

    checks.begin("hanging")
    published = count()

    def publish() -> int:
        """A LowState that differs from the one before, and when it is received, ns."""
        k = next(published)  # for all rows: what is checked seldom depends on the time
        state.tick[()] = 2 * k
        state.gyroscope[0] = k % 10
        state.q[:] = target.q
        return k * round(PERIOD * 1e9)

    def check(_: int) -> object:
        now = publish()
        checks.take(state, 1, now, target.q)
        return checks.unknown(now, target.q) or checks.stop

    composer.begin(measured.q, mode_machine=5)

    def compose(k: int) -> object:
        return composer.compose(
            target, target, Phase.PLAY, k, elapsed=PERIOD, measured=measured, age=PERIOD
        )

    return {
        "check the state": check,
        "check its CRC": lambda _: state.crc_matches(),
        "sample the motion": lambda k: targets.at(Phase.PLAY, k * TICK % 10**10, timing, target),
        "torque, bolted": torque("bolted"),
        "torque, hanging": torque("hanging"),
        "limit, compose and seal": compose,
    }


def measure(count: int) -> dict[str, dict[str, float]]:
    """CPU of this thread by part and circumstance, us."""
    found: dict[str, dict[str, float]] = {}
    for name, part in parts().items():
        costs = {}
        for circumstance, pause in (("back_to_back", 0.0), ("after_a_pause", PAUSE)):
            spent = 0
            for k in range(count):
                if pause:
                    time.sleep(pause)
                start = time.thread_time_ns()
                part(k)
                spent += time.thread_time_ns() - start
            costs[circumstance] = spent / count / 1000.0
        found[name] = costs
    found["sleep"] = {"after_a_pause": sleep_cost(count)}
    return found


def sleep_cost(count: int) -> float:
    """CPU of waiting for a deadline, us: falling asleep, waking up, and the rest awake."""
    clock = SystemClock()
    with on_time(priority=0):
        due, start = clock.now(), time.thread_time_ns()
        for _ in range(count):
            due += round(PAUSE * 1e9)
            clock.sleep_until(due)
        return (time.thread_time_ns() - start) / count / 1000.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    found = measure(args.count)
    if args.json:
        print(json.dumps(found, indent=2))
        return
    print(f"{'CPU of a tick, us':<20}{'back to back':>14}{'after a pause':>15}")
    for name, costs in found.items():
        hot, cold = costs.get("back_to_back"), costs["after_a_pause"]
        print(f"{name:<20}{'' if hot is None else f'{hot:.1f}':>14}{cold:15.1f}")
    print(sides.load())


if __name__ == "__main__":
    main()
