"""Messages of the DDS topics: serialised samples with numpy views of their fields.

A message object owns one buffer. `load` copies received bytes into it, `tobytes` returns a copy for
writing, and views show the fields in place. Views of scalars have the shape () and are written with
`message.tick[()] = 5`. `Samples` reads a field of many samples at once. Motors are in motor order.
The messages have arrays of 35 motors, of which the views show the first 29, the motors of a G1.
"""

from __future__ import annotations

from collections import deque
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
    "COMMANDS",
    "COMMAND_NAMES",
    "LOG",
    "LOWCMD",
    "LOWSTATE",
    "ODOMMODESTATE",
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
        idl_type: the cyclonedds class with the type name on DDS.
        payload: (size,) uint8, the sample without its CDR header, which all views refer to.
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
        """Copy received bytes, including the CDR header, into this message.

        Raises:
            WireError: the bytes are not one little-endian sample of this type.
        """
        self.layout.check(data)
        self._buffer[:] = data

    def tobytes(self) -> bytes:
        """The serialised sample, including the CDR header; a copy."""
        return bytes(self._buffer)


class _Motors(Message):
    """A message with all motors that ends with Unitree's checksum."""

    #: Name of the array of motors in the IDL.
    motors: ClassVar[str]
    #: The newest samples that this process has sealed; a rollout reads them in the same process.
    _sealed: ClassVar[deque[bytes]] = deque(maxlen=4)

    def __init__(self) -> None:
        super().__init__()
        self._crc = Crc(self.layout)
        self.crc = self.view("crc")
        self.mode_pr = self.view("mode_pr")
        self.mode_machine = self.view("mode_machine")
        # The offset of the first motor's mode is irregular, so there is no view of all modes.
        self._modes = self.layout[f"{self.motors}.mode"].offsets[:N_JOINTS]

    def motor_view(self, name: str) -> NDArray[Any]:
        """A writable view (29,) of a field of every motor, by its name in the IDL."""
        return self.view(f"{self.motors}.{name}")[:N_JOINTS]

    @property
    def motor_mode(self) -> NDArray[np.uint8]:
        """(29,) uint8, 1 for an enabled motor; a copy."""
        return self.payload[self._modes]

    @motor_mode.setter
    def motor_mode(self, mode: NDArray[np.uint8] | int) -> None:
        self.payload[self._modes] = mode

    def seal(self) -> bytes:
        """Set the checksum and return the serialised sample."""
        self.crc[()] = self._crc.compute(self.payload)
        self._sealed.append(sealed := bytes(self._buffer))
        return sealed

    def crc_matches(self) -> bool:
        """Return whether the checksum is right."""
        return self._buffer in self._sealed or self._crc.matches(self.payload)


