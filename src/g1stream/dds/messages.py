"""Samples as the bytes they are on the wire, with their fields as numpy arrays.

A message object owns one buffer for its whole life: `load` copies received bytes into it, `tobytes`
copies them out to be written, and the views between show the fields in place. Views of scalars have
the shape () and are written with `message.tick[()] = 5`. `Samples` reads a field of many samples at
once. Motors are in motor order; the wire's arrays of 35 are shown up to the 29th, which is the last
that a G1 has.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Final

import numpy as np

from g1stream.dds import types
from g1stream.dds.layout import CDR_HEADER, Crc, Layout
from g1stream.dds.remote import BUTTONS_AT
from g1stream.robot.joints import N_JOINTS

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import ArrayLike, NDArray

__all__ = [
    "ARM_SDK",
    "COMMANDS",
    "LOG",
    "LOWCMD",
    "LOWSTATE",
    "POLICY",
    "REFERENCE",
    "SECONDARY_IMU",
    "SPORTMODESTATE",
    "TOPICS",
    "Batch",
    "Log",
    "LowCmd",
    "LowState",
    "Message",
    "PolicyStep",
    "Reference",
    "Samples",
    "SecondaryImu",
    "SportModeState",
    "Topic",
    "encode_samples",
    "played_bits",
    "played_joints",
]


class Message:
    """One sample of a fixed-size type.

    Attributes:
        idl_type: the cyclonedds class that names the type on the wire.
        payload: (size,) uint8, the sample without its CDR header; every view points into it.
    """

    idl_type: ClassVar[Any]

    def __init__(self) -> None:
        self.layout = Layout.of(self.idl_type)
        self._buffer = bytearray(CDR_HEADER.ljust(self.layout.sample_size, b"\0"))
        self.payload: NDArray[np.uint8] = np.frombuffer(
            self._buffer, np.uint8, self.layout.size, len(CDR_HEADER)
        )

    def view(self, path: str) -> NDArray[Any]:
        """A writable view of a field, by its dotted path in the IDL."""
        return self.layout[path].view(self.payload)

    def load(self, data: bytes) -> None:
        """Take over received bytes, CDR header included.

        Raises:
            WireError: the bytes are not one little-endian sample of this type.
        """
        self.layout.check(data)
        self._buffer[:] = data

    def tobytes(self) -> bytes:
        """The sample as it goes onto the wire, CDR header included."""
        return bytes(self._buffer)


class _Motors(Message):
    """A message that holds all motors and ends in Unitree's checksum."""

    #: The wire's array of motors.
    motors: ClassVar[str]

    def __init__(self) -> None:
        super().__init__()
        self._crc = Crc(self.layout)
        self.crc = self.view("crc")
        self.mode_pr = self.view("mode_pr")
        self.mode_machine = self.view("mode_machine")
        # The first motor's mode is not in step with the others', so that no view can show them all.
        self._modes = self.layout[f"{self.motors}.mode"].offsets[:N_JOINTS]

    def motor_view(self, name: str) -> NDArray[Any]:
        """A writable view (29,) of a field of every motor, by its name in the IDL."""
        return self.view(f"{self.motors}.{name}")[:N_JOINTS]

    @property
    def motor_mode(self) -> NDArray[np.uint8]:
        """(29,) uint8, 1 for a motor that is enabled; a copy."""
        return self.payload[self._modes]

    @motor_mode.setter
    def motor_mode(self, mode: NDArray[np.uint8] | int) -> None:
        self.payload[self._modes] = mode

    def seal(self) -> bytes:
        """Fill in the checksum and return the sample as it goes onto the wire."""
        self.crc[()] = self._crc.compute(self.payload)
        return bytes(self._buffer)

    def crc_matches(self) -> bool:
        """Whether the sample carries its own checksum."""
        return self._crc.matches(self.payload)


class LowCmd(_Motors):
    """The command to all motors, topic rt/lowcmd; to arms and waist only, topic rt/arm_sdk.

    Attributes:
        q, dq, tau, kp, kd: (29,) float32: rad, rad/s, N·m, N·m/rad, N·m·s/rad.
        weight: () float32, on rt/arm_sdk the share of these commands, 0 to 1; the rest is the
            onboard controller's. It is the q of a motor that no G1 has.
        mode_pr, mode_machine: () uint8.
    """

    idl_type = types.LowCmd_
    motors = "motor_cmd"

    def __init__(self) -> None:
        super().__init__()
        self.q, self.dq, self.tau, self.kp, self.kd = map(
            self.motor_view, ("q", "dq", "tau", "kp", "kd")
        )
        self.weight = self.view("motor_cmd.q")[N_JOINTS : N_JOINTS + 1].reshape(())


