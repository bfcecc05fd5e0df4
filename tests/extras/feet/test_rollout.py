"""A rollout of a robot on its feet is the same every time."""

import pytest

import g1stream
from g1stream.config import Config


def test_the_same_arguments_give_the_same_messages():
    pytest.importorskip("daqp")
    config = Config.model_validate({"stream": {"ramp": 0.5, "hold": 0.1, "damp": 0.5}})
    first, second = (
        g1stream.rollout("demo", support="feet", seconds=0.2, config=config) for _ in range(2)
    )
    assert list(first.replay_bytes("/lowcmd")) == list(second.replay_bytes("/lowcmd"))
    assert list(first.replay_bytes("/lowstate")) == list(second.replay_bytes("/lowstate"))
