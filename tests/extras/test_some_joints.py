"""What the extras show of a session in which only the arms play."""

from __future__ import annotations

import numpy as np

import g1stream
from g1stream.config import Config
from g1stream.extras.video.render import Poses


def test_the_error_in_a_video_is_that_of_the_joints_that_play():
    stream = {"ramp": 0.5, "hold": 0.1, "damp": 0.5, "others": "free"}
    config = Config.model_validate({"stream": stream})
    arms = g1stream.rollout("demo", seconds=1.0, joints="arms", config=config)
    shown, tracking = Poses(arms, np.array([0.8])), arms.tracking()
    at = np.abs(tracking.time - 0.8).argmin()
    expected = np.degrees(np.sqrt(np.mean(tracking.error[at, 15:] ** 2)))
    assert f"{expected:.2f} deg" in shown.text(0)
