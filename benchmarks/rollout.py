"""What a rollout costs: physics, feed-forward, recording; beside MuJoCo stepping the same model.

    python benchmarks/rollout.py [--motion demo] [--support bolted ...] [--rate 500] [--json]

CPU time for each second that is simulated, in ms, the median of the rounds. The floor is
`mj_step` alone: the same model, settings and number of steps, from the same state, the motors off.
Parts are timed around the calls that do the work, 0.1 us a call included: the physics (`World.step`
and `World.state`), the feed-forward (`FeedForward.command`), what is recorded
(copying the samples, with the channels raw as in `g1stream library simulate`), and the rest:
the loop, its safety, targets, messages and their checksums.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from contextlib import ExitStack
from functools import wraps
from typing import Any
from unittest.mock import patch

import g1stream
from g1stream.app.sim import make_world
from g1stream.config import load_config
from g1stream.control.feedforward import FeedForward
from g1stream.robot.model import G1
from g1stream.session.source import MemorySource
from g1stream.sim.world import World

PARTS = {
    "physics": ((World, "step"), (World, "state")),
    "feed-forward": ((FeedForward, "command"),),
    "recording": ((MemorySource, "write_batch"),),
}


def timed(spent: dict[str, float], part: str, kind: type, name: str) -> Any:
    """A patch of a method that adds the time of each call to a part."""
    method, clock = getattr(kind, name), time.perf_counter

    @wraps(method)
    def call(*args: Any, **kwargs: Any) -> Any:
        begun = clock()
        try:
            return method(*args, **kwargs)
        finally:
            spent[part] += clock() - begun

    return patch.object(kind, name, call)


def floor(support: Any, seconds: float) -> float:
    """CPU seconds of stepping the model alone."""
    import mujoco

    config = load_config(over={"sim.support": support})
    world = make_world(G1.default(), config.sim)
    begun = time.process_time()
    for _ in range(round(seconds / world.timestep)):
        mujoco.mj_step(world.model, world.data)
    return time.process_time() - begun


def run(motion: str, support: Any, rate: float) -> dict[str, float]:
    """Milliseconds of CPU for a second that is simulated: in all, of each part, of the floor."""
    config = load_config(over={"record.channels": "raw", "stream.rate": rate})
    spent = dict.fromkeys(PARTS, 0.0)
    with ExitStack() as stack:
        for part, methods in PARTS.items():
            for kind, name in methods:
                stack.enter_context(timed(spent, part, kind, name))
        begun = time.process_time()
        session = g1stream.rollout(motion, support=support, config=config)
        total = time.process_time() - begun
    begun = time.process_time()
    session.metrics()
    measured = time.process_time() - begun
    times = session.measured.publish_time
    seconds = float(times[-1] - times[0]) / 1e9
    parts = {"floor": floor(support, seconds), **spent, "rest": total - sum(spent.values())}
    figures = {name: 1e3 * value / seconds for name, value in parts.items()}
    return figures | {
        "rollout": 1e3 * total / seconds,
        "metrics": 1e3 * measured / seconds,
        "times_real_time": seconds / total,
        "times_floor": total / parts["floor"],
    }


def main() -> None:
    """Parse, measure, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--motion", default="demo")
    parser.add_argument("--support", nargs="+", default=["bolted", "hanging", "free"])
    parser.add_argument("--rate", type=float, default=500.0, help="commands a second")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--json", action="store_true")
    flags = parser.parse_args()
    g1stream.rollout("demo", seconds=0.1)  # imports, and what is made once
    rows = {}
    for support in flags.support:
        rounds = [run(flags.motion, support, flags.rate) for _ in range(flags.rounds)]
        rows[support] = {key: statistics.median(one[key] for one in rounds) for key in rounds[0]}
    if flags.json:
        print(json.dumps(rows, indent=2))
        return
    print(f"{'CPU, ms per simulated second':<32}" + "".join(f"{name:>10}" for name in rows))
    for key in next(iter(rows.values())):
        print(
            f"{key.replace('_', ' '):<32}" + "".join(f"{row[key]:10.1f}" for row in rows.values())
        )


if __name__ == "__main__":
    main()
