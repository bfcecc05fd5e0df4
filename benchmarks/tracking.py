"""How closely the simulated robot follows: each feed-forward on each support, in one table.

    python benchmarks/tracking.py [--motion CSV] [--seconds 20] [--dds] [--plot PNG] [--json]
    python benchmarks/tracking.py --arms [--motion CSV] [--seconds 20]
    python benchmarks/tracking.py --peers [--runs 10] [--rows TEXT] [--keep DIR] [--json]

Every cell is the RMSE over all joints, rad, while the motion is played with the gains of Unitree's
example; then the worst joint's. "30 Hz nearest frame" is what scripts do: no spline, q only.

In lockstep the simulation advances while the loop sleeps, so that no clock on the wall is involved
and a cell comes out the same every time. What is measured is distorted by a generator of fixed
seed: encoders by 0.1 mrad and 10 mrad/s, the gyroscope by 10 mrad/s, the accelerometer by
0.1 m/s^2. `--dds` adds the same on our bridge over DDS in real time. What a wrong support does is
measured in lockstep, with the check that would notice it left out.

`--arms` plays arms and waist through the controller of our bridge (`--via arm_sdk`), over DDS.

`--peers` plays the motion on Unitree's own simulators instead, see tracking_peers.py.
"""

from __future__ import annotations

import argparse
import json
import shlex
import statistics
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from unittest.mock import patch

import numpy as np

import tracking_peers
from g1stream.app.rollout import rollout
from g1stream.app.session import open_session
from g1stream.app.stream import stream
from g1stream.child_process import Child
from g1stream.config import load_config
from g1stream.control.feedforward import FeedForward
from g1stream.motion.readers import load_motion
from g1stream.motion.trajectory import Trajectory
from g1stream.robot.joints import JOINT_NAMES

if TYPE_CHECKING:
    from g1stream.app.session import Session
    from g1stream.dds.messages import LowState
    from g1stream.motion.motion import Motion
    from g1stream.motion.spline import TrajectoryPoint
    from g1stream.types import FeedForwardKind, Floats, Support

CLIP = Path(__file__).parents[2] / "shared" / "lafan1" / "joints_labeled.csv"
SUPPORTS: tuple[Support, ...] = ("bolted", "hanging", "follow")
KINDS: tuple[FeedForwardKind, ...] = ("none", "velocity", "dynamics")
NEAREST = "30 Hz nearest frame"
SEED = 5
SHOWN = ("left_knee_joint", "waist_pitch_joint", "right_elbow_joint")
#: Without the stop that a badly followed robot would run into.
SETTINGS = {"safety.max_joint_speed": 1e3, "stream.hold": 0.0}


class Cell(NamedTuple):
    """One run: RMSE over all joints and of the worst, rad, and the median cost of a torque, us."""

    rmse: float
    worst_rmse: float
    worst: str
    cost_us: float | None


def cell_of(joints: Floats, cost_us: float | None = None) -> Cell:
    """The figures of a run, from the RMSE (29,) of each joint."""
    worst = int(joints.argmax())
    rmse = float(np.sqrt(np.mean(joints**2)))
    return Cell(rmse, float(joints[worst]), JOINT_NAMES[worst], cost_us)


@contextmanager
def timed_feedforward() -> Iterator[list[int]]:
    """Collect what the feed-forward of each tick costs meanwhile, ns."""
    command, costs = FeedForward.command, list[int]()

    def timed(*args: Any) -> Any:
        start = time.perf_counter_ns()
        target = command(*args)
        costs.append(time.perf_counter_ns() - start)
        return target

    with patch.object(FeedForward, "command", timed):
        yield costs


class NearestFrame(Trajectory):
    """The frame that is nearest in time, as scripts look it up, instead of the spline."""

    def sample(self, t: float) -> TrajectoryPoint:
        """The reference at a time, s."""
        frame = min(round(t * self.motion.fps), self.motion.n_frames - 1)
        return super().sample(t)._replace(joint_pos=self.motion.joint_pos[frame])


