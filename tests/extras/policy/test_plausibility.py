import numpy as np
import pytest

from g1stream.cli.main import main
from g1stream.errors import ConfigError
from g1stream.extras.policy.contract import read_contract
from g1stream.extras.policy.network import Network
from g1stream.extras.policy.plausibility import ORDERS
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.model import G1
from known_policies import POLICIES, needs_policies

#: Of whole_body_tracking, by part of a joint's name: the first that fits.
CLASSES = {
    ("hip_pitch", "hip_yaw", "waist_yaw"): (40.179, 2.558, 0.5475),
    ("hip_roll", "knee"): (99.098, 6.309, 0.3507),
    ("ankle", "waist"): (28.501, 1.814, 0.4386),
    ("wrist_pitch", "wrist_yaw"): (16.778, 1.068, 0.0745),
    ("shoulder", "elbow", "wrist"): (14.251, 0.907, 0.4386),
}
KEYS = "joint_stiffness", "joint_damping", "action_scale"
#: Breadth first, as Isaac Lab numbers the joints of a G1.
ISAAC = """left_hip_pitch right_hip_pitch waist_yaw left_hip_roll right_hip_roll waist_roll
left_hip_yaw right_hip_yaw waist_pitch left_knee right_knee left_shoulder_pitch right_shoulder_pitch
left_ankle_pitch right_ankle_pitch left_shoulder_roll right_shoulder_roll left_ankle_roll
right_ankle_roll left_shoulder_yaw right_shoulder_yaw left_elbow right_elbow left_wrist_roll
right_wrist_roll left_wrist_pitch right_wrist_pitch left_wrist_yaw right_wrist_yaw"""
ISAAC_NAMES = [f"{name}_joint" for name in ISAAC.split()]


def of_class(name):
    return next(one for parts, one in CLASSES.items() if any(part in name for part in parts))


def told(values):
    return ",".join(f"{one:g}" for one in values)


def written(names):
    """Gains and scales in the order of some joints."""
    columns = zip(*map(of_class, names), strict=True)
    return dict(zip(KEYS, map(list, columns), strict=True))


def as_metadata(values):
    return {key: told(one) for key, one in values.items()}


def test_the_orders_are_of_the_29_joints():
    assert list(ORDERS["Isaac's order"]) == ISAAC_NAMES
    assert all(sorted(order) == sorted(JOINT_NAMES) for order in ORDERS.values())


@pytest.mark.parametrize("key", KEYS)
@pytest.mark.parametrize("names", [JOINT_NAMES, ISAAC_NAMES])
def test_values_of_the_motor_classes_pass_and_sorted_ones_do_not(policy, names, key):
    values = {"joint_names": ",".join(names)} | as_metadata(written(names))
    contract = read_contract(Network(policy(values)))
    assert contract.doubts(G1.default()) == []
    values[key] = told(sorted(written(names)[key]))
    with pytest.raises(ConfigError, match="in another order"):
        read_contract(Network(policy(values)))


@pytest.mark.parametrize(
    ("names", "other", "order"),
    [
        (JOINT_NAMES, ISAAC_NAMES, "Isaac's order"),
        (ISAAC_NAMES, JOINT_NAMES, "motor order"),
        (JOINT_NAMES, sorted(JOINT_NAMES), "alphabetical order"),
    ],
)
def test_values_in_another_order_than_the_joints_name_it(policy, capsys, names, other, order):
    values = {"joint_names": ",".join(names)} | as_metadata(written(other))
    assert main(["policy", str(policy(values))]) == 2
    assert f"are in {order}," in capsys.readouterr().err


def test_a_default_pose_may_be_uneven_but_not_in_another_order(policy, capsys):
    knees = [0.1 * name.endswith("knee_joint") for name in JOINT_NAMES]
    boxer = [*knees[:9], 0.4, *knees[10:]]
    assert main(["policy", str(policy({"default_joint_pos": told(boxer)}))]) == 0
    assert "left_knee" in capsys.readouterr().err
    bent = {"hip_pitch": -0.2, "knee": 0.4, "ankle_pitch": -0.2}
    isaac = [sum(bent[one] for one in bent if one in name) for name in ISAAC_NAMES]
    assert main(["policy", str(policy({"default_joint_pos": told(isaac)}))]) == 2
    assert "Isaac" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("joint", "value", "doubted"),
    [
        ("left_hip_yaw", 0.2, True),  # the place of waist_yaw in Isaac's order, which has no pair
        ("left_hip_yaw", 1e-9, False),
        ("left_knee", 0.1005, True),
        ("right_elbow", 0.0009, False),
    ],
)
def test_a_pose_shows_another_order_by_several_pairs_only(policy, joint, value, doubted):
    names = list(JOINT_NAMES)
    pose = [0.0] * 29
    pose[names.index(f"{joint}_joint")] = value
    values = as_metadata(written(names)) | {"default_joint_pos": ",".join(map(repr, pose))}
    doubts = read_contract(Network(policy(values))).doubts(G1.default())
    assert [joint in one for one in doubts] == [True] * doubted


@pytest.mark.parametrize(
    ("kp", "kd", "passes"),
    [(1.0, -0.0, False), (1.0, 1.0, False), (40.0, 0.0, False), (40.0, 0.1, True)],
)
def test_a_servo_moves_and_damps_its_joint(policy, kp, kd, passes):
    values = {"joint_stiffness": told([kp] * 29), "joint_damping": told([kd] * 29)}
    assert main(["policy", str(policy(values))]) == (0 if passes else 2)


@pytest.mark.parametrize(
    ("joint", "column", "value"),
    [("wrist_roll", 0, 99.0), ("wrist_yaw", 2, 4.9), ("elbow", 2, 0.01)],
)
def test_what_is_unusual_is_a_warning(policy, joint, column, value):
    values = written(JOINT_NAMES)
    for at, name in enumerate(JOINT_NAMES):
        if joint in name:
            values[KEYS[column]][at] = value
    (doubt,) = read_contract(Network(policy(as_metadata(values)))).doubts(G1.default())
    assert joint in doubt


@needs_policies
@pytest.mark.parametrize(
    "name",
    [
        "beyondmimic_29dof.onnx",
        "holosoma_dance1_subject2.onnx",
        "unitree_dance1_subject2/policy.onnx",
        "unitree_velocity/policy.onnx",
    ],
)
def test_policies_of_others_are_plausible(name):
    contract = read_contract(Network(POLICIES / name))
    assert contract.doubts(G1.default()) == []
    assert np.mean(contract.kp) > 20.0
