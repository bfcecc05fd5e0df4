"""Whether the cause that is told of an error is the one that brought it about.

A motion that touches itself is played twice in lockstep, with and without self-collision. Of each
second of it, the cause of the greatest error is looked for as `g1stream report` does. Where the
same joint's error at that instant is less than half without self-collision, that was the cause.

    python benchmarks/cause.py dance.csv --seconds 60
"""

from __future__ import annotations

import argparse
from collections import Counter
from pathlib import Path

import numpy as np

import g1stream
from g1stream.config import Config
from g1stream.extras.report.cause import worst_error
from g1stream.robot.joints import JOINT_NAMES

#: Errors below are left out, rad; and those so soon after a second has begun, s, that what was
#: before them is not looked at.
LEAST, SOON = np.radians(1.0), 0.4


def main() -> None:
    """Print how often what is told is true."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("motion", type=Path)
    parser.add_argument("--seconds", type=float, default=60.0)
    args = parser.parse_args()
    apart = Config.model_validate({"sim": {"self_collision": False}})
    session = g1stream.rollout(args.motion, seconds=args.seconds)
    without = g1stream.rollout(args.motion, seconds=args.seconds, config=apart).tracking()
    table: Counter[tuple[bool, str]] = Counter()
    for begin in np.arange(0.0, args.seconds - 1.0, 0.5):
        part = session.sel(time=slice(begin, begin + 1.0))
        worst = worst_error(part)
        if abs(worst.error_rad) < LEAST or worst.at_s < begin + SOON:
            continue
        row = int(np.abs(without.motion_time - worst.at_s).argmin())
        alone = without.error[row, JOINT_NAMES.index(worst.joint)]
        table[bool(abs(alone) < 0.5 * abs(worst.error_rad)), worst.cause or "none found"] += 1
    print(f"{'by self-collision':>20} {'cause told':>20} {'errors':>7}")
    for (true, told), n in sorted(table.items(), key=lambda one: -one[1]):
        print(f"{'yes' if true else 'no':>20} {told:>20} {n:>7}")


if __name__ == "__main__":
    main()
