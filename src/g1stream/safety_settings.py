"""The settings that say when the robot is stopped: the table [safety]."""

from __future__ import annotations

from g1stream.settings import PLAY_FLAG, Table, setting

__all__ = ["SafetyConfig"]


class SafetyConfig(Table):
    """When to stop; docs/safety.md explains each threshold."""

    position_margin: float = setting(
        0.0, "how far targets are kept from the joint limits", "rad", ge=0.0, le=0.5
    )
    state_timeout: float | None = setting(
        None,
        "age of the last LowState that stops, and longest stall of the loop; 0.1 s if unset, and "
        "0.5 s on the loopback interface, where a simulator shares this machine",
        "s",
        example=0.1,
        gt=0.0,
        le=1.0,
    )
    max_crc_errors: int = setting(
        10, "LowStates with a wrong CRC within a second that do not stop", ge=0, le=1000
    )
    frozen_timeout: float = setting(
        1.0,
        "time of LowStates with the same tick, or the same content, that stops",
        "s",
        gt=0.0,
        le=2.0,
    )
    frozen_motion: float = setting(
        0.01,
        "how far the targets must have moved while the content is the same: without noise, a "
        "simulated robot at rest repeats itself; 0 on a robot, whose sensors have noise",
        "rad",
        ge=0.0,
        le=0.5,
    )
    limit_excess: float = setting(
        0.3,
        "how far a measured joint may be beyond its limits; at most 0.1 rad where the ramp starts",
        "rad",
        ge=0.0,
        le=1.0,
    )
    max_leap: float = setting(
        0.5,
        "measured step of a joint, beyond what its velocity limit allows, that stops",
        "rad",
        gt=0.0,
        le=1.0,
    )
    max_tilt: float = setting(1.0, "pelvis tilt that stops", "rad", gt=0.0, le=3.2)
    max_joint_speed: float = setting(
        60.0, "measured joint speed that stops", "rad/s", gt=0.0, le=1000.0
    )
    mode_machine: tuple[int, ...] = setting(
        (0, 5),
        "robots that may be commanded: 5 is the 29-joint G1, or in its place the kind that `robot` "
        "is (4 with 23 joints), 0 a simulator that does not say",
        min_length=1,
        strict=False,  # TOML and JSON know lists only
    )
    max_tracking_error: float = setting(
        1.0,
        "distance of a joint from its target, averaged over safety.tracking_time, that stops",
        "rad",
        gt=0.0,
        le=6.3,
    )
    tracking_time: float = setting(
        2.0, "over which the distance is averaged", "s", ge=0.02, le=10.0
    )
    jam_time: float = setting(
        4.0,
        "time in which a joint is looked at to find whether it follows its target",
        "s",
        ge=0.2,
        le=10.0,
    )
    jam_motion: float = setting(
        1.0,
        "motion of a target within safety.jam_time of which the joint must follow a tenth: a joint "
        "that does not is jammed, or its motor is off",
        "rad",
        gt=0.0,
        le=6.3,
    )
    max_torque: float = setting(
        1.5, "measured torque that stops, over the joint's own limit", gt=0.0, le=10.0
    )
    torque_time: float = setting(0.5, "time of such a torque that stops", "s", ge=0.0, le=10.0)
    max_casing_temperature: float = setting(
        85.0, "temperature of a motor's casing that stops", "°C", gt=0.0, le=200.0
    )
    max_winding_temperature: float = setting(
        120.0, "temperature of a motor's winding that stops", "°C", gt=0.0, le=200.0
    )
    min_voltage: float = setting(
        40.0,
        "supply of a motor that stops if lower for 0.5 s; 0 V counts as not measured",
        "V",
        ge=0.0,
        le=60.0,
    )
    motor_fault_time: float = setting(
        0.5,
        "time that a motor may be off (mode 0) or report a fault, once the robot is commanded",
        "s",
        ge=0.0,
        le=2.0,
    )
    motor_fault_mask: int = setting(
        0xFFFFFFFF, "bits of a motor's motorstate that are faults", ge=0, le=0xFFFFFFFF
    )
    max_missed_ticks: float = setting(
        0.5, "share of the ticks of a second that may be missed", ge=0.0, le=1.0
    )
    stop_buttons: tuple[str, ...] = setting(
        ("L2+B", "select"),
        "buttons of the robot's remote, each or each combination of which damps and ends",
        strict=False,
    )
    deadman: str | None = setting(
        None,
        "button of the robot's remote that has to be held: the robot moves only meanwhile, and is "
        "damped when it is released",
        flag=PLAY_FLAG,
        example="R1",
    )
    guard: bool = setting(
        True,
        "a guard process damps where the stream is killed, stopped or hangs; false is refused but "
        "on the loopback interface",
    )
    require_record: bool = setting(False, "damp and end when the recording fails", flag=PLAY_FLAG)
    urdf_limits: bool = setting(
        False,
        "take a URDF's joint limits as they are, also where they are wider than those of the "
        "robots in this package; dangerous",
        flag=(*PLAY_FLAG, "motion"),
    )
    allow_second_writer: bool = setting(
        False,
        "play although another publisher is on rt/lowcmd, or with stream.via = arm_sdk on "
        "rt/arm_sdk; dangerous",
        flag=PLAY_FLAG,
    )