class LowCmd(_Motors):
    """The command to all motors (topic rt/lowcmd), or to arms and waist only (topic rt/arm_sdk).

    Attributes:
        q, dq, tau, kp, kd: (29,) float32: rad, rad/s, N·m, N·m/rad, N·m·s/rad.
        weight: () float32, on rt/arm_sdk the share of this command, 0 to 1; the onboard controller
            has the rest. It is the q of motor 29, which no G1 has.
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
        quaternion: (4,) float32, wxyz, pelvis to world (yaw relative to the IMU's start).
        gyroscope, accelerometer: (3,) float32, pelvis frame, rad/s and m/s^2, including gravity.
        rpy: (3,) float32, rad.
        tick: () uint32, ms.
        mode_pr, mode_machine: () uint8.
        temperature: (29, 2) int16, of casing and winding, °C.
        vol: (29,) float32, supply voltage of the motor, V.
        motorstate: (29,) uint32, faults of the motor, one bit each.
        wireless_remote: (40,) uint8, see `g1stream.dds.remote`.
        published, received: int, source timestamp and time of reception, ns since the epoch, set by
            the receiver; 0 if unknown.
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
        """(97,) float32, a copy of q, dq, tau_est, quaternion, gyroscope and accelerometer."""
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
    """The base: its true pose from a simulator on rt/sportmodestate, or a robot's estimate.

    A G1 publishes the latter on rt/odommodestate, and another type on rt/sportmodestate.

    Attributes:
        position, velocity: (3,) float32, of the pelvis in the world, m and m/s.
        quaternion: (4,) float32, wxyz, pelvis to world; 0 if the simulator does not set it.
        sec, nanosec: () the simulator's time.
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

    Its doubles are rounded to single precision, like the values of the LowCmd.

    Attributes:
        tick: () uint64, number of the reference.
        motion_time: () float64, s since the motion's first frame.
        phase: () uint8, a `g1stream.types.Phase`.
        played: () uint32, joints that play the motion, see `played_joints`.
        q, dq, ddq, tau: (29,) float64: rad, rad/s, rad/s^2, N·m.
        root_pos: (3,) float64, m, world.
        root_quat_wxyz: (4,) float64, pelvis to world.
        root_lin_vel: (3,) float64, m/s, world.
        root_ang_vel: (3,) float64, rad/s, pelvis frame.
        target: (129,) float64, all fields from `q` to `root_ang_vel`, concatenated.
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
    """A step of a learned policy, topic rt/g1stream/policy, published with its first LowCmd.

    Attributes:
        tick: () uint64, tick of the Reference that is published with that LowCmd.
        state_published, state_received: () uint64, publish time (0 if unknown) and reception time
            of the observed LowState, ns since the epoch.
        state_age: () float64, time from the reception to the observation, s.
        motion_time: () float64, motion time of the observed reference, s.
        inference_time: () float64, computation time of the network, s.
        step: () uint32, number of the step; 0 when the policy takes over the robot.
        repeated: () uint32, number of steps in a row in which the last finite action replaced one
            that is not finite; 0 for a finite action.
        n_observation: () uint32, number of observed values.
        observation: (2048,) float32, input of the network.
        action: (29,) float32, output of the network, motor order.
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
    """Encode (29,) joints that play the motion as `played` of a Reference."""
    return sum(1 << joint for joint in np.flatnonzero(played).tolist())


def played_joints(bits: NDArray[np.uint32]) -> NDArray[np.bool_]:
    """Decode `played` (...) of References into (..., 29) joints; 0 stands for all joints."""
    one = np.asarray(bits, np.uint32)[..., np.newaxis] >> np.arange(N_JOINTS, dtype=np.uint32) & 1
    return np.asarray((one == 1) | ~one.any(axis=-1, keepdims=True))


class _Text:
    """A string in a field of fixed size: UTF-8, padded with zeros."""

    def __set_name__(self, owner: type[Message], name: str) -> None:
        self._name = name

    def __get__(self, message: Message, owner: type[Message]) -> str:
        return message.view(self._name).tobytes().rstrip(b"\0").decode(errors="replace")

    def __set__(self, message: Message, value: str) -> None:
        # An incomplete character at the end is left out. Characters without UTF-8 encoding, such as
        # bytes in a file's name, become question marks.
        field = message.view(self._name)
        encoded = value.encode(errors="replace")[: field.size]
        cut = encoded.decode(errors="ignore").encode()
        field[:] = np.frombuffer(cut.ljust(field.size, b"\0"), np.uint8)


class Log(Message):
    """One event, topic rt/g1stream/log.

    Attributes:
        level: () uint8: 1 debug, 2 info, 3 warning, 4 error, 5 fatal.
        name, text: str, cut to the size of their fields.
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
        data: the serialised samples, including the CDR header.
        log_times: reception times, ns of CLOCK_REALTIME.
        publish_times: publish times, ns.
        writers: Cyclone's handles of their writers.
    """

    data: list[bytes] = field(default_factory=list)
    log_times: list[int] = field(default_factory=list)
    publish_times: list[int] = field(default_factory=list)
    writers: list[int] = field(default_factory=list)


class Samples:
    """The fields of many samples of one topic: `samples["imu_state.gyroscope"]` is (N, 3).

    Args:
        topic: topic of the samples.
        data: (N) serialised samples, including the CDR header; or (N, size) uint8 with a sample in
            each row.

    Raises:
        WireError: an item is not one little-endian sample of the topic's type.
    """

    def __init__(self, topic: Topic, data: Sequence[bytes] | NDArray[np.uint8]) -> None:
        self._layout = layout = Layout.of(topic.idl_type)
        if isinstance(data, np.ndarray):
            sizes, octets = set(data.shape[1:]), data
        else:
            sizes, octets = set(map(len, data)), np.frombuffer(b"".join(data), np.uint8)
        size, encoding = layout.sample_size, np.frombuffer(CDR_HEADER[:2], np.uint8)
        if sizes - {size} or (octets.reshape(-1, size)[:, :2] != encoding).any():
            for sample in data:
                layout.check(bytes(sample))
        rows = octets.reshape(len(data), size)
        self._payloads = rows[:, len(CDR_HEADER) : len(CDR_HEADER) + layout.size]

    def __getitem__(self, path: str) -> NDArray[Any]:
        """(N, ...) a field by its dotted path in the IDL, with the precision of the IDL; a copy."""
        copied: NDArray[Any] = self.shown(path).copy()
        return copied

    def shown(self, path: str) -> NDArray[Any]:
        """(N, ...) as `samples[path]`, but a view of the samples if possible."""
        values = self._layout[path].read(self._payloads)
        return values[:, :N_JOINTS] if path.startswith(("motor_cmd.", "motor_state.")) else values

    def crc_matches(self) -> NDArray[np.bool_]:
        """(N,) whether the checksum of each sample is right."""
        return np.asarray(self["crc"] == Crc(self._layout).compute_many(self._payloads))


def encode_samples(topic: Topic, values: Mapping[str, ArrayLike], n: int) -> NDArray[np.uint8]:
    """Encode (n, size) samples of a topic for `Samples`, with their checksums.

    Args:
        topic: topic of the samples.
        values: (n, ...) values of fields by dotted path in the IDL; the other fields are 0. Fields
            of motors have 29 values.
        n: number of samples.
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
        payloads = rows[:, len(CDR_HEADER) :][:, : layout.size]
        sums = Crc(layout).compute_many(payloads).astype("<u4")
        payloads[:, layout["crc"].offsets + np.arange(4)] = sums[:, np.newaxis].view(np.uint8)
    return rows


