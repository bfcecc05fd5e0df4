"""Stream a motion from a CSV file to a simulator on this machine, and record the session.

Start a simulator first, such as `g1stream sim`; then

    python examples/stream_csv.py dance.csv dance.mcap
"""

import argparse
import logging
from pathlib import Path

import g1stream


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("motion", help="a CSV file, or the name of a bundled motion, such as demo")
    parser.add_argument("session", type=Path, help="the MCAP to record into")
    parser.add_argument("--domain", type=int, default=1, help="DDS domain of the simulator")
    parser.add_argument("--duration", type=float, help="play so much of the motion, s")
    args = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(message)s")

    motion = g1stream.load_motion(args.motion)
    print(f"{motion.name}: {motion.n_frames} frames at {motion.fps:g} fps")
    settings = {"dds.domain": args.domain, "stream.duration": args.duration}
    config = g1stream.load_config(over=settings)
    g1stream.stream(motion, config, record=args.session, force=True)

    tracking = g1stream.open_session(args.session).tracking()
    print(f"RMSE of all joints {tracking.overall:.4f} rad; worst joint: {tracking.worst_joint}")


if __name__ == "__main__":
    main()
