"""The metrics of a session: what `Session.metrics` gives, and a report or a comparison shows.

docs/metrics.md defines each of them, with its formula and where it comes from. Units are part of
the names; None stands for what is not known.
"""

from __future__ import annotations

from typing import Any, Final

from g1stream.session.records import Int, Percentiles, Record
from g1stream.session.summary import JointTracking, MessageStats

__all__ = [
    "NAMED_METRICS",
    "BodyMetrics",
    "EndEffectorMetrics",
    "JointMetrics",
    "JointTorque",
    "LimbMetrics",
    "LinkMetrics",
    "Metrics",
    "PelvisMetrics",
    "SuccessMetrics",
    "TerminationMetrics",
    "TimingMetrics",
    "TorqueMetrics",
    "TrackingMetrics",
]

NAMED_METRICS: Final = {
    "rmse": ("rad", "tracking.all_joints.rmse_rad"),
    "mae": ("rad", "tracking.all_joints.mae_rad"),
    "p99": ("rad", "tracking.all_joints.p99_rad"),
    "max": ("rad", "tracking.all_joints.max_abs_rad"),
    "bias": ("rad", "tracking.all_joints.bias_rad"),
    "delay": ("s", "tracking.all_joints.delay_s"),
    "velocity_rmse": ("rad/s", "tracking.all_joints.velocity_rmse_rad_s"),
    "mpjpe": ("mm", "body.pelvis_frame.mpjpe_mm"),
    "mpjpe_root": ("mm", "body.root_relative.mpjpe_mm"),
    "mpjpe_world": ("mm", "body.world.mpjpe_mm"),
    "torque_rms": ("N·m", "torque.rms_nm"),
    "torque_use": ("", "torque.use"),
    "saturated": ("", "torque.saturated"),
    "power": ("W", "torque.power_w"),
    "rate": ("Hz", "timing.rate_hz"),
    "lateness_p99": ("us", "timing.lateness_us.p99"),
    "state_age_p99": ("us", "timing.state_age_us.p99"),
}
"""Metrics of a whole session by the name that a condition has for them: unit and place."""


class JointMetrics(JointTracking):
    """How a joint followed its reference.

    Attributes:
        mae_rad: mean absolute error.
        p99_rad: 99th percentile of the absolute error.
        delay_s: by which the joint is behind the reference; None where too little moves.
        delay_ci95_s: half the width of the delay's 95 % interval of confidence.
        correlation: 0 to 1, of the measurement with the reference that much earlier.
        velocity_rmse_rad_s: of the joint's velocity; None where the robot reports none.
        acceleration_rmse_rad_s2: of the joint's acceleration, likewise.
    """

    mae_rad: float
    p99_rad: float
    delay_s: float | None = None
    delay_ci95_s: float | None = None
    correlation: float | None = None
    velocity_rmse_rad_s: float | None = None
    acceleration_rmse_rad_s2: float | None = None


class LimbMetrics(Record):
    """How the joints of a limb, or all joints, followed their reference together.

    Attributes:
        rmse_rad: root mean square error.
        mae_rad: mean absolute error.
        p99_rad: 99th percentile of the absolute error.
        max_abs_rad: the greatest error, either way.
        max_abs_at_s: when that was, since the motion's first frame.
        worst_joint: the joint of the greatest RMSE.
        bias_rad: root mean square of the joints' mean errors.
        delay_s, delay_ci95_s, correlation: as in `JointMetrics`, of the joints together.
        velocity_rmse_rad_s, acceleration_rmse_rad_s2: as in `JointMetrics`.
    """

    rmse_rad: float
    mae_rad: float
    p99_rad: float
    max_abs_rad: float
    max_abs_at_s: float
    worst_joint: str
    bias_rad: float
    delay_s: float | None = None
    delay_ci95_s: float | None = None
    correlation: float | None = None
    velocity_rmse_rad_s: float | None = None
    acceleration_rmse_rad_s2: float | None = None


