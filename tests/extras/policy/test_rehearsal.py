import json
import logging
import threading
from types import SimpleNamespace

import onnx
import pytest

import g1stream
from g1stream.analysis.summary import Summary, Termination
from g1stream.cli.main import main
from g1stream.config import Config
from g1stream.errors import SafetyError
from g1stream.events import handled_by
from g1stream.extras.policy import rehearsal
from g1stream.extras.policy.contract import read_contract
from g1stream.extras.policy.network import Network
from g1stream.extras.policy.rehearsal import Rehearsal, Trial, rehearse_policy
from known_policies import DANCE, POLICIES, needs_policies

UNITREE = POLICIES / "unitree_dance1_subject2" / "policy.onnx"


def with_terms(contract, changed):
    return contract.model_copy(update={"terms": changed([*contract.terms])})


def scaled(name, factor):
    def change(terms):
        at = [one.name for one in terms].index(name)
        new = {"scale": [factor * one for one in terms[at].scale]}
        return [*terms[:at], terms[at].model_copy(update=new), *terms[at + 1 :]]

    return lambda contract: with_terms(contract, change)


def exchanged(contract):
    """The last two terms."""
    return with_terms(contract, lambda terms: [*terms[:-2], terms[-1], terms[-2]])


#: A wrong contract, and how the right one differs from it.
WRONG = {
    "last_action and joint_vel_rel exchanged": exchanged,
    "base_ang_vel x -1": scaled("base_ang_vel", -1.0),
    "base_ang_vel x 2": scaled("base_ang_vel", 0.5),
    "action_scale x 2": lambda one: one.model_copy(
        update={"action_scale": [0.5 * value for value in one.action_scale]}
    ),
    "anchor torso_link": lambda one: one.model_copy(update={"anchor": "pelvis"}),
    "lag 0": lambda one: one.model_copy(update={"lag": 1}),
}


@pytest.fixture
def simulated(monkeypatch):
    """A simulator in which a robot stands if the contract, and the time to stand, please `stands`.

    Returns the contracts that were tried, with that time.
    """

    def simulate(stands):
        tried = []

        def rehearse(motion, config, stand, seconds):
            tried.append((read_contract(Network(config.stream.policy)), stand))
            reason = "" if stands(*tried[-1]) else "the robot falls"
            ended = Termination(reason=reason, played_s=1.0 if reason else 7.0, motion_s=7.0)
            return Summary(termination=ended)

        monkeypatch.setattr(rehearsal, "_rehearse", rehearse)
        return tried

    return simulate


def facts_of(contract):
    """What a policy observes and does."""
    keys = "action_scale", "kp", "kd", "lag", "anchor", "joint_names"
    terms = [(one.value, one.scale) for one in contract.terms]
    return [terms, *(getattr(contract, key) for key in keys)]


@pytest.mark.parametrize("named", WRONG)
def test_the_contract_near_a_wrong_one_that_stands_is_found(policy, simulated, named):
    network = Network(policy())
    right = read_contract(network)
    tried = simulated(lambda contract, stand: facts_of(contract) == facts_of(right))
    lefts = []
    found = rehearse_policy(
        network,
        WRONG[named](right),
        g1stream.load_motion("demo"),
        lambda trial, left: lefts.append(left),
    )
    assert not found.stands
    assert lefts == [0, 0, *reversed(range(len(found.near)))]
    assert [one.contract for one in found.near if not one.reason] == [named]
    assert found.near[0].contract == named
    assert [stand for _, stand in tried] == [3.0, *[0.5] * (len(tried) - 1)]
    assert len(tried) == 2 + len(found.near)


def test_a_policy_that_stands_is_compared_with_its_other_anchor(policy, simulated):
    tried = simulated(lambda contract, stand: True)
    network = Network(policy())
    found = rehearse_policy(network, read_contract(network), g1stream.load_motion("demo"))
    assert found.stands
    assert (found.own.stood_s, found.stand_s, found.longer) == (7.0, 3.0, None)
    assert [(contract.anchor, stand) for contract, stand in tried] == [
        ("torso_link", 3.0),
        ("pelvis", 3.0),
    ]


@pytest.mark.parametrize(("other", "doubted"), [(0.098, True), (0.142, False), (0.1, False)])
def test_another_anchor_that_follows_closer_is_named(other, doubted):
    own = Trial(contract="", stood_s=7.0, reason="", rmse_rad=0.11)
    near = own.model_copy(update={"contract": "anchor torso_link", "rmse_rad": other})
    found = Rehearsal(tried_s=7.0, stand_s=0.5, own=own, longer=None, near=[near])
    assert found.stands
    assert bool(found.doubts) is doubted


def test_a_policy_that_stands_for_a_short_time_only_stands(policy, simulated):
    tried = simulated(lambda contract, stand: stand < 1.0)
    network = Network(policy())
    found = rehearse_policy(network, read_contract(network), g1stream.load_motion("demo"))
    assert found.stands
    assert found.longer
    assert (found.longer.stood_s, found.stand_s) == (1.0, 0.5)
    assert [stand for _, stand in tried] == [3.0, 0.5, 0.5]


