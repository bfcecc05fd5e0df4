"""Compare two runs of one motion: two recorded sessions, or two rollouts with other feed-forward.

    python examples/compare_runs.py before.mcap after.mcap
    python examples/compare_runs.py

Prints the tracking error of each limb in both, and the ratio.
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
        first, second = (g1stream.open_session(path).tracking() for path in args.sessions)
    else:
        first, second = (
            g1stream.rollout("demo", feedforward=kind, seconds=5.0).tracking()
            for kind in ("velocity", "dynamics")
        )
    rows = {**first.rmse_by_limb, "all joints": first.overall}
    others = {**second.rmse_by_limb, "all joints": second.overall}
    print("limb         first rad  second rad  ratio")
    for limb, rmse in rows.items():
        print(f"{limb:<11}  {rmse:9.4f}  {others[limb]:10.4f}  {others[limb] / rmse:5.2f}")


if __name__ == "__main__":
    main()
