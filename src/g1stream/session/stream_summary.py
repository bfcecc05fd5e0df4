"""What the stream counted; it writes this into the metadata of the session file."""

from __future__ import annotations

from g1stream.realtime import Grant
from g1stream.session.records import Int, Percentiles, Record
from g1stream.types import FeedForwardKind, StreamSupport

__all__ = ["BalanceSummary", "FeedForwardChange", "Finding", "StreamSummary"]


class Finding(Record):
    """The result of a check: why no command was sent, or what the doctor says.

    Attributes:
        about: what was checked, in a word or two.
        cause: what was found.
        remedy: what to do about it; empty where there is nothing to do.
    """

    about: str
    cause: str
    remedy: str = ""


class FeedForwardChange(Record):
    """The feed-forward torque was switched off, or on again.

    Attributes:
        motion_time_s: when in the motion.
        kind: of feed-forward from then on.
        reason: why; empty where the reason to do without is gone.
    """

    motion_time_s: float
    kind: FeedForwardKind
    reason: str = ""


class BalanceSummary(Record):
    """How near a robot on its feet was to falling: the worst values of PLAY and HOLD.

    Attributes:
        capture_margin_m: from the capture point to the edge of the soles; negative outside.
        tilt_rad: of the pelvis against the reference.
        height_error_m: of the pelvis, above or below the reference.
        feet_error_m: of the one foot's place beside the other, while both stand: it slipped, or
            was put down elsewhere.
        carried: share of the weight on the feet; the rest is in the air, or hangs from a band.
        lifts: how often a foot was lifted.
        unsolved_ticks: without forces of the floor that keep the robot on its feet.
    """

    capture_margin_m: float
    tilt_rad: float
    height_error_m: float
    feet_error_m: float
    carried: float
    lifts: Int
    unsolved_ticks: Int


class StreamSummary(Record):
    """What the stream counted.

    Attributes:
        reason: why it ended early; empty when it ended as asked.
        start_s: where in the motion it was to begin.
        slowed: factor by which the motion was slowed to fit the joints' speeds; 1 where it was not.
        commands: LowCmds written.
        rate_hz, nominal_rate_hz: LowCmds per second, achieved and asked for.
        lateness_us: of each write against its deadline; a skipped tick has no write.
        skipped_ticks: left out because they were a whole period late or more.
        worst_work_us: longest time from a write to the end of the tick's computation.
        ramp_s: length of RAMP.
        ramp_speed_rad_s: highest speed of `ramp_joint`, the joint with the longest way, in it.
        delay_s: by which the motion ended later, because the loop stalled.
        clamped_ticks: joint -> ticks at which its target was held at a position limit, most first.
        speed_limited_ticks: joint -> ticks at which its target was held back to its highest speed.
        torque_limited_ticks: joint -> ticks at which its target was brought nearer to the measured
            position, because the servo would have asked for more torque than the motor has.
        saturated_ticks: joint -> ticks at which its feed-forward torque was held at its limit.
        feedforward: what commands carried beside the position when RAMP began.
        support: how the robot was taken to be held.
        preview_s: by which commands were ahead of the reference (`stream.preview`).
        feedforward_changes: when the torque was switched off and on again, in order.
        balance: of a robot on its feet.
        robot: name of the model that feed-forward torques were computed with.
        time_scale: median of simulated over real time, where it was measured.
        command_delay_s: longest age of the commands that the motors' torques followed, because
            they had waited in a queue; 0 where it was below 0.1 s, None where it is unknown.
        states_used: LowStates that were the newest at a tick.
        states_wrong_crc: LowStates that were dropped because of their CRC.
        states_received: all of them.
        states_lost: LowStates that did not arrive, by the ticks of those that did; None where the
            publisher is not our own bridge, whose ticks number its LowStates.
        dds_lost: LowStates that DDS itself reports as lost.
        tick_jumps: steps of LowState's tick that skipped at least one; of another publisher than
            our bridge no more than a hint, because unitree_mujoco's ticks jump without a loss.
        states_malformed: samples on the topic that were no LowState.
        state_restarts: how often the ticks of LowState began anew.
        commands_dropped: LowCmds that could not be written at once.
        realtime: what was asked of the system to be on time, and what it granted.
        findings: where no command was sent, what DDS shows of why, and what to do.
        lateness_histogram_us: lower edge of a 1 us bin -> ticks.
    """

    reason: str | None = None
    start_s: float | None = None
    slowed: float | None = None
    commands: Int | None = None
    rate_hz: float | None = None
    nominal_rate_hz: float | None = None
    lateness_us: Percentiles | None = None
    skipped_ticks: Int | None = None
    worst_work_us: float | None = None
    ramp_s: float | None = None
    ramp_speed_rad_s: float | None = None
    ramp_joint: str | None = None
    delay_s: float | None = None
    clamped_ticks: dict[str, Int] | None = None
    speed_limited_ticks: dict[str, Int] | None = None
    torque_limited_ticks: dict[str, Int] | None = None
    saturated_ticks: dict[str, Int] | None = None
    feedforward: FeedForwardKind | None = None
    support: StreamSupport | None = None
    preview_s: float | None = None
    feedforward_changes: list[FeedForwardChange] = []
    balance: BalanceSummary | None = None
    robot: str | None = None
    time_scale: float | None = None
    command_delay_s: float | None = None
    states_used: Int | None = None
    states_wrong_crc: Int | None = None
    states_received: Int | None = None
    states_lost: Int | None = None
    dds_lost: Int | None = None
    tick_jumps: Int | None = None
    states_malformed: Int | None = None
    state_restarts: Int | None = None
    commands_dropped: Int | None = None
    realtime: list[Grant] = []
    findings: list[Finding] = []
    lateness_histogram_us: dict[Int, Int] | None = None  # last, as it is long