def in_lockstep(
    motion: Motion,
    seconds: float,
    support: Support,
    kind: FeedForwardKind,
    *,
    announced: Support | None = None,
    nearest: bool = False,
    self_collision: bool = True,
) -> tuple[Cell, Session]:
    """One run without a wall clock."""
    rng = np.random.default_rng(SEED)

    def noise(state: LowState) -> None:
        for values, deviation in (
            (state.q, 1e-4),
            (state.dq, 1e-2),
            (state.gyroscope, 1e-2),
            (state.accelerometer, 0.1),
        ):
            values[:] = rng.normal(values, deviation)

    at_frame_rate = {"stream.rate": motion.fps, "stream.preview": 0.0} if nearest else {}
    config = load_config(None, SETTINGS | at_frame_rate | {"sim.self_collision": self_collision})
    trajectory = NearestFrame if nearest else Trajectory
    with timed_feedforward() as costs, patch("g1stream.motion.fit.Trajectory", trajectory):
        session = rollout(
            motion,
            support=support,
            feedforward=kind,
            config=config,
            seconds=seconds,
            announced=announced,
            noise=noise,
        )
    played = session.sel("PLAY")
    state, reference = played.measured, played.reference
    offset = reference.publish_time[0] - round(reference.motion_time[0] * 1e9)
    motion_time = (state.publish_time - offset) / 1e9
    error = Trajectory(motion).sample_many(motion_time).joint_pos - state.q
    return cell_of(np.sqrt(np.mean(error**2, axis=0)), statistics.median(costs) / 1e3), session


def over_dds(
    motion: Motion, seconds: float, support: Support, kind: FeedForwardKind, domain: int
) -> Cell:
    """One run in real time on our bridge."""
    over = {
        "dds.domain": domain,
        "stream.duration": seconds,
        "stream.feedforward": kind,
        "sim.support": support,
    }
    config = load_config(None, SETTINGS | over)
    sim = Child("sim", config)
    try:
        sim.wait_until_ready()
        with tempfile.TemporaryDirectory() as directory:
            path = Path(directory, "session.mcap")
            stream(motion, config, record=path)
            return cell_of(open_session(path).tracking().rmse)
    finally:
        sim.kill()


def arms(motion: Motion, seconds: float, domain: int) -> None:
    """Print the RMSE of arms and waist under the controller of our bridge, rad, by limb."""
    over = {"dds.domain": domain, "stream.duration": seconds, "stream.via": "arm_sdk"}
    over |= {"sim.onboard": "ai", "sim.support": "follow"}
    for kind in KINDS:
        config = load_config(None, SETTINGS | over | {"stream.feedforward": kind})
        sim = Child("sim", config)
        try:
            sim.wait_until_ready()
            with tempfile.TemporaryDirectory() as directory:
                found = stream(motion, config, record=Path(directory, "s.mcap")).tracking
        finally:
            sim.kill()
        if found:
            limbs = (f"{limb} {one.rmse_rad:.4f}" for limb, one in found.limbs.items())
            print(f"{kind:10} {found.all_joints.rmse_rad:.4f}   {', '.join(limbs)}")


