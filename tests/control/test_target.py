"""A target's row of values and the names of its parts."""

import numpy as np
import pytest

from g1stream.control.target import Target
from g1stream.dds.messages import Reference


@pytest.fixture
def target():
    return Target(1.5, np.arange(135.0))


def test_the_published_parts_are_those_of_a_reference_in_its_order(target):
    reference = Reference()
    reference.target[:] = target.published
    names = ("q", "dq", "ddq", "tau", "root_pos", "root_quat_wxyz", "root_lin_vel", "root_ang_vel")
    for name in names:
        assert getattr(reference, name).tolist() == getattr(target, name).tolist(), name


def test_the_parts_cover_the_row_without_overlap(target):
    rest = np.concatenate([target.root_lin_acc, target.root_ang_acc])
    assert np.concatenate([target.published, rest]).tolist() == target.values.tolist()


def test_a_row_is_a_sample_of_the_motion(trajectory):
    point = trajectory.sample(0.13)
    target = Target.of(0.13, point)
    assert target.motion_time == 0.13
    for part, of_point in (
        (target.q, point.joint_pos),
        (target.dq, point.joint_vel),
        (target.ddq, point.joint_acc),
        (target.root_pos, point.root_pos),
        (target.root_quat_wxyz, point.root_quat_wxyz),
        (target.root_lin_vel, point.root_lin_vel),
        (target.root_ang_vel, point.root_ang_vel),
        (target.root_lin_acc, point.root_lin_acc),
        (target.root_ang_acc, point.root_ang_acc),
    ):
        assert part.tolist() == of_point.tolist()
    assert not target.tau.any()
    with pytest.raises(ValueError, match="read-only"):
        target.q[:] = 0.0


def test_other_values_leave_the_original_alone(target):
    other = target.but(q=np.zeros(29), tau=2.0)
    assert not other.q.any()
    assert other.tau.tolist() == [2.0] * 29
    assert other.motion_time == 1.5
    assert target.values.tolist() == np.arange(135.0).tolist()
    with pytest.raises(ValueError, match="shape"):
        target.but(q=np.zeros(28))
