"""Try several position gains on the simulated robot: one rollout for each, faster than real time.

    python examples/sweep_rollout.py demo --kp 20 40 80 160 --support hanging --plot sweep.png

Prints the tracking error of each; no DDS and no second process are involved.
"""

import argparse
from pathlib import Path

import g1stream


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("motion", nargs="?", default="demo", help="CSV file, or a bundled motion")
    parser.add_argument("--kp", type=float, nargs="+", default=[20, 40, 80, 160], help="N·m/rad")
    parser.add_argument("--support", choices=["bolted", "hanging", "follow"], default="bolted")
    parser.add_argument("--feedforward", choices=["none", "velocity", "dynamics"])
    parser.add_argument("--seconds", type=float, default=5.0, help="of the motion to play")
    parser.add_argument("--plot", type=Path, help="draw the RMSE over kp into this PNG")
    args = parser.parse_args()

    rmse = []
    print("kp N·m/rad  RMSE rad  worst joint")
    for kp in args.kp:
        session = g1stream.rollout(
            args.motion,
            support=args.support,
            feedforward=args.feedforward,
            seconds=args.seconds,
            kp=kp,
        )
        tracking = session.tracking()
        rmse.append(tracking.overall)
        print(f"{kp:9g}  {tracking.overall:8.4f}  {tracking.worst_joint}")

    if args.plot:
        from matplotlib.figure import Figure

        axes = (figure := Figure(layout="constrained")).add_subplot()
        axes.plot(args.kp, rmse, "o-")
        axes.set(xlabel="kp, N·m/rad", ylabel="RMSE of all joints, rad")
        figure.savefig(args.plot)


if __name__ == "__main__":
    main()
