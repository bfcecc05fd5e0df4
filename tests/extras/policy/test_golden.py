import json

import numpy as np
import onnx
import pytest
from scipy.spatial.transform import Rotation

from g1stream.cli.main import main
from g1stream.errors import ConfigError
from g1stream.extras.policy.observer import Observer
from g1stream.motion.motion import Motion
from known_policies import DANCE, POLICIES, needs_policies

N, FIRST = 40, 20
TERMS = {"motion_command": 58, "motion_anchor_ori_b": 6, "base_ang_vel": 3} | dict.fromkeys(
    ("joint_pos_rel", "joint_vel_rel", "last_action"), 29
)
STARTS = dict(zip(TERMS, np.cumsum([0, *TERMS.values()]), strict=False))
WEIGHTS = np.random.default_rng(7).normal(0.0, 0.05, (154, 29)).astype(np.float32)


def wxyz(turn):
    return turn.as_quat()[:, [3, 0, 1, 2]]


def torso(pelvis, joints):
    """The waist turns about z, then x, then y."""
    return pelvis * Rotation.from_euler("ZXY", joints[:, 12:15])


def columns(name):
    return slice(STARTS[name], STARTS[name] + TERMS[name])


@pytest.fixture
def motion(tmp_path):
    """Each joint swings at its own frequency, and the pelvis turns."""
    times = np.arange(100) / 50.0
    rates = 1.0 + np.arange(29) / 29.0
    pelvis = Rotation.from_euler("ZYX", np.outer(np.sin(times), [0.5, 0.2, -0.1]))
    made = Motion(
        name="swing",
        fps=50.0,
        joint_pos=0.2 * np.sin(np.outer(times, rates)),
        root_pos=np.tile([0.0, 0.0, 0.8], (100, 1)),
        root_quat_wxyz=wxyz(pelvis),
    )
    steps = slice(FIRST, FIRST + N)
    velocity = np.gradient(made.joint_pos, 0.02, axis=0)
    return made.save(tmp_path / "swing.npz"), made.joint_pos[steps], velocity[steps], pelvis[steps]


@pytest.fixture
def golden(motion):
    """A run as a training would log it: by the published formulas, in float32.

    It begins in the pose of the reference.
    """
    random, off = np.random.default_rng(8), np.arange(N)[:, None] > 0
    _, ref_pos, ref_vel, ref_pelvis = motion
    joint_pos = ref_pos + off * random.normal(0.0, 0.05, (N, 29))
    joint_vel = ref_vel + random.normal(0.0, 0.5, (N, 29))
    pelvis = ref_pelvis * Rotation.from_rotvec(off * random.normal(0.0, 0.05, (N, 3)))
    turning = random.normal(0.0, 1.0, (N, 3))
    relative = torso(pelvis, joint_pos).inv() * torso(ref_pelvis, ref_pos)
    obs, action = np.zeros((N, 154), np.float32), np.zeros((N, 29), np.float32)
    for i in range(N):
        obs[i, columns("motion_command")] = np.concatenate([ref_pos[i], ref_vel[i]])
        obs[i, columns("motion_anchor_ori_b")] = relative[i].as_matrix()[:, :2].ravel()
        obs[i, columns("base_ang_vel")] = turning[i]
        obs[i, columns("joint_pos_rel")] = joint_pos[i] - 0.1
        obs[i, columns("joint_vel_rel")] = joint_vel[i]
        obs[i, columns("last_action")] = action[i - 1] if i else 0.0
        action[i] = obs[i] @ WEIGHTS
    return {
        "joint_pos": joint_pos,
        "joint_vel": joint_vel,
        "root_pos_w": np.tile([0.0, 0.0, 0.8], (N, 1)),
        "root_quat_w": wxyz(pelvis),
        "root_lin_vel_b": np.zeros((N, 3)),
        "root_ang_vel_b": turning,
        "obs": obs,
        "action": action,
        "time_step": np.arange(FIRST, FIRST + N),
    }


