"""rt/lowcmd and rt/lowstate of a G1, written a second time: nothing of g1stream is imported here.

The types are those of unitree_hg in Unitree's SDK. A sample travels as plain CDR, which leaves out
some of the padding of the C struct and nothing else; CMD and STATE are the C structs.
"""

from __future__ import annotations

import os
from typing import Any, Final

import numpy as np
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import annotations as idl
from cyclonedds.idl import make_idl_struct, types
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from fastcrc import crc32

N_JOINTS: Final = 29
_HEADER: Final = b"\x00\x01\x00\x00"
_OCTET: Any = getattr(types, "byte", types.uint8)  # 0.10.2 calls an octet uint8

_MOTOR_CMD = np.dtype(
    [("mode", "u1"), *((n, "<f4") for n in ("q", "dq", "tau", "kp", "kd")), ("reserve", "<u4")],
    align=True,
)
CMD: Final = np.dtype(
    [
        ("mode_pr", "u1"),
        ("mode_machine", "u1"),
        ("motor", _MOTOR_CMD, 35),
        ("reserve", "<u4", 4),
        ("crc", "<u4"),
    ],
    align=True,
)
_MOTOR_STATE = np.dtype(
    [
        ("mode", "u1"),
        *((n, "<f4") for n in ("q", "dq", "ddq", "tau_est")),
        ("temperature", "<i2", 2),
        ("vol", "<f4"),
        ("sensor", "<u4", 2),
        ("motorstate", "<u4"),
        ("reserve", "<u4", 4),
    ],
    align=True,
)
_IMU = np.dtype(
    [
        ("quaternion", "<f4", 4),
        *((n, "<f4", 3) for n in ("gyroscope", "accelerometer", "rpy")),
        ("temperature", "<i2"),
    ],
    align=True,
)
STATE: Final = np.dtype(
    [
        ("version", "<u4", 2),
        ("mode_pr", "u1"),
        ("mode_machine", "u1"),
        ("tick", "<u4"),
        ("imu", _IMU),
        ("motor", _MOTOR_STATE, 35),
        ("remote", "u1", 40),
        ("reserve", "<u4", 4),
        ("crc", "<u4"),
    ],
    align=True,
)


def _struct(typename: str, **fields: Any) -> Any:
    name = f"unitree_hg.msg.dds_.{typename}"
    return idl.final(idl.autoid("sequential")(make_idl_struct(typename, name, fields)))


_F, _U = types.float32, types.uint32
_MotorCmd = _struct("MotorCmd_", mode=_OCTET, q=_F, dq=_F, tau=_F, kp=_F, kd=_F, reserve=_U)
_ImuState = _struct(
    "IMUState_",
    quaternion=types.array[_F, 4],
    gyroscope=types.array[_F, 3],
    accelerometer=types.array[_F, 3],
    rpy=types.array[_F, 3],
    temperature=types.int16,
)
_MotorState = _struct(
    "MotorState_",
    mode=_OCTET,
    q=_F,
    dq=_F,
    ddq=_F,
    tau_est=_F,
    temperature=types.array[types.int16, 2],
    vol=_F,
    sensor=types.array[_U, 2],
    motorstate=_U,
    reserve=types.array[_U, 4],
)
LowCmd: Final = _struct(
    "LowCmd_",
    mode_pr=_OCTET,
    mode_machine=_OCTET,
    motor_cmd=types.array[_MotorCmd, 35],
    reserve=types.array[_U, 4],
    crc=_U,
)
LowState: Final = _struct(
    "LowState_",
    version=types.array[_U, 2],
    mode_pr=_OCTET,
    mode_machine=_OCTET,
    tick=_U,
    imu_state=_ImuState,
    motor_state=types.array[_MotorState, 35],
    wireless_remote=types.array[_OCTET, 40],
    reserve=types.array[_U, 4],
    crc=_U,
)


