"""Show a session in the Rerun viewer: the robot, its ghost, and the joints with the greatest error.

    pip install 'rerun-sdk>=0.41,<0.42'   # Python 3.11 or later
    python examples/rerun_session.py session.mcap
    python examples/rerun_session.py session.mcap -o session.rrd   # then: rerun session.rrd

Rerun's own MCAP loader makes the measured robot, the transforms of robot and ghost, and the log. It
makes neither the ghost's shapes nor curves of joints; they are added here.
"""

import argparse
import re
import tempfile
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.urdf import UrdfTree

import g1stream

TIMELINE = "message_publish_time"  # as Rerun's loader names it


def log_ghost(robot: g1stream.G1) -> None:
    """Log the robot's shapes in translucent blue, for the links whose poses are in /ghost/tf."""
    urdf = re.sub('rgba="[^"]*"', 'rgba="0.1 0.75 1 0.35"', robot.urdf)
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory, "ghost.urdf")
        path.write_text(urdf)
        tree = UrdfTree.from_file_path(path, "ghost", frame_prefix="ghost/")
        shapes = f"/ghost/{tree.name}/visual_geometries/**"
        rr.send_chunks(tree.stream(include_joint_transforms=False).filter(content=shapes))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("session", help="a session file, recorded with --channels standard or full")
    parser.add_argument("-o", "--out", help="save it as this .rrd instead")
    args = parser.parse_args()

    session = g1stream.open_session(args.session)
    worst = np.argsort(-session.tracking().rmse)[:4]
    names = [g1stream.JOINT_NAMES[joint] for joint in worst]
    robots = rrb.Spatial3DView(
        name="measured robot; blue: reference joints on the measured pelvis",
        spatial_information=rrb.SpatialInformation(target_frame="world"),
    )
    log = rrb.TextLogView(origin="/log", name="log")
    plots = [rrb.TimeSeriesView(origin=f"/joints/{name}", name=f"{name}, rad") for name in names]
    left = rrb.Vertical(robots, log, row_shares=[3, 1])
    blueprint = rrb.Blueprint(
        rrb.Horizontal(left, rrb.Vertical(*plots)), rrb.TimePanel(timeline=TIMELINE)
    )

    rr.init("g1stream", spawn=args.out is None, default_blueprint=blueprint)
    if args.out:
        rr.save(args.out, default_blueprint=blueprint)
    rr.log_file_from_path(args.session)
    log_ghost(session.robot)
    reference, measured = session.reference, session.measured
    curves = {"reference": (reference, reference.q), "measured": (measured, measured.q)}
    for curve, (stream, q) in curves.items():
        times = rr.TimeColumn(TIMELINE, timestamp=stream.publish_time.astype("datetime64[ns]"))
        for joint, name in zip(worst, names, strict=True):
            scalars = rr.Scalars.columns(scalars=q[:, joint])
            rr.send_columns(f"/joints/{name}/{curve}", [times], scalars)


if __name__ == "__main__":
    main()
