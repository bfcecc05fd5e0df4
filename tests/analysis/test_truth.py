"""The metrics give back what was put into synthetic sessions; benchmarks/truth.py has the cases."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from g1stream.robot.joints import JOINT_NAMES
from g1stream.testing import SyntheticSession

PATH = Path(__file__).parents[2] / "benchmarks" / "truth.py"


@pytest.fixture(scope="module")
def truth():
    spec = importlib.util.spec_from_file_location("truth", PATH)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
def test_what_was_put_in_comes_back(truth):
    rows = truth.rows()
    assert len(rows) == 16
    wrong = [row for row in rows if abs(row.found - row.put_in) > row.tolerance]
    assert wrong == []


def test_the_interval_of_confidence_holds_the_delay(truth):
    own = np.linspace(0.0, 0.028, 29)
    inside = []
    for seed in range(3):
        made = SyntheticSession(10.0, delay=own, noise=5e-3, seed=seed)
        joints = truth.measured(made).tracking.joints
        for name, delay in zip(JOINT_NAMES, own, strict=True):
            found = joints[name]
            assert 0 < found.delay_ci95_s < 0.002
            inside.append(abs(found.delay_s - delay) <= found.delay_ci95_s)
    assert np.mean(inside) > 0.85  # of 87, where 95 % are expected


def test_a_joint_that_rotates_moves_the_links_by_so_much(truth):
    bias = np.zeros(29)
    bias[JOINT_NAMES.index("left_ankle_roll_joint")] = 0.1
    body = truth.measured(SyntheticSession(2.0, bias=bias)).body
    # The last link of the leg turns in place: its origin does not move.
    assert body.pelvis_frame.mpjpe_mm == pytest.approx(0.0, abs=0.02)
    assert body.end_effectors["left_ankle_roll_link"].orientation_rad == pytest.approx(
        0.1, abs=1e-4
    )
    assert body.world.mpjpe_mm == pytest.approx(body.root_relative.mpjpe_mm)
    assert body.pelvis.orientation_rad == pytest.approx(0.0, abs=1e-6)


def test_a_velocity_error_is_that_of_the_joints(truth):
    made = SyntheticSession(10.0, gain=0.9)
    every = truth.measured(made).tracking.all_joints
    _, dq, ddq = made.joints(np.arange(0.0, 10.0, 0.02))
    assert every.velocity_rmse_rad_s == pytest.approx(0.1 * np.sqrt(np.mean(dq**2)), rel=0.01)
    assert every.acceleration_rmse_rad_s2 == pytest.approx(0.1 * np.sqrt(np.mean(ddq**2)), rel=0.02)
