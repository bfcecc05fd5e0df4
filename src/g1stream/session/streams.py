"""The topics of a session that are streams of samples, and the events of its log."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from foxglove_schemas_protobuf.Log_pb2 import Log
from google.protobuf.message import DecodeError

from g1stream.dds import messages
from g1stream.errors import RecordingError
from g1stream.input_limits import NUMBER
from g1stream.session.stream import Stream
from g1stream.session.summary import PhaseInterval
from g1stream.types import Floats, Phase

if TYPE_CHECKING:
    from numpy.typing import NDArray


__all__ = [
    "STREAMS",
    "ArmCommand",
    "Base",
    "Command",
    "LogEvent",
    "Measured",
    "Reference",
    "TorsoImu",
]


class Reference(Stream):
    """The target at each tick, computed from the motion.

    Attributes:
        tick: (N,) of the control loop, from its first command.
        motion_time: (N,) s since the motion's first frame.
        phase: (N,) uint8, a `g1stream.types.Phase`.
        played: (N,) uint32, bit i of which tells that joint i plays the motion; 0 in files of
            earlier versions, in which all did: see `g1stream.dds.messages.played_joints`.
        q, dq, ddq, tau: (N, 29) rad, rad/s, rad/s^2, N·m, motor order.
        root_pos: (N, 3) m, world.
        root_quat_wxyz: (N, 4) pelvis to world.
        root_lin_vel: (N, 3) m/s, world.
        root_ang_vel: (N, 3) rad/s, pelvis frame.
    """

    topic = "/reference"
    source = messages.REFERENCE

    tick: NDArray[np.uint64]
    motion_time: Floats
    phase: NDArray[np.uint8]
    played: NDArray[np.uint32]
    q: Floats
    dq: Floats
    ddq: Floats
    tau: Floats
    root_pos: Floats
    root_quat_wxyz: Floats
    root_lin_vel: Floats
    root_ang_vel: Floats

    @property
    def start_ns(self) -> int:
        """When the motion's first frame was or would have been published, ns since the epoch.

        On the recorder's clock. Where nothing was played, when the first sample was published.
        """
        self.read("phase", "motion_time")
        sane = np.abs(self.motion_time) < NUMBER
        playing = np.flatnonzero((self.phase == Phase.PLAY) & sane)
        if not len(playing):
            return super().start_ns
        first = playing[self.publish_time[playing].argmin()]
        since_frame_0 = round(float(self.motion_time[first]) * 1e9)
        return int(self.publish_time[first]) - since_frame_0 + self.clock_offset

    @property
    def phases(self) -> list[PhaseInterval]:
        """The phases in order, s on the motion's clock.

        Each lasts until the next one begins, the last until the last sample.

        Raises:
            RecordingError: a number stands for no phase.
        """
        numbers, times = self.read("phase").phase, self.time
        if not len(times):
            return []
        starts = np.concatenate([[0], np.flatnonzero(np.diff(numbers)) + 1])
        ends = np.concatenate([starts[1:], [-1]])
        return [
            PhaseInterval(
                phase=_phase(int(numbers[start])),
                start_s=float(times[start]),
                end_s=float(times[end]),
            )
            for start, end in zip(starts, ends, strict=True)
        ]


def _phase(number: int) -> Phase:
    try:
        return Phase(number)
    except ValueError as error:
        raise RecordingError(
            f"The recorded reference has the unknown phase {number}.",
            "Read it with the version of g1stream that recorded it.",
        ) from error


class Command(Stream):
    """The commands to the motors.

    Attributes:
        mode: (N, 29) 1 for a motor that is enabled.
        q, dq, tau: (N, 29) targets: rad, rad/s, N·m.
        kp, kd: (N, 29) gains: N·m/rad, N·m·s/rad.
    """

    topic = "/lowcmd"
    source = messages.LOWCMD
    paths = MappingProxyType(
        {name: f"motor_cmd.{name}" for name in ("mode", "q", "dq", "tau", "kp", "kd")}
    )

    mode: NDArray[np.uint8]
    q: Floats
    dq: Floats
    tau: Floats
    kp: Floats
    kd: Floats


class ArmCommand(Command):
    """The targets for arms and waist that the robot's own controller was given."""

    topic = "/arm_sdk"
    source = messages.ARM_SDK

    __annotations__ = Command.__annotations__


class Measured(Stream):
    """The state of the robot.

    Attributes:
        tick: (N,) the robot's own clock, ms; always 0 from some simulators.
        q, dq, ddq, tau: (N, 29) rad, rad/s, rad/s^2, N·m, motor order.
        imu_quat_wxyz: (N, 4) pelvis to world, with the yaw as the IMU counts it.
        gyroscope: (N, 3) rad/s, pelvis frame.
        accelerometer: (N, 3) m/s^2, pelvis frame, gravity included.
    """

    topic = "/lowstate"
    source = messages.LOWSTATE
    paths = MappingProxyType(
        {
            "q": "motor_state.q",
            "dq": "motor_state.dq",
            "ddq": "motor_state.ddq",
            "tau": "motor_state.tau_est",
            "imu_quat_wxyz": "imu_state.quaternion",
            "gyroscope": "imu_state.gyroscope",
            "accelerometer": "imu_state.accelerometer",
        }
    )

    tick: NDArray[np.uint32]
    q: Floats
    dq: Floats
    ddq: Floats
    tau: Floats
    imu_quat_wxyz: Floats
    gyroscope: Floats
    accelerometer: Floats


class Base(Stream):
    """The pelvis, as a simulator or a state estimator publishes it.

    Attributes:
        position: (N, 3) m, world.
        velocity: (N, 3) m/s, world.
    """

    topic = "/sportmodestate"
    source = messages.SPORTMODESTATE

    position: Floats
    velocity: Floats


class TorsoImu(Stream):
    """The IMU in the torso.

    Attributes:
        imu_quat_wxyz: (N, 4) torso to world, with the yaw as the IMU counts it.
        gyroscope: (N, 3) rad/s, torso frame.
        accelerometer: (N, 3) m/s^2, torso frame, gravity included.
    """

    topic = "/secondary_imu"
    source = messages.SECONDARY_IMU
    paths = MappingProxyType({"imu_quat_wxyz": "quaternion"})

    imu_quat_wxyz: Floats
    gyroscope: Floats
    accelerometer: Floats


STREAMS: Final[Mapping[str, type[Stream]]] = {
    kind.topic: kind for kind in (Reference, Command, ArmCommand, Measured, Base, TorsoImu)
}
"""The kind of stream of each topic that has one."""

_LEVELS: Final = {number: name for name, number in Log.Level.items()}


class LogEvent(NamedTuple):
    """One event of a session.

    Attributes:
        time: when it happened, ns since the epoch.
        level: DEBUG, INFO, WARNING, ERROR or FATAL; UNKNOWN where it is none of these.
        name: the program that logged it.
        text: what happened.
    """

    time: int
    level: str
    name: str
    text: str

    @classmethod
    def decode(cls, data: bytes) -> LogEvent:
        """The event in a message of /log.

        Raises:
            RecordingError: it is not a foxglove.Log.
        """
        try:
            message = Log.FromString(data)
        except DecodeError as error:
            raise RecordingError(
                f"A message of /log, of {len(data)} bytes, is not a foxglove.Log.",
                "Read the session with the version of g1stream that recorded it.",
            ) from error
        level = _LEVELS.get(message.level, "UNKNOWN")
        return cls(message.timestamp.ToNanoseconds(), level, message.name, message.message)
