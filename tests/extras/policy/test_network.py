from hashlib import sha256

import numpy as np
import onnx
import pytest
from onnx import helper, numpy_helper
from onnx.external_data_helper import set_external_data

from g1stream.errors import ConfigError
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


def with_two_files(folder):
    """A policy with its weights in one file and the constant of a node in another."""
    model = normalising()
    weights, *statistics = model.graph.initializer
    constant = helper.make_node("Constant", [], ["mean"], value=statistics[0])
    del model.graph.initializer[1]
    (folder / "of").mkdir()
    for tensor, name in ((weights, "w.bin"), (constant.attribute[0].t, "of/mean.bin")):
        (folder / name).write_bytes(tensor.raw_data)
        set_external_data(tensor, name, length=len(tensor.raw_data))
        tensor.ClearField("raw_data")
    model.graph.node.insert(0, constant)
    path = folder / "policy.onnx"
    path.write_bytes(model.SerializeToString())
    return path


def test_all_external_data_are_part_of_the_hash_whatever_their_names(tmp_path):
    path = with_two_files(tmp_path)
    files = [tmp_path / "of" / "mean.bin", tmp_path / "w.bin"]
    network = Network(path)
    content = b"".join(one.read_bytes() for one in files)
    assert network.data_sha256 == sha256(content).hexdigest()
    assert np.isfinite(network.act(np.ones(154))).all()
    for file in files:
        before = file.read_bytes()
        file.write_bytes(before[:-1] + b"\x40")
        assert Network(path).data_sha256 != network.data_sha256
        file.write_bytes(before)
    assert Network(path).data_sha256 == network.data_sha256


@pytest.mark.parametrize("name", ["../w.bin", "of/../../w.bin", "/w.bin"])
def test_external_data_outside_the_folder_are_refused(tmp_path, name):
    model = network_of()
    set_external_data(model.graph.initializer[0], name)
    path = tmp_path / "policy.onnx"
    path.write_bytes(model.SerializeToString())
    with pytest.raises(ConfigError):
        Network(path)
