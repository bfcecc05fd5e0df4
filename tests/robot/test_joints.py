"""Motor order, groups and gains against the compiled model and Unitree's figures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from g1stream.errors import ConfigError
from g1stream.robot.joints import (
    EXAMPLE_KD,
    EXAMPLE_KP,
    JOINT_GROUPS,
    JOINT_NAMES,
    N_JOINTS,
    JointSet,
    by_joint,
    matching_joints,
    select_joints,
)


def test_motor_order_is_the_order_of_joints_in_the_compiled_model(robot, compile_mujoco):
    model = compile_mujoco(robot.urdf)
    names = [model.joint(i).name for i in range(1, model.njnt)]  # 0 is the free root
    assert tuple(names) == JOINT_NAMES
    assert len(JOINT_NAMES) == N_JOINTS == 29


def test_groups_hold_each_joint_once_in_motor_order():
    assert [i for group in JOINT_GROUPS.values() for i in group] == list(range(N_JOINTS))
    assert {name: len(group) for name, group in JOINT_GROUPS.items()} == {
        "left_leg": 6,
        "right_leg": 6,
        "waist": 3,
        "left_arm": 7,
        "right_arm": 7,
    }
    for name, group in JOINT_GROUPS.items():
        side = name.split("_")[0]
        assert all(JOINT_NAMES[i].startswith(side) for i in group)


def test_example_gains_per_joint():
    stiffness = dict(zip(JOINT_NAMES, EXAMPLE_KP.tolist(), strict=True))
    assert stiffness["right_hip_yaw_joint"] == 60
    assert stiffness["left_knee_joint"] == 100
    assert stiffness["left_ankle_roll_joint"] == 40
    assert (stiffness["waist_yaw_joint"], stiffness["waist_pitch_joint"]) == (60, 40)
    assert stiffness["right_wrist_yaw_joint"] == 40
    assert EXAMPLE_KP.sum() == 2 * (3 * 60 + 100 + 2 * 40) + 140 + 14 * 40
    assert [n for n, kd in zip(JOINT_NAMES, EXAMPLE_KD, strict=True) if kd != 1] == [
        "left_knee_joint",
        "right_knee_joint",
    ]


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
        (" *_knee_joint , waist_yaw_joint", [3, 9, 12]),
        ("*_knee,waist_yaw", [3, 9, 12]),
        ("*", range(29)),
    ],
)
def test_joints_are_selected_by_limb_name_and_pattern(selection, joints):
    assert np.flatnonzero(select_joints(selection)).tolist() == list(joints)


@pytest.mark.parametrize("selection", ["", "arm", "arms,", "left_toe", "arms;waist"])
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


def test_an_unknown_joint_without_close_matches_has_a_short_remedy():
    with pytest.raises(ConfigError) as error:
        matching_joints("", "In joints")
    assert len(error.value.remedy) < 200
    assert all(limb in error.value.remedy for limb in (*JOINT_GROUPS, "arms", "legs", "*_knee"))


def test_the_page_that_the_remedy_names_lists_the_joints():
    page = (Path(__file__).parents[2] / "docs/glossary.md").read_text()
    missing = [name for name in JOINT_NAMES if f"`{name}`" not in page]
    assert all(name.startswith("right_") for name in missing)
    assert len(missing) == 13
