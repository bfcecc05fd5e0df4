"""Make a motion of steps, ask whether a G1 can play it on its feet, and play it in a rollout.

    python examples/steps.py steps.npz [--stride 0.12] [--pairs 3] [--force]

The motion file can be played in a simulator, too: g1stream stream steps.npz --support feet
"""

from __future__ import annotations

import argparse

import numpy as np

import g1stream
from g1stream.extras.physics.example_motions import stepping


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("motion", help="NPZ file to write")
    parser.add_argument("--stride", type=float, default=0.12, help="m")
    parser.add_argument("--pairs", type=int, default=3, help="steps of both feet")
    parser.add_argument("--force", action="store_true", help="replace the file")
    args = parser.parse_args()
    # Where each step goes: x and y, m, and heading, rad; the left foot first, then the right one.
    forward = np.repeat(np.arange(args.pairs) + 1, 2)
    motion = stepping(np.outer(forward, [args.stride, 0.0, 0.0]))
    motion.save(args.motion, force=args.force)
    feet = g1stream.physics.motion_physics(motion).verdicts["feet"]
    print(feet)
    if feet.playable == "yes":
        session = g1stream.rollout(motion, support="feet")
        print(session.summary())


if __name__ == "__main__":
    main()