class LowState(_Motors):
    """The measured state of the whole robot, topic rt/lowstate; its arrays can be changed in place.

    Attributes:
        q, dq, ddq, tau_est: (29,) float32: rad, rad/s, rad/s^2, N·m.
        quaternion: (4,) float32, wxyz, pelvis to world (yaw as the IMU counts it).
        gyroscope, accelerometer: (3,) float32, pelvis frame, rad/s and m/s^2, gravity included.
        rpy: (3,) float32, rad.
        tick: () uint32, ms.
        mode_pr, mode_machine: () uint8.
        temperature: (29, 2) int16, of casing and winding, °C.
        vol: (29,) float32, supply of the motor, V.
        motorstate: (29,) uint32, faults of the motor, one bit each.
        wireless_remote: (40,) uint8, see `g1stream.dds.remote`.
        published, received: int, ns since the epoch, set by who received it: its source timestamp,
            and when it was taken; 0 where that is not known.
    """

    idl_type = types.LowState_
    motors = "motor_state"

    _READINGS: ClassVar = (
        *(f"motor_state.{name}" for name in ("q", "dq", "tau_est")),
        *(f"imu_state.{name}" for name in ("quaternion", "gyroscope", "accelerometer")),
    )

    def __init__(self) -> None:
        super().__init__()
        self.published = self.received = 0
        self.tick = self.view("tick")
        self.quaternion, self.gyroscope, self.accelerometer, self.rpy = (
            self.view(f"imu_state.{name}")
            for name in ("quaternion", "gyroscope", "accelerometer", "rpy")
        )
        self.q, self.dq, self.ddq, self.tau_est = map(
            self.motor_view, ("q", "dq", "ddq", "tau_est")
        )
        self.temperature, self.vol, self.motorstate = map(
            self.motor_view, ("temperature", "vol", "motorstate")
        )
        self.wireless_remote = self.view("wireless_remote")
        self._buttons = self.wireless_remote[BUTTONS_AT]
        fields = [self.layout[path].offsets for path in self._READINGS]
        self._reading_words = np.concatenate([one[:N_JOINTS] for one in fields]) // 4
        self._words = self.payload.view(np.float32)

    @property
    def buttons(self) -> int:
        """The remote's buttons, one bit each in the order of `g1stream.dds.remote.BUTTONS`."""
        return int.from_bytes(self._buttons.tobytes(), "little")

    def readings(self) -> NDArray[np.float32]:
        """(97,) float32, a copy: q, dq, tau_est, quaternion, gyroscope, accelerometer."""
        return self._words.take(self._reading_words)


class SecondaryImu(Message):
    """The IMU in the torso, topic rt/secondary_imu; fields as in `LowState`."""

    idl_type = types.IMUState_

    def __init__(self) -> None:
        super().__init__()
        self.quaternion, self.gyroscope, self.accelerometer, self.rpy = (
            self.view(name) for name in ("quaternion", "gyroscope", "accelerometer", "rpy")
        )


class SportModeState(Message):
    """The base as a simulator knows it, topic rt/sportmodestate.

    Attributes:
        position, velocity: (3,) float32, of the pelvis in the world, m and m/s.
        quaternion: (4,) float32, wxyz, pelvis to world; 0 where the simulator does not set it.
        sec, nanosec: () the simulator's own time.
    """

    idl_type = types.SportModeState_

    def __init__(self) -> None:
        super().__init__()
        self.position = self.view("position")
        self.velocity = self.view("velocity")
        self.quaternion = self.view("imu_state.quaternion")
        self.sec = self.view("stamp.sec")
        self.nanosec = self.view("stamp.nanosec")


