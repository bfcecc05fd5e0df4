from pathlib import Path

import numpy as np
import pytest

from g1stream.errors import ConfigError
from g1stream.robot.joints import (
    EXAMPLE_KD,
    EXAMPLE_KP,
    JOINT_NAMES,
    N_JOINTS,
    JointSet,
    by_joint,
    select_joints,
)


def test_motor_order_is_the_order_of_joints_in_the_compiled_model(robot, compile_mujoco):
    model = compile_mujoco(robot.urdf)
    names = [model.joint(i).name for i in range(1, model.njnt)]  # 0 is the free root
    assert tuple(names) == JOINT_NAMES
    assert len(JOINT_NAMES) == N_JOINTS == 29


def test_example_gains_per_joint():
    leg = [60, 60, 60, 100, 40, 40]
    assert EXAMPLE_KP.tolist() == [*leg, *leg, 60, 40, 40, *[40] * 14]
    assert {i: kd for i, kd in enumerate(EXAMPLE_KD) if kd != 1} == {3: 2, 9: 2}


def test_by_joint_sorts_and_leaves_out_zeros():
    ticks = [0] * N_JOINTS
    ticks[3], ticks[12] = 2, 7
    assert list(by_joint(ticks).items()) == [("waist_yaw_joint", 7), ("left_knee_joint", 2)]
    with pytest.raises(ValueError, match="shorter"):
        by_joint(ticks[:-1])


@pytest.mark.parametrize(
    ("selection", "joints"),
    [
        (None, range(29)),
        ("arms,waist", range(12, 29)),
        ("legs", range(12)),
        ("left_arm", range(15, 22)),
        ("right_leg", range(6, 12)),
        (" *_knee_joint , waist_yaw_joint", [3, 9, 12]),
        ("*_knee,waist_yaw", [3, 9, 12]),
        ("*", range(29)),
    ],
)
def test_joints_are_selected_by_limb_name_and_pattern(selection, joints):
    assert np.flatnonzero(select_joints(selection)).tolist() == list(joints)


@pytest.mark.parametrize("selection", ["", "arms,", "left_toe"])
def test_a_selection_that_matches_no_joint_is_refused(selection):
    with pytest.raises(ConfigError, match=r"stream\.joints"):
        select_joints(selection)


WRISTS = [f"{side}_wrist_{part}_joint" for side in ("left", "right") for part in ("pitch", "yaw")]
LOCKED = ["waist_roll_joint", "waist_pitch_joint"]


@pytest.mark.parametrize(
    ("mode_machine", "name", "absent"),
    [
        (5, "g1_29dof_rev_1_0", []),
        (4, "g1_23dof", [*LOCKED, *WRISTS]),
        (6, "g1_29dof_lock_waist", LOCKED),
        (9, "g1_dual_arm", list(JOINT_NAMES[:15])),
    ],
)
def test_the_kinds_of_g1_by_mode_machine(mode_machine, name, absent):
    kind = JointSet.of_mode(mode_machine)
    assert kind is not None
    assert kind.name == name
    assert [JOINT_NAMES[i] for i in kind.absent] == absent
    assert kind.present.sum() == 29 - len(absent)
    assert kind.allowed((0, 5)) == (0, mode_machine)


@pytest.mark.parametrize("mode_machine", [0, 1, 2, 3, 7, 255])
def test_other_modes_are_of_no_known_kind(mode_machine):
    assert JointSet.of_mode(mode_machine) is None


def test_the_page_that_the_remedy_names_lists_the_joints():
    page = (Path(__file__).parents[2] / "docs/glossary.md").read_text()
    missing = [name for name in JOINT_NAMES if f"`{name}`" not in page]
    assert all(name.startswith("right_") for name in missing)
    assert len(missing) == 13
