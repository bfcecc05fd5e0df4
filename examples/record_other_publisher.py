"""Record what somebody else publishes: a policy, Unitree's own simulator, a robot.

    python examples/record_other_publisher.py session.mcap --domain 1 --seconds 10

The recorder only listens. The file has each LowCmd and LowState byte for byte and, for viewers, the
measured robot as transforms and joint states.
"""

import argparse
import logging
import time
from pathlib import Path

import numpy as np

import g1stream


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("session", type=Path, help="the MCAP to record into")
    parser.add_argument("--domain", type=int, default=1, help="DDS domain")
    parser.add_argument("--interface", default="lo", help="network interface")
    parser.add_argument("--seconds", type=float, default=10.0)
    args = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(message)s")

    settings = {"dds.domain": args.domain, "dds.interface": args.interface}
    config = g1stream.load_config(over=settings)
    end = time.monotonic() + args.seconds
    g1stream.record(args.session, config, force=True, should_stop=lambda: time.monotonic() > end)

    session = g1stream.open_session(args.session)
    for topic, count in session.topics.items():
        print(f"{topic:<30} {count:>8} messages")
    if session.topics.get("/lowstate"):
        ranges = np.ptp(session.measured.q, axis=0)
        widest = int(ranges.argmax())
        print(f"{g1stream.JOINT_NAMES[widest]} moved most: {ranges[widest]:.3f} rad")


if __name__ == "__main__":
    main()
