"""Robots, random motions, and sessions whose error is known, as fixtures."""

from known_robots import compile_mujoco, random_frames, reference_urdf, robot
from known_sessions import change, play, take, write_session

__all__ = [
    "change",
    "compile_mujoco",
    "play",
    "random_frames",
    "reference_urdf",
    "robot",
    "take",
    "write_session",
]