def draw(sessions: dict[str, Session], path: Path) -> None:
    """Three joints, reference and measured."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(len(SHOWN), sharex=True, figsize=(11, 8), layout="constrained")
    reference = sessions["dynamics"].sel("PLAY").reference
    for axis, name in zip(axes, SHOWN, strict=True):
        joint = JOINT_NAMES.index(name)
        axis.plot(reference.time, reference.q[:, joint], "k", lw=2.5, label="reference")
        for label, session in sessions.items():
            state = session.sel("PLAY").measured
            axis.plot(state.time, state.q[:, joint], lw=1, label=label)
        axis.set_ylabel(f"{name}, rad")
    axes[0].legend(loc="upper right")
    axes[-1].set_xlabel("time, s")
    figure.savefig(path, dpi=110)


def table(cells: dict[str, dict[str, Cell]]) -> str:
    """The cells as text: a row for each way to command, a column for each support."""
    head = f"{'':32}" + "".join(f"{column:>34}" for column in SUPPORTS)
    lines = [head, "-" * len(head)]
    for name, row in cells.items():
        shown = [
            f"{cell.rmse:.4f} ({cell.worst.removesuffix('_joint')} {cell.worst_rmse:.3f})"
            if (cell := row.get(column))
            else "-"
            for column in SUPPORTS
        ]
        lines.append(f"{name:32}" + "".join(f"{text:>34}" for text in shown))
    return "\n".join(lines)


def parsed() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="How closely the simulated robot follows.")
    parser.add_argument("--motion", default=str(CLIP) if CLIP.exists() else "demo")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--dds", action="store_true", help="also in real time over DDS")
    parser.add_argument("--arms", action="store_true", help="arms and waist, with --via arm_sdk")
    parser.add_argument("--domain", type=int, default=79, help="DDS domain for --dds and --arms")
    parser.add_argument("--plot", type=Path, help="draw three joints into this PNG")
    parser.add_argument("--json", action="store_true", help="print every cell as JSON")
    parser.add_argument("--peers", action="store_true", help="on Unitree's own simulators")
    parser.add_argument("--runs", type=int, default=1, help="how often, for --peers")
    parser.add_argument("--rows", default="", help="only rows with this text, for --peers")
    parser.add_argument("--keep", type=Path, help="keep the sessions in this folder, for --peers")
    parser.add_argument(
        "--stream-flags", default="", help="more flags of `g1stream stream`, for --peers"
    )
    return parser.parse_args()


def on_peers(motion: Motion, seconds: float, arguments: argparse.Namespace) -> None:
    """Print the table of Unitree's own simulators, or why it cannot be measured."""
    if reason := tracking_peers.missing("sdkplay.py", "sdk/bin/python"):
        print(f"skipped: {reason}")
        return
    flags, path = shlex.split(arguments.stream_flags), Path(motion.source or "")
    keep = arguments.keep
    if keep:
        keep.mkdir(parents=True, exist_ok=True)
    runs = tracking_peers.run_table(
        path, seconds, arguments.runs, flags, rows=arguments.rows, keep=keep
    )
    if arguments.json:
        table = {"motion": motion.name, "seconds": seconds, "rmse": tracking_peers.as_json(runs)}
        print(json.dumps(table, indent=2))
        return
    print(f"{motion.name}, {seconds:g} s: RMSE over all joints, rad; median, every run\n")
    print(tracking_peers.as_text(runs))


def main() -> None:
    arguments = parsed()
    motion = load_motion(arguments.motion)
    seconds = min(arguments.seconds, motion.duration)
    if arguments.peers:
        on_peers(motion, seconds, arguments)
        return
    if arguments.arms:
        arms(motion, seconds, arguments.domain)
        return

    cells: dict[str, dict[str, Cell]] = {}
    shown: dict[str, Session] = {}

    def lockstep(row: str, support: Support, kind: FeedForwardKind, **how: Any) -> None:
        cell, session = in_lockstep(motion, seconds, support, kind, **how)
        cells.setdefault(row, {})[support] = cell
        if support == "hanging" and row in (NEAREST, "dynamics"):
            shown[row] = session
        print(".", end="", flush=True, file=sys.stderr)

    for support in SUPPORTS:
        lockstep(NEAREST, support, "none", nearest=True)
        for kind in KINDS:
            lockstep(kind, support, kind)
        lockstep("dynamics, no self-collision", support, "dynamics", self_collision=False)
        for wrong in SUPPORTS:
            if wrong != support:
                lockstep(f"dynamics, as if {wrong}", support, "dynamics", announced=wrong)
        for kind in KINDS if arguments.dds else ():
            cell = over_dds(motion, seconds, support, kind, arguments.domain)
            cells.setdefault(f"DDS, real time: {kind}", {})[support] = cell
    print(file=sys.stderr)
    if arguments.plot:
        draw(shown, arguments.plot)
    if arguments.json:
        every = {
            row: {support: cell._asdict() for support, cell in columns.items()}
            for row, columns in cells.items()
        }
        print(json.dumps({"motion": motion.name, "seconds": seconds, "rmse_rad": every}, indent=2))
        return
    print(f"{motion.name}, {seconds:g} s: RMSE over all joints, rad (worst joint's)\n")
    print(table(cells))
    for kind in ("velocity", "dynamics"):
        costs = ", ".join(f"{s} {cells[kind][s].cost_us:.0f} us" for s in SUPPORTS)
        print(f"\nfeed-forward of a tick, {kind}: {costs}", end="")
    print()


if __name__ == "__main__":
    main()
