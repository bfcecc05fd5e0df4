"""Run one fault: a robot that records what its motors get, `g1stream stream`, and what goes wrong.

`play` returns an `Outcome`: figures of the commands that were received, how the process ended and
what the session file says, read with the official reader. `Outcome.wrong` lists what must not be.
"""

from __future__ import annotations

import csv
import json
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from forked import Forked
from g1 import JOINTS
from judge import LENGTH, RATE, Outcome, judge

HERE: Final = Path(__file__).parent
PATIENCE: Final = 100.0
#: Of every process that a row starts. pytest changes os.environ between two tests, and a process
#: that another thread starts with it meanwhile may fail with EFAULT.
ENVIRONMENT: Final = {k: v for k, v in os.environ.items() if k != "CYCLONEDDS_URI"}
#: Rows that run at the same time: they mostly wait.
AT_ONCE: Final = 4

CONFIG: Final = f"""
[stream]
rate = {RATE}.0
ramp = 0.3
hold = 0.1
damp = 0.5
wait = 4.0
"""


@dataclass(frozen=True)
class Fault:
    """One row of the table.

    Attributes:
        name: what goes wrong.
        group: part of the table.
        robot: faults of the robot, see robot.py.
        act: done to the running session, `at` s after the first stiff command, or after the
            recorder has started if nothing is commanded.
        prepare: makes files in the session's folder; returns more arguments of the command.
        code: exit code expected; negative: the signal that ends the process.
        reason: must be in what the program prints, such as the setting that was exceeded.
        sent: something is commanded; otherwise not one LowCmd may come.
        soft: the first command must damp.
        mute: what the program prints is not seen.
        ends: the session ends before the motion does.
        record: what the session file must be: "complete", "cut" (its end is missing, but the
            official reader reads it) or "any"; None: the session is not recorded.
        handover_ms: longest time between the streamer's last command and the guard's first.
        q: pose of the robot at the start.
        arms: the robot stands by its own controller, and the command is `stream --via arm_sdk`.
        command: arguments of g1stream, instead of `stream MOTION`.
        alone: run while no other fault is.
        impossible: why it cannot be brought about on this machine.
        at: see `act`.
    """

    name: str
    group: str
    robot: Sequence[dict[str, Any]] = ()
    act: Callable[[Session], None] | None = None
    prepare: Callable[[Session], Sequence[str]] | None = None
    code: int | tuple[int, ...] = 1
    reason: str = ""
    sent: bool = True
    soft: bool = False
    mute: bool = False
    ends: bool = True
    record: str | None = None
    handover_ms: float | None = None
    q: Sequence[float] | None = None
    arms: bool = False
    command: Sequence[str] = ()
    alone: bool = False
    impossible: str = ""
    at: float = 0.8


class Robot:
    """robot.py as a process."""

    def __init__(self, spec: dict[str, Any], prefix: Sequence[str] = ()) -> None:
        self.out = Path(spec["out"])
        stdin, ours = os.pipe()
        said, stdout = os.pipe()
        self._stdin, self._said = os.fdopen(ours, "w"), os.fdopen(said)
        self._process: Forked | subprocess.Popen[bytes]
        if prefix:
            command = [*prefix, sys.executable, str(HERE / "robot.py"), json.dumps(spec)]
            self._process = subprocess.Popen(command, stdin=stdin, stdout=stdout, env=ENVIRONMENT)
        else:
            self._process = Forked("robot", [json.dumps(spec)], ENVIRONMENT, [stdin, stdout, 2])
        os.close(stdin)
        os.close(stdout)
        self._lines: queue.SimpleQueue[str] = queue.SimpleQueue()
        threading.Thread(target=self._listen, daemon=True).start()
        if self._lines.get(timeout=PATIENCE) != "ready":
            raise RuntimeError("the robot does not start")

    def _listen(self) -> None:
        with self._said:
            for line in self._said:
                self._lines.put(line.strip())
        self._lines.put("")

    def wait_commanded(self, alive: Callable[[], bool]) -> bool:
        """Whether a stiff command comes before the streamer ends."""
        while alive() and self._lines.empty():
            time.sleep(0.02)
        return not self._lines.empty() and self._lines.get() == "commanded"

    def finish(self) -> Any:
        """End it; its record."""
        self._stdin.close()
        self._process.wait(PATIENCE)
        with np.load(self.out) as record:
            return {name: record[name] for name in record.files}

    def mute(self) -> None:
        """Leave the domain, and keep the record."""
        self._process.send_signal(signal.SIGUSR1)

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()


