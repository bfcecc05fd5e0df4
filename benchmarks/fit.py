"""How often `fit` finds hidden parameters, and how much of the gap it closes.

    python benchmarks/fit.py [--fits 20] [--support bolted] [--seconds 40] [--first 0] [--jobs 1]
        [--json]

Each fit has a simulated robot with hidden parameters: viscous and dry friction of every joint 0.5
to 3 times the default, armature 0.5 to 2 times, commands 2 to 12 ms late, and 1 kg on the torso.
It plays the motion of `fit --motion-out` and another one, in lockstep and with sensor noise
(`sim.noise` 1), under a feed-forward that knows nothing of them. The other session is held out.
Printed are the parameters whose true value is inside the 95 % interval, of all and of those that
`fit` says it can tell, by kind; by how much the held-out gap shrinks; and how fast `simulate` is,
in CPU time.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from itertools import chain
from typing import Any
from unittest.mock import patch

import numpy as np

import g1stream
from g1stream.app.sim import make_world
from g1stream.config import load_config
from g1stream.extras.fit.excite import exciting_motion
from g1stream.extras.fit.identify import Fit, FittedValue, fit_parameters
from g1stream.extras.fit.simulated_session import gap
from g1stream.robot.joints import ARMATURE, DAMPING, FRICTION, JOINT_NAMES, N_JOINTS
from g1stream.robot.model import G1
from g1stream.robot.parameters import Parameters


def hidden(seed: int) -> Parameters:
    """The parameters of a robot."""
    rng = np.random.default_rng(seed)
    return Parameters(
        damping=DAMPING * rng.uniform(0.5, 3.0, N_JOINTS),
        friction=FRICTION * rng.uniform(0.5, 3.0, N_JOINTS),
        armature=ARMATURE * rng.uniform(0.5, 2.0, N_JOINTS),
        command_delay=float(rng.uniform(0.002, 0.012)),
        mass={"torso_link": 1.0},
    )


def played(motion: Any, parameters: Parameters, support: Any, seed: int) -> Any:
    """The session of a robot with these parameters, without its ramp."""

    def other_world(robot: G1, settings: Any) -> Any:
        return make_world(replace(robot, parameters=parameters), settings)

    config = load_config(
        over={
            "record.channels": "raw",
            "sim.noise": 1.0,
            "sim.seed": seed,
            "stream.feedforward": "dynamics",
            "stream.ramp": 1.0,
            "stream.hold": 0.0,
            "stream.damp": 0.5,
        }
    )
    with patch("g1stream.app.rollout.make_world", other_world):
        return g1stream.rollout(motion, config=config, support=support).sel("PLAY")


def truth(parameters: Parameters, one: FittedValue) -> float:
    """The true value of a parameter."""
    if one.kind == "command_delay":
        return parameters.command_delay
    if one.kind == "mass":
        return parameters.mass.get(one.name, 0.0)
    if one.kind.startswith("com_"):
        return 0.0
    return float(getattr(parameters, one.kind)[JOINT_NAMES.index(one.name)])


def run(seed: int, support: Any, seconds: float) -> tuple[Fit, Parameters, float, float]:
    """A fit, the true parameters, the CPU time of the fit, s, and simulated over CPU time."""
    parameters = hidden(seed)
    excite = exciting_motion(seconds=seconds, seed=seed)
    session = played(excite, parameters, support, seed)
    other = played(exciting_motion(seconds=12.0, seed=seed + 1000), parameters, support, seed + 1)
    begun = time.process_time()
    fit = fit_parameters([session], hold_out=other)
    spent = time.process_time() - begun
    begun = time.process_time()
    simulated = gap(session).simulated_s
    return fit, parameters, spent, simulated / (time.process_time() - begun)


def main() -> None:
    """Parse, measure, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--fits", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="number of the first seed")
    parser.add_argument("--support", default="bolted", choices=("bolted", "hanging"))
    parser.add_argument("--seconds", type=float, default=40.0)
    parser.add_argument("--jobs", type=int, default=1, help="fits at the same time")
    parser.add_argument("--json", action="store_true")
    flags = parser.parse_args()
    inside: dict[str, list[bool]] = {}
    told: dict[str, list[bool]] = {}
    errors: dict[str, list[float]] = {}
    reductions, spent, speeds = [], [], []
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(flags.jobs, mp_context=spawn) as pool:
        seeds = range(flags.first, flags.first + flags.fits)
        measure = partial(run, support=flags.support, seconds=flags.seconds)
        for seed, (fit, parameters, seconds, speed) in zip(
            seeds, pool.map(measure, seeds), strict=True
        ):
            for one in fit.values:
                if one.kind == "torque_lag":  # the robot is sampled as the simulator is
                    continue
                true = truth(parameters, one)
                right = bool(one.low <= true <= one.high)
                inside.setdefault(one.kind, []).append(right)
                if one.told:
                    told.setdefault(one.kind, []).append(right)
                    errors.setdefault(one.kind, []).append(abs(one.value - true))
            reductions.append(fit.reduction)
            spent.append(seconds)
            speeds.append(speed)
            if not flags.json:
                print(
                    f"seed {seed}: gap {1e3 * fit.gap_before_rad:.2f} -> "
                    f"{1e3 * fit.gap_after_rad:.2f} mrad, {100 * fit.reduction:.0f} % less, "
                    f"{seconds:.0f} s of CPU; simulate {speed:.1f} x real time",
                    flush=True,
                )
    every, known = ([*chain(*by_kind.values())] for by_kind in (inside, told))
    figures = {
        "fits": flags.fits,
        "support": flags.support,
        "inside": float(np.mean(every)),
        "inside_told": float(np.mean(known)),
        "told": len(known) / len(every),
        "reduction_median": float(np.median(reductions)),
        "reduction_worst": float(np.min(reductions)),
        "reduced_by_80": float(np.mean(np.array(reductions) >= 0.8)),
        "fit_cpu_s": float(np.median(spent)),
        "simulate_times_real_time": float(np.median(speeds)),
    }
    if flags.json:
        print(json.dumps(figures, indent=2))
        return
    print(f"{'':<16}{'values':>8}{'inside':>9}{'told':>9}{'inside':>9}{'median error':>14}")
    for kind, values in inside.items():
        mine = told.get(kind, [])
        share = f"{np.mean(mine):.3f}" if mine else ""
        error = f"{np.median(errors[kind]):.4g}" if mine else ""
        print(
            f"{kind:<16}{len(values):>8}{np.mean(values):>9.3f}{len(mine) / len(values):>9.3f}"
            f"{share:>9}{error:>14}"
        )
    for name, value in figures.items():
        print(
            f"{name.replace('_', ' '):<20}{value:.3f}"
            if isinstance(value, float)
            else f"{name.replace('_', ' '):<20}{value}"
        )


if __name__ == "__main__":
    main()
