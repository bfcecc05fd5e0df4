import pytest

from g1stream.app.rollout import rollout
from g1stream.config import Config
from g1stream.robot.joints import JOINT_NAMES, JOINT_SETS

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("kind", JOINT_SETS[1:], ids=lambda kind: kind.name)
def test_no_other_joints_are_commanded_in_any_phase(kind):
    short = {"start": 2.0, "ramp": 0.5, "hold": 0.1, "damp": 0.5}
    config = Config.model_validate({"robot": kind.name, "stream": short})
    session = rollout("demo", seconds=0.5, config=config)
    assert session.summary().termination.reason == ""
    assert session.robot.joint_set.mode_machine == kind.mode_machine
    assert len(session.summary().absent) == (~kind.present).sum()
    command = session.command.read()
    assert (command.mode_machine == kind.mode_machine).all()
    assert (command.mode == kind.present).all()
    for name in ("q", "dq", "tau", "kp", "kd"):
        assert not getattr(command, name)[:, ~kind.present].any()
    assert not session.measured.q[:, ~kind.present].any()
    assert session.tracking().overall < 0.1
    present = [name for name, there in zip(JOINT_NAMES, kind.present, strict=True) if there]
    assert list(session.summary().tracking.joints) == present


def test_a_robot_of_another_kind_is_not_commanded(domain_id, running, tap):
    kind = JOINT_SETS[1]
    with (
        tap(domain_id) as commands,
        running("sim", "--domain", domain_id, "--robot", kind.name),
        running("stream", "demo", "--domain", domain_id) as stream,
    ):
        said, _ = stream.communicate(timeout=60)
    assert stream.returncode == 1
    assert kind.name in said
    assert commands == []