@dataclass(frozen=True)
class Topic:
    """A DDS topic with its name and message class."""

    name: str
    message: type[Message]

    @property
    def idl_type(self) -> Any:
        """The cyclonedds class with the type name on DDS."""
        return self.message.idl_type


LOWCMD: Final = Topic("rt/lowcmd", LowCmd)
LOWSTATE: Final = Topic("rt/lowstate", LowState)
SPORTMODESTATE: Final = Topic("rt/sportmodestate", SportModeState)
ODOMMODESTATE: Final = Topic("rt/odommodestate", SportModeState)
SECONDARY_IMU: Final = Topic("rt/secondary_imu", SecondaryImu)
REFERENCE: Final = Topic("rt/g1stream/reference", Reference)
POLICY: Final = Topic("rt/g1stream/policy", PolicyStep)
LOG: Final = Topic("rt/g1stream/log", Log)

COMMANDS: Final = {"lowcmd": LOWCMD, "arm_sdk": Topic("rt/arm_sdk", LowCmd)}
"""Topics of commands, by `stream.via`."""

COMMAND_NAMES: Final = frozenset(topic.name for topic in COMMANDS.values())

TOPICS: Final = (
    *COMMANDS.values(),
    LOWSTATE,
    SPORTMODESTATE,
    ODOMMODESTATE,
    SECONDARY_IMU,
    REFERENCE,
    POLICY,
    LOG,
)