class Reference(Message):
    """The target of the motion at the publish time of its LowCmd, topic rt/g1stream/reference.

    Its doubles are rounded to single precision, as those of the LowCmd are.

    Attributes:
        tick: () uint64, counts the references published.
        motion_time: () float64, s since the motion's first frame.
        phase: () uint8, a `g1stream.types.Phase`.
        played: () uint32, which joints play the motion, see `played_joints`.
        q, dq, ddq, tau: (29,) float64: rad, rad/s, rad/s^2, N·m.
        root_pos: (3,) float64, m, world.
        root_quat_wxyz: (4,) float64, pelvis to world.
        root_lin_vel: (3,) float64, m/s, world.
        root_ang_vel: (3,) float64, rad/s, pelvis frame.
        target: (129,) float64, all from `q` to `root_ang_vel`, one after the other.
    """

    idl_type = types.Reference_

    def __init__(self) -> None:
        super().__init__()
        self.tick = self.view("tick")
        self.motion_time = self.view("motion_time")
        self.phase = self.view("phase")
        self.played = self.view("played")
        self.q, self.dq, self.ddq, self.tau = (
            self.view(name) for name in ("q", "dq", "ddq", "tau")
        )
        self.root_pos = self.view("root_pos")
        self.root_quat_wxyz = self.view("root_quat_wxyz")
        self.root_lin_vel = self.view("root_lin_vel")
        self.root_ang_vel = self.view("root_ang_vel")
        start = int(self.layout["q"].offsets[0])
        self.target = np.frombuffer(self.payload.data, np.float64, offset=start)


class PolicyStep(Message):
    """A step of a learned policy, topic rt/g1stream/policy; published with its first LowCmd.

    Attributes:
        tick: () uint64, of the Reference beside that LowCmd.
        state_published, state_received: () uint64, ns since the epoch: when the LowState that was
            observed was published, 0 where that is not known, and received.
        state_age: () float64, s from then to the observation.
        motion_time: () float64, s, of the reference that is observed.
        inference_time: () float64, s in the network.
        step: () uint32, since the policy took the robot over, at 0.
        repeated: () uint32, how often in a row the last finite action has stood in for one that is
            not; 0 for a finite one.
        n_observation: () uint32, how many values are observed.
        observation: (1024,) float32, as the network takes it.
        action: (29,) float32, as the network gave it, motor order.
    """

    idl_type = types.Policy_

    def __init__(self) -> None:
        super().__init__()
        self.tick, self.state_published, self.state_received = map(
            self.view, ("tick", "state_published", "state_received")
        )
        self.state_age, self.motion_time, self.inference_time = map(
            self.view, ("state_age", "motion_time", "inference_time")
        )
        self.step, self.repeated = map(self.view, ("step", "repeated"))
        self.n_observation = self.view("n_observation")
        self.observation, self.action = map(self.view, ("observation", "action"))


def played_bits(played: NDArray[np.bool_]) -> int:
    """A Reference's `played` of (29,) which joints play the motion."""
    return sum(1 << joint for joint in np.flatnonzero(played).tolist())


def played_joints(bits: NDArray[np.uint32]) -> NDArray[np.bool_]:
    """(..., 29) which joints play the motion, of a Reference's `played` (...); all if it is 0."""
    one = np.asarray(bits, np.uint32)[..., np.newaxis] >> np.arange(N_JOINTS, dtype=np.uint32) & 1
    return np.asarray((one == 1) | ~one.any(axis=-1, keepdims=True))


class _Text:
    """A string in a field of fixed size: UTF-8, padded with zeros."""

    def __set_name__(self, owner: type[Message], name: str) -> None:
        self._name = name

    def __get__(self, message: Message, owner: type[Message]) -> str:
        return message.view(self._name).tobytes().rstrip(b"\0").decode(errors="replace")

    def __set__(self, message: Message, value: str) -> None:
        # A character cut in two at the end is left out rather than sent broken; what has no UTF-8,
        # such as bytes in a file's name, becomes a question mark.
        field = message.view(self._name)
        encoded = value.encode(errors="replace")[: field.size]
        cut = encoded.decode(errors="ignore").encode()
        field[:] = np.frombuffer(cut.ljust(field.size, b"\0"), np.uint8)


class Log(Message):
    """One event, topic rt/g1stream/log.

    Attributes:
        level: () uint8: 1 debug, 2 info, 3 warning, 4 error, 5 fatal.
        name, text: str, cut to what the fixed fields hold.
    """

    idl_type = types.Log_
    name = _Text()
    text = _Text()

    def __init__(self) -> None:
        super().__init__()
        self.level = self.view("level")


@dataclass
class Batch:
    """Received samples of one topic, oldest first.

    Attributes:
        data: each sample as it is on the wire, CDR header included.
        log_times: when each was received here, CLOCK_REALTIME, ns.
        publish_times: when its writer published it, ns.
        writers: Cyclone's handle of its writer.
    """

    data: list[bytes] = field(default_factory=list)
    log_times: list[int] = field(default_factory=list)
    publish_times: list[int] = field(default_factory=list)
    writers: list[int] = field(default_factory=list)


