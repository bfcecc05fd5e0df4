import json
from contextlib import nullcontext, suppress

import numpy as np
import onnx
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from onnx import helper

from g1stream.cli.main import main
from g1stream.config import Config
from g1stream.errors import ConfigError
from g1stream.extras.policy.contract import read_contract
from g1stream.extras.policy.network import Network
from g1stream.extras.policy.observation import body
from g1stream.extras.policy.observer import Observer
from g1stream.extras.policy.source import PolicyTargets
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.model import G1
from known_policies import METADATA, endless, saved

UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])
#: A gain for each motor, alike left and right.
BY_MOTOR = [20.0 + motor for motor in (*range(6), *range(6), *range(12, 15), *[*range(15, 22)] * 2)]
#: Metadata with a value for each joint.
BY_JOINT = ("joint_stiffness", "joint_damping", "default_joint_pos", "action_scale")


def contract_of(path):
    return read_contract(Network(path))


def test_metadata_of_whole_body_tracking(policy):
    contract = contract_of(policy())
    assert [(term.name, term.size) for term in contract.terms] == [
        ("motion_command", 58),
        ("motion_anchor_ori_b", 6),
        ("base_ang_vel", 3),
        ("joint_pos_rel", 29),
        ("joint_vel_rel", 29),
        ("last_action", 29),
    ]
    assert contract.joint_names == list(JOINT_NAMES)
    assert contract.action_scale == [0.5] * 29
    assert (contract.rate, contract.anchor, contract.lag) == (50.0, "torso_link", 0)
    assert contract.reference == "a motion"
    assert contract.origin["kp"] == "metadata of the ONNX file"
    assert contract.origin["rate"].startswith("assumed")


def test_a_toml_file_comes_first_and_its_patterns_are_put_over_each_other(policy):
    path = policy()
    path.with_suffix(".toml").write_text(
        'rate = 100.0\nkp = { "*" = 20.0, "*_knee_joint" = 90.0 }\n'
    )
    contract = contract_of(path)
    kp = dict(zip(contract.joint_names, contract.kp, strict=True))
    assert contract.rate == 100.0
    assert (kp["left_knee_joint"], kp["waist_yaw_joint"]) == (90.0, 20.0)
    assert contract.kd == [2.0] * 29
    assert contract.origin["rate"] == str(path.with_suffix(".toml"))


@pytest.fixture
def deployed(policy):
    """Write a policy beside a deploy.yaml with some observations, and joints in another order."""

    def write(width, observations):
        values = {
            "joint_ids_map": [*range(28, -1, -1)],
            "step_dt": 0.02,
            "stiffness": BY_MOTOR,
            "damping": [1.0] * 29,
            "default_joint_pos": [0.0] * 29,
            "actions": {"JointPositionAction": {"scale": [0.25] * 29, "offset": [0.01] * 29}},
            "observations": observations,
        }
        path = policy(only={}, width=width)
        path.with_name("deploy.yaml").write_text(json.dumps(values))
        return path

    return write


def test_deploy_yaml_has_gains_by_motor_and_joints_in_the_policys_order(deployed):
    observations = {
        "base_ang_vel": {"scale": [0.2] * 3, "history_length": 1},
        "joint_pos_rel": {"scale": None, "history_length": 1},
        "last_action": {"history_length": 1},
    }
    contract = contract_of(deployed(61, observations))
    assert contract.joint_names == list(JOINT_NAMES[::-1])
    assert contract.kp == BY_MOTOR[::-1]
    assert contract.in_motor_order(contract.kp).tolist() == BY_MOTOR
    assert contract.default_pos == [0.0] * 29
    assert contract.action_offset == [0.01] * 29
    assert [term.scale for term in contract.terms] == [[0.2] * 3, [1.0], [1.0]]
    assert contract.rate == pytest.approx(50.0)
    assert (contract.reference, contract.anchor) == ("none", None)


def with_action(path, **changed):
    """Change what the deploy.yaml beside a policy says about its action."""
    beside = path.with_name("deploy.yaml")
    values = json.loads(beside.read_text())
    values["actions"]["JointPositionAction"] |= changed
    beside.write_text(json.dumps(values))
    return path


