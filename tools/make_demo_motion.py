"""Make the bundled motion `demo`: squat, wave, sway, step in place, bow.

    python tools/make_demo_motion.py [OUTPUT]

Arms and waist are drawn as joint paths. The legs follow from the pelvis and the feet by inverse
kinematics, so that a foot on the ground stays flat and does not slip, and the root's height is the
one at which it stands there. Every path is made of minimum-jerk moves (Flash and Hogan 1985) and
begins and ends at rest. The same bytes come out of every run.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.robot.joints import JOINT_GROUPS, JOINT_NAMES
from g1stream.robot.kinematics import forward_kinematics
from g1stream.robot.model import G1
from g1stream.robot.rotations import (
    quat_conj,
    quat_from_rpy,
    quat_mul,
    quat_rotate,
    xyzw_from_wxyz,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

OUTPUT: Final = Path(__file__).parents[1] / "src/g1stream/motion/demo.csv"
FPS: Final = 30
DURATION: Final = 14.0
TIME: Final = np.arange(round(DURATION * FPS) + 1) / FPS

#: Height of the ankle roll frame above the sole, m.
SOLE: Final = 0.035
#: Height of the pelvis above the ground when standing with slightly bent knees, m.
STANDING: Final = 0.775
#: Where the feet stand: half their distance, m, and how far each is turned out, rad.
HALF_STANCE: Final = 0.10
TOES_OUT: Final = 0.08

# Stepping in place: the pelvis sways like a sine, and around each of its peaks the foot that it has
# left swings. At this period a sway of 6.5 cm takes the centre of pressure from foot to foot.
STEPPING: Final = 8.3
SWAY_PERIOD: Final = 1.8
SWAYS: Final = 2
SWING: Final = 0.55


def path(*points: tuple[float, float]) -> Array:
    """A value over TIME that rests at each (second, value) and moves with minimum jerk between."""
    seconds, values = np.array(points).T
    total = np.full_like(TIME, values[0])
    for start, stop, step in zip(seconds[:-1], seconds[1:], np.diff(values), strict=True):
        x = np.clip((TIME - start) / (stop - start), 0.0, 1.0)
        total += step * x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
    return total


def swing(start: float, stop: float, hertz: float, fade: float) -> Array:
    """A sine over TIME that swells within `fade` seconds of `start` and is gone again at `stop`."""
    window = path((start, 0.0), (start + fade, 1.0), (stop - fade, 1.0), (stop, 0.0))
    return window * np.sin(2.0 * np.pi * hertz * (TIME - start))


# How much of each figure there is at each time (T,): 0 is none of it.
SQUAT: Final = path((0.5, 0), (1.6, 1), (2.0, 1), (3.0, 0))
WAVE: Final = path((3.0, 0), (3.8, 1), (5.0, 1), (5.7, 0))
HELLO: Final = swing(3.6, 5.2, 1.6, 0.4)
SPREAD: Final = path((5.6, 0), (6.5, 1), (7.6, 1), (8.4, 0))
LEAN_LEFT: Final = path((5.6, 0), (6.5, 1), (7.6, -1), (8.4, 0))
SWAY_LEFT: Final = swing(STEPPING, STEPPING + SWAYS * SWAY_PERIOD, 1 / SWAY_PERIOD, 0.5)
MARCH: Final = path((8.2, 0), (8.8, 1), (11.4, 1), (12.0, 0))
BOW: Final = path((11.9, 0), (12.6, 1), (12.9, 1), (13.6, 0))


def hops(side: str, height: float) -> Array:
    """Height (T,) of a foot above the ground: up and down again at each of its steps."""
    first_peak = STEPPING + SWAY_PERIOD * (0.25 if side == "right" else 0.75)
    points = [(0.0, 0.0)]
    for peak in first_peak + SWAY_PERIOD * np.arange(SWAYS):
        points += [(peak - SWING / 2, 0.0), (peak, height), (peak + SWING / 2, 0.0)]
    return path(*points)


def pelvis() -> tuple[Array, Array]:
    """Position (T, 3) m and roll, pitch, yaw (T, 3) rad of the pelvis."""
    forward = -0.09 * SQUAT - 0.08 * BOW
    left = 0.03 * WAVE + 0.03 * LEAN_LEFT + 0.065 * SWAY_LEFT
    up = STANDING - 0.27 * SQUAT - 0.03 * SPREAD - 0.02 * MARCH - 0.015 * BOW
    roll = -0.14 * LEAN_LEFT
    pitch = 0.36 * SQUAT + 0.42 * BOW
    yaw = -0.12 * WAVE
    return np.stack([forward, left, up], axis=1), np.stack([roll, pitch, yaw], axis=1)


def foot(side: str) -> tuple[Array, Array]:
    """Position (T, 3) m of a foot's ankle roll frame and its orientation (T, 4) wxyz."""
    sign = 1.0 if side == "left" else -1.0
    still = np.zeros_like(TIME)
    pos = np.stack([still, still + sign * HALF_STANCE, SOLE + hops(side, 0.11)], axis=1)
    return pos, quat_from_rpy(np.stack([still, still, still + sign * TOES_OUT], axis=1))


