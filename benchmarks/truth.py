"""Metrics of synthetic sessions beside what was put into them.

    python benchmarks/truth.py

Each session has one thing wrong, or all at once; the table says what was put in, what
`session.metrics()` gives back, and the tolerance within which the tests want it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from g1stream.analysis.metrics import Metrics
from g1stream.app.session import Session
from g1stream.robot.joints import JOINT_NAMES
from g1stream.session.source import MemorySource
from g1stream.testing import SyntheticSession

SECONDS = 10.0
KNEE = JOINT_NAMES.index("left_knee_joint")


class Row(NamedTuple):
    """A figure that was put in, and what came back."""

    session: str
    metric: str
    unit: str
    put_in: float
    found: float
    tolerance: float


def measured(made: SyntheticSession) -> Metrics:
    """The metrics of a session in memory."""
    source = MemorySource()
    made.write(source)
    return Session(source).metrics()


def rows() -> list[Row]:
    """Every figure that is known in advance."""
    return [*_delays(), *_bias_and_noise(), *_torque(), *_dropouts(), *_clocks()]


def _delays() -> list[Row]:
    found = []
    own = np.linspace(0.0, 0.028, 29)
    for name, made in (
        ("delay", SyntheticSession(SECONDS, delay=own)),
        (
            "delay, noise 5 mrad, gain 0.8",
            SyntheticSession(SECONDS, delay=own, noise=5e-3, gain=0.8),
        ),
    ):
        tracking = measured(made).tracking
        assert tracking
        for joint in ("left_hip_pitch_joint", "left_knee_joint", "right_wrist_yaw_joint"):
            delay = tracking.joints[joint].delay_s
            assert delay is not None
            at = float(own[JOINT_NAMES.index(joint)])
            tolerance = 0.05 if made.noise == 0.0 else 1.0
            found.append(Row(name, f"delay {joint}", "ms", at * 1e3, delay * 1e3, tolerance))
    return found


def _bias_and_noise() -> list[Row]:
    bias = np.linspace(-0.05, 0.05, 29)
    tracking = measured(SyntheticSession(SECONDS, bias=bias, noise=2e-3)).tracking
    assert tracking
    knee, every = tracking.joints["left_knee_joint"], tracking.all_joints
    expected = float(np.hypot(bias[KNEE], 2e-3))
    return [
        Row("bias, noise 2 mrad", "bias of the knee", "mrad", bias[KNEE] * 1e3,
            knee.bias_rad * 1e3, 0.15),
        Row("bias, noise 2 mrad", "RMSE of the knee", "mrad", expected * 1e3,
            knee.rmse_rad * 1e3, 0.15),
        Row("bias, noise 2 mrad", "bias of all joints", "mrad",
            float(np.sqrt(np.mean(bias**2))) * 1e3, every.bias_rad * 1e3, 0.05),
    ]  # fmt: skip


def _torque() -> list[Row]:
    made = SyntheticSession(SECONDS, torque=2.0)
    torque = measured(made).torque
    assert torque
    time = np.arange(0.0, SECONDS, 1e-3)
    work = float((2.0 * made.joints(time)[1] ** 2).sum() * 1e-3)
    return [Row("torque 2 dq", "work", "J", work, torque.work_j or 0.0, 0.002 * work)]


def _dropouts() -> list[Row]:
    made = SyntheticSession(SECONDS, delay=0.012, gaps=((2.0, 0.05), (5.0, 0.3)))
    found = measured(made)
    states = found.timing.topics["/lowstate"]
    assert found.tracking
    delay = found.tracking.all_joints.delay_s
    return [
        Row("dropouts of 0.05 and 0.3 s", "gaps", "", 2.0, states.gaps or 0, 0.0),
        Row("dropouts of 0.05 and 0.3 s", "longest", "ms", 302.0,
            (states.longest_interval_s or 0.0) * 1e3, 0.01),
        Row("dropouts of 0.05 and 0.3 s", "delay", "ms", 12.0, (delay or 0.0) * 1e3, 0.05),
    ]  # fmt: skip


def _clocks() -> list[Row]:
    found = measured(SyntheticSession(SECONDS, delay=0.012, clock_offset=-3.2, latency=1e-4))
    states = found.timing.topics["/lowstate"]
    assert found.tracking
    delay = found.tracking.all_joints.delay_s
    return [
        # In one direction the usual latency cannot be told from the offset.
        Row("robot's clock 3.2 s behind", "offset", "ms", 3200.0,
            (states.clock_offset_s or 0.0) * 1e3, 0.11),
        Row("robot's clock 3.2 s behind", "delay", "ms", 12.0, (delay or 0.0) * 1e3, 0.15),
        Row("robot's clock 3.2 s behind", "age of the state", "us", 1000.0,
            found.timing.state_age_us.p50 if found.timing.state_age_us else 0.0, 110.0),
    ]  # fmt: skip


def main() -> None:
    """Print the table."""
    print("| session | metric | unit | put in | found | tolerance |")
    print("|---|---|---|---|---|---|")
    for row in rows():
        print(
            f"| {row.session} | {row.metric} | {row.unit} | {row.put_in:.3f} | {row.found:.3f} | "
            f"{row.tolerance:g} |"
        )


if __name__ == "__main__":
    main()
