"""What is sent is within the limits, whatever is asked for and whatever a state claims."""

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st

from g1stream.config import SafetyConfig
from g1stream.control.command import Composer
from g1stream.control.gains import Gains
from g1stream.control.limits import MAX_STEP_TIME, CommandLimits
from g1stream.control.reading import STALE, Reading
from g1stream.control.receiver import Receiver
from g1stream.control.targets import Setpoint
from g1stream.dds.messages import LowCmd, LowState
from g1stream.robot.model import G1
from g1stream.types import Phase

ROBOT = G1.default()
#: Of float32 numbers and of the tolerance of a joint's speed.
ABOVE = 1.0 + 2e-3
TICKS = 30


def target(q, dq, tau):
    zeros = np.zeros(3)
    return Setpoint(0.0, q, dq, np.zeros(29), tau, zeros, np.array([1.0, 0, 0, 0]), *[zeros] * 4)


def some(rng, scale, share):
    """(29,) mostly small numbers, and some up to `scale`."""
    wild = rng.random(29) < share
    return np.where(wild, rng.uniform(-scale, scale, 29), rng.normal(0.0, 0.01, 29))


@given(
    seed=st.integers(0, 2**32 - 1),
    margin=st.floats(0.0, 0.05),
    stiffness=st.floats(0.0, 500.0),
    lies=st.floats(0.0, 0.5),
    leaps=st.floats(0.0, 0.5),
    outside=st.floats(0.0, 0.3),
)
@example(seed=1, margin=0.0, stiffness=40.0, lies=0.02, leaps=0.0, outside=0.0)
@example(seed=6098, margin=0.0, stiffness=1.0, lies=0.5, leaps=0.5, outside=0.25)
@settings(max_examples=60)
def test_every_command_is_within_the_limits(seed, margin, stiffness, lies, leaps, outside):
    rng = np.random.default_rng(seed)
    lower, upper, fastest = ROBOT.lower + margin, ROBOT.upper - margin, ROBOT.velocity * ABOVE
    effort = ROBOT.torque_limit
    kp, kd = np.full(29, stiffness), rng.uniform(0.0, 10.0, 29)
    limits = CommandLimits(ROBOT, SafetyConfig(position_margin=margin))
    composer = Composer(
        limits, Gains(kp, kd), Receiver(2_000_000, 0.5), ROBOT.present, ROBOT.present
    )
    begun = rng.uniform(ROBOT.lower - outside, ROBOT.upper + outside)
    composer.begin(begun.astype(np.float32), 5)
    before, sent = begun, LowCmd()
    for tick in range(TICKS):
        elapsed, age = rng.uniform(0.0005, 0.05), rng.uniform(0.0, 2 * STALE)
        ramped = min(1.0, tick / rng.integers(1, TICKS))
        asked = target(
            before + some(rng, 4.0, leaps), some(rng, 80.0, leaps), rng.uniform(-effort, effort)
        )
        state = LowState()
        state.q[:] = before + some(rng, 3.0, lies)
        state.dq[:] = some(rng, 100.0, lies)
        measured = Reading.from_low_state(state, 0)
        command, _ = composer.compose(
            asked,
            asked,
            Phase.PLAY,
            tick,
            elapsed=elapsed,
            progress=ramped,
            measured=measured,
            age=age,
        )
        limits.sent()
        sent.load(command)
        q, dq, tau = (values.astype(float) for values in (sent.q, sent.dq, sent.tau))
        low, high = np.minimum(lower, begun), np.maximum(upper, begun)
        if ramped == 1.0:  # the limits have moved in from where the joints were
            slack = np.maximum(0.0, np.maximum(lower - before, before - upper))
            low, high = lower - slack, upper + slack
        assert (q >= low - 1e-5).all()
        assert (q <= high + 1e-5).all()
        reach = fastest * min(elapsed, MAX_STEP_TIME)
        assert (np.abs(q - before) <= reach + 1e-5).all()
        assert (np.abs(dq) <= fastest).all()
        assert (np.abs(tau) <= effort * ABOVE).all()
        if age <= STALE:
            at = measured.q + age * measured.dq.astype(float)
            torque = kp * (q - at) + kd * (dq - measured.dq) + tau
            within = np.abs(torque) <= effort * ABOVE + 1e-2
            # Where that asks for more than a step or a speed, all of that has been used. A joint
            # beyond its limits is pulled to them, and not followed.
            used = (np.abs(q - before) >= 0.99 * reach) | (np.abs(dq) >= 0.99 * fastest)
            beyond = (at < lower) | (at > upper)
            assert (within | used | beyond).all()
        before = q