@pytest.mark.parametrize(("ids", "refused"), [([*range(12)], True), ([*range(29)], False)])
def test_an_action_of_some_joints_in_a_deploy_yaml_is_refused(deployed, ids, refused):
    path = with_action(deployed(29, {"last_action": {}}), joint_ids=ids)
    with pytest.raises(ConfigError, match="joint_ids") if refused else nullcontext():
        assert contract_of(path).rate == pytest.approx(50.0)


@pytest.mark.parametrize("offset", [0.0, [0.0] * 29, None])
def test_an_offset_of_zero_is_one_and_is_not_the_default_pose(deployed, offset):
    """Unitree's runner adds no offset if it is null."""
    path = with_action(deployed(29, {"last_action": {}}), offset=offset)
    beside = path.with_name("deploy.yaml")
    values = json.loads(beside.read_text()) | {"default_joint_pos": [0.1] * 29}
    beside.write_text(json.dumps(values))
    contract = contract_of(path)
    assert (contract.default_pos, contract.action_offset) == ([0.1] * 29, [0.0] * 29)
    assert contract.targets(np.ones(29)) == pytest.approx(np.full(29, 0.25))


def test_targets_keep_the_limits_of_a_deploy_yaml(deployed):
    """Limits are those of targets, by joint of the policy, whose order is the reverse."""
    limits = [[-0.5, 0.1 + 0.01 * joint] for joint in range(29)]
    contract = contract_of(with_action(deployed(29, {"last_action": {}}), clip=limits))
    assert contract.targets(np.full(29, 100.0))[::-1] == pytest.approx([one[1] for one in limits])
    assert contract.targets(np.full(29, -100.0)) == pytest.approx(np.full(29, -0.5))


def test_metadata_that_is_nested_too_deeply_is_refused(policy):
    path = policy(only={"dof_names": "[" * 100_000})
    with pytest.raises(ConfigError):
        contract_of(path)


def test_histories_of_metadata_and_a_toml_file(policy, capsys):
    path = policy({"observation_history_lengths": "0,1,3,3,1,2.0"}, width=247)
    contract = contract_of(path)
    assert [term.history for term in contract.terms] == [1, 1, 3, 3, 1, 2]
    assert [term.size for term in contract.terms] == [58, 6, 9, 87, 29, 58]
    assert contract.history_start == "first step"
    path.with_suffix(".toml").write_text(
        'history_start = "zeros"\n[[terms]]\nname = "base_ang_vel"\nhistory = 82\n'
        '[[terms]]\nname = "command_ang_vel"\n'
    )
    contract = contract_of(path)
    assert [term.history for term in contract.terms] == [82, 1]
    assert contract.history_start == "zeros"
    assert main(["policy", str(path)]) == 0
    assert "steps before the first one: zeros" in " ".join(capsys.readouterr().out.split())
    term = '[[terms]]\nname = "base_ang_vel"\nhistory = '
    for told, values, named in (
        (term, ("0", "true", "1.5", "1000", '"2"', "[1]"), "history of base_ang_vel"),
        ("history_start = ", ('"ones"', "0", '["zeros"]'), "history_start"),
        ("history_by = ", ('"steps"', "true", '["step"]'), "history_by"),
        ("scale_first = ", ('"true"', "[true]"), "scale_first"),
        ("action = ", ('"action"', '["actions"]', "0"), "output"),
        ("clip = ", ('"x"', "[1.0, 2.0]", "nan"), "clip"),
        ("target_clip = ", ("1.0", "[1.0, 2.0]", "[[1.0]]"), "target_clip|facts"),
        (f"{term}2\nnewest_first = ", ("1", '"true"'), "newest_first"),
        (f"{term}2\nclip = ", ("1.0", "[1.0]", '["a", "b"]', "[[1.0, 2.0], 3.0]"), "limit|facts"),
    ):
        for wrong in values:
            path.with_suffix(".toml").write_text(f"{told}{wrong}\n")
            with pytest.raises(ConfigError, match=named):
                contract_of(path)


def test_histories_of_a_deploy_yaml(deployed):
    term = {"base_ang_vel": {"scale": [0.2] * 3, "clip": None, "history_length": 2}}
    contract = contract_of(deployed(6, {"use_gym_history": False, "scale_first": True} | term))
    assert [(one.size, one.history) for one in contract.terms] == [(6, 2)]


