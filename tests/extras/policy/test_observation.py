import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from g1stream.errors import ConfigError
from g1stream.extras.policy.contract import read_contract
from g1stream.extras.policy.held_motion import check_motion, held_frame
from g1stream.extras.policy.network import Network
from g1stream.extras.policy.observation import body
from g1stream.extras.policy.observer import Observer, anchor_poses, pelvis_poses
from g1stream.motion.readers import load_motion
from g1stream.robot.model import G1
from known_policies import DANCE, POLICIES, needs_policies

pytestmark = needs_policies
BENT = {"*": 0.0, "*_hip_pitch_*": -0.312, "*_knee_*": 0.669, "*_ankle_pitch_*": -0.363} | {
    "*_shoulder_pitch_*": 0.2,
    "left_shoulder_roll_*": 0.2,
    "right_shoulder_roll_*": -0.2,
    "*_elbow_*": 0.6,
}
HIP_PITCH_AND_YAW = ("*_hip_pitch_*", "*_hip_yaw_*", "waist_yaw_*")
KNEE = ("*_hip_roll_*", "*_knee_*")
ANKLE = ("*_ankle_*", "waist_roll_*", "waist_pitch_*")
WRIST = ("*_wrist_pitch_*", "*_wrist_yaw_*")


def by_class(arm, *classes):
    groups = HIP_PITCH_AND_YAW, KNEE, ANKLE, WRIST
    return {"*": arm} | {
        name: value for names, value in zip(groups, classes, strict=True) for name in names
    }


SCALE = by_class(0.4386, 0.5475, 0.3507, 0.4386, 0.0745)
STANCE = "base_lin_vel base_ang_vel projected_gravity velocity_commands joint_pos joint_vel actions"
LOCOMOTION = "actions base_ang_vel command_ang_vel command_lin_vel cos_phase dof_pos dof_vel"
#: What the files do not say.
TOLD: dict[str, dict[str, object]] = {
    "holosoma_locomotion.onnx": {
        "rate": 50.0,
        "default_pos": BENT,
        "action_scale": {"*": 0.25},
        "terms": [
            {"name": name, "scale": {"base_ang_vel": 0.25, "dof_vel": 0.05}.get(name, 1.0)}
            for name in f"{LOCOMOTION} projected_gravity sin_phase".split()
        ],
    },
    "stance_29dof.onnx": {
        "rate": 50.0,
        "default_pos": BENT,
        "action_scale": SCALE,
        "kp": by_class(14.251, 40.179, 99.098, 28.501, 16.778),
        "kd": by_class(0.907, 2.558, 6.309, 1.814, 1.068),
        "terms": [{"name": name} for name in STANCE.split()],
    },
}


def toml(value):
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{json.dumps(k)} = {toml(one)}' for k, one in value.items())} }}"
    if isinstance(value, list):
        return f"[{', '.join(map(toml, value))}]"
    return json.dumps(value)


def contract_of(name, directory):
    """The network and contract of a policy, with what its file does not say beside it."""
    path = POLICIES / name
    if path.is_dir():
        path /= "policy.onnx"
    elif name in TOLD:
        facts = dict(TOLD[name])
        if name.startswith("stance"):
            isaac = Network(POLICIES / "beyondmimic_29dof.onnx").metadata["joint_names"]
            facts["joint_names"] = isaac.split(",")
        copy = directory / name
        copy.symlink_to(path)
        lines = (f"{key} = {toml(value)}" for key, value in facts.items())
        copy.with_suffix(".toml").write_text("\n".join(lines))
        path = copy
    network = Network(path)
    return network, read_contract(network)


def references(contract, network, robot):
    """The reference of a frame: of the motion in the network, or of the dance at 50 fps."""
    if contract.reference == "in the policy":

        def held(frame):
            q, dq, *anchor = held_frame(network, contract, frame)
            (pos,), (quat,) = pelvis_poses(contract.anchor, robot, q[None], *anchor)
            return body(q, dq, quat, np.zeros(3), pos)

        return held
    dance = load_motion(DANCE)
    times = np.arange(int(dance.duration * 50) + 1) * dance.fps / 50.0
    joints = np.stack(
        [np.interp(times, np.arange(dance.n_frames), one) for one in dance.joint_pos.T], axis=1
    )
    velocity = np.gradient(joints, 0.02, axis=0)
    turns = Rotation.from_quat(dance.root_quat_wxyz[:, [1, 2, 3, 0]])
    quats = Slerp(np.arange(dance.n_frames), turns)(times).as_quat()[:, [3, 0, 1, 2]]
    return lambda frame: body(joints[frame], velocity[frame], quats[frame], np.zeros(3))


GOLDEN = json.loads((POLICIES / "golden.json").read_text()) if POLICIES.is_dir() else {}


@pytest.mark.parametrize("name", GOLDEN)
def test_each_policy_observes_and_does_what_it_did_elsewhere(name, tmp_path):
    network, contract = contract_of(name, tmp_path)
    robot, golden = G1.default(), GOLDEN[name]
    reference = None
    if contract.reference != "none":
        reference = references(contract, network, robot)
    observer = Observer(contract, robot)
    for number, step in enumerate(golden["steps"]):
        arrays = {key: np.array(value) for key, value in step.items() if key != "frame"}
        quat, pos = arrays["quat_wxyz"], arrays["base_pos_w"]
        # The position that is given is that of the anchor.
        offset, _ = anchor_poses(contract.anchor, robot, arrays["q"][None], np.zeros(3), quat)
        lin_vel = Rotation.from_quat(quat, scalar_first=True).apply(arrays["base_lin_vel_b"])
        moves = arrays["gyroscope"], pos - offset[0], lin_vel
        state = body(arrays["q"], arrays["dq"], quat, *moves)
        frame = reference(step["frame"]) if reference else state
        if reference and not number:
            observer.begin(state, frame)
            observer.observe(state, reference(step["frame"] - contract.lag))
        observer.last_action = arrays["last_action"]
        observation = observer.observe(state, frame)
        start = 0
        for term in contract.terms:
            part = slice(start, start := start + term.size)
            assert observation[part] == pytest.approx(arrays["observation"][part], abs=1e-5), term
        action = network.act(observation, step["frame"] or 0)
        assert action == pytest.approx(arrays["action"], abs=1e-4)
        targets = observer.act(action)
        assert targets == pytest.approx(arrays["target_q"], abs=1e-3)  # scales have 4 digits


@pytest.fixture(scope="module")
def dance():
    return load_motion(DANCE)


def in_isaac_order(contract):
    network = Network(POLICIES / "beyondmimic_29dof.onnx")
    return contract.model_copy(update={"joint_names": network.metadata["joint_names"].split(",")})


def test_another_motion_than_that_in_the_policy_is_refused(tmp_path, dance):
    network, contract = contract_of("holosoma_dance1_subject2.onnx", tmp_path)
    check_motion(contract, network, dance)
    for one, motion in ((contract, load_motion("demo")), (in_isaac_order(contract), dance)):
        with pytest.raises(ConfigError, match="another motion"):
            check_motion(one, network, motion)


def test_a_policy_that_tracks_no_motion_is_refused_for_one(tmp_path):
    network, contract = contract_of("unitree_velocity", tmp_path)
    with pytest.raises(ConfigError, match="tracks no motion"):
        check_motion(contract, network, load_motion("demo"))
