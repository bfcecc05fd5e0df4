"""Compare two runs of one motion: two recorded sessions, or two rollouts with other feed-forward.

    python examples/compare_runs.py before.mcap after.mcap
    python examples/compare_runs.py

Prints what `g1stream compare` prints; several sessions on each side would show their spread.
"""

import argparse

import g1stream


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("sessions", nargs="*", help="two recorded sessions; rollouts if left out")
    args = parser.parse_args()

    if len(args.sessions) not in (0, 2):
        parser.error("give two sessions, or none")
    if args.sessions:
        comparison = g1stream.report.compare(*args.sessions)
    else:
        velocity, dynamics = (
            g1stream.rollout("demo", feedforward=kind, seconds=5.0)
            for kind in ("velocity", "dynamics")
        )
        comparison = g1stream.report.compare(velocity, dynamics)
    print(comparison)


if __name__ == "__main__":
    main()
