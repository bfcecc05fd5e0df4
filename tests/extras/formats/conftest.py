from known_motions import load, make_motion, wild_motion
from known_robots import real_clip

__all__ = ["load", "make_motion", "real_clip", "wild_motion"]
