"""How closely the simulated robot follows: each feed-forward on each support, in one table.

    python benchmarks/tracking.py [--motion CSV] [--seconds 20] [--dds] [--plot PNG] [--json]

Every cell is the RMSE over all joints, rad, while the motion is played with the gains of Unitree's
example; then the worst joint's. "30 Hz nearest frame" is what scripts do: no spline, q only.

In lockstep the simulation advances while the loop sleeps, so that no clock on the wall is involved
and a cell comes out the same every time. What is measured is distorted by a generator of fixed
seed: encoders by 0.1 mrad and 10 mrad/s, the gyroscope by 10 mrad/s, the accelerometer by
0.1 m/s^2. `--dds` adds the same on our bridge over DDS in real time. What a wrong support does is
measured in lockstep, with the check that would notice it left out.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from g1stream.analysis.summary import summarise
from g1stream.config import Config, SimConfig, load_config
from g1stream.control.feedforward import FeedForward
from g1stream.control.gains import Gains
from g1stream.control.loop import StreamLoop
from g1stream.control.phases import Timing
from g1stream.control.safety import Envelope
from g1stream.control.target import Target
from g1stream.control.targets import Targets
from g1stream.dds.topics import LOWSTATE
from g1stream.motion.trajectory import Trajectory
from g1stream.programs.child_process import Child
from g1stream.programs.stream import stream
from g1stream.robot.dynamics import InverseDynamics
from g1stream.robot.joints import EXAMPLE_KD, EXAMPLE_KP, JOINT_NAMES, TORQUE_LIMIT
from g1stream.robot.model import G1
from g1stream.session.motions import load_motion
from g1stream.session.session import open_session
from g1stream.sim.lockstep import Lockstep
from g1stream.sim.robot import SimulatedRobot
from g1stream.sim.world import World
from g1stream.types import Phase

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from g1stream.control.measured import ImuReading
    from g1stream.dds.messages import LowState
    from g1stream.dds.topics import Topic
    from g1stream.motion.motion import Motion
    from g1stream.types import FeedForwardKind, Support

CLIP = Path(__file__).parents[2] / "shared" / "lafan1" / "joints_labeled.csv"
SUPPORTS: tuple[Support, ...] = ("bolted", "hanging", "follow")
KINDS: tuple[FeedForwardKind, ...] = ("none", "velocity", "dynamics")
NEAREST = "30 Hz nearest frame"
RAMP = 3.0
SEED = 5
SHOWN = ("left_knee_joint", "waist_pitch_joint", "right_elbow_joint")


class Cell(NamedTuple):
    """One run: RMSE over all joints and of the worst, rad, and the median cost of a torque, us."""

    rmse: float
    worst_rmse: float
    worst: str
    cost_us: float | None


class Trace(NamedTuple):
    """Time (N,), s, reference and measured positions (N, 29), rad, of a run."""

    time: NDArray[np.float64]
    reference: NDArray[np.float64]
    measured: NDArray[np.float64]


def cell_of(joints: NDArray[np.float64], cost_us: float | None = None) -> Cell:
    """The figures of a run, from the RMSE (29,) of each joint."""
    worst = int(joints.argmax())
    rmse = float(np.sqrt(np.mean(joints**2)))
    return Cell(rmse, float(joints[worst]), JOINT_NAMES[worst], cost_us)


class NearestFrame(Targets):
    """The frame that is nearest in time, as scripts look it up."""

    def __init__(self, motion: Motion, seconds: float) -> None:
        super().__init__(Trajectory(motion), start=0.0, play=seconds, ramp=RAMP)
        self._motion = motion

    def at(self, phase: Phase, elapsed: float) -> Target:
        """The target in a phase."""
        target = super().at(phase, elapsed)
        if phase is not Phase.PLAY:
            return target
        frame = min(round(target.motion_time * self._motion.fps), self._motion.n_frames - 1)
        return target.but(q=self._motion.joint_pos[frame])


class Timed(FeedForward):
    """Measures what a command's torque costs, and believes the support that it is told."""

    def begin(self, announced: str | None) -> Any:
        """Settle what is done, without the check that would notice a wrong support."""
        told = super().begin(announced)
        self._check = None
        self.costs: list[int] = []
        return told

    def command(
        self, phase: Phase, elapsed: float, target: Target, imu: ImuReading, age: float
    ) -> Target:
        """The target with what its command carries."""
        start = time.perf_counter_ns()
        result = super().command(phase, elapsed, target, imu, age)
        self.costs.append(time.perf_counter_ns() - start)
        return result


