import json
import os
import subprocess
import sys
from hashlib import sha256

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper
from onnx.external_data_helper import set_external_data

from g1stream.app.rollout import rollout
from g1stream.config import Config
from g1stream.errors import ConfigError
from g1stream.extras.policy.contract import read_contract
from g1stream.extras.policy.network import Network
from g1stream.extras.policy.replay import replay_policy
from g1stream.robot.joints import JOINT_NAMES
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
    path = tmp_path / "inner" / "policy.onnx"
    path.parent.mkdir()
    (tmp_path / "w.bin").write_bytes(bytes(100_000))
    path.write_bytes(model.SerializeToString())
    with pytest.raises(ConfigError, match="not in the folder"):
        Network(path)


def adding(tmp_path, names=("h_in", "h_out"), **shape):
    """A policy whose actions are the sum of all its observations so far, a state that it keeps."""
    takes, gives = names
    model = network_of(width=29, **shape)
    del model.graph.node[:]
    tensor = helper.make_tensor_value_info
    model.graph.input.append(tensor(takes, 1, [1, 1, 29]))
    model.graph.output.append(tensor(gives, 1, [1, 1, 29]))
    model.graph.node.extend(
        [
            helper.make_node("Add", ["obs", takes], [gives]),
            helper.make_node("Squeeze", [gives, "axis"], ["actions"]),
        ]
    )
    model.graph.initializer.append(numpy_helper.from_array(np.array([0]), "axis"))
    onnx.save(model, path := tmp_path / "policy.onnx")
    path.with_suffix(".toml").write_text(FACTS)
    return path


FACTS = f"""
rate = 50.0
joint_names = {json.dumps(JOINT_NAMES)}
default_pos = 0.1
action_scale = 0.01
kp = 40.0
kd = 2.0
terms = [{{ name = "motion_joint_pos" }}]
"""


@pytest.mark.parametrize("names", [("h_in", "h_out"), ("hx", "next_hx")])
def test_a_state_is_fed_back_from_the_begin_of_a_run(tmp_path, names):
    path = adding(tmp_path, names)
    if names[0] == "hx":
        with pytest.raises(ConfigError, match=r"hx \(1, 1, 29\)"):
            read_contract(Network(path))
        path.with_suffix(".toml").write_text('feedback = { hx = "next_hx" }\n' + FACTS)
    network = Network(path)
    contract = read_contract(network)
    assert contract.feedback == dict([names])
    observations = np.random.default_rng(5).normal(size=(4, 29)).astype(np.float32)
    for _ in range(2):
        network.begin(contract.feedback)
        acted = [network.act(one) for one in observations]
        np.testing.assert_allclose(acted, np.cumsum(observations, axis=0), rtol=1e-5)


def test_a_run_with_a_state_is_replayed(tmp_path):
    path = adding(tmp_path)
    stream = {"policy": str(path), "stand": 0.5, "ramp": 0.5, "beyond_limits": "anyway"}
    session = rollout("demo", config=Config.model_validate({"stream": stream}), seconds=1.0)
    steps = session.policy
    np.testing.assert_allclose(steps.action, np.cumsum(steps.observation, axis=0), rtol=1e-4)
    assert np.abs(steps.observation[:10]).max() > 0.05
    found = replay_policy(session)
    assert (found.differing, found.steps) == (0, len(steps))


@pytest.mark.parametrize("line", ['{ other = "h_out" }', '{ h_in = "other" }', "{}", "1"])
def test_a_state_that_nothing_feeds_is_refused(tmp_path, line):
    path = adding(tmp_path)
    path.with_suffix(".toml").write_text(f"feedback = {line}\n{FACTS}")
    with pytest.raises(ConfigError, match=r"h_in|feedback|facts"):
        read_contract(Network(path))


def test_the_mean_behind_a_link_is_read(tmp_path):
    """As in the cache of a hub, whose files are links."""
    hidden, shown = tmp_path / "blobs", tmp_path / "snapshot"
    hidden.mkdir()
    shown.mkdir()
    how = {"save_as_external_data": True, "location": "w.bin", "size_threshold": 0}
    onnx.save(normalising(), hidden / "policy.onnx", **how)
    for file in hidden.iterdir():
        (shown / file.name).symlink_to(file)
    mean, std = Network(shown / "policy.onnx").normaliser
    np.testing.assert_array_equal(mean, MEAN)
    np.testing.assert_array_equal(std, STD)


@pytest.mark.parametrize(
    ("takes", "gives"),
    [
        (("h_in", TensorProto.INT64, [1, 29]), ("h_out", TensorProto.INT64, [1, 29])),
        (("h_in", 1, [1, 1, 29]), ("h_out", 1, [1, 29])),
        (("h_in", 1, [10**5, 10**6]), ("h_out", 1, [10**5, 10**6])),
        (("latent", 1, [1, 29]), ("latent_out", 1, [1, 29])),
    ],
)
def test_what_is_no_state_is_refused(tmp_path, takes, gives):
    model = network_of(width=29)
    model.graph.input.append(helper.make_tensor_value_info(*takes))
    model.graph.output.append(helper.make_tensor_value_info(*gives))
    model.graph.node.append(helper.make_node("Identity", [takes[0]], [gives[0]]))
    onnx.save(model, path := tmp_path / "policy.onnx")
    path.with_suffix(".toml").write_text(FACTS)
    with pytest.raises(ConfigError, match=takes[0]):
        read_contract(Network(path))


def test_no_network_is_reported_to_anybody(policy, tmp_path):
    """onnxruntime keeps what it will send in the home directory."""
    left_out = ("CI", "ORT_DISABLE_TELEMETRY", "ORT_RUNNING_UNIT_TESTS", "XDG_CACHE_HOME")
    environment = {name: one for name, one in os.environ.items() if name not in left_out}
    code = "import sys; from g1stream.extras.policy.network import Network; Network(sys.argv[1])"
    home, path = tmp_path / "home", policy()
    home.mkdir()
    command = [sys.executable, "-c", code, str(path)]
    subprocess.run(command, check=True, env=environment | {"HOME": str(home)})
    assert not [one for one in home.rglob("*") if one.is_file()]