def solve_leg(robot: G1, side: str, joint_pos: Array, root_pos: Array, root_quat: Array) -> None:
    """Fill the six joints of a leg in `joint_pos` (T, 29) so that its foot is where it should be.

    Newton's method on all frames at once, with the geometric Jacobian of the six revolute joints.
    """
    target_pos, target_quat = foot(side)
    joints = list(JOINT_GROUPS[f"{side}_leg"])
    links = [int(np.flatnonzero(robot.joint_of_link == joint)[0]) for joint in joints]
    for _ in range(30):
        pos, quat = forward_kinematics(robot, joint_pos, root_pos, root_quat)
        axes = quat_rotate(quat[:, links], robot.axis[links])
        arms = pos[:, links[-1:]] - pos[:, links]
        jacobian = np.concatenate([np.cross(axes, arms), axes], axis=2).transpose(0, 2, 1)
        turn = quat_mul(target_quat, quat_conj(quat[:, links[-1]]))
        error = np.hstack(
            [target_pos - pos[:, links[-1]], 2.0 * turn[:, 1:] * np.sign(turn[:, :1])]
        )
        step = np.linalg.solve(jacobian, error[..., np.newaxis])[..., 0]
        joint_pos[:, joints] += np.clip(step, -0.3, 0.3)
    if np.abs(error).max() > 1e-12:
        raise RuntimeError(f"the {side} foot cannot be reached: off by {np.abs(error).max():.3g}")


def upper_body() -> dict[str, Array]:
    """Paths of waist and arms, by joint without `_joint`; what is not named stays at 0."""
    both_pitch = 0.2 - 1.2 * SQUAT - 0.2 * SPREAD
    both_elbow = 1.0 - 0.9 * SQUAT + 0.4 * SPREAD - 0.8 * MARCH
    return {
        "waist_yaw": -0.25 * WAVE - 0.2 * SWAY_LEFT,
        "waist_roll": 0.10 * BOW - 0.08 * WAVE - 0.06 * LEAN_LEFT,
        "waist_pitch": -0.26 * SQUAT - 0.05 * MARCH,
        "left_shoulder_pitch": both_pitch + 0.3 * WAVE - 0.6 * SWAY_LEFT + 0.3 * BOW,
        "right_shoulder_pitch": both_pitch - 0.2 * WAVE + 0.6 * SWAY_LEFT - 0.9 * BOW,
        "left_shoulder_roll": 0.2 + 0.45 * WAVE + 1.3 * SPREAD + 0.1 * BOW,
        "right_shoulder_roll": -0.2 - 1.35 * WAVE - 1.3 * SPREAD,
        "left_shoulder_yaw": -0.2 * WAVE,
        "right_shoulder_yaw": -1.4 * WAVE + 0.9 * BOW,
        "left_elbow": both_elbow - 0.6 * WAVE,
        "right_elbow": both_elbow - 0.9 * WAVE + 0.45 * HELLO - 0.8 * BOW,
        "right_wrist_yaw": 0.22 * HELLO,
    }


def make(robot: G1) -> tuple[Array, Array, Array]:
    """The motion: joints (T, 29) rad, root position (T, 3) m, root orientation (T, 4) wxyz."""
    root_pos, root_rpy = pelvis()
    root_quat = quat_from_rpy(root_rpy)
    joint_pos = np.zeros((len(TIME), len(JOINT_NAMES)))
    for name, values in upper_body().items():
        joint_pos[:, JOINT_NAMES.index(f"{name}_joint")] = values
    for side in ("left", "right"):
        for part, guess in (("hip_pitch", -0.3), ("knee", 0.6), ("ankle_pitch", -0.3)):
            joint_pos[:, JOINT_NAMES.index(f"{side}_{part}_joint")] = guess
        solve_leg(robot, side, joint_pos, root_pos, root_quat)
    return joint_pos, root_pos, root_quat


def to_csv(joint_pos: Array, root_pos: Array, root_quat: Array) -> str:
    """The Foxglove layout: a header, then a numbered line a frame, quaternions xyzw."""
    columns = ("Frame", "X", "Y", "Z", "QX", "QY", "QZ", "QW", *JOINT_NAMES)
    # Adding 0.0 turns -0.0 into 0.0, whose sign would depend on rounding.
    values = np.hstack([root_pos, xyzw_from_wxyz(root_quat), joint_pos]).round(6) + 0.0
    rows = [f"{frame}," + ",".join(f"{v:.6f}" for v in row) for frame, row in enumerate(values)]
    return "\n".join([",".join(columns), *rows, ""])


def main() -> None:
    output = Path(sys.argv[1]) if len(sys.argv) > 1 else OUTPUT
    output.write_text(to_csv(*make(G1.default())), encoding="utf-8", newline="\n")
    print(f"wrote {output}: {len(TIME)} frames, {DURATION:g} s")


if __name__ == "__main__":
    main()
