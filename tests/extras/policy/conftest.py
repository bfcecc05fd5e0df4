import onnx
import pytest
from onnx import helper

from known_policies import METADATA, network_of


@pytest.fixture
def policy(tmp_path):
    """Write a policy: metadata over `METADATA` or `only` these, and the network's shape.

    Metadata that are None are left out.
    """

    def write(told=None, only=None, **shape):
        model = network_of(**shape)
        told = METADATA | (told or {}) if only is None else only
        helper.set_model_props(model, {k: v for k, v in told.items() if v is not None})
        onnx.save(model, path := tmp_path / "policy.onnx")
        return path

    return write
