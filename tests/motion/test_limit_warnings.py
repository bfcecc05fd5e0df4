"""What a motion asks for beyond the limits is told before it moves anything."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from g1stream.config import Config
from g1stream.control.loop import StreamLoop
from g1stream.motion.limit_warnings import Interval, beyond_limits
from g1stream.motion.motion import Motion
from g1stream.programs.stream import stream
from g1stream.robot.model import G1

KNEE, ELBOW = "left_knee_joint", "left_elbow_joint"
FPS = 30.0


@pytest.fixture(scope="module")
def robot():
    return G1.load()


@pytest.fixture(scope="module")
def still(robot):
    """Four seconds in which nothing moves."""
    n = 121
    upright = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
    middle = np.tile((robot.lower + robot.upper) / 2, (n, 1))
    return Motion("still", FPS, robot.joint_names, middle, np.zeros((n, 3)), upright)


@pytest.fixture(scope="module")
def wild(still, robot):
    """The same, but for one frame, 3 s into it."""
    angles = still.joint_pos.copy()
    angles[90, robot.joint_names.index(KNEE)] = 9.0
    angles[90, robot.joint_names.index(ELBOW)] = 2.5
    return replace(still, name="wild", joint_pos=angles)


def told(motion, robot, start=0.0, length=None, loop=False):
    return beyond_limits(motion, robot, Config(), Interval(start, length, motion.duration, loop))


def test_a_motion_within_its_limits_is_no_matter(still, robot):
    assert told(still, robot) == []


def test_the_worst_joint_is_named_with_its_figures(wild, robot):
    further, faster = told(wild, robot)
    upper = robot.upper[robot.joint_names.index(KNEE)]
    assert further == (
        f"wild asks {KNEE} for 9.00 rad at 3.00 s, and its limit is {upper:.2f}; "
        "1 other joint beyond theirs. Commands are held at the limits."
    )
    assert f"wild asks {KNEE} for " in faster
    assert "rad/s" in faster


@pytest.mark.parametrize(
    ("start", "length", "loop", "n"),
    [
        (0.0, 2.0, False, 0),
        (2.5, 1.0, False, 2),
        (3.99, None, False, 0),
        (0.0, 2.0, True, 0),
        (3.5, 2.0, True, 0),
        (3.5, None, True, 2),
    ],
)
def test_only_what_is_played_counts(wild, robot, start, length, loop, n):
    assert len(told(wild, robot, start, length, loop)) == n


def test_times_are_those_of_the_whole_motion(wild, robot):
    assert "at 3.00 s" in told(wild, robot, start=2.5)[0]
    assert "at 3.00 s" in told(wild, robot, start=3.5, loop=True)[0]


def test_the_way_back_of_a_loop_counts(still, robot):
    """Out of a last frame within the limit, but fast, it goes beyond before it turns back."""
    knee = robot.joint_names.index(KNEE)
    angles = still.joint_pos.copy()
    done = np.arange(121) / 120
    angles[:, knee] = robot.upper[knee] - Config().safety.position_margin - 2.5 * (1.0 - done**4)
    rising = replace(still, name="rising", joint_pos=angles)
    assert told(rising, robot) == []
    assert told(rising, robot, length=4.0, loop=True) == []
    (further,) = told(rising, robot, loop=True)
    assert f"rising asks {KNEE} for " in further
    assert " rad on the way back to its first frame, and its limit is " in further


def test_the_stream_tells_it_before_the_first_command(wild, domain_id, monkeypatch):
    config = Config.model_validate({"dds": {"domain": domain_id}, "stream": {"wait": 1.0}})
    events = []
    run = StreamLoop.run

    def running(loop):
        events.append("runs")
        return run(loop)

    monkeypatch.setattr(StreamLoop, "run", running)
    stream(wild, config, on_warning=lambda text: events.append(text.split()[0]))
    assert events == ["wild", "wild", "runs"]