def in_lockstep(
    motion: Motion,
    seconds: float,
    support: Support,
    kind: FeedForwardKind,
    *,
    told: Support | None = None,
    nearest: bool = False,
) -> tuple[Cell, Trace]:
    """One run without a clock."""
    robot, rng = G1.default(), np.random.default_rng(SEED)
    trajectory = Trajectory(motion)
    states: list[tuple[float, NDArray[np.float64]]] = []

    def look(topic: Topic, data: bytes, stamp: int) -> None:
        played = link.now() - loop.state.since
        if topic is LOWSTATE and loop.state.phase is Phase.PLAY and played >= 0:
            states.append((played / 1e9, world.state().q))

    def distort(state: LowState) -> None:
        for values, deviation in (
            (state.q, 1e-4),
            (state.dq, 1e-2),
            (state.gyroscope, 1e-2),
            (state.accelerometer, 0.1),
        ):
            values[:] = rng.normal(values, deviation)

    world = World(robot, support)
    simulated = SimulatedRobot(world, SimConfig(), noise=distort)
    link = Lockstep(simulated, support, on_sample=look)
    period = round(1e9 / motion.fps) if nearest else 2_000_000
    feed = Timed(
        kind,
        told,
        dynamics=InverseDynamics(robot),
        limit=np.minimum(TORQUE_LIMIT, robot.effort),
        period=period / 1e9,
        ramp=RAMP,
        preview=0.0 if nearest else period / 1e9,
    )
    smooth = Targets(trajectory, start=0.0, play=seconds, ramp=RAMP)
    loop = StreamLoop(
        link,
        link,
        NearestFrame(motion, seconds) if nearest else smooth,
        Envelope(robot, safety(Config()).safety),
        Timing(*(round(part * 1e9) for part in (1.0, RAMP, seconds, 0.0, 0.5))),
        Gains(EXAMPLE_KP, EXAMPLE_KD),
        period=period,
        damp_kd=3.0,
        settle=0,
        feedforward=feed,
    )
    loop.run()
    times, measured = (np.array(part) for part in zip(*states, strict=True))
    trace = Trace(times, trajectory.sample_many(times).joint_pos, measured)
    joints = np.sqrt(np.mean((trace.reference - trace.measured) ** 2, axis=0))
    return cell_of(joints, statistics.median(feed.costs) / 1e3), trace


def safety(config: Config) -> Config:
    """The config without the stops that a swinging or badly followed robot would run into."""
    relaxed = config.safety.model_copy(update={"max_tilt": 3.1, "max_joint_speed": 1e3})
    return config.model_copy(update={"safety": relaxed})


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
    config = safety(load_config(None, over))
    sim = Child("sim", config)
    try:
        sim.wait_until_ready()
        with tempfile.TemporaryDirectory() as directory:
            path = Path(directory, "session.mcap")
            stream(motion, config, record=path)
            tracking = summarise(open_session(path)).tracking
    finally:
        sim.kill()
    if tracking is None:
        raise RuntimeError("the session has no state to compare")
    return cell_of(tracking.rmse)


def draw(traces: dict[str, Trace], path: Path) -> None:
    """Three joints, reference and measured."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(len(SHOWN), sharex=True, figsize=(11, 8), layout="constrained")
    reference = next(iter(traces.values()))
    for axis, name in zip(axes, SHOWN, strict=True):
        joint = JOINT_NAMES.index(name)
        axis.plot(reference.time, reference.reference[:, joint], "k", lw=2.5, label="reference")
        for label, trace in traces.items():
            axis.plot(trace.time, trace.measured[:, joint], lw=1, label=label)
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
    parser.add_argument("--domain", type=int, default=79, help="DDS domain for --dds")
    parser.add_argument("--plot", type=Path, help="draw three joints into this PNG")
    parser.add_argument("--json", action="store_true", help="print every cell as JSON")
    return parser.parse_args()


def main() -> None:
    arguments = parsed()
    motion = load_motion(arguments.motion, G1.default())
    seconds = min(arguments.seconds, motion.duration)

    cells: dict[str, dict[str, Cell]] = {}
    traces: dict[str, Trace] = {}

    def lockstep(row: str, support: Support, kind: FeedForwardKind, **how: Any) -> None:
        cell, trace = in_lockstep(motion, seconds, support, kind, **how)
        cells.setdefault(row, {})[support] = cell
        if support == "hanging" and row in (NEAREST, "dynamics"):
            traces[row] = trace
        print(".", end="", flush=True, file=sys.stderr)

    for support in SUPPORTS:
        lockstep(NEAREST, support, "none", nearest=True)
        for kind in KINDS:
            lockstep(kind, support, kind)
        for told in SUPPORTS:
            if told != support:
                lockstep(f"dynamics, as if {told}", support, "dynamics", told=told)
        for kind in KINDS if arguments.dds else ():
            cell = over_dds(motion, seconds, support, kind, arguments.domain)
            cells.setdefault(f"DDS, real time: {kind}", {})[support] = cell
    print(file=sys.stderr)
    if arguments.plot:
        draw(traces, arguments.plot)
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