class Samples:
    """The fields of many samples of one topic: `samples["imu_state.gyroscope"]` is (N, 3).

    Args:
        topic: whose samples they are.
        data: (N) samples as they were on the wire, CDR header included; or (N, size) uint8 with one
            in each row.

    Raises:
        WireError: one of them is not one little-endian sample of the topic's type.
    """

    def __init__(self, topic: Topic, data: Sequence[bytes] | NDArray[np.uint8]) -> None:
        self._layout = layout = Layout.of(topic.idl_type)
        if isinstance(data, np.ndarray):
            rows = data
            encoding = np.frombuffer(CDR_HEADER[:2], np.uint8)
            if rows.shape[1] != layout.sample_size or (rows[:, :2] != encoding).any():
                for row in rows:
                    layout.check(row.tobytes())
        else:
            for sample in data:
                layout.check(sample)
            octets = np.frombuffer(b"".join(data), np.uint8)
            rows = octets.reshape(len(data), layout.sample_size)
        self._payloads = rows[:, len(CDR_HEADER) : len(CDR_HEADER) + layout.size]

    def __getitem__(self, path: str) -> NDArray[Any]:
        """(N, ...) a field by its dotted path in the IDL, in the wire's own precision; a copy."""
        copied: NDArray[Any] = self.shown(path).copy()
        return copied

    def shown(self, path: str) -> NDArray[Any]:
        """(N, ...) the same, a view of the samples where it can be: for who copies it at once."""
        values = self._layout[path].read(self._payloads)
        return values[:, :N_JOINTS] if path.startswith(("motor_cmd.", "motor_state.")) else values


def encode_samples(topic: Topic, values: Mapping[str, ArrayLike], n: int) -> NDArray[np.uint8]:
    """(n, size) samples of a topic, as `Samples` reads them, with their checksums.

    Args:
        topic: whose samples they are.
        values: by dotted path in the IDL, (n, ...) values of fields; the others are 0. Of motors
            the first 29 are given.
        n: how many.
    """
    layout = Layout.of(topic.idl_type)
    rows = np.zeros((n, layout.sample_size), np.uint8)
    rows[:, : len(CDR_HEADER)] = np.frombuffer(CDR_HEADER, np.uint8)
    for path, given in values.items():
        place = layout[path]
        offsets = place.offsets
        if path.startswith(("motor_cmd.", "motor_state.")):
            offsets = offsets[:N_JOINTS]
        octets = np.ascontiguousarray(given, place.dtype)[..., np.newaxis].view(np.uint8)
        rows[:, len(CDR_HEADER) + offsets[..., np.newaxis] + np.arange(octets.shape[-1])] = octets
    if "crc" in layout.fields:
        crc, payloads = Crc(layout), rows[:, len(CDR_HEADER) :][:, : layout.size]
        sums = np.array([crc.compute(row) for row in payloads], "<u4")
        payloads[:, layout["crc"].offsets + np.arange(4)] = sums[:, np.newaxis].view(np.uint8)
    return rows


@dataclass(frozen=True)
class Topic:
    """A DDS topic: its name on the wire and the message it carries."""

    name: str
    message: type[Message]

    @property
    def idl_type(self) -> Any:
        """The cyclonedds class that names the type on the wire."""
        return self.message.idl_type


LOWCMD: Final = Topic("rt/lowcmd", LowCmd)
ARM_SDK: Final = Topic("rt/arm_sdk", LowCmd)
LOWSTATE: Final = Topic("rt/lowstate", LowState)
SPORTMODESTATE: Final = Topic("rt/sportmodestate", SportModeState)
SECONDARY_IMU: Final = Topic("rt/secondary_imu", SecondaryImu)
REFERENCE: Final = Topic("rt/g1stream/reference", Reference)
POLICY: Final = Topic("rt/g1stream/policy", PolicyStep)
LOG: Final = Topic("rt/g1stream/log", Log)

COMMANDS: Final = {"lowcmd": LOWCMD, "arm_sdk": ARM_SDK}
"""Where commands go, by `stream.via`."""

TOPICS: Final = (LOWCMD, ARM_SDK, LOWSTATE, SPORTMODESTATE, SECONDARY_IMU, REFERENCE, POLICY, LOG)
