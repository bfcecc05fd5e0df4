"""`--support feet` in lockstep: seconds stood, RMSE, pushes, other masses, delay, friction, tick.

A line of pushes has the largest that is stood, and what is seen of a fall: the time from a push
that is 10 N larger, and one half as large again, to DAMP, and the pelvis's tilt and height then.

With noise on every measurement and a tick of delay; each run has a seed of its own. All of it takes
hours: `--only TEXT` prints the lines with this text in their names, `--first` is the first seed.
Run: python benchmarks/feet.py [--runs 10] [--first 0] [--seconds 60] [--clip CSV] [--only TEXT]
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from g1stream.app.sim import make_world
from g1stream.config import Config, load_config
from g1stream.control.feedforward import FeedForward
from g1stream.control.loop import make_loop
from g1stream.control.plan import plan
from g1stream.control.reading import ImuReading, Reading
from g1stream.control.sources import Moment, load_source
from g1stream.control.targets import Setpoint
from g1stream.extras.feet.balance import Balance
from g1stream.extras.physics.example_motions import squatting, stepping
from g1stream.extras.physics.stance import on_standing_legs, stand
from g1stream.motion.motion import Motion
from g1stream.motion.readers import load_motion
from g1stream.motion.trajectory import Trajectory
from g1stream.robot.model import G1
from g1stream.robot.rotations import tilt_of
from g1stream.sim.lockstep import Lockstep
from g1stream.sim.robot import SensorNoise, SimulatedRobot
from g1stream.types import Floats, Phase

if TYPE_CHECKING:
    from collections.abc import Callable

    from g1stream.dds.messages import LowState

CLIP = Path(__file__).parents[2] / "shared" / "lafan1" / "joints_labeled.csv"
ROBOT = G1.default()
CONFIG = Config.model_validate(
    {"sim": {"support": "free"}, "stream": {"support": "feet", "ramp": 2.0, "hold": 0.0}}
)
FALLEN = 0.3  # m, height of the pelvis


class Trouble(NamedTuple):
    """What is wrong with the robot."""

    push: Floats = np.zeros(3)  # N at the torso, for 0.1 s, 1 s after PLAY began
    mass: float = 1.0  # of the robot over the model's; the difference is in the torso
    delay: float = 0.0  # s more from a command to the robot
    friction: float = 1.0  # of the floor


NONE = Trouble()
TROUBLES = {
    "10 % heavier": Trouble(mass=1.1),
    "10 % lighter": Trouble(mass=0.9),
    "10 ms later": Trouble(delay=0.01),
    "friction 0.4": Trouble(friction=0.4),
}
DANCE = "dance, arms and waist"
#: What a simulator that is short of CPU makes of real time.
SLOW = 0.85
#: Directions along x and y.
PUSHES = {
    "push forward": (1, 0),
    "push backward": (-1, 0),
    "push left": (0, 1),
    "push right": (0, -1),
}


class Run(NamedTuple):
    """How a run went."""

    stood: float  # s in PLAY
    rmse: float  # rad, of the joints meanwhile
    reason: str  # why it ended, if early
    pushed: float  # s from the push to DAMP
    tilt: float  # rad, of the pelvis at DAMP
    height: float  # m, of the pelvis at DAMP


def play(motion: Motion, trouble: Trouble, seed: int) -> Run:
    """Play a motion to its end, or until the robot falls."""
    settings = CONFIG.sim.model_copy(update={"command_delay": trouble.delay})
    world, add_noise = make_world(ROBOT, settings), SensorNoise(seed=seed)
    torso = world.model.body("torso_link").id
    world.model.body_mass[torso] += (trouble.mass - 1.0) * world.model.body_mass.sum()
    world.model.geom_friction[:, 0] = trouble.friction
    stood, squares, pushed, falls = 0, 0.0, 0, (0.0, 0.0)

    def measure(state: LowState) -> None:
        nonlocal stood, squares, pushed, falls
        playing = loop.state.phase is Phase.PLAY and loop.newest is not None
        elapsed = loop.state.elapsed(link.now()) / 1e9
        world.data.xfrc_applied[torso, :3] = trouble.push * (playing and 1.0 <= elapsed < 1.1)
        if loop.state.phase < Phase.DAMP:
            pushed += pushed > 0 or (playing and elapsed >= 1.0)
            falls = float(tilt_of(world.data.qpos[3:7])), float(world.data.qpos[2])
        if playing and world.data.qpos[2] > FALLEN:
            stood += 1
            squares += float(((state.q[:29] - loop.newest.target.q) ** 2).mean())
        add_noise(state)

    link = Lockstep(SimulatedRobot(world, settings, noise=measure), "free")
    loop: Any = make_loop(plan(motion, CONFIG, simulated=True), link, link, settle=0)
    stop = loop.run().stop
    rmse = float(np.sqrt(squares / max(stood, 1)))
    return Run(stood / 500.0, rmse, stop.text if stop else "", pushed / 500.0, *falls)


def table(name: str, motion: Motion, seeds: range, trouble: Trouble = NONE) -> None:
    """Print one line."""
    results = [play(motion, trouble, seed) for seed in seeds]
    stood, rmse = [run.stood for run in results], [run.rmse for run in results]
    lasted = sum(not run.reason for run in results)
    worst = next((run.reason for run in results if run.reason), "")
    print(
        f"{name:38s} {lasted:2d} of {len(seeds):2d} to the end; stood {min(stood):5.1f} s or more; "
        f"RMSE {min(rmse):.4f} to {max(rmse):.4f} rad {worst}",
        flush=True,
    )


def swaying(seconds: float) -> Motion:
    """Weight shifts: the pelvis 5 cm to either side every 4 s, on knees bent by 0.75 rad."""
    motion = squatting(seconds, arms=0.0)
    time = np.arange(motion.n_frames) / motion.fps
    pos = np.tile(motion.joint_pos[0], (motion.n_frames, 1))
    angle = 0.07 * np.sin(0.5 * np.pi * time) * np.minimum(1.0, time / 2.0)
    for hip, ankle in ((1, 5), (7, 11)):
        pos[:, hip] += angle
        pos[:, ankle] -= angle
    return Motion.from_arrays(pos, motion.root_pos, fps=motion.fps, name="swaying")


def striding(
    seconds: float, stride: tuple[float, float, float], period: float = 1.6, swing: float = 0.8
) -> Motion:
    """Steps of one foot and then the other by a stride, m, m and rad: three there, three back."""
    pairs = np.arange(round(seconds / period) - 2) // 2
    there = 3 - np.abs((pairs + 1) % 6 - 3)
    return stepping(np.outer(there, stride), period=period, swing=swing)


def push(motion: Motion, way: tuple[int, int], force: float, seed: int) -> Run:
    """A run with a push along x and y, N."""
    return play(motion, Trouble(push=force * np.array([*way, 0.0])), seed)


def largest_push(motion: Motion, way: tuple[int, int], seed: int) -> int:
    """The largest push along x and y that it stands, N, to 10 N."""
    stood, fell = 0, 32  # tens of N
    while fell - stood > 1:
        tried = (stood + fell) // 2
        if push(motion, way, 10.0 * tried, seed).reason:
            fell = tried
        else:
            stood = tried
    return 10 * stood


def push_table(name: str, motion: Motion, way: tuple[int, int], seeds: range) -> None:
    """Print one line for the largest push, and one for each of two larger ones."""
    largest = [largest_push(motion, way, seed) for seed in seeds]
    print(f"{name:38s} {', '.join(map(str, largest))} N", flush=True)
    for words, share, more in (("10 N more", 1.0, 10), ("half as much again", 1.5, 0)):
        sizes = [share * one + more for one in largest]
        runs = [push(motion, way, one, seed) for one, seed in zip(sizes, seeds, strict=True)]
        spans = [
            f"{min(values):.2f} to {max(values):.2f}"
            for values in zip(*((run.pushed, run.tilt, run.height) for run in runs), strict=True)
        ]
        text = "DAMP after {} s, tilted by {} rad, at {} m".format(*spans)
        print(f"{name}, {words:20s} {text}; {runs[0].reason}", flush=True)


def ticks(motion: Motion) -> None:
    """What the torque of a tick takes, beside that of the feed-forward of a hanging robot."""
    trajectory = Trajectory(motion)
    times = np.arange(0.0, motion.duration, 0.01)
    targets = [Setpoint.from_point(at, trajectory.sample(at)) for at in times]
    balance = Balance(ROBOT, 0.002)
    balance.begin(targets[0])
    hung = load_config(over={"stream.support": "hanging"})
    source = load_source(hung, ROBOT, simulated=True)
    hanging = FeedForward(source, limit=ROBOT.torque_limit, period=0.002)
    hanging.begin(targets[0], None)
    taken: dict[str, list[float]] = {"hanging": [], "feet": []}
    still = np.zeros(29, np.float32)
    for target in targets:
        imu = ImuReading(target.root_quat_wxyz, np.zeros(3), np.array([0.0, 0.0, 9.81]))
        measured = Reading(target.q, still, still, imu)
        begun = time.perf_counter()
        hanging.command(Moment(Phase.PLAY, 1.0, target, measured, 0.0))
        between = time.perf_counter()
        balance.torque(target, measured, 0.0)
        balance.watch(target)
        taken["hanging"].append(between - begun)
        taken["feet"].append(time.perf_counter() - between)
    for name, values in taken.items():
        median, high = 1e6 * np.percentile(values, [50, 99])
        print(f"tick {name:8s} median {median:6.0f} us, 99 % {high:6.0f} us")
    ratio = np.median(taken["feet"]) / np.median(taken["hanging"])
    print(f"tick of feet over that of hanging: {ratio:.2f}", flush=True)


def motions(seconds: float, clip: Path) -> dict[str, Callable[[], Motion]]:
    """By name: what makes the motion."""

    def dancing() -> Motion:
        dance = load_motion(clip)
        dance = dance.frames(0, min(dance.n_frames, round(seconds * dance.fps) + 1))
        return on_standing_legs(dance, ROBOT, ROBOT.select("arms,waist"))

    return {
        "squat and arms": lambda: squatting(seconds),
        "weight shifts": lambda: swaying(seconds),
        "demo": lambda: load_motion("demo"),
        "steps in place": lambda: striding(seconds, (0.0, 0.0, 0.0)),
        "each foot lifted for 5 s": lambda: striding(seconds, (0.0, 0.0, 0.0), 6.0, 5.0),
        "steps forward and back": lambda: striding(seconds, (0.12, 0.0, 0.0)),
        "steps to the side and back": lambda: striding(seconds, (0.0, 0.1, 0.0)),
        "turns by steps": lambda: striding(seconds, (0.0, 0.0, 0.4)),
        "quick steps forward and back": lambda: striding(seconds, (0.12, 0.0, 0.0), 0.6, 0.4),
        DANCE: dancing,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("--first", type=int, default=0, help="seed of the first run")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--clip", type=Path, default=CLIP, help="whose arms are danced")
    parser.add_argument("--only", default="", help="the lines with this text in their names")
    args = parser.parse_args()
    seeds = range(args.first, args.first + args.runs)
    of_all = motions(args.seconds, args.clip)
    for name, make in of_all.items():
        if args.only in name:
            table(name, stand(make(), ROBOT).motion, seeds)
    slowly = f"{DANCE}, {SLOW} of real time"
    if args.only in slowly:  # in the simulator's own time, what was planned is faster
        table(slowly, stand(of_all[DANCE](), ROBOT).motion.at_speed(1.0 / SLOW), seeds)
    squat = stand(squatting(min(args.seconds, 20.0)), ROBOT).motion
    for name, trouble in TROUBLES.items():
        if args.only in name:
            table(name, squat, seeds, trouble)
    short = stand(squatting(3.0), ROBOT).motion
    for name, way in PUSHES.items():
        if args.only in name:
            push_table(name, short, way, seeds)
    if args.only in "ticks":
        ticks(short)


if __name__ == "__main__":
    main()
