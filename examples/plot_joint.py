"""Draw one joint, measured position over reference, from a session or from a new rollout.

    python examples/plot_joint.py left_knee_joint knee.png session.mcap
    python examples/plot_joint.py left_knee_joint knee.png

The joints are those of `g1stream.JOINT_NAMES`.
"""

import argparse
from pathlib import Path

from matplotlib.figure import Figure

import g1stream


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("joint", choices=g1stream.JOINT_NAMES, metavar="joint", help="its name")
    parser.add_argument("picture", type=Path, help="the PNG to draw into")
    parser.add_argument("session", nargs="?", help="a recorded session; a rollout if left out")
    args = parser.parse_args()

    if args.session:
        session = g1stream.open_session(args.session)
    else:
        session = g1stream.rollout("demo", seconds=5.0)
    joint = g1stream.JOINT_NAMES.index(args.joint)
    played = session.sel("PLAY")

    axes = (figure := Figure(figsize=(10, 4), layout="constrained")).add_subplot()
    axes.plot(played.measured.time, played.measured.q[:, joint], label="measured")
    axes.plot(played.reference.time, played.reference.q[:, joint], "k--", label="reference")
    axes.set(title=args.joint, xlabel="time, s", ylabel="position, rad")
    axes.legend()
    figure.savefig(args.picture)
    print(f"RMSE of {args.joint}: {session.tracking().rmse[joint]:.4f} rad")


if __name__ == "__main__":
    main()
