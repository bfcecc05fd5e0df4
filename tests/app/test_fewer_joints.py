"""G1s with fewer joints than 29: a motion streamed to our bridge over real DDS, and in lockstep."""

from __future__ import annotations

import json

import numpy as np
import pytest

from g1stream.app.rollout import rollout
from g1stream.app.session import open_session
from g1stream.config import Config
from g1stream.dds.messages import LOWCMD
from g1stream.robot.joints import JOINT_NAMES, JOINT_SETS
from g1stream.types import Phase

pytestmark = pytest.mark.slow


def test_a_motion_is_played_by_the_joints_that_there_are(domain_id, tmp_path, running, tap):
    kind = JOINT_SETS[1]
    path, present = tmp_path / "s.mcap", kind.present
    where = ("--domain", domain_id, "--robot", kind.name)
    play = ("--ramp", 0.5, "--start", 2.0, "--duration", 1.0, "--json", "--record", path)
    with (
        tap(domain_id, LOWCMD) as commands,
        running("sim", *where),
        running("stream", "demo", *where, *play) as stream,
    ):
        said, told = stream.communicate(timeout=60)
    assert stream.returncode == 0, told
    for command in (received.command for received in commands):
        assert int(command.mode_machine) == kind.mode_machine
        assert command.motor_mode.tolist() == present.astype(int).tolist()
        for values in (command.q, command.dq, command.tau, command.kp, command.kd):
            assert not values[~present].any()
    session, summary = open_session(path), json.loads(said)
    assert len(summary["absent"]) == (~present).sum()
    assert len(summary["tracking"]["joints"]) == present.sum()
    playing = session.reference.phase == Phase.PLAY
    assert np.ptp(session.reference.q[playing][:, present], axis=0).max() > 0.3
    assert summary["tracking"]["all_joints"]["rmse_rad"] < 0.1
    assert not session.measured.q[:, ~present].any()


@pytest.mark.parametrize("kind", JOINT_SETS[1:], ids=lambda kind: kind.name)
def test_no_other_joints_are_commanded_in_any_phase(kind):
    short = {"start": 2.0, "ramp": 0.5, "hold": 0.1, "damp": 0.5}
    config = Config.model_validate({"robot": kind.name, "stream": short})
    session = rollout("demo", seconds=0.5, config=config)
    assert session.summary().termination.reason == ""
    assert session.robot.joint_set.mode_machine == kind.mode_machine
    command = session.command.read()
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