def observed(contract, rates):
    """Observations of gyroscopes whose three values are alike."""
    observer, zero = Observer(contract, G1.default()), np.zeros(29)
    states = [body(zero, zero, UPRIGHT, np.full(3, one)) for one in rates]
    return [observer.observe(one, states[0]) for one in states]


@pytest.mark.parametrize(
    ("by_step", "last"), [(False, [2, 2, 2, 3, 3, 3, -2, -3]), (True, [2, 2, 2, -2, 3, 3, 3, -3])]
)
def test_histories_are_by_term_or_by_step(deployed, by_step, last):
    """Of a gyroscope, and of the height of the gravity vector, which follows it here."""
    rate = {"base_ang_vel": {"history_length": 2}, "command_ang_vel": {"history_length": 2}}
    contract = contract_of(deployed(8, {"use_gym_history": by_step} | rate))
    *_, found = observed(contract, [1.0, 2.0, 3.0])
    assert found.tolist() == [max(0, one) for one in last]
    assert sum(term.size for term in contract.terms) == 8


def test_histories_of_a_toml_file_without_the_present_and_with_the_newest_step_first(policy):
    path = policy(width=12)
    path.with_suffix(".toml").write_text(
        'history_start = "zeros"\n[[terms]]\nname = "base_ang_vel"\n[[terms]]\nname = "past"\n'
        'formula = "base_ang_vel"\nhistory = 3\nbehind = 1\nnewest_first = true\n'
    )
    contract = contract_of(path)
    assert [term.name for term in contract.terms] == ["base_ang_vel", "base_ang_vel.2"]
    found = observed(contract, [1.0, 2.0, 3.0])
    assert [one[::3].tolist() for one in found] == [[1, 0, 0, 0], [2, 1, 0, 0], [3, 2, 1, 0]]
    copy = path.rename(path.with_name("copy.onnx"))
    copy.with_suffix(".toml").write_text(contract.toml())
    again = observed(contract_of(copy), [1.0, 2.0, 3.0])
    assert [one.tolist() for one in again] == [one.tolist() for one in found]


@pytest.mark.parametrize(("scale_first", "most"), [(False, 0.2), (True, 1.0)])
def test_limits_of_a_term_are_before_or_after_its_scale(deployed, scale_first, most):
    term = {"base_ang_vel": {"scale": [0.2] * 3, "clip": [-1.0, 1.0]}}
    contract = contract_of(deployed(3, {"scale_first": scale_first} | term))
    first, second = observed(contract, [0.5, -100.0])
    assert (first[0], second[0]) == (pytest.approx(0.1), pytest.approx(-most))


def test_metadata_of_mjlab_from_1_3_on(policy):
    """Lists by term, where a list in a list has semicolons, as its exporter writes them."""
    told = {
        "observation_terms_scale": "1.0,1.0,0.25;0.5;1.0,1.0,0.05,1.0",
        "observation_terms_clip": "-inf;inf,-inf;inf,-2.0;4.0,-inf;inf,-inf;inf,-inf;inf",
        "observation_terms_history_length": "0,0,2,0,0,0",
        "observation_terms_flatten_history_dim": "True,True,True,True,True,True",
    }
    terms = {term.name: term for term in contract_of(policy(told, width=157)).terms}
    rate = terms["base_ang_vel"]
    assert (rate.scale, rate.history, rate.size) == ([0.25, 0.5, 1.0], 2, 6)
    assert rate.clip == [[-0.5, -1.0, -2.0], [1.0, 2.0, 4.0]]
    assert (terms["joint_vel_rel"].scale, terms["joint_vel_rel"].clip) == ([0.05], None)


HOLOSOMA = {
    "dof_names": json.dumps(list(JOINT_NAMES)),
    "kp": json.dumps([40.0] * 29),
    "kd": json.dumps([2.0] * 29),
}
TRAINING = {
    "observation": {
        "clip_observations": 100.0,
        "groups": {
            "actor_obs": {
                "history_length": 2,
                "terms": {"dof_vel": {"scale": 0.05}, "actions": {"scale": 1.0}},
            },
        },
    },
    "robot": {
        "init_state": {"default_joint_angles": dict.fromkeys(JOINT_NAMES, 0.2)},
        "dof_effort_limit_list": [80.0] * 29,
        "control": {"action_scale": 0.25, "action_scales_by_effort_limit_over_p_gain": True},
    },
    "simulator": {"config": {"sim": {"fps": 200, "control_decimation": 4}}},
}


