"""What differs between a simulator and a robot and is no setting: constants of the two profiles."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

if TYPE_CHECKING:
    from g1stream.types import Profile

__all__ = ["PROFILES", "ProfileConstants"]


class ProfileConstants(NamedTuple):
    """Thresholds and speeds of a profile; docs/safety.md explains what each of them stops.

    Attributes:
        max_crc_errors: maximum number of LowStates with a wrong CRC within a second.
        frozen_timeout: maximum time with the same tick or content in every LowState, s.
        frozen_motion: motion of the targets beyond which an unchanged LowState is frozen, rad.
        limit_excess: maximum distance of a measured joint beyond its limits, rad.
        max_leap: maximum measured step of a joint beyond what its velocity limit allows, rad.
        tracking_time: time over which the distance from the target is averaged, s.
        jam_time: time in which a joint must follow its target, s.
        jam_motion: motion of a target in that time beyond which its joint is checked, rad.
        torque_time: maximum time with more torque than `safety.max_torque`, s.
        max_casing_temperature, max_winding_temperature: of a motor, °C.
        min_voltage: supply voltage of a motor below which the stream stops after 0.5 s, V.
        motor_fault_time: maximum time that a motor may be off or report a fault, s.
        max_missed_ticks: maximum share of the ticks of a second that the loop misses.
        ramp_speed: maximum joint speed on the way to the first frame, rad/s.
        soft_start: duration of damping before the ramp, s.
        time_scale: simulated time per real time; None: measured from the joints.
    """

    max_crc_errors: int
    frozen_timeout: float
    frozen_motion: float
    limit_excess: float
    max_leap: float
    tracking_time: float
    jam_time: float
    jam_motion: float
    torque_time: float
    max_casing_temperature: float
    max_winding_temperature: float
    min_voltage: float
    motor_fault_time: float
    max_missed_ticks: float
    ramp_speed: float
    soft_start: float
    time_scale: float | None


#: A simulator shares its machine with other programs and stalls, and nothing breaks.
_SIMULATOR: Final = ProfileConstants(
    max_crc_errors=10,  # unitree_mujoco sends none; a wrong one here is a test
    frozen_timeout=1.0,  # a simulator that gets no CPU repeats its LowState and catches up later
    frozen_motion=0.01,  # a simulated robot at rest, without noise, repeats its LowState
    limit_excess=0.3,  # the limits of MuJoCo's joints are soft
    max_leap=0.5,  # after a stall, many steps arrive in one LowState
    tracking_time=2.0,
    jam_time=4.0,  # a slow simulator moves little in a second of real time
    jam_motion=1.0,
    torque_time=0.5,
    max_casing_temperature=85.0,  # the values that Unitree's motors report as overheating
    max_winding_temperature=120.0,
    min_voltage=40.0,  # of a battery of 13 cells, empty
    motor_fault_time=0.5,
    max_missed_ticks=0.5,
    ramp_speed=1.5,
    soft_start=0.0,
    time_scale=None,
)
#: A robot keeps its rate, has noise in every sensor, and breaks.
_ROBOT: Final = ProfileConstants(
    max_crc_errors=3,
    frozen_timeout=0.1,  # 50 LowStates
    frozen_motion=0.0,  # its sensors have noise, so that equal content is never real
    limit_excess=0.1,  # the play of an end stop
    max_leap=0.1,
    tracking_time=0.5,
    jam_time=0.5,
    jam_motion=0.3,
    torque_time=0.2,  # an impact is shorter
    max_casing_temperature=75.0,  # before the motors reduce their torque by themselves
    max_winding_temperature=100.0,
    min_voltage=42.0,
    motor_fault_time=0.1,
    max_missed_ticks=0.1,
    ramp_speed=0.5,  # slow enough to reach the remote
    soft_start=0.5,  # commands that only damp, before any that moves
    time_scale=1.0,
)

PROFILES: Final[dict[Profile, ProfileConstants]] = {
    "simulator": _SIMULATOR,
    "network-simulator": _SIMULATOR,
    "robot": _ROBOT,
}