class TrackingMetrics(Record):
    """How closely the joints followed the reference in PLAY.

    Attributes:
        compared_states: LowStates that were compared.
        excluded_states: LowStates in PLAY that lie in a gap of the reference, or are not finite.
        compared_s: length of PLAY, gaps left out.
        all_joints: together.
        limbs: by name.
        joints: by name.
    """

    compared_states: Int
    excluded_states: Int
    compared_s: float
    all_joints: LimbMetrics
    limbs: dict[str, LimbMetrics]
    joints: dict[str, JointMetrics]


class LinkMetrics(Record):
    """How far the links were from those of the reference.

    Attributes:
        mpjpe_mm: mean distance, over links and frames.
        p99_mm, max_mm: of the frames' means over all links.
        max_at_s: when the greatest was, since the motion's first frame.
        vel_mm_per_frame: mean error of the links' velocities; None with one frame.
        acc_mm_per_frame2: mean error of their accelerations; None with two frames.
        by_link_mm: mean distance of each link.
    """

    mpjpe_mm: float
    p99_mm: float
    max_mm: float
    max_at_s: float
    vel_mm_per_frame: float | None
    acc_mm_per_frame2: float | None
    by_link_mm: dict[str, float]


class EndEffectorMetrics(Record):
    """How far a hand or a foot was from the reference's, in the pelvis's frame."""

    position_mm: float
    max_position_mm: float
    orientation_rad: float


class PelvisMetrics(Record):
    """How far the pelvis was from the reference's, which it is at in the first frame.

    Attributes:
        orientation_rad, max_orientation_rad: mean and greatest angle between the two.
        yaw_rate_rad_s: mean absolute error of the angular velocity about the pelvis's z axis.
        position_mm, max_position_mm, final_position_mm: mean, greatest and last distance; None
            where the position was not measured.
        lin_vel_m_s: mean error of the velocity, likewise.
    """

    orientation_rad: float
    max_orientation_rad: float
    yaw_rate_rad_s: float
    position_mm: float | None = None
    max_position_mm: float | None = None
    final_position_mm: float | None = None
    lin_vel_m_s: float | None = None


class TerminationMetrics(Record):
    """What ends an episode of BeyondMimic, at its greatest.

    Attributes:
        max_pelvis_height_mm: error of the pelvis's height.
        max_gravity_difference: between the z components of the direction of gravity in the two
            pelvis frames, 0 to 2.
        max_end_effector_height_mm: error of the height of a hand or a foot.
    """

    max_pelvis_height_mm: float
    max_gravity_difference: float
    max_end_effector_height_mm: float


class BodyMetrics(Record):
    """How closely the robot followed in space, in PLAY, over its 30 bodies.

    Attributes:
        fps: of the frames.
        frames: how many.
        world: with the base, where its position was measured.
        root_relative: without the position of the base, with its attitude, where that was measured.
        pelvis_frame: without position and attitude of the base: what the joints alone make.
        end_effectors: hands and feet, by link.
        pelvis: None where its attitude was not measured.
        terminations: None where its position was not measured.
    """

    fps: float
    frames: Int
    world: LinkMetrics | None
    root_relative: LinkMetrics | None
    pelvis_frame: LinkMetrics
    end_effectors: dict[str, EndEffectorMetrics]
    pelvis: PelvisMetrics | None
    terminations: TerminationMetrics | None


class JointTorque(Record):
    """The torque of a joint, as its motor estimates it.

    Attributes:
        limit_nm: the smaller of the motor's limit and the URDF's effort.
        rms_nm: root mean square.
        p99_nm, max_nm: of its absolute value.
        use: p99_nm / limit_nm.
        saturated: share of the states at 99 % of the limit or more.
        commanded_rmse_nm: root mean square of commanded - estimated; None without commands.
        commanded_beyond: share of the states at which more than the limit was commanded.
        work_j: integral of |tau dq|; None where no velocities are reported.
        net_work_j: integral of tau dq: what the motor gave less what it took.
    """

    limit_nm: float
    rms_nm: float
    p99_nm: float
    max_nm: float
    use: float
    saturated: float
    commanded_rmse_nm: float | None = None
    commanded_beyond: float | None = None
    work_j: float | None = None
    net_work_j: float | None = None