class Session:
    """A running `g1stream` with its robot, for what is done to it.

    Attributes:
        folder: of its files.
        domain: of DDS.
        interface, prefix: of the network; what runs a command where that interface is.
        motion, config: the files of the motion and the settings.
        environment: of the command.
        process: the command's.
        robot: the robot.
        path: the session file.
        said: the file for what the command prints.
        before: called in the command's process before it begins.
        terminal, screen: the command's end of a terminal and ours, where it has one.
        clean_up: called at the end.
        wrong: what an act has found.
    """

    def __init__(self, fault: Fault, domain: int, folder: Path) -> None:
        self.fault, self.domain, self.folder = fault, domain, folder
        self.path = folder / "session.mcap"
        self.motion = folder / "motion.csv"
        self.config = folder / "config.toml"
        self.environment = dict(ENVIRONMENT)
        self.interface = "lo"
        self.prefix: list[str] = []
        self.before: Callable[[], None] | None = None
        self.terminal: int | None = None
        self.screen = -1
        self.clean_up: list[Callable[[], Any]] = []
        self.wrong: list[str] = []
        self.said = folder / "said.txt"
        self.process: Forked | subprocess.Popen[bytes]
        self.robot: Robot

    def set(self, text: str) -> None:
        """Add lines of TOML to the settings."""
        self.config.write_text(self.config.read_text() + text)

    def customise(self, code: str) -> None:
        """Run Python code at the start of each process of the session."""
        (self.folder / "sitecustomize.py").write_text(code)
        paths = [str(self.folder), *filter(None, [self.environment.get("PYTHONPATH")])]
        self.environment["PYTHONPATH"] = os.pathsep.join(paths)

    def start(self, arguments: Sequence[str]) -> None:
        with self.said.open("ab") as said, Path(os.devnull).open() as nothing:
            streams = [nothing.fileno(), said.fileno(), said.fileno()]
            if self.terminal is not None:
                streams = [self.terminal] * 3
            # What acts before an interpreter has started needs one of its own.
            own = self.prefix or self.before or self.environment != ENVIRONMENT
            if own or self.terminal is not None:
                stdin, stdout, stderr = streams
                self.process = subprocess.Popen(
                    [*self.prefix, sys.executable, "-m", "g1stream", *arguments],
                    stdin=stdin,
                    stdout=stdout,
                    stderr=stderr,
                    env=self.environment,
                    preexec_fn=self.before,  # noqa: PLW1509
                )
            else:
                self.process = Forked("g1stream.cli.main", arguments, ENVIRONMENT, streams)
        if self.terminal is not None:
            os.close(self.terminal)

    def alive(self) -> bool:
        return self.process.poll() is None

    def children(self, program: str = "") -> list[int]:
        """The processes of this session's programs, or of one of them, such as `record`."""
        names = [f"-m\0g1stream.{room}.{program}" for room in ("app", "control", "recorder")]
        parents, found = [self.process.pid], []
        while parents:
            for task in Path(f"/proc/{parents.pop()}/task").glob("*/children"):
                with suppress(OSError):  # a thread or a process that has just ended
                    for pid in map(int, task.read_text().split()):
                        parents.append(pid)
                        line = Path(f"/proc/{pid}/cmdline").read_text()
                        found += [pid] * any(name in line for name in names)
        return found

    def recorder(self) -> int:
        return self.children("record")[0]

    def receiver(self) -> int:
        return self.children("receiver")[0]

    def guard(self) -> int:
        return self.children("guard")[0]

    def wait_recorder(self) -> bool:
        """Whether the recorder starts before the command ends."""
        while self.alive() and not self.children("record"):
            time.sleep(0.02)
        return self.alive()

    def wait_for(self, processes: Sequence[int]) -> None:
        """Until these have ended as well; what has not after a while is wrong, and killed."""
        end = time.monotonic() + PATIENCE / 5
        for pid in processes:
            while _runs(pid) and time.monotonic() < end:
                time.sleep(0.05)
            if _runs(pid):
                self.wrong.append(f"process {pid} goes on")
                with suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)

    def wait(self) -> int:
        """Until the command ends; killed after a while."""
        try:
            return self.process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
            return 1000


def _runs(pid: int) -> bool:
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return False
    return stat.rpartition(")")[2].split()[0] != "Z"


def write_motion(path: Path, joints: Any, fps: int = 30) -> None:
    """A motion file of joint positions (N, 29), in the layout with a header."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow([*["Frame", "X", "Y", "Z", "QX", "QY", "QZ", "QW"], *JOINTS])
        for number, row in enumerate(joints):
            writer.writerow([number, 0, 0, 0.793, 0, 0, 0, 1, *row])


def sway(amplitude: float = 0.9, fps: int = 30) -> Any:
    """(N, 29) rad: from zero and back, with arms, waist and knees."""
    t = np.arange(round(LENGTH * fps) + 1) / fps
    joints = np.zeros((len(t), 29))
    swing = amplitude * (1 - np.cos(2 * np.pi * t / 1.25)) / 2
    for name in ("left_knee", "right_knee", "left_shoulder_pitch", "right_elbow", "waist_yaw"):
        joints[:, JOINTS.index(f"{name}_joint")] = swing
    return np.round(joints, 6)


def play(fault: Fault, domain: int, folder: Path) -> Outcome:
    """Run one row."""
    session = Session(fault, domain, folder)
    session.config.write_text(CONFIG)
    write_motion(session.motion, sway())
    more = list(fault.prepare(session)) if fault.prepare else []
    arguments = list(fault.command) or ["stream", str(session.motion)]
    arguments += ["--domain", str(domain), "--config", str(session.config), "--json", *more]
    if fault.arms:
        arguments += ["--via", "arm_sdk"]
    if fault.record:
        arguments += ["--record", str(session.path)]
    spec: dict[str, Any] = {"domain": domain, "interface": session.interface}
    spec |= {"out": str(folder / "tap.npz"), "faults": list(fault.robot)}
    spec["arm_sdk"] = fault.arms
    if fault.q:
        spec["q"] = list(fault.q)
    session.robot = robot = Robot(spec, session.prefix)
    outcome = Outcome(fault)
    try:
        session.start(arguments)
        helpers: list[int] = []
        begun = (
            partial(robot.wait_commanded, session.alive) if fault.sent else session.wait_recorder
        )
        if fault.act and begun():
            time.sleep(fault.at)
            helpers = session.children()
            fault.act(session)
        outcome.code = session.wait()
        session.wait_for(helpers)  # the guard damps, the recorder writes the end of its file
        record = robot.finish()
    finally:
        robot.kill()
        if session.alive():
            session.process.kill()
            session.process.wait()
    try:
        outcome.said = session.said.read_text(errors="replace")
        judge(outcome, record, session.path)
        outcome.wrong += session.wrong
    finally:
        for undo in session.clean_up:
            undo()
    return outcome
