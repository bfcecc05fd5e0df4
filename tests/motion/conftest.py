from known_motions import load, make_motion, wild_motion
from known_robots import real_clip, robot

__all__ = ["load", "make_motion", "real_clip", "robot", "wild_motion"]
