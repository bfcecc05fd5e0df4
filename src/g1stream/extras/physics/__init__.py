"""The physics of a motion, and changes that let a robot play it on its feet."""

from typing import TYPE_CHECKING

from g1stream.optional import lazily

if TYPE_CHECKING:
    from g1stream.extras.physics.measure import motion_physics as motion_physics
    from g1stream.extras.physics.result import MotionPhysics as MotionPhysics
    from g1stream.extras.physics.stance import Standing as Standing
    from g1stream.extras.physics.standing import stand as stand

__all__ = ["MotionPhysics", "Standing", "motion_physics", "stand"]

__getattr__ = lazily(
    __name__,
    {
        "motion_physics": "measure",
        "MotionPhysics": "result",
        "Standing": "stance",
        "stand": "standing",
    },
)
