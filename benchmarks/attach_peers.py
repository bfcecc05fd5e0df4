"""`attach` on recordings of Unitree's example and of a policy, in both of Unitree's simulators.

    python benchmarks/attach_peers.py
    python benchmarks/attach_peers.py --policy policy.onnx --motion dance.csv [--seconds 20]

Without a policy the SDK's low-level example of the G1 moves the ankles and wrists. `g1stream
record` records it, and in a second run bag_side.py, which is not ours, as a ROS 2 bag. `attach`
finds the example's movement, written as a motion, in both. The truth is the example's own clock: it
adds 2 ms with each command.

With a policy, g1stream streams the motion as in feet_peers.py and bag_side.py records. The truth is
the reference that was played. The robot's own lag is part of `late_ms` then, because a policy's
commands are not the motion. tracking_peers.py says what has to be set up.
"""

from __future__ import annotations

import argparse
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

import g1stream
from feet_peers import play, simulating
from g1stream.errors import G1StreamError
from g1stream.extras.attach.alignment import find_plays
from g1stream.motion.trajectory import Trajectory
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS
from tracking_peers import PEERS, SIMULATORS, missing

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from g1stream import Motion, Session

#: Length of a stage of the example, s, and its time between two commands, s.
STAGE: Final = 3.0
STEP: Final = 0.002


def example_motion(seconds: float) -> Motion:
    """What the example commands: rest, ankles by pitch and roll, then ankles and wrists."""
    time = np.arange(0.0, seconds, 0.01)
    wave = np.sin(2.0 * np.pi * time)
    middle, last = (time > STAGE) & (time <= 2.0 * STAGE), time > 2.0 * STAGE
    ten, thirty = np.radians([10.0, 30.0])
    shares = {  # in the last stage A is the roll and B the pitch
        "left_ankle_pitch_joint": thirty * middle - ten * last,
        "right_ankle_pitch_joint": thirty * middle + ten * last,
        "left_ankle_roll_joint": ten * middle + thirty * last,
        "right_ankle_roll_joint": -ten * middle - thirty * last,
        "left_wrist_roll_joint": thirty * last,
        "right_wrist_roll_joint": thirty * last,
    }
    q = np.zeros((len(time), N_JOINTS))
    for name, share in shares.items():
        q[:, JOINT_NAMES.index(name)] = share * wave
    return g1stream.Motion.from_arrays(q, np.tile([0.0, 0.0, 0.8], (len(q), 1)), fps=100.0)


def ours(path: Path) -> list[Any]:
    """The command of our recorder."""
    return [sys.executable, "-m", "g1stream", "record", "-o", path, "--force", "--quiet"]


def other(path: Path) -> list[Any]:
    """The command of a recorder that is not ours."""
    return [PEERS / "sdk/bin/python", Path(__file__).with_name("bag_side.py"), path]


@contextmanager
def interrupted(command: list[Any]) -> Iterator[None]:
    """A program in the simulators' network; SIGINT ends it."""
    with subprocess.Popen([PEERS / "ns", *map(str, command)], stderr=subprocess.DEVNULL) as program:
        try:
            yield
        finally:
            program.send_signal(signal.SIGINT)
            program.wait(60)


def run_example(name: str, seconds: float, recorder: list[Any]) -> None:
    """The example in a simulator, recorded by a program."""
    with simulating(name, 0, []), interrupted(recorder):
        time.sleep(4.0)  # until it receives
        example = [PEERS / one for one in ("ns", "sdk/bin/python", "g1_example_sim.py")]
        with subprocess.Popen([*example, "lo"], stdout=subprocess.DEVNULL) as program:
            time.sleep(seconds)
            program.kill()


