import numpy as np
import pytest

from g1stream.extras.fit.regression import AXES, LINKS, Movement, Regression, names_of
from g1stream.robot.dynamics import BaseMotion, InverseDynamics
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS
from g1stream.robot.model import G1

PERIOD = 0.004
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])
ADDED = [*(("mass", link) for link in LINKS), *((axis, "left_elbow_link") for axis in AXES)]
TEXT = """
[damping]
"*" = 0.13
left_knee_joint = 0.3
[friction]
arms = 0.35
[armature]
left_knee_joint = 0.04
[mass]
torso_link = 1.2
right_ankle_roll_link = -0.2
[com]
left_elbow_link = [0.02, 0.0, -0.01]
"""


def sines(seconds):
    time = np.arange(0.0, seconds, PERIOD)[:, np.newaxis]
    joints = np.arange(N_JOINTS)
    q, dq, ddq = np.zeros((3, len(time), N_JOINTS))
    for amplitude, hertz in ((0.15, 0.4), (0.08, 1.1), (0.03, 2.1)):
        omega = 2.0 * np.pi * hertz * (1.0 + 0.02 * joints)
        angle = omega * time + joints * (1.0 + hertz)
        q += amplitude * np.sin(angle)
        dq += amplitude * omega * np.cos(angle)
        ddq -= amplitude * omega**2 * np.sin(angle)
    return q + 0.3 * (np.arange(N_JOINTS) % 7 == 3), dq, ddq


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    path = tmp_path_factory.mktemp("params") / "g1.toml"
    path.write_text(TEXT)
    return G1.load(params=path)


@pytest.fixture(scope="module")
def estimated(robot):
    q, dq, ddq = sines(8.0)
    dynamics, base = InverseDynamics(robot), BaseMotion(UPRIGHT, np.zeros(3))
    tau = [dynamics.solve("bolted", *row, base).tau for row in zip(q, dq, ddq, strict=True)]
    imu = np.tile([*UPRIGHT, *np.zeros(5), 9.81], (len(q), 1))
    windows = [slice(0, 1000), slice(1000, len(q))]
    # Commands without feedback that act 1 ms later than the torque says.
    late = np.stack(tau) + 1e-3 * np.gradient(tau, PERIOD, axis=0)
    movement = Movement(q, late, np.stack(tau), imu, PERIOD, windows, "bolted")
    scale = np.stack([np.ones(N_JOINTS), np.full(N_JOINTS, 1e-4)])
    found = Regression(G1.default(), ADDED).estimate([movement], scale)
    return dict(zip(names_of(ADDED), found.values, strict=True))


@pytest.mark.parametrize("kind", ["damping", "friction", "armature"])
def test_motors(robot, estimated, kind):
    truth = getattr(robot.parameters, kind)
    found = np.array([estimated[kind, name] for name in JOINT_NAMES])
    # The low-pass leaves next to nothing of the kinks of dry friction.
    assert found == pytest.approx(truth, rel=0.06, abs=0.004 if kind != "armature" else 1.5e-3)


def test_links(estimated):
    masses = {link: estimated["mass", link] for link in LINKS}
    truth = {"torso_link": 1.2, "right_ankle_roll_link": -0.2}
    for link, mass in masses.items():
        assert mass == pytest.approx(truth.get(link, 0.0), abs=0.05), link
    shift = [estimated[axis, "left_elbow_link"] for axis in AXES]
    assert shift == pytest.approx([0.02, 0.0, -0.01], abs=6e-3)
    assert estimated["command_delay", ""] == pytest.approx(1e-3, abs=2e-4)
