"""Iterative learning on a linear plant, on the simulated robot, and against an obstacle."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from g1stream.analysis.learning import Repetition, improve, learn, repeating
from g1stream.config import Config
from g1stream.errors import ConfigError, RecordingError
from g1stream.motion.correction import LARGEST_CORRECTION, Correction, grid
from g1stream.programs.rollout import rollout
from g1stream.session.motions import load_motion

LAFAN = Path(__file__).parents[2].parent / "shared" / "lafan1" / "joints_labeled.csv"
TIME = grid(0.0, 8.0)
SHAPE = (len(TIME), 29)
FREE = np.full(SHAPE, 10.0)
#: Error without correction: smooth, at most 0.05 rad, another phase for each joint.
DISTURBANCE = 0.05 * np.sin(2.0 * TIME[:, np.newaxis] + np.arange(29))
FIVE = slice(150, 300)
SHORT = {"ramp": 1.0, "hold": 0.1, "damp": 0.5}


def repetitions(follow, n, lower=-FREE, upper=FREE):
    """RMSE, correction and frozen of n repetitions; `follow(c)` is what a correction moves."""
    done, values, frozen, history = [], np.zeros(SHAPE), np.zeros(SHAPE, dtype=bool), ()
    for _ in range(n):
        error = DISTURBANCE - follow(values)
        rmse = float(np.sqrt(np.mean(error**2)))
        done.append(Repetition(values, error, rmse, frozen, np.ones(len(TIME)), history))
        values, frozen, history = improve(done, TIME, lower, upper)
    return done


def test_a_linear_plant_is_learned_in_two_repetitions():
    done = repetitions(lambda c: 0.7 * c, 4)
    rmse = [one.rmse for one in done]
    assert rmse[2] < rmse[0] / 2
    assert rmse == sorted(rmse, reverse=True)
    assert not done[-1].frozen.any()
    assert done[-1].history == pytest.approx(rmse[:-1])


def test_a_joint_that_does_not_respond_is_taken_back_and_stays():
    def follow(c):
        moved = 0.8 * c
        moved[FIVE, 5] = 0.0
        return moved

    done = repetitions(follow, 5)
    assert np.abs(done[1].values[FIVE, 5]).max() > 0.02
    for later in done[2:]:
        assert np.abs(later.values[160:290, 5]).max() < 1e-9
        assert later.frozen[160:290, 5].all()
        assert not np.delete(later.frozen, 5, axis=1).any()
    rest = np.delete(np.arange(29), 5)
    assert np.abs(done[-1].error[20:-20, rest]).max() < 0.5 * np.abs(DISTURBANCE).max()
    # Smooth where it is taken back: within one period of the grid it changes little.
    assert np.abs(np.diff(done[-1].values[20:-20, 5])).max() < 0.01


def test_it_continues_from_the_best_repetition():
    bad = repetitions(lambda c: -c, 2)  # a plant that does the opposite
    assert bad[1].rmse > bad[0].rmse
    values, _, _ = improve(bad, TIME, -FREE, FREE)
    start = improve(bad[:1], TIME, -FREE, FREE)[0]
    assert np.abs(values).max() < np.abs(start).max()


@pytest.mark.parametrize(("noise", "sessions"), [(0.02, 2), (0.02, 6), (0.1, 6)])
def test_the_share_that_repeats_is_known_from_what_differs(noise, sessions):
    """Signal 1, noise of n sessions: 1 / (1 + noise² / n) of the mean is what comes next."""
    time, signal, rng = grid(0.0, 60.0), 0.03, np.random.default_rng(1)
    frozen, weight = np.zeros((len(time), 29), dtype=bool), np.ones(len(time))
    every = [
        Repetition(c, signal + noise * rng.standard_normal(frozen.shape) - c, 0.0, frozen, weight)
        for c in (np.full(frozen.shape, 0.01 * n) for n in range(sessions))
    ]
    power = signal**2
    expected = power / (power + noise**2 / sessions)
    assert repeating(every, time).mean() == pytest.approx(expected, abs=0.05)
    assert repeating(every[:1], time).tolist() == np.ones(frozen.shape).tolist()


def test_noise_is_not_learned():
    rng, frozen, weight = np.random.default_rng(2), np.zeros(SHAPE, dtype=bool), np.ones(len(TIME))
    noise = [0.01 * rng.standard_normal(SHAPE) for _ in range(3)]
    every = [Repetition(np.zeros(SHAPE), one, 0.01, frozen, weight) for one in noise]
    mean = Repetition(np.zeros(SHAPE), sum(noise) / 3, 0.01, frozen, weight)
    learned, _, _ = improve([mean], TIME, -FREE, FREE, repeating(every, TIME))
    without, _, _ = improve([mean], TIME, -FREE, FREE)
    assert np.sqrt(np.mean(learned**2)) < np.sqrt(np.mean(without**2)) / 2


@pytest.mark.slow
def test_a_single_session_of_a_slow_simulator_is_refused(session, correction):
    slow = played()
    slow.metadata["stream"]["time_scale"] = 0.93
    with pytest.raises(RecordingError) as refused:
        learn(slow)
    assert "0.93" in refused.value.cause
    assert learn([slow, session]).values == pytest.approx(correction.values)


def test_what_a_stall_leaves_is_not_learned():
    free, stalled, weight = np.zeros(SHAPE), np.zeros(SHAPE), np.ones(len(TIME))
    frozen = np.zeros(SHAPE, dtype=bool)
    weight[FIVE], stalled[FIVE] = 0.0, 0.2
    undisturbed = [Repetition(free, DISTURBANCE, 0.03, frozen, np.ones(len(TIME)))]
    alone = improve(undisturbed, TIME, -FREE, FREE)[0]
    disturbed = Repetition(alone, 0.2 * DISTURBANCE + stalled, 0.2, frozen, weight, (0.03,))
    first = replace(undisturbed[0], error=DISTURBANCE + stalled, weight=weight)
    assert not improve([first], TIME, -FREE, FREE)[0][FIVE].any()
    after = improve([*undisturbed, disturbed], TIME, -FREE, FREE)[0]
    assert after[FIVE] == pytest.approx(0.8 * DISTURBANCE[FIVE] + 0.2 * alone[FIVE])


def test_it_stays_within_its_limit_and_those_of_the_joints():
    def no_motion(c):
        return 1e-1 * c

    for one in repetitions(no_motion, 6):
        assert np.abs(one.values).max() <= LARGEST_CORRECTION
    upper = np.full(SHAPE, 0.003)
    upper[:, 3] = -0.1  # the motion itself is beyond the limit
    for one in repetitions(no_motion, 3, upper=upper):
        assert one.values[:, 3].max() <= 0.0
        assert one.values.max() <= 0.003


def clip():
    if not LAFAN.exists():
        pytest.skip("../shared/lafan1 is not there")
    return load_motion(LAFAN).frames(1260, 1320)  # 42 to 44 s, where no limbs touch


@pytest.mark.slow
@pytest.mark.parametrize(
    ("motion", "support"),
    [(lambda: load_motion("demo"), "bolted"), (clip, "hanging")],
    ids=["demo-bolted", "lafan1-hanging"],
)
def test_the_simulated_robot_follows_twice_as_closely_after_three_repetitions(motion, support):
    sessions, correction = [], None
    motion, config = motion(), Config.model_validate({"stream": SHORT})
    for _ in range(4):
        options = {"support": support, "correction": correction, "config": config}
        sessions.append(rollout(motion, seconds=2.0, **options))
        correction = learn(sessions)
    rmse = [session.tracking().overall for session in sessions]
    assert rmse[3] < rmse[0] / 2
    assert max(rmse[1:]) < rmse[0]
    assert correction.history == pytest.approx(rmse)


def played(**options):
    settings = {"stream": SHORT | options.pop("stream", {}), **options.pop("config", {})}
    options = {"seconds": 2.0} | options
    return rollout("demo", config=Config.model_validate(settings), **options)


@pytest.fixture(scope="module")
def session():
    return played()


@pytest.fixture(scope="module")
def correction(session) -> Correction:
    return learn(session)


@pytest.mark.slow
def test_the_reference_stays_what_was_asked(session, correction):
    corrected = played(correction=correction)
    assert corrected.reference.q.tolist() == session.reference.q.tolist()
    play = corrected.reference.phase == 2
    time = corrected.reference.motion_time[play]
    assert corrected.command.q[play].tolist() != session.command.q[play].tolist()
    assert corrected.command.q[~play] == pytest.approx(session.command.q[~play], abs=1e-6)
    assert time[-1] <= 2.0
    assert corrected.tracking().overall < session.tracking().overall
    about = corrected.metadata["correction"]
    assert about["repetitions"] == 1
    assert about["largest_rad"] == correction.largest
    attached = Correction.from_bytes(corrected.attachments["correction.npz"], Path("session"))
    assert attached.values.tolist() == correction.values.tolist()
    assert learn(corrected).history == pytest.approx(
        [session.tracking().overall, corrected.tracking().overall]
    )


def test_sessions_with_the_same_correction_are_averaged(session, correction):
    again = learn([session, session])
    assert again.values == pytest.approx(correction.values)
    assert again.history == pytest.approx(correction.history)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"stream": {"rate": 250.0}}, "rate"),
        ({"support": "hanging"}, "support"),
        ({"feedforward": "velocity"}, "feed-forward"),
        ({"config": {"gains": {"kp": {"left_knee_joint": 90.0}}}}, "left_knee_joint"),
    ],
)
def test_other_conditions_are_refused(session, correction, options, named):
    with pytest.raises(ConfigError) as refused:
        played(correction=correction, **options)
    assert named in refused.value.cause
    with pytest.raises(RecordingError) as different:
        learn([session, played(**options)])
    assert named in different.value.cause


def test_another_motion_and_another_part_are_refused(session, correction):
    other = load_motion("demo").frames(0, 90)
    with pytest.raises(ConfigError) as refused:
        rollout(other, seconds=1.0, correction=correction)
    assert "motion" in refused.value.cause
    with pytest.raises(RecordingError) as different:
        learn([session, played(seconds=1.0)])
    assert "2.00 s" in different.value.cause


@pytest.mark.slow
def test_what_cannot_be_learned_from_is_refused(session):
    with pytest.raises(RecordingError):
        learn([])
    looped = played(stream={"loop": True})
    with pytest.raises(RecordingError) as refused:
        learn(looped)
    assert "loop" in refused.value.cause


def test_a_session_in_which_the_controller_moves_the_legs_is_refused():
    """No setting of --via arm_sdk names joints."""
    arms = played(joints="arms,waist", seconds=0.5)
    arms.metadata["config"]["stream"] |= {"joints": None, "via": "arm_sdk"}
    with pytest.raises(RecordingError) as refused:
        learn(arms)
    assert "some joints" in refused.value.cause


@pytest.mark.slow
def test_a_session_of_a_robot_with_fewer_joints_is_refused():
    with pytest.raises(RecordingError) as refused:
        learn(played(config={"robot": "g1_23dof"}, seconds=0.5))
    assert "some joints" in refused.value.cause
