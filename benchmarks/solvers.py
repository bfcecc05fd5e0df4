"""The quadratic programs of `--support feet`, one a tick, by several solvers.

The programs are those of squats with waving arms, and of the bundled demo with its lifts, in
lockstep with noise (feet.py). Each solver gets them in order, and what a tick would have to do
counts: what it asks for as input, and where it can, the start from the last solution. `apart` is
the largest difference from the forces that daqp finds, over the robot's weight; `failed` are
programs without a solution, or with one that breaks a bound by more than 1e-3: of the weight, of
the weight times a metre, or of a torque limit.

    pip install clarabel osqp proxsuite quadprog
    python benchmarks/solvers.py [--seconds 10]

Those that are not installed are left out.
"""

from __future__ import annotations

import argparse
import importlib
import time
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import daqp
import numpy as np

from feet import NONE, ROBOT, play
from g1stream.extras.physics.example_motions import squatting
from g1stream.extras.physics.stance import stand
from g1stream.motion.readers import load_motion

if TYPE_CHECKING:
    from collections.abc import Callable

    from g1stream.motion.motion import Motion
    from g1stream.types import Floats

#: By how much a solution may break a bound.
_TOLERANCE: Final = 1e-3


class Program(NamedTuple):
    """Minimize x'Hx/2 + f'x so that least <= Ax <= most; beyond 1e29 there is no bound."""

    square: Floats
    linear: Floats
    rows: Floats
    least: Floats
    most: Floats


def programs(motion: Motion) -> list[Program]:
    """Those of a run."""
    found = []
    solve = daqp.solve

    def spy(*given: Any, **settings: Any) -> Any:
        square, linear, rows, most, least, *_ = given
        found.append(Program(*(one.copy() for one in (square, linear, rows, least, most))))
        return solve(*given, **settings)

    daqp.solve = spy
    try:
        run = play(stand(motion, ROBOT).motion, NONE, 0)
    finally:
        daqp.solve = solve
    if run.reason:
        raise RuntimeError(run.reason)
    return found


def by_daqp(_: Any) -> Callable[[Program], Floats]:
    def solve(one: Program) -> Floats:
        kinds = np.zeros(len(one.least), np.int32)
        x: Floats = daqp.solve(
            one.square, one.linear, one.rows, one.most, one.least, kinds, iter_limit=100
        )[0]
        return x

    return solve


def by_quadprog(module: Any) -> Callable[[Program], Floats]:
    def solve(one: Program) -> Floats:
        rows = np.concatenate([one.rows, -one.rows]).T
        bounds = np.concatenate([one.least, -one.most])
        bounded = bounds > -1e29
        x: Floats = module.solve_qp(one.square, -one.linear, rows[:, bounded], bounds[bounded])[0]
        return x

    return solve


def by_osqp(module: Any) -> Callable[[Program], Floats]:
    from scipy.sparse import csc_matrix

    solvers: dict[int, tuple[Any, Any]] = {}  # with the entries of the triangle, by column

    def solve(one: Program) -> Floats:
        n = len(one.linear)
        if n not in solvers:
            triangle = np.nonzero(np.tri(n))[::-1]
            square = csc_matrix((one.square[triangle], triangle), (n, n))
            rows = csc_matrix(np.ones_like(one.rows))
            rows.data[:] = one.rows.T.ravel()
            settings = {"eps_abs": 1e-5, "eps_rel": 1e-5, "verbose": False, "polishing": False}
            solver = module.OSQP()
            solver.setup(square, one.linear, rows, one.least, one.most, **settings)
            solvers[n] = solver, triangle
        else:
            solver, triangle = solvers[n]
            values = {"Px": one.square[triangle], "Ax": one.rows.T.ravel()}
            solver.update(q=one.linear, l=one.least, u=one.most, **values)
        x: Floats = solver.solve(raise_error=False).x
        return x

    return solve


def by_proxsuite(module: Any) -> Callable[[Program], Floats]:
    solvers: dict[int, Any] = {}

    def solve(one: Program) -> Floats:
        n = len(one.linear)
        given = (one.square, one.linear, None, None, one.rows, one.least, one.most)
        if (solver := solvers.get(n)) is None:
            solver = solvers[n] = module.proxqp.dense.QP(n, 0, len(one.least))
            solver.settings.eps_abs = 1e-6
            guess = module.proxqp.InitialGuess.WARM_START_WITH_PREVIOUS_RESULT
            solver.settings.initial_guess = guess
            solver.init(*given)
        else:
            solver.update(*given)
        solver.solve()
        return np.array(solver.results.x)

    return solve


def by_clarabel(module: Any) -> Callable[[Program], Floats]:
    from scipy.sparse import csc_matrix

    settings = module.DefaultSettings()
    settings.verbose = False

    def solve(one: Program) -> Floats:
        rows = np.concatenate([-one.rows, one.rows])
        bounds = np.concatenate([-one.least, one.most])
        bounded = bounds < 1e29
        cones = [module.NonnegativeConeT(np.count_nonzero(bounded))]
        square, rows = csc_matrix(np.triu(one.square)), csc_matrix(rows[bounded])
        solver = module.DefaultSolver(square, one.linear, rows, bounds[bounded], cones, settings)
        return np.array(solver.solve().x)

    return solve


#: By name: whether it starts from the last solution, and what makes it.
SOLVERS: Final[dict[str, tuple[bool, Callable[[Any], Callable[[Program], Floats]]]]] = {
    "daqp": (False, by_daqp),
    "quadprog": (False, by_quadprog),
    "proxsuite": (True, by_proxsuite),
    "osqp": (True, by_osqp),
    "clarabel": (False, by_clarabel),
}


def broken(one: Program, solution: Floats) -> bool:
    """Whether it is no solution."""
    given = one.rows @ solution
    beyond = np.maximum(one.least - given, given - one.most).max()
    return not beyond <= _TOLERANCE  # NaN, too


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=10.0, help="of the squats")
    args = parser.parse_args()
    for name, motion in (("squat", squatting(args.seconds)), ("demo", load_motion("demo"))):
        given = programs(motion)
        sole = sum(len(one.linear) < 12 for one in given)
        print(f"{name}: {len(given)} programs, {sole} of them for one foot")
        print("solver      warm   median us    99 % us     max us   apart   failed")
        first: list[Floats] = []
        for solver, (warm, make) in SOLVERS.items():
            try:
                module = importlib.import_module(solver)
            except ImportError:
                print(f"{solver:11s} not installed")
                continue
            solve, taken, found = make(module), [], []
            for one in given:
                begun = time.perf_counter()
                try:
                    found.append(solve(one))
                except ValueError:  # quadprog: the constraints are inconsistent
                    found.append(np.full(len(one.linear), np.nan))
                taken.append(time.perf_counter() - begun)
            first = first or found
            failed = [broken(*both) for both in zip(given, found, strict=True)]
            apart = [
                np.abs(ours - theirs).max()
                for ours, theirs, bad in zip(first, found, failed, strict=True)
                if not bad
            ]
            median, high, most = 1e6 * np.percentile(taken, [50, 99, 100])
            print(
                f"{solver:11s} {'yes' if warm else 'no':4s} {median:11.0f} {high:10.0f} "
                f"{most:10.0f} {max(apart, default=np.nan):7.0e} {sum(failed):8d}",
                flush=True,
            )


if __name__ == "__main__":
    main()
