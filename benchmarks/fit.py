"""How often `fit` finds the parameters of a robot of another simulator, and what it closes.

    python benchmarks/fit.py [--fits 20] [--reports instant] [--delays 4.25 5 5.5 6.75]
        [--backlash 0] [--support bolted] [--told bolted] [--seconds 20] [--first 0] [--jobs 1]
        [--json]

Each fit has a robot of `foreign_robot.py` with hidden parameters: viscous and dry friction of every
joint 0.5 to 3 times the default, armature 0.5 to 2 times, and 1 kg on the torso; the delays of
commands, ms, take turns. It plays the motion of `fit --motion-out` and another one, under a
feed-forward that knows nothing of them. The other session is held out. `fit` is told that the robot
was held as `--told`. Printed are, by kind, the values that `fit` tells, those whose 95 % interval
holds the true value, those that a parameters file has although they are the default, and those that
it marks as another value than the default; by how much the held-out gap shrinks; and what is
refused.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import time
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import Any

import numpy as np

from foreign_robot import Foreign
from g1stream.errors import G1StreamError
from g1stream.extras.fit.excite import exciting_motion
from g1stream.extras.fit.identify import Fit, FittedValue, fit_parameters
from g1stream.robot.joints import ARMATURE, DAMPING, FRICTION, JOINT_NAMES, N_JOINTS


def hidden(seed: int, **more: Any) -> Foreign:
    """A robot with other parameters than the default ones."""
    rng = np.random.default_rng(seed)
    return Foreign(
        damping=DAMPING * rng.uniform(0.5, 3.0, N_JOINTS),
        friction=FRICTION * rng.uniform(0.5, 3.0, N_JOINTS),
        armature=ARMATURE * rng.uniform(0.5, 2.0, N_JOINTS),
        mass={"torso_link": 1.0},
        **more,
    )


def truth(robot: Foreign, one: FittedValue) -> float:
    """The true value of a parameter."""
    if one.kind == "command_delay":
        return robot.delay
    if one.kind == "mass":
        return robot.mass.get(one.name, 0.0)
    if one.kind.startswith("com_"):
        return 0.0
    of_joints = robot.scale if one.kind == "torque_scale" else getattr(robot, one.kind)
    return float(of_joints[JOINT_NAMES.index(one.name)])


def run(seed: int, flags: argparse.Namespace) -> tuple[Foreign, Fit | str, float]:
    """The true robot, the fit or why there is none, and the CPU time of the fit, s."""
    delay = flags.delays[seed % len(flags.delays)] / 1e3
    backlash = flags.backlash
    step = 2.5e-4 if backlash else 5e-4
    robot = hidden(seed, reports=flags.reports, delay=delay, backlash=backlash, step=step)
    session, other = (
        robot.play(exciting_motion(seconds=long, seed=number), flags.support, seed=number)
        for long, number in ((flags.seconds, seed), (12.0, seed + 1000))
    )
    begun = time.process_time()
    try:
        fit: Fit | str = fit_parameters([session], hold_out=other, support=flags.told)
    except G1StreamError as error:
        fit = str(error)
    return robot, fit, time.process_time() - begun


def main() -> None:
    """Parse, measure, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--fits", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="number of the first seed")
    parser.add_argument("--reports", default="instant", choices=("instant", "mean"))
    parser.add_argument("--delays", type=float, nargs="+", default=[4.25, 5.0, 5.5, 6.75])
    parser.add_argument("--backlash", type=float, default=0.0, help="rad")
    parser.add_argument("--support", default="bolted", choices=("bolted", "hanging"))
    parser.add_argument("--told", choices=("bolted", "hanging"), help="support; the true one")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--jobs", type=int, default=1, help="fits at the same time")
    parser.add_argument("--json", action="store_true")
    flags = parser.parse_args()
    flags.told = flags.told or flags.support
    kinds: dict[str, list[tuple[bool, bool, bool, bool, float]]] = {}
    reductions, spent, refused = [], [], []
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(flags.jobs, mp_context=spawn) as pool:
        seeds = range(flags.first, flags.first + flags.fits)
        for seed, (robot, fit, seconds) in zip(
            seeds, pool.map(partial(run, flags=flags), seeds), strict=True
        ):
            spent.append(seconds)
            refusal = fit if isinstance(fit, str) else fit.refusal
            refused += [refusal] if refusal else []
            if isinstance(fit, str):
                continue
            reductions.append(fit.reduction)
            for one in fit.values:
                true, error = truth(robot, one), abs(one.value - truth(robot, one))
                right = one.low is not None and one.high is not None and one.low <= true <= one.high
                row = one.told, right, one.written and true == one.default, one.differs, error
                kinds.setdefault(one.kind, []).append(row)
            if not flags.json:
                found = fit.find("command_delay")
                print(
                    f"seed {seed}: delay {1e3 * robot.delay:.2f} ms, found {1e3 * found.value:.2f} "
                    f"+- {1e3 * ((found.high or 0.0) - found.value):.2f}; gap "
                    f"{1e3 * fit.gap_before_rad:.2f} -> {1e3 * fit.gap_after_rad:.2f} mrad; "
                    f"{seconds:.0f} s of CPU {refusal}",
                    flush=True,
                )
    rows: dict[str, dict[str, float | None]] = {}
    for kind, values in {**kinds, "all": [row for one in kinds.values() for row in one]}.items():
        told = [row for row in values if row[0]]
        rows[kind] = {
            "values": len(values),
            "told": len(told) / max(1, len(values)),
            "inside": float(np.mean([row[1] for row in told])) if told else None,
            "written_but_default": sum(row[2] for row in values),
            "marked": sum(row[3] for row in values),
            "median_error": float(np.median([row[4] for row in told])) if told else None,
        }
    figures = {
        "fits": flags.fits,
        "refused": len(refused),
        "reduction_median": float(np.median(reductions)) if reductions else None,
        "reduction_worst": float(np.min(reductions)) if reductions else None,
        "fit_cpu_s": float(np.median(spent)),
    }
    if flags.json:
        print(json.dumps({**figures, "kinds": rows}, indent=2))
        return
    heads = ("values", "told", "inside", "default", "marked", "median error")
    print(f"{'':<16}" + "".join(f"{head:>13}" for head in heads))
    for kind, figures_of in rows.items():
        cells = ["" if one is None else f"{one:.4g}" for one in figures_of.values()]
        print(f"{kind:<16}" + "".join(f"{cell:>13}" for cell in cells))
    for name, value in figures.items():
        print(f"{name.replace('_', ' '):<20}{value}")
    for reason in sorted(set(refused)):
        print(f"refused: {reason}")


if __name__ == "__main__":
    main()
