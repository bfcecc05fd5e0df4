"""What the extras show of a session in which only the arms play."""

from __future__ import annotations

import numpy as np
import pytest

import g1stream
from g1stream.config import Config
from g1stream.extras.report.page import report
from g1stream.extras.video.render import Poses


@pytest.fixture(scope="module")
def arms():
    stream = {"ramp": 0.5, "hold": 0.1, "damp": 0.5, "others": "free"}
    config = Config.model_validate({"stream": stream})
    return g1stream.rollout("demo", seconds=1.0, joints="arms", config=config)


def test_the_error_in_a_video_is_that_of_the_joints_that_play(arms):
    shown, tracking = Poses(arms, np.array([0.8])), arms.tracking()
    at = np.abs(tracking.time - 0.8).argmin()
    expected = np.degrees(np.sqrt(np.mean(tracking.error[at, 15:] ** 2)))
    assert f"{expected:.2f} deg" in shown.text(0)


@pytest.mark.slow
def test_a_figure_and_a_report_show_some_joints(arms, tmp_path):
    arms.plot().savefig(tmp_path / "arms.png")
    report(arms, tmp_path / "arms.html")
    assert (tmp_path / "arms.html").stat().st_size > 100_000
