"""Robots and random motions, as fixtures."""

from known_robots import compile_mujoco, random_frames, reference_urdf, robot

__all__ = ["compile_mujoco", "random_frames", "reference_urdf", "robot"]
