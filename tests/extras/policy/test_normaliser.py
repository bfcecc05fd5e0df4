import numpy as np
import onnx
import pytest
from onnx import helper, numpy_helper

from g1stream.extras.policy.network import Network
from known_policies import network_of

MEAN = np.linspace(-1.0, 1.0, 154, dtype=np.float32)
STD = np.linspace(0.1, 3.0, 154, dtype=np.float32)


def normalising(first="Sub", mean=MEAN, std=STD, before=()):
    """A network whose observation goes through `before`, `first` with the mean, and a division."""
    model, at = network_of(), "obs"
    del model.graph.node[:]
    steps = [(kind,) for kind in before] + [(first, "mean"), ("Div", "std"), ("MatMul", "weights")]
    for i, (kind, *others) in enumerate(steps):
        gives = "actions" if kind == "MatMul" else f"passed{i}"
        model.graph.node.append(helper.make_node(kind, [at, *others], [gives]))
        at = gives
    for name, values in (("mean", mean), ("std", std)):
        model.graph.initializer.append(numpy_helper.from_array(values[None], name))
    return model


@pytest.mark.parametrize("before", [(), ("Identity",), ("Clip", "Identity")])
@pytest.mark.parametrize("external", [False, True])
def test_mean_and_deviation_are_those_of_the_file(tmp_path, before, external):
    path = tmp_path / "policy.onnx"
    how = {"save_as_external_data": True, "location": "policy.onnx.data", "size_threshold": 0}
    onnx.save(normalising(before=before), path, **(how if external else {}))
    mean, std = Network(path).normaliser
    np.testing.assert_array_equal(mean, MEAN)
    np.testing.assert_array_equal(std, STD)


@pytest.mark.parametrize(
    "model",
    [
        network_of(),
        normalising(first="Add"),
        normalising(std=np.zeros(154, np.float32)),
        normalising(mean=np.zeros(1, np.float32), std=np.ones(1, np.float32)),
        normalising(mean=np.full(154, np.nan, np.float32)),
    ],
    ids=["none", "another operator", "no deviation", "another width", "not finite"],
)
def test_what_is_no_normalisation_of_the_observation_is_none(tmp_path, model):
    path = tmp_path / "policy.onnx"
    onnx.save(model, path)
    assert Network(path).normaliser is None
