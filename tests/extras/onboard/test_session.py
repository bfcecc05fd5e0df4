import json
import sys
from pathlib import Path

import numpy as np
import pytest

from g1stream.app.session import open_session
from g1stream.types import Phase

PATIENT = Path(__file__).parents[2] / "data" / "patient.toml"
LEGS, ARMS = slice(0, 12), slice(12, 29)

pytestmark = [
    pytest.mark.alone,  # a stream that lacks its CPU ends for that reason
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform != "linux", reason="the guard needs Linux"),
]


def test_a_session_has_what_the_arms_were_asked_and_did(domain_id, running, tmp_path):
    """On a robot that stands by itself; tests/faults has the ends of such a stream."""
    path, where = tmp_path / "arms.mcap", ("--domain", domain_id)
    play = ["stream", "demo", "--via", "arm_sdk", "--config", PATIENT, "--ramp", 2, "--duration", 1]
    with (
        running("sim", *where, "--onboard", "ai", "--support", "follow"),
        running(*play, *where, "--json", "--record", path) as stream,
    ):
        said, told = stream.communicate(timeout=60)
    assert stream.returncode == 0, told
    summary, session = json.loads(said), open_session(path)
    assert summary["stream"]["reason"] == ""
    assert len(summary["tracking"]["joints"]) == 17
    assert set(summary["tracking"]["limbs"]) == {"waist", "left_arm", "right_arm"}
    assert summary["stream"]["feedforward"] == "dynamics"  # without it, the waist alone has 0.1
    assert summary["tracking"]["all_joints"]["rmse_rad"] < 0.02
    assert session.topics["/arm_sdk"] == session.topics["/reference"]
    playing = session.reference.phase == Phase.PLAY
    reference = session.reference.q[playing][-1]
    # What the motors are told is what was asked, once the weight is 1; legs keep standing.
    command = session.command
    at = int(np.searchsorted(command.publish_time, session.reference.publish_time[playing][-1]))
    assert command.q[at, ARMS] == pytest.approx(reference[ARMS], abs=0.1)
    assert not command.q[:, LEGS].any()
    legs = session.measured.q[:, LEGS]
    assert np.abs(legs).max() < 0.1
    assert session.base is not None
    assert np.abs(session.base.position[:, 2] - 0.79).max() < 0.01