@pytest.fixture
def compared(policy, motion, golden, tmp_path, capsys):
    """Compare with the run after some arrays were changed: the exit code and the result."""

    def compare(told=None, **changed):
        path = policy(told)
        model = onnx.load(path)
        model.graph.initializer[0].CopyFrom(onnx.numpy_helper.from_array(WEIGHTS, "weights"))
        onnx.save(model, path)
        np.savez(tmp_path / "run.npz", **{**golden, **changed})
        given = ["--golden", str(tmp_path / "run.npz"), "--motion", str(motion[0]), "--json"]
        code = main(["policy", str(path), *given])
        text = capsys.readouterr()
        return code, json.loads(text.out) if code < 2 else text.err

    return compare


def first(result):
    return next((name for name, one in result["terms"].items() if one["relation"]), None)


def test_a_run_of_the_same_contract_is_the_same(compared):
    code, result = compared()
    assert code == 0
    assert result["same"]
    assert not result["aligned"]
    assert (result["steps"], [*result["terms"]]) == (N, [*TERMS])


def changed(golden, name, how):
    obs = golden["obs"].copy()
    obs[:, columns(name)] = how(obs[:, columns(name)])
    return obs


ISAAC = [0, 6, 12, 1, 7, 13, 2, 8, 14, 3, 9, 15, 22, 4, 10, 16, 23, 5, 11, 17, 24, 18, 25]
ISAAC += [19, 26, 20, 27, 21, 28]


@pytest.mark.parametrize(
    ("name", "how", "said"),
    [
        ("base_ang_vel", lambda x: 0.25 * x, "ours x 0.25"),
        ("base_ang_vel", lambda x: -x, "ours x -1"),
        ("base_ang_vel", lambda x: x * [1, -1, 1], "ours x -1 in value 1"),
        ("joint_vel_rel", lambda x: 0.05 * x, "ours x 0.05"),
        ("joint_vel_rel", lambda x: x[:, ISAAC], "in Isaac's order"),
        ("joint_pos_rel", lambda x: 2.0 * x[:, ISAAC], "ours x 2, in Isaac's order"),
        ("joint_pos_rel", lambda x: x + 0.1, "ours plus a constant, 0.1"),
        ("base_ang_vel", lambda x: 0.0 * x, "zeros"),
        ("motion_command", lambda x: np.roll(x, 29, axis=1), "in another order"),
    ],
)
def test_the_first_term_that_differs_is_named_with_its_relation(compared, golden, name, how, said):
    code, result = compared(obs=changed(golden, name, how))
    assert code == 1
    assert first(result) == name
    assert result["terms"][name]["relation"].startswith(said)
    assert [one["relation"] for k, one in result["terms"].items() if k != name] == [""] * 5
    assert result["action"]["relation"]  # it is that of the true observation


def test_terms_that_are_exchanged_are_found_at_their_places(compared, golden):
    obs = golden["obs"].copy()
    obs[:, columns("joint_vel_rel")] = golden["obs"][:, columns("last_action")]
    obs[:, columns("last_action")] = golden["obs"][:, columns("joint_vel_rel")]
    code, result = compared(obs=obs)
    assert code == 1
    assert first(result) == "joint_vel_rel"
    assert (
        f"at values {STARTS['last_action']} to 153" in result["terms"]["joint_vel_rel"]["relation"]
    )


def test_another_anchor_is_named(compared):
    code, result = compared({"anchor_body_name": "pelvis"})
    assert code == 1
    assert result["terms"]["motion_anchor_ori_b"]["relation"] == "that of anchor torso_link"


def test_an_action_that_differs_is_named(compared, golden):
    code, result = compared(action=golden["action"] * 2.0)
    assert code == 1
    assert result["action"]["relation"] == "ours x 2"


def test_a_run_in_another_world_is_aligned(compared, golden):
    """The robot stands elsewhere, with another heading; the first step aligns them."""
    turned = Rotation.from_euler("z", 1.0) * Rotation.from_quat(
        golden["root_quat_w"][:, [1, 2, 3, 0]]
    )
    code, result = compared(root_quat_w=wxyz(turned), root_pos_w=golden["root_pos_w"] + 3.0)
    assert (code, result["aligned"], result["same"]) == (0, True, True)
    assert result["terms"]["motion_anchor_ori_b"]["max_abs"] < 1e-5


