"""Arms moved while the robot stands by itself: real processes, our bridge, and every way out."""

import json
import signal
import sys
from pathlib import Path

import numpy as np
import pytest

from g1stream.app.session import open_session
from g1stream.dds.messages import ARM_SDK
from g1stream.types import Phase

PATIENT = Path(__file__).parents[1] / "data" / "patient.toml"
STEP = 0.001  # of the weight between two commands at 500 Hz
LEGS, ARMS = slice(0, 12), slice(12, 29)

pytestmark = [
    pytest.mark.alone,  # a stream that lacks its CPU ends for that reason
    pytest.mark.dds,
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform != "linux", reason="the guard needs Linux"),
]


@pytest.fixture(scope="module")
def standing(module_domain_id, running):
    """A robot that stands by itself; its domain."""
    with running("sim", "--domain", module_domain_id, "--onboard", "ai", "--support", "follow"):
        yield module_domain_id


def arguments(domain_id, *more):
    play = ["stream", "demo", "--via", "arm_sdk", "--config", PATIENT, "--ramp", 2, "--json"]
    return (*play, "--domain", domain_id, *more)


def weight_of(received):
    return float(received.command.weight)


def test_a_stream_that_was_stopped_hands_the_arms_back(standing, until, running, tap):
    """With its guard; tests/faults has other ends."""
    with (
        tap(standing, ARM_SDK) as commands,
        tap(standing) as motors,
        running(*arguments(standing)) as stream,
    ):
        until(lambda: commands and weight_of(commands[-1]) > 0.5, "a weight")
        stream.send_signal(signal.SIGSTOP)
        until(lambda: len({one.writer for one in commands}) == 2, "the guard")
        stream.send_signal(signal.SIGCONT)
        until(lambda: weight_of(commands[-1]) == 0.0, "the arms to be handed back")
        said, _ = stream.communicate(timeout=30)
        at_rest = lambda: np.abs(motors[-1].command.q).max() < 1e-3  # noqa: E731
        until(at_rest, "the pose of the onboard controller")
    assert stream.returncode == 1
    assert "was stopped" in json.loads(said)["stream"]["reason"]
    weights = np.array([weight_of(one) for one in commands])
    assert weights[0] < 0.1
    assert weights.max() > 0.2
    writers = np.array([one.writer for one in commands])
    own, guard = weights[writers == writers[0]], weights[writers != writers[0]]
    before = int((writers != writers[0]).argmax())  # the guard takes over
    assert np.abs(np.diff([*own[:before], *guard])).max() < 1.001 * STEP
    assert set(own[before:]) <= set(guard)  # what goes on repeats, maybe late, the guard's
    assert weights[-1] == 0.0
    falling = commands[len(weights) - 1 - int(weights[::-1].argmax()) :]
    assert (falling[-1].stamp - falling[0].stamp) / 1e9 > 1.8 * weights.max()
    assert all((one.command.kp[ARMS] > 0.0).all() for one in commands)
    assert not any(one.command.kp[LEGS].any() for one in commands)
    assert max(np.ptp([one.command.q for one in falling[100:]], axis=0)) == 0.0


def test_a_session_has_what_the_arms_were_asked_and_did(standing, running, tmp_path):
    path = tmp_path / "arms.mcap"
    with running(*arguments(standing, "--duration", 1, "--record", path)) as stream:
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
