import numpy as np
import pytest

from g1stream.config import RecordConfig
from g1stream.dds.messages import POLICY, Batch, PolicyStep
from g1stream.extras.policy.terms import schema
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.model import G1
from g1stream.session.format import CHANNELS
from g1stream.session.records import PolicyInfo
from g1stream.view.pipeline import MessagePipeline
from written_sessions import decoded

T0 = 1_700_000_000_000_000_000
TIMES = [T0, T0 + 20_000_000]
OBSERVED = np.array([0.1, -2.0, np.nan, 3.0, 1e-9, 7.0, 8.0], np.float32)


@pytest.fixture
def steps():
    step = PolicyStep()
    step.n_observation[()], step.observation[: len(OBSERVED)] = len(OBSERVED), OBSERVED
    step.action[:] = np.arange(29)
    step.step[()], step.repeated[()] = 7, 2
    step.state_published[()], step.inference_time[()] = T0 - 1_500_000, 4e-5
    return {POLICY.name: Batch([step.tobytes()] * 2, [t + 50_000 for t in TIMES], TIMES)}


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (
            ("projected_gravity", "base_lin_vel"),
            {"projected_gravity": OBSERVED[:3], "base_lin_vel": OBSERVED[5:]},
        ),
        (("projected_gravity", "base_lin_vel.2"), {"projected_gravity": OBSERVED[:3]}),
        (
            ("projected_gravity", "of another version"),
            {"projected_gravity": OBSERVED[:3], "values": OBSERVED},
        ),
        (("base_ang_vel", "repeated.2"), {"base_ang_vel": OBSERVED[:3], "values": OBSERVED}),
        (None, {"values": OBSERVED}),
    ],
)
def test_the_steps_of_a_policy_have_the_names_of_its_terms(steps, names, expected):
    sizes = [{"size": 3}, {"size": 4, "history": 2}]
    terms = [{"name": name, **size} for name, size in zip(names or (), sizes, strict=False)]
    info = PolicyInfo(contract={"terms": terms}) if names else None
    (messages,) = MessagePipeline(G1.default(), RecordConfig(), info).encode(steps)
    assert messages.topic == "/policy/terms"
    assert (messages.publish_times.tolist(), messages.log_times[0]) == (TIMES, T0 + 50_000)
    rows = [decoded(messages.topic, one) for one in messages.payloads]
    assert [row.delay_ms for row in rows] == [1.5, 21.5]
    assert (rows[0].step, rows[0].repeated, rows[0].inference_ms) == (7, 2, 0.04)
    fields = schema().decode().partition("PolicyObservation\n")[2].partition("=")[0].split()[1::2]
    assert {*fields} > {*expected}
    for name in fields:
        np.testing.assert_array_equal(getattr(rows[1].observation, name), expected.get(name, []))
    assert [getattr(rows[0].action, name) for name in JOINT_NAMES] == list(range(29))


def test_no_number_of_the_schema_is_too_large_for_a_double():
    assert "int64" not in CHANNELS["/policy/terms"].build_schema().decode()


def test_the_channels_raw_have_none(steps):
    assert MessagePipeline(G1.default(), RecordConfig(channels="raw")).encode(steps) == []