class TorqueMetrics(Record):
    """The torque of the motors: in PLAY, or in the whole session where nothing was played.

    Attributes:
        in_play: whether it is that of PLAY.
        duration_s: gaps left out.
        rms_nm: of all joints together.
        use: the highest of a joint.
        most_used: that joint.
        saturated: share of the states at which at least one joint is at its limit.
        commanded_rmse_nm: of all joints together.
        work_j, net_work_j: of all joints together.
        power_w: work_j per second.
        joints: by name.
    """

    in_play: bool
    duration_s: float
    rms_nm: float
    use: float
    most_used: str
    saturated: float
    commanded_rmse_nm: float | None = None
    work_j: float | None = None
    net_work_j: float | None = None
    power_w: float | None = None
    joints: dict[str, JointTorque]


class TimingMetrics(Record):
    """How punctual everything was, in the whole session.

    Attributes:
        rate_hz, nominal_rate_hz: LowCmds per second, achieved and asked for.
        interval_us: between the publish times of LowCmds.
        lateness_us: of each write against its deadline; None where the stream told nothing.
        lateness_histogram_us: lower edge of a 1 us bin -> ticks, likewise.
        skipped_ticks: left out because they were a whole period late or more, likewise.
        state_age_us: of the newest LowState at each LowCmd, between the publish times.
        topics: rate, gaps and wire latency of each topic of DDS.
    """

    rate_hz: float | None = None
    nominal_rate_hz: float | None = None
    interval_us: Percentiles | None = None
    lateness_us: Percentiles | None = None
    lateness_histogram_us: dict[Int, Int] | None = None
    skipped_ticks: Int | None = None
    state_age_us: Percentiles | None = None
    topics: dict[str, MessageStats]


class SuccessMetrics(Record):
    """Whether the motion was played to its end and followed.

    Attributes:
        completed: whether the stream played what it was asked to; None where that is not known.
        progress: share of what was asked that was played, 0 to 1.
        links: what the links' distance is measured by: `world` where nothing holds the pelvis,
            `root_relative` or `pelvis_frame` else.
        max_link_error_mm: the greatest of the frames' mean distances of all links.
        success: completed, and that distance at most 500 mm in every frame, as PHC, OmniH2O and
            ASAP ask; None where one of the two is not known.
        success_strict: the same with BeyondMimic's limits on heights of pelvis, hands and feet
            (250 mm) and the pelvis's tilt (0.8) in place of that distance; None where something
            holds the pelvis.
    """

    completed: bool | None = None
    progress: float | None = None
    links: str | None = None
    max_link_error_mm: float | None = None
    success: bool | None = None
    success_strict: bool | None = None


class Metrics(Record):
    """How well a session went, in numbers.

    Attributes:
        success: whether the motion was played to its end and followed.
        tracking: of the joints.
        body: of the links, in space.
        torque: of the motors.
        timing: of commands, states and the wire.
        missing: which of these is None -> why, a sentence.
    """

    success: SuccessMetrics
    tracking: TrackingMetrics | None
    body: BodyMetrics | None
    torque: TorqueMetrics | None
    timing: TimingMetrics
    missing: dict[str, str]

    def named(self) -> dict[str, float | None]:
        """The `NAMED_METRICS` of this session; None where one is not known."""
        return {name: self._at(path) for name, (_, path) in NAMED_METRICS.items()}

    def _at(self, path: str) -> float | None:
        found: Any = self
        for name in path.split("."):
            found = found and getattr(found, name)
        value: float | None = found
        return value
