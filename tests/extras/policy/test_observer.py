import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from g1stream.errors import ConfigError
from g1stream.extras.policy.contract import read_contract
from g1stream.extras.policy.network import Network
from g1stream.extras.policy.observation import body
from g1stream.extras.policy.observer import Observer
from g1stream.robot.model import G1
from known_policies import saved

ANKLES = [4, 5, 10, 11]
DEFAULT = np.zeros(29)
DEFAULT[[0, 6, 4, 10]], DEFAULT[[3, 9]] = -0.2, 0.4
DEFAULT[[16, 23]], DEFAULT[[18, 25]] = (0.4, -0.4), 1.2


@pytest.fixture
def contract(tmp_path):
    path = saved(tmp_path / "policy.onnx", [("input", 1432)], [("output", 29)])
    return read_contract(Network(path))


def test_the_observation_of_twist2_is_that_of_its_runner(contract):
    """As its deploy_real computes it: 35 values of the reference, 92 of the robot, ten such steps
    before, the oldest first and zeros at first, and the 35 values again."""
    rng, robot = np.random.default_rng(3), G1.default()
    observer, before = Observer(contract, robot), [np.zeros(127)] * 10
    for _ in range(12):
        q, dq, wanted, action = rng.normal(size=(4, 29))
        gyroscope, pos, lin_vel, ang_vel = rng.normal(size=(4, 3))
        own, its = Rotation.random(2, rng=rng)
        mimic = [*its.inv().apply(lin_vel)[:2], pos[2], *its.as_euler("xyz")[:2], ang_vel[2]]
        mimic = np.concatenate([mimic, wanted])
        slowed = np.where(np.isin(np.arange(29), ANKLES), 0.0, 0.05 * dq)
        rolled = own.as_euler("xyz")[:2]
        present = [mimic, 0.25 * gyroscope, rolled, q - DEFAULT, slowed, observer.last_action]
        now = np.concatenate(present)
        quats = (one.as_quat(scalar_first=True) for one in (own, its))
        state = body(q, dq, next(quats), gyroscope)
        reference = body(wanted, dq, next(quats), ang_vel, pos, lin_vel)
        expected = np.concatenate([now, *before, mimic])
        np.testing.assert_allclose(observer.observe(state, reference), expected, atol=1e-9)
        before = [*before[1:], now]
        targets = DEFAULT + 0.5 * np.clip(20.0 * action, -10.0, 10.0)
        np.testing.assert_allclose(observer.act(20.0 * action), targets)


def test_facts_of_a_contract_that_repeats_terms_serve_another_policy(contract, tmp_path):
    copy = saved(tmp_path / "copy.onnx", [("obs", 1432)], [("actions", 29)])
    copy.with_suffix(".toml").write_text(contract.toml())
    ours, copied = (
        [one.model_dump(exclude={"named"}) for one in of.terms]
        for of in (contract, read_contract(Network(copy)))
    )
    assert copied == ours


@pytest.mark.parametrize("of", ["nowhere", "again", "joint_vel"])
def test_only_terms_with_values_of_their_own_are_repeated(tmp_path, contract, of):
    path = saved(tmp_path / "policy.onnx", [("obs", 58)], [("actions", 29)])
    terms = f'[{{ name = "joint_pos" }}, {{ name = "again", of = ["{of}"] }}]'
    head = contract.toml().partition("[[terms]]")[0]
    path.with_suffix(".toml").write_text(f"{head}\nterms = {terms}\n")
    with pytest.raises(ConfigError, match=of):
        read_contract(Network(path))
