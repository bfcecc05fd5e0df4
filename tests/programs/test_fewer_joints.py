"""G1s with fewer joints than 29: a motion streamed to our bridge, over real DDS."""

from __future__ import annotations

import json

import numpy as np
import pytest

from g1stream.dds.topics import LOWCMD
from g1stream.robot.joints import JOINT_SETS
from g1stream.session.session import open_session
from g1stream.types import Phase

PLAY = 2.0

pytestmark = [pytest.mark.dds, pytest.mark.slow]
fewer = pytest.mark.parametrize("kind", JOINT_SETS[1:], ids=lambda kind: kind.name)


@fewer
def test_a_motion_is_played_by_the_joints_that_there_are(kind, domain_id, tmp_path, running, tap):
    path, present = tmp_path / "s.mcap", kind.present
    where = ("--domain", domain_id, "--robot", kind.name)
    play = ("--ramp", 0.5, "--start", 2.0, "--duration", PLAY, "--json", "--record", path)
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
    assert summary["tracking"]["rmse_rad"] < 0.1
    assert not session.measured.q[:, ~present].any()


@fewer
def test_a_robot_of_another_kind_is_not_commanded(kind, domain_id, running, tap):
    with (
        tap(domain_id) as commands,
        running("sim", "--domain", domain_id, "--robot", kind.name),
        running("stream", "demo", "--domain", domain_id) as stream,
    ):
        said, _ = stream.communicate(timeout=60)
    assert stream.returncode == 1
    assert kind.name in said
    assert commands == []