def test_metadata_of_holosoma(policy):
    told = HOLOSOMA | {"experiment_config": json.dumps(TRAINING)}
    contract = contract_of(policy(only=told, width=116))
    assert [term.named for term in contract.terms] == ["actions", "dof_vel"]
    assert contract.terms[1].scale == [0.05]
    assert [(term.size, term.history) for term in contract.terms] == [(58, 2)] * 2
    assert contract.history_start == "zeros"
    assert contract.action_scale == [0.25 * 80.0 / 40.0] * 29
    assert (contract.rate, contract.clip) == (50.0, 100.0)
    assert contract.default_pos == [0.2] * 29


def test_metadata_of_holosoma_0_0_3(policy):
    """Scales of the action by joint, and the terms in the order of a list."""
    layout = [
        {"group": "a", "name": "dof_vel", "dim": 29, "history_length": 1, "scale": 0.05},
        {"group": "b", "name": "actions", "dim": 29, "history_length": 3, "clip": [-1.0, 1.0]},
    ]
    told = HOLOSOMA | {
        "experiment_config": json.dumps(TRAINING),
        "action_scale": json.dumps([0.01 * gain for gain in BY_MOTOR]),
        "observation_layout": json.dumps(layout),
        "observation_clip": "50.0",
    }
    contract = contract_of(policy(only=told, width=116))
    assert [(one.named, one.size, one.scale) for one in contract.terms] == [
        ("dof_vel", 29, [0.05]),
        ("actions", 87, [1.0]),
    ]
    assert contract.terms[1].clip == [[-1.0], [1.0]]
    assert contract.action_scale == [0.01 * gain for gain in BY_MOTOR]
    assert (contract.clip, contract.history_start) == (50.0, "zeros")


def test_joints_without_an_action_are_held(policy):
    names = [name for name in JOINT_NAMES if "wrist" not in name]
    path = policy(
        {"joint_names": ",".join(names)} | dict.fromkeys(BY_JOINT), n_actions=23, width=49
    )
    path.with_suffix(".toml").write_text(
        "kp = 100.0\nkd = 2.0\nheld_kp = 40.0\nheld_kd = 1.0\ndefault_pos = 0.1\n"
        'held_pos = { "*" = 0.0, "left_wrist_roll_joint" = 0.5 }\naction_scale = 0.25\n'
        "action_clip = 2.0\naction_smoothing = 0.5\n"
        'terms = [{ name = "dof_pos" }, { name = "actions" }, { name = "base_ang_vel" }]\n'
    )
    contract = contract_of(path)
    assert [term.size for term in contract.terms] == [23, 23, 3]
    wrists = [i for i, name in enumerate(JOINT_NAMES) if "wrist" in name]
    targets = Observer(contract, G1.default()).act(np.full(23, 10.0))
    assert targets[wrists].tolist() == [0.5, 0, 0, 0, 0, 0]
    assert np.delete(targets, wrists) == pytest.approx(np.full(23, 0.1 + 0.25 * 2.0))
    gains = PolicyTargets(Config(stream={"policy": str(path)}), G1.default()).traits.gains
    assert (gains.kp[wrists].tolist(), gains.kd[wrists].tolist()) == ([40.0] * 6, [1.0] * 6)
    assert np.delete(gains.kp, wrists).tolist() == [100.0] * 23


def test_an_output_of_another_name_is_the_action(policy):
    path = policy()
    model = onnx.load(path)
    model.graph.output.insert(0, onnx.helper.make_tensor_value_info("obs", 1, [1, 154]))
    onnx.save(model, path)
    with pytest.raises(ConfigError, match="154 values"):
        contract_of(path)
    path.with_suffix(".toml").write_text('action = "actions"\n')
    contract = contract_of(path)
    assert contract.action == "actions"
    assert Network(path).act(np.ones(154), output="actions") == pytest.approx(np.full(29, 1.54))