def test_a_contract_that_cannot_be_played_is_one_that_falls(policy, simulated, monkeypatch):
    network = Network(policy())
    simulated(lambda contract, stand: False)
    changes = [("joints of none", {"joint_names": ["hip"] * 29}), ("lag 1", {"lag": 1})]
    monkeypatch.setattr(rehearsal, "_changes", lambda contract: iter(changes))
    found = rehearse_policy(network, read_contract(network), g1stream.load_motion("demo"))
    assert [(one.contract, one.stood_s, one.playable) for one in found.near] == [
        ("lag 1", 1.0, True),
        ("joints of none", 0.0, False),
    ]
    assert str(found).count("cannot be played") == 1  # no trial has an RMSE here


def test_contracts_are_tried_with_external_data_of_any_name(policy, simulated):
    path = policy()
    external = {"save_as_external_data": True, "location": "w.bin", "size_threshold": 0}
    onnx.save(onnx.load(path), path, **external)
    network, toml = Network(path), path.with_suffix(".toml")
    toml.write_text("lag = 0\n")
    tried = simulated(lambda contract, stand: False)
    rehearse_policy(network, read_contract(network), g1stream.load_motion("demo"))
    assert {one.lag for one, _ in tried} == {0, 1}
    assert toml.read_text() == "lag = 0\n"


def test_the_time_that_was_tried_is_named(policy, monkeypatch):
    tried, ended = [], Termination(reason="the robot falls", played_s=1.0, motion_s=2.0)

    def rollout(motion, *, config, seconds):
        tried.append(seconds)
        return SimpleNamespace(summary=lambda: Summary(termination=ended))

    monkeypatch.setattr(rehearsal, "rollout", rollout)
    config = Config(stream={"policy": str(policy()), "rehearse": 5.0, "duration": 2.0})
    with pytest.raises(SafetyError, match=r"\b2 s\b"):
        rehearsal.require_standing(g1stream.load_motion("demo"), config)
    assert tried == [2.0]


def test_the_verdict_is_the_exit_code_and_each_trial_has_a_line(policy, simulated, capsys):
    for stands, code in ((True, 0), (False, 1)):
        simulated(lambda contract, stand, stands=stands: stands)
        assert main(["policy", str(policy()), "--motion", "demo", "--json"]) == code
        text = capsys.readouterr()
        result = json.loads(text.out)
        found = result["rehearsal"]
        assert (found["stands"], found["doubts"]) == (stands, [])
        assert all(one in text.err for one in result["doubts"])
        assert bool(found["own"]["reason"]) is not stands
        assert len(text.err.splitlines()) == len(result["doubts"]) + len(found["near"]) + (
            1 if stands else 2
        )
    assert main(["policy", str(policy()), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["rehearsal"] is None


@pytest.mark.parametrize("other", ["--golden", "--motion"])
def test_toml_is_refused_with_a_check(policy, other):
    assert main(["policy", str(policy()), other, "demo", "--toml"]) == 2


def test_a_rehearsal_is_silent_and_other_threads_are_not(monkeypatch):
    """The level of the logger stays, as other threads log at it meanwhile."""
    own, other = logging.getLogger("g1stream.rehearsed"), logging.getLogger("g1stream.other")
    motion, kept, seen, told = g1stream.load_motion("demo"), logging.Handler(), [], []
    kept.emit = lambda record: told.append(record.getMessage())

    def rollout(given, *, config, seconds):
        own.warning("of the rehearsal")
        own.critical("of the rehearsal")
        thread = threading.Thread(target=other.info, args=("meanwhile",))
        thread.start()
        thread.join()
        seen.append(given)
        raise SafetyError("It fails.", "")

    monkeypatch.setattr("g1stream.extras.policy.rehearsal.rollout", rollout)
    with handled_by(kept):
        with pytest.raises(SafetyError):
            rehearsal.require_standing(motion, Config(stream={"rehearse": 1.0}))
        own.info("afterwards")
    assert told[-2:] == ["meanwhile", "afterwards"]
    assert not [one for one in told if one == "of the rehearsal"]
    assert seen == [motion]


@needs_policies
def test_a_wrong_sign_falls_and_the_right_one_stands(monkeypatch):
    """In the simulator, for a second of the dance: gyroscope x -1, and what is tried about it."""
    network = Network(UNITREE)
    wrong = WRONG["base_ang_vel x -1"](read_contract(network))
    every = rehearsal._changes
    monkeypatch.setattr(
        rehearsal, "_changes", lambda one: [x for x in every(one) if x[0] == "base_ang_vel x -1"]
    )
    found = rehearse_policy(network, wrong, g1stream.load_motion(DANCE).trim(0.0, 1.0))
    assert not found.stands
    assert found.own.stood_s < 2.0
    assert [(one.contract, one.reason) for one in found.near] == [("base_ang_vel x -1", "")]
    assert found.near[0].stood_s > 3.0
