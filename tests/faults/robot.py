"""A robot that can fail, and the record of what its motors received; uses nothing of g1stream.

    python robot.py '{"domain": 20, "out": "tap.npz", "faults": [{"at": 0.8, "do": "silent"}]}'

29 joints with the servo of a motor (kp, kd, tau, limited to its effort) follow rt/lowcmd; the last
command stays in force, as on the robot. With "arm_sdk" its own controller holds the joints at 0,
and blends what comes on rt/arm_sdk into its command for arms and waist. rt/lowstate tells of them
at 250 Hz. Each fault acts from `at` to `until`, s after the first stiff command; negative: from the
beginning. A fault sets fields of LowState ("set": {"motor.q.3": NaN}) or does one
of `Robot.DO`; with "every": n, only in each n-th state.

It prints `ready` and `commanded`, and writes `out` when its standard input ends. After SIGUSR1 it
has no publisher any more.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
import time
from typing import Any, Final

import numpy as np
import unitree_hg
from g1 import EFFORT, WEIGHT

PERIOD: Final = 2_000_000
_BIT_OF_TICK: Final = 1_000_000  # ns; the robot's tick counts milliseconds


class Robot:
    """The joints, the faults and the wire.

    Args:
        spec: as in the module's docstring; also `interface`, and `q`, the pose at the start, rad.
    """

    DO: Final = (
        *("silent", "zeros", "bad_crc", "no_crc", "frozen_content"),
        *("jam", "leap", "restart", "twin", "rogue", "seldom"),
    )
    #: q, dq, tau, kp and kd (5, 29) of the robot's own controller.
    OWN: Final = np.repeat([[0.0], [0.0], [0.0], [60.0], [1.0]], 29, axis=1)

    def __init__(self, spec: dict[str, Any]) -> None:
        self.gone = False
        self.faults = spec.get("faults", [])
        assert all(f["do"] in self.DO for f in self.faults if "do" in f)
        self.wire = unitree_hg.Wire(spec["domain"], spec.get("interface", "lo"))
        self.arm_sdk = spec.get("arm_sdk", False)
        self.topic = "rt/arm_sdk" if self.arm_sdk else "rt/lowcmd"
        self.commands = self.wire.reader(self.topic, unitree_hg.LowCmd)
        self.states = self.wire.writer("rt/lowstate", unitree_hg.LowState)
        self.twin: Any = None
        self.rogue: Any = None
        self.raw = bytearray(unitree_hg.STATE.itemsize)
        self.state = unitree_hg.struct_in(self.raw, unitree_hg.STATE)
        self.state["mode_machine"] = 5
        self.state["imu"]["quaternion"][0] = 1.0
        self.state["imu"]["accelerometer"][2] = 9.81
        self.state["motor"]["mode"][:29] = 1
        self.state["motor"]["temperature"][:29] = 40
        self.q = np.array(spec.get("q", [0.0] * 29))
        self.dq, self.tau = np.zeros(29), np.zeros(29)
        self.inertia = EFFORT / 400.0
        self.command = np.zeros((), unitree_hg.CMD)
        self.rng = np.random.default_rng(1)
        self.tick_zero = time.monotonic_ns()
        self.commanded = 0
        self.begun: set[int] = set()
        self.turn = 0
        self.log: list[tuple[Any, ...]] = []
        self.pauses: list[tuple[int, int]] = []

    def active(self) -> list[dict[str, Any]]:
        """The faults of this moment; `new` is true the first time."""
        since = (time.monotonic_ns() - self.commanded) / 1e9 if self.commanded else -1.0
        found = []
        for number, fault in enumerate(self.faults):
            at = fault.get("at", -1.0)
            if self.turn // 2 % fault.get("every", 1):
                continue
            if (at < 0 or since >= at) and since < fault.get("until", 1e9):
                found.append({**fault, "new": number not in self.begun})
                self.begun.add(number)
        return found

    def receive(self) -> None:
        for sample in unitree_hg.take(self.commands):
            struct, info = unitree_hg.cmd_of(sample.data), sample.sample_info
            now = time.monotonic_ns()
            self.log.append(
                (
                    now,
                    info.source_timestamp,
                    info.publication_handle,
                    struct,
                    self.q.copy(),
                    self.dq.copy(),
                )
            )
            self.command = np.frombuffer(struct, unitree_hg.CMD)[0]
            if not self.commanded and self.command["motor"]["kp"].any():
                self.commanded = now
                print("commanded", flush=True)  # noqa: T201

    def move(self, doing: dict[str, dict[str, Any]]) -> None:
        motor = self.command["motor"][:29]
        asked = np.array([motor[name] for name in ("q", "dq", "tau", "kp", "kd")], float)
        on = motor["mode"] == 1
        if self.arm_sdk:
            weight = np.where(on, float(self.command["motor"]["q"][WEIGHT]), 0.0)
            asked, on = self.OWN + weight * (asked - self.OWN), np.ones(29, bool)
        q, dq, tau, kp, kd = asked
        friction = np.maximum(0.3, 1.4 * np.sqrt(kp * self.inertia) - kd)
        self.tau = kp * (q - self.q) + kd * (dq - self.dq) + tau
        self.tau = np.clip(np.nan_to_num(self.tau), -EFFORT, EFFORT) * on
        dt = PERIOD / 1e9
        damping = 1.0 + dt * friction / self.inertia
        self.dq = (self.dq + dt * self.tau / self.inertia) / damping
        if "jam" in doing:
            self.dq[doing["jam"]["joint"]] = 0.0
        self.q = self.q + dt * self.dq
        leap = doing.get("leap", {})
        if leap.get("new"):
            self.q[leap["joint"]] += leap["by"]

    def publish(self, faults: list[dict[str, Any]], doing: dict[str, dict[str, Any]]) -> None:
        state = self.state
        state["tick"] = (time.monotonic_ns() - self.tick_zero) // _BIT_OF_TICK
        motor = state["motor"]
        if "frozen_content" not in doing:
            motor["q"][:29] = self.q + self.rng.normal(0.0, 1e-5, 29)
            motor["dq"][:29], motor["tau_est"][:29] = self.dq, self.tau
            state["imu"]["gyroscope"] = self.rng.normal(0.0, 1e-3, 3)
        raw = bytearray(len(self.raw)) if "zeros" in doing else bytearray(self.raw)
        told = unitree_hg.struct_in(raw, unitree_hg.STATE)
        for fault in faults:
            for path, value in fault.get("set", {}).items():
                _set(told, path, value)
        if "no_crc" not in doing:
            told["crc"] = unitree_hg.crc_of(raw) ^ (0xBAD if "bad_crc" in doing else 0)
        sample = unitree_hg.sample_of_state(raw)
        unitree_hg.write(self.states, sample)
        if "twin" in doing:
            if self.twin is None:
                self.wire.another()
                self.twin = self.wire.writer("rt/lowstate", unitree_hg.LowState)
            unitree_hg.write(self.twin, sample)

    def restart(self) -> None:
        """Publish from now on as a bridge does that was started again."""
        self.tick_zero = time.monotonic_ns()
        self.states = None
        self.wire.another()
        self.states = self.wire.writer("rt/lowstate", unitree_hg.LowState)

    def interfere(self, announced: str) -> None:
        """Publish commands of our own, which damp."""
        if self.rogue is None:
            self.wire.another()
            self.rogue = self.wire.writer(self.topic, unitree_hg.LowCmd, announced)
        raw = bytearray(unitree_hg.CMD.itemsize)
        command = unitree_hg.struct_in(raw, unitree_hg.CMD)
        command["mode_machine"] = 5
        command["motor"]["mode"][:29] = 1
        command["motor"]["kd"][:29] = 1.0
        command["reserve"] = 0xBEEF  # so that the log can tell them apart
        command["crc"] = unitree_hg.crc_of(raw)
        unitree_hg.write(self.rogue, unitree_hg.sample_of_cmd(raw))

    def run(self, done: threading.Event) -> None:
        """Live until `done`."""
        deadline = last = time.monotonic_ns()
        while not done.is_set():
            deadline = max(deadline + PERIOD, time.monotonic_ns() - PERIOD)
            time.sleep(max(0.0, (deadline - time.monotonic_ns()) / 1e9))
            now = time.monotonic_ns()
            if now - last > 2 * PERIOD:
                self.pauses.append((last + PERIOD, now))
            last = now
            faults = self.active()
            doing = {fault["do"]: fault for fault in faults if "do" in fault}
            self.receive()
            if doing.get("restart", {}).get("new"):
                self.restart()
            self.move(doing)
            self.turn += 1
            if self.gone:
                self.states = None
            elif self.turn % (100 if "seldom" in doing else 2) == 0 and "silent" not in doing:
                self.publish(faults, doing)
            if "rogue" in doing:
                self.interfere(doing["rogue"].get("announced", ""))

    def save(self, out: str) -> None:
        """Write the log: one row a command."""
        columns = list(zip(*self.log, strict=True)) or [()] * 6
        commands = np.frombuffer(b"".join(columns[3]), np.uint8)
        np.savez(
            out,
            received=np.array(columns[0], np.int64),
            published=np.array(columns[1], np.int64),
            writer=np.array(columns[2], np.uint64),
            command=commands.reshape(-1, unitree_hg.CMD.itemsize),
            q=np.array(columns[4]).reshape(-1, 29),
            dq=np.array(columns[5]).reshape(-1, 29),
            pauses=np.array(self.pauses, np.int64).reshape(-1, 2),
            wall=time.time_ns() - time.monotonic_ns(),
        )


def _set(state: Any, path: str, value: Any) -> None:
    *names, last = path.split(".")
    place = state
    for name in names:
        place = place[int(name)] if name.isdigit() else place[name]
    place[int(last) if last.isdigit() else last] = value


def main() -> None:
    spec = json.loads(sys.argv[1])
    done = threading.Event()

    def wait() -> None:
        while os.read(0, 100):
            pass
        done.set()

    robot = Robot(spec)

    def leave(*_: object) -> None:
        robot.gone = True

    signal.signal(signal.SIGUSR1, leave)
    threading.Thread(target=wait, daemon=True).start()
    print("ready", flush=True)  # noqa: T201
    robot.run(done)
    robot.save(spec["out"])
    os._exit(0)  # Cyclone may wait for ever when a process leaves a domain with two participants


if __name__ == "__main__":
    main()
