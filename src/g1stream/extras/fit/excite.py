"""A motion that shows a robot's parameters: every joint moves fast and slow, and both ways.

Each joint follows a sum of sines of its own frequencies (J. Swevers et al. 1997, "Optimal robot
excitation and identification"): slow ones for dry friction and weight, fast ones for viscous
friction and armature. The robot has to be bolted or to hang, its feet free.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from g1stream.errors import ConfigError
from g1stream.motion.blend import minimum_jerk
from g1stream.motion.motion import Motion
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS
from g1stream.robot.model import G1
from g1stream.sim.world import Root, World
from g1stream.types import Floats

__all__ = ["exciting_motion"]

#: Per joint, by the ends of its name: middle of the movement, rad, mirrored on the right; greatest
#: deflection, rad; greatest acceleration of one sine, rad/s².
_MOVES: Final = (
    ("hip_pitch_joint", -0.25, 0.40, 12.0),
    ("hip_roll_joint", 0.25, 0.20, 10.0),
    ("hip_yaw_joint", 0.0, 0.35, 15.0),
    ("knee_joint", 0.60, 0.45, 15.0),
    ("ankle_pitch_joint", -0.10, 0.35, 40.0),
    ("ankle_roll_joint", 0.0, 0.20, 30.0),
    ("waist_yaw_joint", 0.0, 0.35, 8.0),
    ("waist_roll_joint", 0.0, 0.15, 4.0),
    ("waist_pitch_joint", 0.05, 0.18, 4.0),
    ("shoulder_pitch_joint", 0.0, 0.60, 20.0),
    ("shoulder_roll_joint", 0.70, 0.35, 15.0),
    ("shoulder_yaw_joint", 0.0, 0.50, 30.0),
    ("elbow_joint", 0.60, 0.60, 30.0),
    ("wrist_roll_joint", 0.0, 0.70, 50.0),
    ("wrist_pitch_joint", 0.0, 0.60, 50.0),
    ("wrist_yaw_joint", 0.0, 0.60, 50.0),
)
#: Sines of a joint, their lowest and highest frequency, Hz.
_SINES, _LOWEST, _HIGHEST = 6, 0.12, 2.4
#: Of the limits of position range and velocity, what is used at most.
_OF_RANGE, _OF_SPEED = 0.9, 0.6
_FPS: Final = 100.0
#: From rest to the full movement, and back, s.
_FADE: Final = 2.0
#: Where links collide the movement is made smaller by this, so often.
_SMALLER, _TRIES = 0.85, 20
_HEIGHT: Final = 0.8


def exciting_motion(robot: G1 | None = None, *, seconds: float = 40.0, seed: int = 0) -> Motion:
    """A motion of all joints within the limits, in which no links collide.

    Args:
        robot: whose limits and shapes; the default one if None.
        seconds: how long.
        seed: of the phases and frequencies: motions of other seeds are others.

    Raises:
        ConfigError: it is too short, or collides however small it is.
    """
    if seconds < 3.0 * _FADE:
        raise ConfigError(
            f"An exciting motion cannot take {seconds:g} s.", f"Give {3.0 * _FADE:g} s or more."
        )
    robot = robot or G1.default()
    rng = np.random.default_rng(seed)
    time = np.arange(round(seconds * _FPS) + 1) / _FPS
    ramp = minimum_jerk(np.clip(np.minimum(time, seconds - time) / _FADE, 0.0, 1.0))[0]
    middle, moved = np.zeros(N_JOINTS), np.zeros((len(time), N_JOINTS))
    for j, name in enumerate(JOINT_NAMES):
        at, deflection, acceleration = next(
            values for ending, *values in _MOVES if name.endswith(ending)
        )
        right_sided = name.startswith("right_") and ("_roll_" in name or "_yaw_" in name)
        low, high = robot.lower[j], robot.upper[j]
        deflection = min(deflection, 0.5 * _OF_RANGE * (high - low))
        middle[j] = np.clip(-at if right_sided else at, low + deflection, high - deflection)
        moved[:, j] = _sines(rng, time, deflection, acceleration, robot.velocity[j])
    moved = ramp[:, np.newaxis] * np.where(robot.present, moved, 0.0)
    middle = np.where(robot.present, middle, 0.0)
    world = World(robot, "follow")
    for _ in range(_TRIES):
        wrong = _colliding(world, middle + moved)
        if not wrong.any():
            break
        moved = moved * np.where(wrong, _SMALLER, 1.0)
    else:
        raise ConfigError(
            f"The links of {robot.name} collide in every exciting motion.",
            "Record a motion of your own that moves every joint.",
        )
    return Motion.from_arrays(
        middle + moved,
        np.tile([0.0, 0.0, _HEIGHT], (len(time), 1)),
        fps=_FPS,
        name=f"excite-{seed}",
    )


def _sines(
    rng: np.random.Generator, time: Floats, deflection: float, acceleration: float, speed: float
) -> Floats:
    """A sum of sines (T,) within a deflection, rad, and within a part of the speed, rad/s."""
    steps = (np.arange(_SINES) + rng.uniform(0.2, 0.8, _SINES)) / _SINES
    omega = 2.0 * np.pi * _LOWEST * (_HIGHEST / _LOWEST) ** steps
    amplitude = np.minimum(deflection / np.sqrt(1.0 + omega), acceleration / omega**2)
    total: Floats = (
        np.sin(np.outer(time, omega) + rng.uniform(0.0, 2.0 * np.pi, _SINES)) @ amplitude
    )
    total *= min(1.0, deflection / float(np.abs(total).max()))
    fastest = float(np.abs(np.gradient(total, time)).max())
    return total * min(1.0, _OF_SPEED * speed / fastest)


def _colliding(world: World, joint_pos: Floats) -> Any:
    """(29,) which joints are on the way between links that collide in some pose of (T, 29)."""
    import mujoco

    model, data = world.model, world.data
    upright, still = np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3)
    root = Root(np.array([0.0, 0.0, 5.0]), upright, still, still, playing=True)
    wrong = np.zeros(N_JOINTS, dtype=bool)
    dofs = [
        model.joint(name).dofadr[0] if has else -1
        for name, has in zip(JOINT_NAMES, world.present, strict=True)
    ]
    for pose in joint_pos[::5]:
        world.set_state(pose, np.zeros(N_JOINTS), root)
        for contact in data.contact[: data.ncon]:
            rows = np.zeros((2, model.nv))
            for row, geom in zip(rows, contact.geom, strict=True):
                jacobian = np.zeros((3, model.nv))
                body = model.geom_bodyid[geom]
                mujoco.mj_jac(model, data, jacobian, None, contact.pos, body)
                row[:] = np.abs(jacobian).sum(axis=0) > 1e-9
            between = rows[0] != rows[1]
            wrong |= [dof >= 0 and bool(between[dof]) for dof in dofs]
    return wrong
