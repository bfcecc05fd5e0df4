"""Converting a motion: `g1stream convert` beside the conventional way and beside the floor.

    python benchmarks/convert.py [--motion CSV] [--rounds 7] [--json]

Every side is a whole process, as a user would start it, and the sides take turns in every round:
- ours: `g1stream convert MOTION OUT`;
- conventional: convert_conventional.py, a protobuf object for each link of each frame;
- floor: convert_floor.py, the stock writer with our very messages, encoded beforehand.
Medians over the rounds. The poses that ours and the conventional way wrote are compared as well.
"""

from __future__ import annotations

import argparse
import json
import os
import pickle
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from mcap.reader import make_reader

HERE = Path(__file__).parent
CLIP = HERE.parent.parent / "shared" / "lafan1" / "joints_labeled.csv"
DEMO = HERE.parent / "src" / "g1stream" / "motion" / "demo.csv"
URDF = HERE.parent / "src" / "g1stream" / "robot" / "g1_29dof_rev_1_0.urdf"


class Run(NamedTuple):
    """One run of a side, s."""

    wall: float
    cpu: float
    printed: str


def run(arguments: list[str]) -> Run:
    """Run a process to its end."""
    before, start = os.times(), time.perf_counter()
    done = subprocess.run(arguments, check=True, capture_output=True, text=True)
    wall, after = time.perf_counter() - start, os.times()
    cpu = after.children_user + after.children_system - before.children_user
    return Run(wall, cpu - before.children_system, done.stdout)


def read_messages(path: Path) -> tuple[list[Any], list[Any]]:
    """Channels and messages of an MCAP, in the order of the file, for the floor to write."""
    channels, rows = {}, []
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages(log_time_order=False):
            assert schema is not None
            channels[channel.topic] = (
                channel.topic,
                schema.name,
                schema.encoding,
                channel.message_encoding,
                schema.data,
            )
            rows.append((channel.topic, message.log_time, message.data))
    return [*channels.values()], rows


def world_poses(path: Path) -> dict[tuple[int, str], np.ndarray]:
    """Matrix of each link in the world, by time and link, of every hundredth message on /tf."""
    from scipy.spatial.transform import Rotation

    poses = {}
    with path.open("rb") as file:
        messages = [m for _, _, m in make_reader(file).iter_messages(topics=["/tf"])]
    for message in messages[::100]:
        found = {"world": np.eye(4)}
        for t in FrameTransforms.FromString(message.data).transforms:
            local = np.eye(4)
            p, q = t.translation, t.rotation
            local[:3, 3] = p.x, p.y, p.z
            local[:3, :3] = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
            found[t.child_frame_id] = found[t.parent_frame_id] @ local
            poses[message.log_time, t.child_frame_id] = found[t.child_frame_id]
    return poses


def largest_difference(ours: Path, theirs: Path) -> float:
    """Greatest difference of any element of any pose; fails unless both have the same ones."""
    a, b = world_poses(ours), world_poses(theirs)
    if a.keys() != b.keys():
        raise SystemExit("The two files do not have the same frames at the same times.")
    return max(float(np.abs(a[key] - b[key]).max()) for key in a)


def measure(motion: Path, rounds: int) -> dict[str, Any]:
    """Run every side in turns."""
    with tempfile.TemporaryDirectory() as directory:
        out = {side: Path(directory, f"{side}.mcap") for side in ("ours", "conventional", "floor")}
        messages = Path(directory, "messages")
        python = sys.executable
        commands = {
            "ours": [python, "-m", "g1stream", "convert", str(motion), str(out["ours"])],
            "conventional": [
                *(python, str(HERE / "convert_conventional.py")),
                *(str(motion), str(URDF), str(out["conventional"])),
            ],
            "floor": [
                *(python, str(HERE / "convert_floor.py")),
                *(str(messages), str(out["floor"])),
            ],
        }
        run(commands["ours"])
        messages.write_bytes(pickle.dumps(read_messages(out["ours"])))
        runs = []
        for _ in range(rounds):
            for path in out.values():
                path.unlink(missing_ok=True)
            runs.append({side: run(command) for side, command in commands.items()})
        sizes = {side: path.stat().st_size / 1e6 for side, path in out.items()}
        difference = largest_difference(out["ours"], out["conventional"])
    median = {
        side: Run(
            statistics.median(r[side].wall for r in runs),
            statistics.median(r[side].cpu for r in runs),
            "",
        )
        for side in commands
    }
    return {
        "motion": motion.name,
        "rounds": rounds,
        "ratio": statistics.median(r["conventional"].wall / r["ours"].wall for r in runs),
        "floor_ratio": statistics.median(r["ours"].wall / r["floor"].wall for r in runs),
        "cpu_ratio": median["conventional"].cpu / median["ours"].cpu,
        "floor_cpu_ratio": median["ours"].cpu / median["floor"].cpu,
        "floor_write_s": statistics.median(float(r["floor"].printed) for r in runs),
        "largest_difference": difference,
        "load": os.getloadavg()[0],
        "sides": {
            side: {"wall_s": m.wall, "cpu_s": m.cpu, "file_mb": sizes[side]}
            for side, m in median.items()
        },
    }


def table(result: dict[str, Any]) -> str:
    lines = [
        f"{result['motion']}, {result['rounds']} rounds, load {result['load']:.1f}",
        f"{'':14}{'wall s':>9}{'cpu s':>9}{'file MB':>9}{'x ours':>9}",
    ]
    ours = result["sides"]["ours"]["wall_s"]
    lines += [
        f"{side:14}{s['wall_s']:9.3f}{s['cpu_s']:9.3f}{s['file_mb']:9.2f}{s['wall_s'] / ours:9.2f}"
        for side, s in result["sides"].items()
    ]
    lines += [
        f"conventional / ours {result['ratio']:.1f} (cpu {result['cpu_ratio']:.1f}), "
        f"ours / floor {result['floor_ratio']:.2f} (cpu {result['floor_cpu_ratio']:.2f})",
        f"reading and writing alone takes the floor {result['floor_write_s']:.3f} s; "
        f"poses differ by {result['largest_difference']:.1e} at most",
    ]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--motion", type=Path, default=CLIP if CLIP.exists() else DEMO)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    result = measure(arguments.motion, arguments.rounds)
    print(json.dumps(result, indent=2) if arguments.json else table(result))


if __name__ == "__main__":
    main()
