"""Whether the capture point shows a fall before the tilt of the pelvis does.

    python benchmarks/capture_point.py SESSION.mcap [...]

The sessions are of policies on free feet in simulators, which publish the position of the pelvis.
The capture point is c + c' sqrt(h / g), with c the centre of mass and h its height (J. Pratt et
al., "Capture point: a step toward humanoid push recovery", 2006). In a dance it leaves the soles
with every step, so it is compared with that of the reference, both from the pelvis. The table has
the largest distance between the two up to 1 s before a fall, or to the end without one, and when it
exceeded some distances. A fall is 0.9 of the tilt that ends a stream, 0.6 rad against the
reference, or a pelvis 0.3 m too low.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from g1stream.analysis.body import FPS, frames
from g1stream.app.session import open_session
from g1stream.extras.policy.source import TILTED
from g1stream.robot.dynamics import GRAVITY, compiled_dynamics
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.rotations import quat_conj, quat_mul, tilt_of

if TYPE_CHECKING:
    from g1stream.analysis.body import RobotFrames
    from g1stream.robot.model import G1
    from g1stream.types import Floats

LOW = 0.3
DISTANCES = (0.15, 0.2, 0.25, 0.3)


def capture_points(robot: G1, state: RobotFrames) -> Floats:
    """(F, 2) m, horizontal, from the pelvis, world axes."""
    model = compiled_dynamics(robot, GRAVITY)
    data = mujoco.MjData(model)
    joints = [model.joint(name).qposadr[0] for name in JOINT_NAMES]
    centre = np.empty((len(state.q), 3))
    for i, q in enumerate(state.q):
        data.qpos[:3], data.qpos[3:7] = state.root_pos[i], state.root_quat_wxyz[i]
        data.qpos[joints] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        centre[i] = data.subtree_com[1]
    fall_time = np.sqrt(np.maximum(centre[:, 2:], 0.0) / GRAVITY)
    points = centre + np.gradient(centre, 1.0 / FPS, axis=0) * fall_time
    found: Floats = (points - state.root_pos)[:, :2]
    return found


def row(path: Path) -> str:
    """One session of the table."""
    session = open_session(path)
    found = frames(session, session.tracking())
    if not found or not found.has_position:
        return f"{path.name[:28]:28} has no position of the pelvis in PLAY"
    asked, done, time = found.reference, found.measured, found.motion_time
    apart = np.linalg.norm(
        capture_points(session.robot, asked) - capture_points(session.robot, done), axis=1
    )
    turns = quat_mul(done.root_quat_wxyz, quat_conj(asked.root_quat_wxyz))
    tilt = np.array([tilt_of(turn) for turn in turns])
    low = asked.root_pos[:, 2] - done.root_pos[:, 2]

    def first(when: np.ndarray) -> str:
        return f"{time[when.argmax()]:.2f}" if when.any() else "-"

    falls = (tilt > 0.9 * TILTED) | (low > LOW)
    before = time < time[falls.argmax()] - 1.0 if falls.any() else np.ones(len(time), bool)
    figures = [first(falls), f"{apart[before].max(initial=0.0):.3f}"]
    figures += [first(apart > distance) for distance in DISTANCES]
    return f"{path.name[:28]:28}" + "".join(f"{one:>8}" for one in figures)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("sessions", type=Path, nargs="+")
    names = ["falls s", "most m", *(f"> {distance:g} m" for distance in DISTANCES)]
    print(" " * 28 + "".join(f"{name:>8}" for name in names))
    for path in parser.parse_args().sessions:
        print(row(path), flush=True)


if __name__ == "__main__":
    main()
