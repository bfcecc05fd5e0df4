"""Writes small policies."""

import onnx
import pytest
from onnx import helper

from known_policies import METADATA, network_of


@pytest.fixture
def policy(tmp_path):
    """Write a policy: metadata over `METADATA`, None to leave one out, and the network's shape."""

    def write(told=None, **shape):
        model = network_of(**shape)
        told = METADATA if told == "all" else METADATA | (told or {})
        helper.set_model_props(model, {k: v for k, v in told.items() if v is not None})
        onnx.save(model, path := tmp_path / "policy.onnx")
        return path

    return write