def example_row(recording: Path, motion: Motion) -> dict[str, Any]:
    """The part of the example that was found, and how late its middle is, ms."""
    session = g1stream.open_session(recording)
    command = session.command
    wrist = command.q[:, JOINT_NAMES.index("left_wrist_roll_joint")]
    still = int(2.0 * STAGE / STEP) // 2  # in these the wrist goes from where it hangs to zero
    begun = still + int(np.argmax(wrist[still:] > 0.1))
    at = 2.0 * STAGE + np.arcsin(wrist[begun] / np.radians(30.0)) / (2.0 * np.pi)
    at += STEP * (np.arange(len(wrist)) - begun)
    inside = (at > STAGE) & (at < motion.duration)
    first = int(command.publish_time[0])
    seconds = (command.publish_time[inside] - first) / 1e9
    speed, offset = np.polyfit(seconds, at[inside], 1)
    unsteady = float(np.std(at[inside] - speed * seconds))
    attached = session.attach(motion)
    about, reference = attached.attached, attached.reference
    assert about
    middle = 0.5 * (about.first_s + about.last_s)
    found = np.interp(middle, reference.motion_time, (reference.publish_time - first) / 1e9)
    return {
        "found in": about.by,
        "found": (about.first_s, about.last_s),
        "similarity": about.similarity,
        "second best": about.rival,
        "speed of the example": speed,
        "its clock differs from a line by, ms": 1e3 * unsteady,
        "speed": about.speed / speed,
        "late_ms": 1e3 * (found - (middle - offset) / speed),
        "rmse_rad": attached.tracking().overall,
    }


def record_policy(name: str, args: argparse.Namespace, own: Path, bag: Path) -> str:
    """Play the motion in a simulator, recorded by the other; why it ended, if early."""
    with simulating(name, 0, []), interrupted(other(bag)):
        return play(name, args.motion, args.seconds, args.policy, [], own)


def policy_row(own: Path, bag: Path, motion: Path) -> dict[str, Any]:
    """The part that was found in the bag, and how late its start is, ms, with the robot's lag."""
    played, known = g1stream.load_motion(motion), g1stream.open_session(own)
    attached: Session = g1stream.open_session(bag).attach(played)
    reference, about = known.reference, attached.attached
    first = int(reference.publish_time[0])
    seconds = (reference.publish_time - first) / 1e9
    truth = find_plays(seconds, reference.q, Trajectory(played)).best
    if truth is None or about is None:
        raise SystemExit(f"{own} has not played {motion}")
    middle = 0.5 * (about.first_s + about.last_s)  # at the start an error of the speed would count
    asked = attached.reference
    theirs = np.interp(middle, asked.motion_time, asked.publish_time - first)
    begun = (first - known.start_ns) / 1e9
    danced = known.sel(time=slice(*(begun + at for at in truth.span)))
    lag = danced.tracking().delay
    return {
        "found in": about.by,
        "found": (about.first_s, about.last_s),
        "played": (truth.first, truth.last),
        "speed": about.speed / truth.speed,
        "late_ms": 1e3 * (theirs / 1e9 - truth.start - middle / truth.speed),
        "lag_ms": lag and 1e3 * lag.seconds,
        "lag_ci95_ms": lag and lag.ci95 and 1e3 * lag.ci95,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--policy", help="file of a learned policy; without it the SDK's example")
    parser.add_argument("--motion", help="the motion that the policy tracks")
    parser.add_argument("--seconds", type=float, default=20.0, help="of the motion")
    parser.add_argument("--simulator", choices=SIMULATORS, help="only this one")
    parser.add_argument("--keep", type=Path, help="a folder for the recordings")
    args = parser.parse_args()
    if bool(args.policy) != bool(args.motion):
        parser.error("--policy and --motion belong together")
    if absent := missing("keys", "sdk/bin/python", "g1_example_sim.py"):
        parser.error(absent)
    with tempfile.TemporaryDirectory() as directory:
        folder = args.keep or Path(directory)
        folder.mkdir(parents=True, exist_ok=True)
        for name in [args.simulator] if args.simulator else SIMULATORS:
            own, bag = folder / f"own-{name}.mcap", folder / f"bag-{name}.mcap"
            rows: dict[Path, Callable[[], dict[str, Any]]]
            if args.policy:
                reason = record_policy(name, args, own, bag)
                print(f"{name}: ended {reason or 'as asked'}", flush=True)
                rows = {bag: partial(policy_row, own, bag, args.motion)}
            else:
                motion = example_motion(args.seconds - 5.0)  # with its start and discovery
                run_example(name, args.seconds, ours(own))
                run_example(name, args.seconds, other(bag))
                rows = {path: partial(example_row, path, motion) for path in (own, bag)}
            for path, row_of in rows.items():
                try:
                    row = row_of()
                except G1StreamError as error:
                    print(f"{path.stem}: not found: {error}")
                    continue
                text = ", ".join(f"{key} {value}" for key, value in row.items())
                print(f"{path.stem}: {text}", flush=True)


if __name__ == "__main__":
    main()
