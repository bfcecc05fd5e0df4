"""The streams of a session: the samples of a topic as arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, ClassVar

from g1stream.dds import topics
from g1stream.types import Floats, Ints

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from g1stream.dds.topics import Topic


__all__ = ["Base", "Command", "Measured", "Reference", "Stream", "TorsoImu"]


@dataclass(frozen=True, eq=False)
class Stream:
    """N samples of one topic, oldest first; all arrays are read-only.

    By itself it is only the times of the messages of some topic. Subclasses say where their samples
    come from: the `topic` in the file, the `source` on the wire, and in `paths` the field of an
    attribute that has another name there.

    Attributes:
        log_time: (N,) int64, when the recorder received each, ns since the epoch.
        publish_time: (N,) int64, when its producer published it, ns since the epoch.
    """

    topic: ClassVar[str]
    source: ClassVar[Topic]
    paths: ClassVar[Mapping[str, str]] = {}

    log_time: Ints
    publish_time: Ints

    def __len__(self) -> int:
        return len(self.log_time)

    @classmethod
    def wire_fields(cls) -> dict[str, str]:
        """Attribute -> path in the IDL, of all that comes from the samples themselves."""
        times = {field.name for field in fields(Stream)}
        names = [field.name for field in fields(cls) if field.name not in times]
        return {name: cls.paths.get(name, name) for name in names}


@dataclass(frozen=True, eq=False)
class Reference(Stream):
    """What the motion asked for at each tick.

    Attributes:
        tick: (N,) of the control loop, from its first command.
        motion_time: (N,) s since the motion's first frame.
        phase: (N,) 0 WAIT, 1 RAMP, 2 PLAY, 3 HOLD, 4 DAMP, 5 DONE.
        q, dq, ddq, tau: (N, 29) rad, rad/s, rad/s^2, Nm, motor order.
        root_pos: (N, 3) m, world.
        root_quat_wxyz: (N, 4) pelvis to world.
        root_lin_vel: (N, 3) m/s, world.
        root_ang_vel: (N, 3) rad/s, pelvis frame.
    """

    topic = "/reference"
    source = topics.REFERENCE

    tick: NDArray[np.uint64]
    motion_time: Floats
    phase: NDArray[np.uint8]
    q: Floats
    dq: Floats
    ddq: Floats
    tau: Floats
    root_pos: Floats
    root_quat_wxyz: Floats
    root_lin_vel: Floats
    root_ang_vel: Floats


@dataclass(frozen=True, eq=False)
class Command(Stream):
    """What the motors were told.

    Attributes:
        mode: (N, 29) 1 for a motor that is enabled.
        q, dq, tau: (N, 29) targets: rad, rad/s, Nm.
        kp, kd: (N, 29) gains: Nm/rad, Nm s/rad.
    """

    topic = "/lowcmd"
    source = topics.LOWCMD
    paths: ClassVar = {name: f"motor_cmd.{name}" for name in ("mode", "q", "dq", "tau", "kp", "kd")}

    mode: NDArray[np.uint8]
    q: Floats
    dq: Floats
    tau: Floats
    kp: Floats
    kd: Floats


@dataclass(frozen=True, eq=False)
class Measured(Stream):
    """What the robot reported.

    Attributes:
        tick: (N,) the robot's own clock, ms; always 0 from some simulators.
        q, dq, ddq, tau: (N, 29) rad, rad/s, rad/s^2, Nm, motor order.
        imu_quat_wxyz: (N, 4) pelvis to world, with the yaw as the IMU counts it.
        gyroscope: (N, 3) rad/s, pelvis frame.
        accelerometer: (N, 3) m/s^2, pelvis frame, gravity included.
    """

    topic = "/lowstate"
    source = topics.LOWSTATE
    paths: ClassVar = {
        "q": "motor_state.q",
        "dq": "motor_state.dq",
        "ddq": "motor_state.ddq",
        "tau": "motor_state.tau_est",
        "imu_quat_wxyz": "imu_state.quaternion",
        "gyroscope": "imu_state.gyroscope",
        "accelerometer": "imu_state.accelerometer",
    }

    tick: NDArray[np.uint32]
    q: Floats
    dq: Floats
    ddq: Floats
    tau: Floats
    imu_quat_wxyz: Floats
    gyroscope: Floats
    accelerometer: Floats


@dataclass(frozen=True, eq=False)
class Base(Stream):
    """Where the pelvis was, as far as somebody knew.

    Attributes:
        position: (N, 3) m, world.
        velocity: (N, 3) m/s, world.
    """

    topic = "/sportmodestate"
    source = topics.SPORTMODESTATE

    position: Floats
    velocity: Floats


@dataclass(frozen=True, eq=False)
class TorsoImu(Stream):
    """What the inertial unit in the torso reported.

    Attributes:
        imu_quat_wxyz: (N, 4) torso to world, with the yaw as the IMU counts it.
        gyroscope: (N, 3) rad/s, torso frame.
        accelerometer: (N, 3) m/s^2, torso frame, gravity included.
    """

    topic = "/secondary_imu"
    source = topics.SECONDARY_IMU
    paths: ClassVar = {"imu_quat_wxyz": "quaternion"}

    imu_quat_wxyz: Floats
    gyroscope: Floats
    accelerometer: Floats