NAMES, HISTORIES = "observation_names", "observation_history_lengths"
#: What is named, the metadata, and the shape of the network.
WRONG = [
    ("terms", {NAMES: None}, {}),
    ("motion_anchor_ori_b", {NAMES: "command,base_ang_vel,joint_pos,joint_vel,actions"}, {}),
    ("motion_anchor_pos_b and base_lin_vel", {}, {"width": 160}),
    ("height_scan", {NAMES: "command,height_scan"}, {}),
    ("hip, knee", {"joint_names": "hip,knee"}, {}),
    ("23 actions", {}, {"n_actions": 23}),
    ("1 joint", {"joint_names": ",".join(JOINT_NAMES[:1] * 29)}, {}),
    ("501", {"joint_stiffness": ",".join(["501"] * 29)}, {}),
    ("-1", {"joint_damping": ",".join(["-1"] * 29)}, {}),
    ("6", {"action_scale": "6"}, {}),
    ("left_knee_joint", {"default_joint_pos": ",".join(["0"] * 3 + ["-1"] + ["0"] * 25)}, {}),
    ("nan", {"action_scale": "nan"}, {}),
    ("head", {"anchor_body_name": "head"}, {}),
    ("28 values", {"joint_stiffness": ",".join(["40"] * 28)}, {}),
    ("motion 290", {HISTORIES: "5,1,1,1,1,1"}, {}),
    ("each term 5 times", {}, {"width": 5 * 154}),
    ("5,1", {HISTORIES: "5,1"}, {}),
    ("1.5", {HISTORIES: "1,1,1.5,1,1,1"}, {}),
    ("'x'", {HISTORIES: "1,1,x,1,1,1"}, {}),
    ("history: joint_pos 3", {HISTORIES: "1,1,1,5,1,1"}, {"width": 212}),
    ("1025 values", {}, {"width": 1025}),
    ("several times: motion, motion", {NAMES: "command,motion"}, {}),
    ("limit of", {"observation_terms_clip": "-1,-1,-1,-1,-1,-1"}, {}),
    ("my.own", {}, {"domain": "my.own"}),
    ("width", {}, {"declared": "any"}),
]


@pytest.mark.parametrize(("named", "told", "shape"), WRONG)
def test_a_wrong_contract_is_refused_and_names_what_is_wrong(policy, capsys, named, told, shape):
    assert main(["policy", str(policy(told, **shape))]) == 2
    said = capsys.readouterr().err
    assert said.startswith("error: ")
    assert named in said


@pytest.mark.parametrize(
    ("inputs", "outputs", "named"),
    [
        ([("obs", 200)], [("action", 23)], "23 actions"),
        ([("obs", 3000)], [("action", 29)], "3000 values"),
        ([("obs", 623)], [("policy", 623), ("action", 29)], 'action = "action"'),
        ([("obs", 655), ("hx", 128)], [("next_hx", 655), ("action", 29)], "hx (1, 128)"),
        ([("obs", 50)], [("token", 64)], "64 values"),
    ],
)
def test_what_cannot_be_played_is_said_before_facts_are_asked_for(
    tmp_path, capsys, inputs, outputs, named
):
    path = saved(tmp_path / "policy.onnx", inputs, outputs)
    assert main(["policy", str(path)]) == 2
    said = capsys.readouterr().err
    assert named in said
    assert "default_pos" not in said


@pytest.mark.parametrize("given", ["encoder", "decoder"])
def test_an_encoder_beside_a_decoder_is_said_to_be_one_of_two_networks(tmp_path, capsys, given):
    for name, (takes, gives) in {"encoder": (500, 64), "decoder": (200, 29)}.items():
        saved(tmp_path / f"g1_{name}.onnx", [("obs", takes)], [("out", gives)])
    assert main(["policy", str(tmp_path / f"g1_{given}.onnx")]) == 2
    said = capsys.readouterr().err
    assert "g1_encoder.onnx" in said
    assert "g1_decoder.onnx" in said
    assert "default_pos" not in said