def test_a_change_that_cannot_be_tried_hides_no_difference(compared, golden, monkeypatch):
    def without_pelvis(contract, robot):
        if contract.anchor == "pelvis":
            raise ConfigError("The motion lacks the pelvis.", "")
        return Observer(contract, robot)

    monkeypatch.setattr("g1stream.extras.policy.golden.Observer", without_pelvis)
    code, result = compared(obs=changed(golden, "base_ang_vel", lambda x: 0.25 * x))
    assert code == 1
    assert result["terms"]["base_ang_vel"]["relation"] == "ours x 0.25"


def test_a_motion_with_one_sample_at_the_rate_of_the_policy_is_still(compared, golden, motion):
    path, joint_pos = motion[0], np.full((2, 29), 0.2)
    path.unlink()
    quat = np.tile([1.0, 0.0, 0.0, 0.0], (2, 1))
    Motion("still", 100.0, joint_pos, np.zeros((2, 3)), quat).save(path)
    still = np.repeat([[0.2, 0.0]], 29, axis=1)
    code, result = compared(obs=changed(golden, "motion_command", lambda x: 0.0 * x + still))
    assert code == 1
    assert result["terms"]["motion_command"]["relation"] == ""


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"obs": np.zeros((N, 150))}, "obs"),
        ({"joint_pos": np.zeros((N, 23))}, "joint_pos"),
        ({"action": np.full((N, 29), np.nan)}, "action"),
        ({"root_quat_w": np.array([{}] * N)}, "root_quat_w"),
        ({"root_quat_w": np.zeros((N, 4))}, "root_quat_w"),
    ],
)
def test_a_run_that_cannot_be_compared_is_refused(compared, changes, named):
    code, said = compared(**changes)
    assert code == 2
    assert named in said


def test_a_file_that_is_no_run_is_refused(policy, tmp_path, capsys):
    for content in (b"", b"PK\x03\x04 damaged"):
        (tmp_path / "run.npz").write_bytes(content)
        assert main(["policy", str(policy()), "--golden", str(tmp_path / "run.npz")]) == 2
    np.savez(tmp_path / "run.npz", obs=np.zeros((3, 154)))
    assert main(["policy", str(policy()), "--golden", str(tmp_path / "run.npz")]) == 2
    assert "lacks joint_pos" in capsys.readouterr().err


@needs_policies
@pytest.mark.parametrize(("factor", "code"), [(1.0, 0), (0.5, 1)])
def test_the_steps_of_a_published_policy(tmp_path, capsys, factor, code):
    """Its four steps were made by another program, which aligned at frame 200."""
    name = "unitree_dance1_subject2"
    steps = json.loads((POLICIES / "golden.json").read_text())[name]["steps"]
    names = {
        "joint_pos": "q",
        "joint_vel": "dq",
        "root_pos_w": "base_pos_w",
        "root_quat_w": "quat_wxyz",
        "root_lin_vel_b": "base_lin_vel_b",
        "root_ang_vel_b": "gyroscope",
        "obs": "observation",
        "action": "action",
        "time_step": "frame",
    }
    run = {ours: np.array([step[theirs] for step in steps]) for ours, theirs in names.items()}
    run["root_ang_vel_b"] *= factor
    np.savez(tmp_path / "run.npz", **run)
    given = ["--golden", str(tmp_path / "run.npz"), "--motion", str(DANCE), "--json"]
    assert main(["policy", str(POLICIES / name / "policy.onnx"), *given]) == code
    result = json.loads(capsys.readouterr().out)
    assert first(result) == (None if factor == 1.0 else "base_ang_vel")
    if factor == 0.5:
        assert result["terms"]["base_ang_vel"]["relation"] == "ours x 2"


@needs_policies
@pytest.mark.parametrize("name", ["no.npz", "."])
def test_a_file_that_cannot_be_read_is_refused(tmp_path, name):
    policy = str(POLICIES / "holosoma_dance1_subject2.onnx")
    assert main(["policy", policy, "--golden", str(tmp_path / name)]) == 2