def struct_in(raw: bytearray, struct: Any) -> Any:
    """The C struct in a buffer, whose padding stays zero: numpy's own copies leave it undefined."""
    return np.frombuffer(raw, struct)[0]


def crc_of(struct: bytes | bytearray) -> int:
    """Unitree's checksum of a C struct: CRC-32 over its words, most significant byte first."""
    words = np.frombuffer(struct[:-4], "<u4")
    return crc32.mpeg_2(words.astype(">u4").tobytes())


def cmd_of(sample: bytes) -> bytes:
    """The C struct of a LowCmd on the wire."""
    cdr = sample[4:]
    return cdr[:2] + bytes(2) + cdr[2:3] + bytes(3) + cdr[4:]


def sample_of_cmd(struct: bytes | bytearray) -> bytes:
    """The inverse of `cmd_of`."""
    return bytes(_HEADER + struct[:2] + struct[4:5] + bytes(1) + struct[8:])


def sample_of_state(struct: bytes | bytearray) -> bytes:
    """A LowState as it is on the wire, of its C struct."""
    return bytes(_HEADER + struct[:70] + struct[72:73] + bytes(1) + struct[76:])


class _Sample:
    """Bytes in place of a decoded sample: Cyclone asks it for its bytes, or makes it of bytes."""

    def __init__(self, data: bytes) -> None:
        self.data = data
        self.sample_info: Any = None

    def serialize(self, use_version_2: bool | None = None) -> bytes:
        return self.data

    @classmethod
    def deserialize(cls, data: bytes) -> Any:
        return cls(data)

    deserialize_key = deserialize


def _topic(participant: Any, name: str, idl_type: Any) -> Any:
    identity = {"__idl__": idl_type.__idl__, "__idl_typename__": idl_type.__idl_typename__}
    return Topic(participant, name, type(idl_type.__name__, (_Sample,), identity))


class Wire:
    """A participant in a domain on an interface, with raw readers and writers."""

    def __init__(self, domain: int, interface: str = "lo") -> None:
        os.environ.pop("CYCLONEDDS_URI", None)
        local = (
            "<Discovery><ParticipantIndex>auto</ParticipantIndex>"
            '<Peers><Peer Address="127.0.0.1"/></Peers></Discovery>'
        )
        self._domain = Domain(
            domain,
            '<CycloneDDS><Domain Id="any"><General><Interfaces>'
            f'<NetworkInterface name="{interface}"/></Interfaces></General>'
            f'<Internal><SocketReceiveBufferSize max="16MB"/></Internal>'
            f"{local if interface == 'lo' else ''}</Domain></CycloneDDS>",
        )
        self._participants = [DomainParticipant(domain)]
        self._number = domain

    def another(self) -> None:
        """What is made from now on belongs to a participant of its own."""
        self._participants.append(DomainParticipant(self._number))

    def reader(self, topic: str, idl_type: Any) -> Any:
        """A reader that keeps every sample until it is taken."""
        participant = self._participants[-1]
        qos = Qos(Policy.Reliability.Reliable(0), Policy.History.KeepLast(4096))
        return DataReader(participant, _topic(participant, topic, idl_type), qos)

    def writer(self, topic: str, idl_type: Any, announced: str = "") -> Any:
        """A writer as a robot has it; announced with this text, if any."""
        participant = self._participants[-1]
        policies = [Policy.Reliability.Reliable(0), Policy.History.KeepLast(1)]
        policies += [Policy.Userdata(announced.encode())] if announced else []
        return DataWriter(participant, _topic(participant, topic, idl_type), Qos(*policies))


def take(reader: Any) -> list[Any]:
    """All samples since the last call: `data` is their bytes, `sample_info` Cyclone's."""
    return [
        one for one in reader.take(4096) if isinstance(one, _Sample) and one.sample_info.valid_data
    ]


def write(writer: Any, sample: bytes) -> None:
    """Publish bytes."""
    writer.write(writer.data_type(sample))