def test_a_network_of_a_family_s_sizes_may_say_itself_what_it_takes(tmp_path):
    path = saved(tmp_path / "policy.onnx", [("obs", 380)], [("actions", 23)])
    model = onnx.load(path)
    numbers = {"default_joint_pos": "0.0", "joint_stiffness": "40.0", "joint_damping": "2.0"}
    lists = {name: ",".join([one] * 23) for name, one in numbers.items()}
    lists |= {"joint_names": ",".join(JOINT_NAMES[:23]), "observation_names": "joint_pos"}
    helper.set_model_props(model, lists | {"action_scale": "0.5"})
    onnx.save(model, path)
    terms = (f'[[terms]]\nname = "{k}"\nhistory = {n}\n' for k, n in TERMS_OF_380.items())
    path.with_suffix(".toml").write_text("held_kp = 40.0\nheld_kd = 1.0\n" + "".join(terms))
    assert contract_of(path).joint_names == [*JOINT_NAMES[:23]]


#: 16 steps of 23 joints and 4 of the gyroscope.
TERMS_OF_380 = {"joint_pos": 16, "base_ang_vel": 4}


#: Gains by motor, as in PBHC's config.yaml and in ASAP's sim2real/config.
LEG = {"pbhc": [100, 100, 100, 150, 40, 40], "asap": [100, 100, 100, 200, 20, 20]}
ARM = {"pbhc": [100, 100, 50, 50], "asap": [90, 60, 20, 60]}


@pytest.mark.parametrize("family", LEG)
def test_a_policy_of_pbhc_or_asap_is_of_the_family_that_is_named(tmp_path, family):
    """Its terms and their order are those of PBHC's published config.yaml, sorted by name."""
    path = saved(tmp_path / "policy.onnx", [("actor_obs", 380)], [("action", 23)])
    for line in ("", 'family = "another"', 'family = "twist2"'):
        path.with_suffix(".toml").write_text(line)
        with pytest.raises(ConfigError) as refused:
            contract_of(path)
        assert 'family = "pbhc" or family = "asap"' in refused.value.remedy
    path.with_suffix(".toml").write_text(f'family = "{family}"\naction_clip = 50.0')
    contract = contract_of(path)
    assert contract.kp == [*LEG[family], *LEG[family], 400, 400, 400, *ARM[family], *ARM[family]]
    present = {"actions": 23, "base_ang_vel": 3, "dof_pos": 23, "dof_vel": 23}
    later = {"projected_gravity": 3, "ref_motion_phase": 1}
    sizes = [*present.values(), *(4 * one for one in (present | later).values()), *later.values()]
    assert [term.size for term in contract.terms] == sizes
    assert (contract.reference, contract.action_clip, contract.clip) == ("a motion", 50.0, 100.0)
    held = set(JOINT_NAMES) - set(contract.joint_names)
    assert {name.split("_", 1)[1] for name in held} == {
        f"wrist_{axis}_joint" for axis in ("roll", "pitch", "yaw")
    }


@pytest.mark.parametrize("content", [b"", b"not a network", b"\x08\x08" * 100])
def test_what_is_no_network_is_refused(tmp_path, content):
    path = tmp_path / "policy.onnx"
    path.write_bytes(content)
    for wrong in (path, tmp_path, tmp_path / "nowhere.onnx"):
        with pytest.raises(ConfigError):
            Network(wrong)


def test_external_data_that_is_absent_is_refused(policy):
    path = policy()
    onnx.save(
        onnx.load(path), path, save_as_external_data=True, location="w.data", size_threshold=0
    )
    assert contract_of(path).rate == 50.0
    path.with_name("w.data").unlink()
    with pytest.raises(ConfigError, match=r"w\.data"):
        Network(path)


def test_a_network_that_fails_is_an_error_with_a_cause(policy, capsys):
    assert main(["policy", str(policy(batch=4)), "--motion", "demo"]) == 2
    assert capsys.readouterr().err.startswith("error: The network of ")


def test_a_scalar_beside_the_action_is_not_used(policy):
    path = policy()
    model = onnx.load(path)
    length = onnx.helper.make_tensor("length", onnx.TensorProto.FLOAT, [], [7.0])
    model.graph.initializer.append(length)
    model.graph.output.append(onnx.helper.make_tensor_value_info("length", 1, []))
    onnx.save(model, path)
    assert Network(path).act(np.ones(154)) == pytest.approx(np.full(29, 1.54))


