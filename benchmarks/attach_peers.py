"""`attach` on a bag that another recorder made of a policy in Unitree's simulators.

    python benchmarks/attach_peers.py --policy policy.onnx --motion dance.csv [--seconds 20]

A policy plays the motion in each simulator as in feet_peers.py. Beside g1stream, which knows when
it plays what, bag_side.py records LowCmd and LowState as a ROS 2 bag, without a reference. `attach`
then finds the motion in the bag. Printed are the played part, and by how much its start is later
than that of the reference that was played; the robot's own lag is part of that, because a policy's
commands are not the motion. tracking_peers.py says what has to be set up.
"""

from __future__ import annotations

import argparse
import signal
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import g1stream
from feet_peers import play, simulating
from g1stream.analysis.alignment import find_plays
from g1stream.errors import G1StreamError
from g1stream.motion.trajectory import Trajectory
from tracking_peers import PEERS, SIMULATORS, missing


def record(name: str, args: argparse.Namespace, own: Path, bag: Path) -> str:
    """Play the motion in a simulator, recorded by us and by the other; why it ended, if early."""
    with simulating(name, 0, []):
        script = Path(__file__).with_name("bag_side.py")
        command = [PEERS / "ns", PEERS / "sdk/bin/python", script, bag]
        with subprocess.Popen(command, stderr=subprocess.DEVNULL) as other:
            try:
                return play(name, args.motion, args.seconds, args.policy, [], own)
            finally:
                other.send_signal(signal.SIGINT)
                other.wait(30)


def found(own: Path, bag: Path, motion: Path) -> dict[str, Any]:
    """The part that was found in the bag, and how late its start is, ms, with the robot's lag."""
    played, known = g1stream.load_motion(motion), g1stream.open_session(own)
    attached = g1stream.open_session(bag).attach(played)
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
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--policy", required=True, help="file of a learned policy")
    parser.add_argument("--motion", required=True, help="the motion that it tracks")
    parser.add_argument("--seconds", type=float, default=20.0, help="of the motion")
    parser.add_argument("--simulator", choices=SIMULATORS, help="only this one")
    parser.add_argument("--keep", type=Path, help="a folder for the recordings")
    args = parser.parse_args()
    if absent := missing("keys", "sdk/bin/python"):
        parser.error(absent)
    with tempfile.TemporaryDirectory() as directory:
        folder = args.keep or Path(directory)
        folder.mkdir(parents=True, exist_ok=True)
        for name in [args.simulator] if args.simulator else SIMULATORS:
            own, bag = folder / f"own-{name}.mcap", folder / f"bag-{name}.mcap"
            reason = record(name, args, own, bag)
            print(f"{name}: ended {reason or 'as asked'}", flush=True)
            try:
                row = found(own, bag, args.motion)
            except G1StreamError as error:
                print(f"  not found: {error}")
                continue
            print("  " + ", ".join(f"{key} {value}" for key, value in row.items()), flush=True)


if __name__ == "__main__":
    main()
