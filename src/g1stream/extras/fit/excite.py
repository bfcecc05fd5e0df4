"""An exciting motion for parameter identification: all joints move at many speeds, both ways.

Each joint follows a sum of sines with its own frequencies (J. Swevers et al. 1997, "Optimal robot
excitation and identification"). Slow sines show dry friction and weight, fast ones viscous friction
and armature. The robot must be bolted or hang with its feet free.
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

#: By the suffix of a joint's name: middle of the movement, rad, mirrored on the right; largest
#: deflection, rad; largest acceleration of a sine, rad/s².
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
#: Number of sines of a joint, and their lowest and highest frequency, Hz.
_SINES, _LOWEST, _HIGHEST = 6, 0.12, 2.4
#: Largest used fraction of the limits of position range and velocity.
_OF_RANGE, _OF_SPEED = 0.9, 0.6
_FPS: Final = 100.0
#: Time from rest to the full movement, and back, s.
_FADE: Final = 2.0
#: Factor that reduces a movement whose links collide, and the number of reductions.
_SMALLER, _TRIES = 0.85, 20
_HEIGHT: Final = 0.8


def exciting_motion(robot: G1 | None = None, *, seconds: float = 40.0, seed: int = 0) -> Motion:
    """Make a motion of all joints within the limits and without collisions.

    Args:
        robot: robot with the limits and shapes; the default one if None.
        seconds: duration.
        seed: seed of the phases and frequencies.

    Raises:
        ConfigError: it is too short, or collides at any size.
    """
    if seconds < 3.0 * _FADE:
        raise ConfigError(
            f"An exciting motion cannot last {seconds:g} s.", f"Give {3.0 * _FADE:g} s or more."
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
            "Record another motion that moves every joint.",
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
    """A sum of sines (T,) within a deflection, rad, and a fraction of the speed limit, rad/s."""
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
    """(29,) which joints are between links that collide in any pose of (T, 29)."""
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