def test_an_unknown_fact_of_a_term_is_refused(policy, capsys):
    path = policy()
    path.with_suffix(".toml").write_text('[[terms]]\nname = "command"\nscales = 0.1\n')
    assert main(["policy", str(path)]) == 2
    assert "scales" in capsys.readouterr().err


def test_json_has_the_contract(policy, capsys):
    assert main(["policy", str(policy()), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["joint_names"] == list(JOINT_NAMES)
    assert sum(term["size"] for term in told["terms"]) == 154


ANYTHING = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=5)),
    lambda inner: st.one_of(
        st.lists(inner, max_size=3), st.dictionaries(st.text(max_size=3), inner, max_size=3)
    ),
    max_leaves=6,
)


def places(values, before=()):
    """The keys that lead to every value of nested tables."""
    yield before
    if isinstance(values, dict):
        for key in values:
            yield from places(values[key], (*before, key))


def changed(values, keys, value):
    if not keys:
        return value
    return values | {keys[0]: changed(values[keys[0]], keys[1:], value)}


@settings(max_examples=80, derandomize=True, suppress_health_check=list(HealthCheck))
@given(st.data())
def test_a_training_configuration_may_hold_anything(policy, data):
    keys = data.draw(st.sampled_from(sorted(places(TRAINING))))
    training = changed(TRAINING, keys, data.draw(ANYTHING))
    told = HOLOSOMA | {"experiment_config": json.dumps(training)}
    name = data.draw(st.sampled_from(sorted(HOLOSOMA)))
    if data.draw(st.booleans()):
        told[name] = json.dumps(data.draw(ANYTHING))
    with suppress(ConfigError):
        contract = contract_of(policy(only=told, width=116))
        assert np.isfinite([contract.kp, contract.kd, contract.default_pos]).all()


@pytest.mark.parametrize("value", ["9" * 4000, "0x" + "f" * 4000, "[" + "9" * 4000 + "]"])
@pytest.mark.parametrize("key", ["step_dt", "stiffness", "history_length", "joint_ids_map"])
def test_a_huge_integer_in_a_deploy_yaml_is_refused(policy, key, value):
    path = policy(only={})
    observations = f"observations:\n  base_ang_vel:\n    history_length: {value}\n"
    text = observations if key == "history_length" else f"{key}: {value}\n"
    path.with_name("deploy.yaml").write_text(text)
    with pytest.raises(ConfigError):
        contract_of(path)


def test_huge_numbers_in_metadata_are_refused(policy):
    told = {"dof_names": json.dumps(list(JOINT_NAMES)), "kp": "[" + "9" * 4000 + "]"}
    path = policy(only=told)
    path.with_suffix(".toml").write_text(
        "rate = 50.0\ndefault_pos = [0.0]\naction_scale = [0.5]\n"
        'kd = [2.0]\nterms = [{ name = "base_ang_vel" }]\n'
    )
    with pytest.raises(ConfigError, match="kp"):
        contract_of(path)


def test_metadata_that_are_not_utf_8_are_refused(policy):
    path = policy({"anchor_body_name": "torso_link"})
    content = path.read_bytes()
    assert content.count(b"torso_link") == 1
    path.write_bytes(content.replace(b"torso_link", b"torso_\xff\xfe\xfd\xfc"))
    with pytest.raises(ConfigError, match="utf-8"):
        contract_of(path)


def test_a_network_that_never_ends_is_ended(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("g1stream.extras.policy.network._LONGEST", 1.0)
    path = tmp_path / "endless.onnx"
    model = endless()
    onnx.helper.set_model_props(model, METADATA)
    onnx.save(model, path)
    with pytest.raises(ConfigError, match="longer than 1 s"):
        Network(path).act(np.zeros(154))
    assert main(["policy", str(path), "--motion", "demo"]) == 2
    assert "longer than 1 s" in capsys.readouterr().err


@pytest.mark.parametrize("line", ['feedback = "h"', "terms = 3", "target_clip = [1.0, -1.0]"])
def test_a_fact_of_another_form_is_named(tmp_path, line):
    path = saved(tmp_path / "policy.onnx", [("obs", 154)], [("actions", 29)])
    path.with_suffix(".toml").write_text(line)
    with pytest.raises(ConfigError) as refused:
        contract_of(path)
    assert f", {line.partition(' ')[0]} is " in refused.value.cause
