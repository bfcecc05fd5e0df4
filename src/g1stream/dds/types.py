"""The types of the robot's topics as cyclonedds classes; a test compares them with idl/.

They provide the type names and type information of topics, and the fixed layouts are derived from
them. Samples are not instances of them, see `g1stream.dds.endpoints`. If cyclonedds cannot be
imported, plain classes provide the layouts, so that files can be read.
"""

from typing import Any, Final

try:
    from cyclonedds.idl import annotations, make_idl_struct, types
except Exception:  # not installed, or its library cannot be loaded
    from g1stream.dds.no_cyclone import annotations, make_idl_struct, types

__all__ = [
    "IMUState_",
    "Log_",
    "LowCmd_",
    "LowState_",
    "MotorCmd_",
    "MotorState_",
    "Policy_",
    "Reference_",
    "SportModeState_",
]

# From cyclonedds 11 on, `types.uint8` is XTypes' UINT8, which 0.10.2 does not know; every SDK
# process on the topic then crashes with a segmentation fault. There, IDL's octet is `types.byte`.
# 0.10.2 does not have this name, and its `types.uint8` is the octet.
octet: Final = types.byte if hasattr(types, "byte") else types.uint8

int16, int32 = types.int16, types.int32
uint32, uint64 = types.uint32, types.uint64
float32, float64 = types.float32, types.float64
array = types.array


def idl_struct(typename: str, /, **fields: Any) -> Any:
    """Make a final, sequentially numbered IDL struct, as the SDK declares its structs."""
    cls = make_idl_struct(typename.rsplit(".", maxsplit=1)[-1], typename, fields)
    return annotations.final(annotations.autoid("sequential")(cls))


def _each(element: Any, names: str) -> dict[str, Any]:
    """Consecutive fields of the same type."""
    return dict.fromkeys(names.split(), element)


def _imu(typename: str, temperature: Any) -> Any:
    """Unitree's IMU state; the types of its temperature differ between Unitree's two packages."""
    vectors = _each(array[float32, 3], "gyroscope accelerometer rpy")
    return idl_struct(typename, quaternion=array[float32, 4], **vectors, temperature=temperature)


MotorCmd_ = idl_struct(
    "unitree_hg.msg.dds_.MotorCmd_",
    mode=octet,
    **_each(float32, "q dq tau kp kd"),
    reserve=uint32,
)

LowCmd_ = idl_struct(
    "unitree_hg.msg.dds_.LowCmd_",
    **_each(octet, "mode_pr mode_machine"),
    motor_cmd=array[MotorCmd_, 35],
    reserve=array[uint32, 4],
    crc=uint32,
)

IMUState_ = _imu("unitree_hg.msg.dds_.IMUState_", int16)

MotorState_ = idl_struct(
    "unitree_hg.msg.dds_.MotorState_",
    mode=octet,
    **_each(float32, "q dq ddq tau_est"),
    temperature=array[int16, 2],
    vol=float32,
    sensor=array[uint32, 2],
    motorstate=uint32,
    reserve=array[uint32, 4],
)

LowState_ = idl_struct(
    "unitree_hg.msg.dds_.LowState_",
    version=array[uint32, 2],
    **_each(octet, "mode_pr mode_machine"),
    tick=uint32,
    imu_state=IMUState_,
    motor_state=array[MotorState_, 35],
    wireless_remote=array[octet, 40],
    reserve=array[uint32, 4],
    crc=uint32,
)

_TimeSpec = idl_struct("unitree_go.msg.dds_.TimeSpec_", sec=int32, nanosec=uint32)

_PathPoint = idl_struct(
    "unitree_go.msg.dds_.PathPoint_", **_each(float32, "t_from_start x y yaw vx vy vyaw")
)

SportModeState_ = idl_struct(
    "unitree_go.msg.dds_.SportModeState_",
    stamp=_TimeSpec,
    error_code=uint32,
    imu_state=_imu("unitree_go.msg.dds_.IMUState_", octet),
    mode=octet,
    progress=float32,
    gait_type=octet,
    foot_raise_height=float32,
    position=array[float32, 3],
    body_height=float32,
    velocity=array[float32, 3],
    yaw_speed=float32,
    range_obstacle=array[float32, 4],
    foot_force=array[int16, 4],
    **_each(array[float32, 12], "foot_position_body foot_speed_body"),
    path_point=array[_PathPoint, 10],
)

Reference_ = idl_struct(
    "g1stream.msg.dds_.Reference_",
    tick=uint64,
    motion_time=float64,
    phase=octet,
    played=uint32,
    **_each(array[float64, 29], "q dq ddq tau"),
    root_pos=array[float64, 3],
    root_quat_wxyz=array[float64, 4],
    **_each(array[float64, 3], "root_lin_vel root_ang_vel"),
)

Policy_ = idl_struct(
    "g1stream.msg.dds_.Policy_",
    **_each(uint64, "tick state_published state_received"),
    **_each(float64, "state_age motion_time inference_time"),
    **_each(uint32, "step repeated n_observation"),
    observation=array[float32, 2048],
    action=array[float32, 29],
)

Log_ = idl_struct(
    "g1stream.msg.dds_.Log_", level=octet, name=array[octet, 16], text=array[octet, 240]
)
