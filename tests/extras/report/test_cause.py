from itertools import count

import numpy as np
import pytest

from g1stream import Motion, open_session, rollout
from g1stream.config import Config
from g1stream.extras.report.cause import worst_error
from g1stream.robot.hulls import SelfCollision
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.model import G1
from g1stream.sim.lockstep import Lockstep
from g1stream.sim.robot import SimulatedRobot
from g1stream.sim.world import World

FPS = 60.0
ELBOW = JOINT_NAMES.index("left_elbow_joint")
ROLL = JOINT_NAMES.index("left_shoulder_roll_joint")
PITCH = JOINT_NAMES.index("left_shoulder_pitch_joint")
WRIST = JOINT_NAMES.index("left_wrist_yaw_joint")
RAMP = 2.0  # s: with less, the arm still sags when PLAY begins
BEGIN = 0.5  # s: until then the motion is at rest


def motion(joint, move):
    """A motion in which one joint moves as a function of the time since `BEGIN`."""
    times = np.arange(round(1.8 * FPS)) / FPS
    joint_pos = np.zeros((len(times), 29))
    joint_pos[:, ROLL] = 0.3  # away from the body
    joint_pos[:, ELBOW] = 0.8
    joint_pos[:, joint] += move((times - BEGIN).clip(0.0))
    return Motion(
        name="provoked",
        fps=FPS,
        joint_pos=joint_pos,
        root_pos=np.tile([0.0, 0.0, 0.8], (len(times), 1)),
        root_quat_wxyz=np.tile([1.0, 0.0, 0.0, 0.0], (len(times), 1)),
    )


def played(of, feedforward=None, stream=None, **settings):
    stream = {"ramp": RAMP, "hold": 0.0, "damp": 0.5, "joints": "left_arm", **(stream or {})}
    config = Config.model_validate({"stream": stream, **settings})
    return rollout(of, config=config, feedforward=feedforward)


def cause(session):
    return worst_error(session)


def swing(size, hertz):
    """A swing that begins and ends smoothly, once."""

    def move(t):
        inside = t * hertz < 1.0
        return size * inside * (0.5 - 0.5 * np.cos(2.0 * np.pi * hertz * t))

    return move


def test_links_inside_each_other_in_the_reference():
    into_torso = motion(ROLL, swing(-0.9, 0.5))
    found = cause(played(into_torso))
    assert (found.joint, found.cause) == ("left_shoulder_roll_joint", "self-collision")
    assert "left shoulder yaw" in found.why
    assert "torso" in found.why
    depth = float(found.why.partition(" mm")[0].rpartition(" ")[2])
    depths = SelfCollision(G1.default()).depths(into_torso.joint_pos)
    deepest = max(depths, key=lambda pair: depths[pair].max())
    assert deepest == ("torso_link", "left_shoulder_yaw_link")
    assert depth == pytest.approx(1e3 * depths[deepest].max(), abs=2.0)


def test_where_the_simulator_lets_them_be_that_is_no_cause():
    through = played(motion(ROLL, swing(-0.9, 0.5)), sim={"self_collision": False})
    assert cause(through).cause != "self-collision"
    assert abs(cause(through).error_rad) < 0.01


@pytest.fixture(scope="module")
def torque_limited():
    return played(motion(PITCH, swing(0.8, 4.0)))


def test_a_motor_at_its_limit(torque_limited):
    found = cause(torque_limited)
    assert (found.joint, found.cause) == ("left_shoulder_pitch_joint", "torque")
    assert "limit 25 N·m" in found.why


def raised(t):
    """To another position within a second, there to stay."""
    return -0.7 * (1.0 - np.cos(np.pi * np.minimum(t, 1.0)))


CLAMP = {"stream": {"beyond_limits": "clamp"}}


@pytest.mark.parametrize(
    ("joint", "move", "settings", "expected", "told"),
    [
        (ELBOW, swing(1.9, 0.5), CLAMP, "position limit", ""),
        (ELBOW, swing(1.2, 0.5), {"safety": {"position_margin": 0.25}}, "position limit", "0.25"),
        (WRIST, lambda t: 1.5 * np.sin(30.0 * t), CLAMP, "speed limit", ""),
        (PITCH, swing(0.6, 1.0), {"feedforward": "none"}, "lag", ""),
        (PITCH, raised, {"feedforward": "velocity"}, "no feed-forward", "kp 40"),
    ],
)
def test_targets_and_torques(joint, move, settings, expected, told):
    session = played(motion(joint, move), **settings)
    found = cause(session)
    assert (found.joint, found.cause) == (JOINT_NAMES[joint], expected)
    assert told in found.why
    assert session.command.missing("kd") == ["kd"]  # what is looked at is not read of the whole


def test_what_ramp_has_left():
    session = played(motion(PITCH, swing(0.1, 0.5)), "none", {"ramp": 1.0})
    found = cause(session)
    assert found.cause == "start"
    assert found.at_s < 0.2
    assert abs(found.error_rad) > 0.02
    assert found.why


def test_an_error_below_a_degree_is_no_fault():
    session = played(motion(PITCH, swing(0.1, 0.5)), stream={"ramp": 1.0})
    found = cause(session)
    assert 0.005 < abs(found.error_rad) < 0.0174
    assert (found.cause, found.why) == (None, "")
    assert str(found).endswith(f"deg at {found.at_s:.2f} s")


NOW = RAMP + BEGIN + 0.25


def stalled(sleep_until, stalls=(NOW * 1e9,)):
    """The loop gets no time for 60 ms once."""
    left = [*stalls]

    def late(self, deadline):
        if left and self.now() >= left[0]:
            deadline = round(left.pop() + 60e6)
        sleep_until(self, deadline)

    return late


def half_as_fast(step):
    calls = count()
    return lambda self, now: next(calls) % 2 or step(self, now)


def paused(step):
    return lambda self, now: 0 <= now - NOW * 1e9 < 8e6 or step(self, now)


def pushed(step):
    """Something pushes the arm with 8 N·m, which nothing in the session tells."""

    def push(self, motors, steps):
        dof = self.model.joint("left_shoulder_pitch_joint").dofadr[0]
        self.data.qfrc_applied[dof] = 8.0 * (NOW - 0.05 < self.data.time < NOW)
        step(self, motors, steps)

    return push


@pytest.mark.parametrize(
    ("owner", "name", "change", "expected", "told"),
    [
        (Lockstep, "sleep_until", stalled, "stall", "60 ms"),
        (SimulatedRobot, "step", half_as_fast, "simulator", "0.50"),
        (SimulatedRobot, "step", paused, "simulator", "ms behind"),
        (World, "step", pushed, None, ""),
    ],
)
def test_programs_that_are_held_up(monkeypatch, owner, name, change, expected, told):
    monkeypatch.setattr(owner, name, change(getattr(owner, name)))
    found = cause(played(motion(PITCH, swing(1.2, 1.2) if expected else swing(0.6, 0.5))))
    assert (found.joint, found.cause) == ("left_shoulder_pitch_joint", expected)
    assert told in found.why
    assert expected or (not found.why and abs(found.error_rad) > 0.05)


def test_a_file_and_a_selection_tell_the_same(torque_limited, tmp_path):
    saved = open_session(torque_limited.save(tmp_path / "torque.mcap"))
    assert cause(saved) == cause(torque_limited)
    part = torque_limited.sel(time=slice(0.5, 1.0))
    assert worst_error(part) == cause(torque_limited)


def test_no_error_has_no_cause(play, write_session):
    found = cause(open_session(write_session(*play(0.0))))
    assert abs(found.error_rad) < 1e-4
    assert (found.cause, found.why) == (None, "")
