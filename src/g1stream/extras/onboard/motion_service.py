"""Types and client of Unitree's motion service, which starts and stops the robot's controllers.

A call is a `Request_` on rt/api/motion_switcher/request. Its answer is the `Response_` with the
same id on rt/api/motion_switcher/response. Parameters and data are JSON. Unlike the topics of the
loop, these types have strings, so Cyclone DDS serialises them; idl/unitree_api is their source.
"""

from __future__ import annotations

import json
import struct
import time
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, Any, Final

from cyclonedds.core import Policy, Qos
from cyclonedds.idl import types
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from g1stream.dds.domain import Participant
from g1stream.dds.messages import LOWCMD
from g1stream.dds.types import idl_struct, octet
from g1stream.errors import SafetyError, WireError

if TYPE_CHECKING:
    from g1stream.config import DdsConfig

__all__ = [
    "API_VERSION",
    "REQUEST_TOPIC",
    "RESPONSE_TOPIC",
    "ApiEndpoint",
    "ApiId",
    "ErrorCode",
    "MotionSwitcherClient",
    "OnboardStatus",
    "Request_",
    "Response_",
    "onboard_status",
    "release_mode",
    "response_to",
    "restore_mode",
]

REQUEST_TOPIC: Final = "rt/api/motion_switcher/request"
RESPONSE_TOPIC: Final = "rt/api/motion_switcher/response"

API_VERSION: Final = "1.0.0.1"
"""Version of the service's API, as in Unitree's SDK."""


class ApiId(IntEnum):
    """Calls of the service; its SET_SILENT and GET_SILENT are not used here."""

    API_VERSION = 1
    CHECK_MODE = 1001
    SELECT_MODE = 1002
    RELEASE_MODE = 1003


class ErrorCode(IntEnum):
    """The code of a response, as in Unitree's documentation of the service."""

    DONE = 0
    NOT_IMPLEMENTED = 3203
    PARAMETER = 7001
    BUSY = 7002
    NAME = 7004
    COMMAND = 7005
    CHECK = 7006
    SWITCH = 7007
    RELEASE = 7008
    CONFIG = 7009


_MEANINGS: Final = {
    ErrorCode.NOT_IMPLEMENTED: "it does not support the call",
    ErrorCode.PARAMETER: "the parameter is invalid",
    ErrorCode.BUSY: "it is busy",
    ErrorCode.NAME: "it has no mode of that name",
    ErrorCode.COMMAND: "its command failed",
    ErrorCode.CHECK: "its check of the mode failed",
    ErrorCode.SWITCH: "the switch to the mode failed",
    ErrorCode.RELEASE: "the release of the mode failed",
    ErrorCode.CONFIG: "its configuration cannot be set",
}

_PACKAGE: Final = "unitree_api.msg.dds_."
_RequestIdentity = idl_struct(f"{_PACKAGE}RequestIdentity_", id=types.int64, api_id=types.int64)
_RequestLease = idl_struct(f"{_PACKAGE}RequestLease_", id=types.int64)
_RequestPolicy = idl_struct(f"{_PACKAGE}RequestPolicy_", priority=types.int32, noreply=bool)
_RequestHeader = idl_struct(
    f"{_PACKAGE}RequestHeader_",
    identity=_RequestIdentity,
    lease=_RequestLease,
    policy=_RequestPolicy,
)
Request_ = idl_struct(
    f"{_PACKAGE}Request_", header=_RequestHeader, parameter=str, binary=types.sequence[octet]
)
_ResponseStatus = idl_struct(f"{_PACKAGE}ResponseStatus_", code=types.int32)
_ResponseHeader = idl_struct(
    f"{_PACKAGE}ResponseHeader_", identity=_RequestIdentity, status=_ResponseStatus
)
Response_ = idl_struct(
    f"{_PACKAGE}Response_", header=_ResponseHeader, data=str, binary=types.sequence[octet]
)

#: Interval at which CheckMode, which changes nothing, is repeated until it is answered, s. An
#: answer that is published before this reader has been discovered is lost.
_RESEND: Final = 0.3
_POLL: Final = 0.005  # s
#: Number of calls and answers that are kept between two takes.
_DEPTH: Final = 16


def response_to(request: Any, code: ErrorCode, data: str = "") -> Any:
    """Make the `Response_` to a `Request_`."""
    header = _ResponseHeader(identity=request.header.identity, status=_ResponseStatus(code=code))
    return Response_(header=header, data=data, binary=[])


class ApiEndpoint:
    """One side of the service: a reliable writer of one topic, and a reader of the other.

    Args:
        participant: the DDS participant.
        serves: the side of the service; False: the side of a client.
    """

    def __init__(self, participant: Participant, *, serves: bool) -> None:
        request = Topic(participant.entity, REQUEST_TOPIC, Request_)
        response = Topic(participant.entity, RESPONSE_TOPIC, Response_)
        incoming, outgoing = (request, response) if serves else (response, request)
        depth = Policy.History.KeepLast(_DEPTH)
        # As in the SDK; the caller repeats a call or answer that the network loses.
        best_effort = Qos(Policy.Reliability.BestEffort, depth)
        self._reader: Any = DataReader(participant.entity, incoming, best_effort)
        reliable = Qos(Policy.Reliability.Reliable(0), depth)
        self._writer: Any = DataWriter(participant.entity, outgoing, reliable)
        participant.register(self)

    def close(self) -> None:
        self._reader = self._writer = None

    def write(self, sample: Any) -> None:
        """Publish a request or a response."""
        self._writer.write(sample)

    def take(self) -> list[Any]:
        """Take the samples since the last take, oldest first, without undecodable ones."""
        received = []
        for _ in range(_DEPTH):
            try:
                samples = self._reader.take(1)
            except (struct.error, ValueError):
                continue
            if not samples:
                break
            received += [one for one in samples if hasattr(one, "header")]
        return received


@dataclass(frozen=True)
class OnboardStatus:
    """Status of the motion service.

    Attributes:
        form: form of the robot; "0" without wheels.
        name: name of the active mode, such as `ai`; empty if none is active.
    """

    form: str
    name: str


class MotionSwitcherClient:
    """Client of the motion service, like MotionSwitcherClient of Unitree's SDK.

    Args:
        participant: a participant in the robot's domain.
        timeout: maximum wait for an answer, including discovery, s.
    """

    def __init__(self, participant: Participant, timeout: float = 5.0) -> None:
        self._participant = participant
        self._timeout = timeout
        self._endpoint = ApiEndpoint(participant, serves=False)

    def check(self) -> OnboardStatus:
        """Read the robot's form and the active mode (CheckMode).

        Raises:
            WireError: there is no answer, an error code, or an answer that cannot be decoded.
        """
        data = self._call(ApiId.CHECK_MODE, resend=_RESEND)
        try:
            answer = json.loads(data)
            return OnboardStatus(form=str(answer.get("form", "")), name=str(answer["name"]))
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            raise WireError(
                f"The answer to CheckMode has no form and name: {data[:80]!r}.",
                "Check the version of the robot's software, and which program serves "
                f"{REQUEST_TOPIC}: g1stream doctor.",
            ) from error

    def release(self) -> None:
        """End the active mode (ReleaseMode); the robot goes limp.

        Raises:
            WireError: there is no answer, an error code, or the mode remains active.
        """
        self.check()  # afterwards the service is discovered, so one request is sufficient
        self._call(ApiId.RELEASE_MODE)
        self._wait_for("")

    def select(self, name: str) -> None:
        """Start a mode (SelectMode).

        Raises:
            WireError: there is no answer, an error code, or the mode does not become active.
        """
        self.check()
        self._call(ApiId.SELECT_MODE, name=name)
        self._wait_for(name)

    def _wait_for(self, name: str) -> None:
        deadline = time.monotonic() + self._timeout
        while (active := self.check().name) != name:
            if time.monotonic() > deadline:
                raise WireError(
                    f"The motion service accepted the call, but its active mode is "
                    f"{active or 'none'} {self._timeout:g} s later.",
                    "Check the robot, and run the command again.",
                )
            time.sleep(_RESEND)

    def _call(self, api: ApiId, *, resend: float | None = None, **parameter: str) -> str:
        """Send a request, repeated every `resend` s, and return the data of the answer."""
        number = time.monotonic_ns()
        header = _RequestHeader(
            identity=_RequestIdentity(id=number, api_id=api),
            lease=_RequestLease(id=0),
            policy=_RequestPolicy(priority=0, noreply=False),
        )
        request = Request_(header=header, parameter=json.dumps(parameter), binary=[])
        now = time.monotonic()
        deadline, send = now + self._timeout, now
        while now < deadline:
            if now >= send:
                self._endpoint.write(request)
                send = now + resend if resend else deadline
            for response in self._endpoint.take():
                if response.header.identity.id == number:
                    self._require_done(api, response.header.status.code)
                    return str(response.data)
            time.sleep(_POLL)
            now = time.monotonic()
        raise self._no_answer(api)

    @staticmethod
    def _require_done(api: ApiId, code: int) -> None:
        if code == ErrorCode.DONE:
            return
        known = code in ErrorCode.__members__.values()
        meaning = f": {_MEANINGS[ErrorCode(code)]}" if known else ""
        again = "Try again in a few seconds." if code == ErrorCode.BUSY else ""
        raise WireError(
            f"The motion service refuses {_call_name(api)} with code {code}{meaning}.",
            again
            or "Show the active mode with `g1stream robot status`; the modes of a G1 are ai, "
            "normal and advanced.",
        )

    def _no_answer(self, api: ApiId) -> WireError:
        where = f"domain {self._participant.domain} on {self._participant.interface}"
        if self._participant.readers(REQUEST_TOPIC):
            return WireError(
                f"The motion service in {where} does not answer {_call_name(api)} within "
                f"{self._timeout:g} s.",
                "Check the network, or wait longer with --timeout.",
            )
        return WireError(
            f"There is no motion service in {where}: no subscriber on {REQUEST_TOPIC} within "
            f"{self._timeout:g} s.",
            "Check the robot, the domain and the interface with `g1stream doctor`; unitree_mujoco "
            "does not have this service.",
        )


def _call_name(api: ApiId) -> str:
    """Name of a call as in Unitree's documentation, such as `CheckMode`."""
    return "".join(part.capitalize() for part in api.name.split("_"))


def onboard_status(where: DdsConfig, timeout: float = 5.0) -> OnboardStatus:
    """The form of the robot and its active mode."""
    with Participant(where.domain, where.interface) as participant:
        return MotionSwitcherClient(participant, timeout).check()


def release_mode(where: DdsConfig, timeout: float = 5.0) -> str:
    """Release the active mode, upon which the robot goes limp. Returns its name; "" if none."""
    with Participant(where.domain, where.interface) as participant:
        client = MotionSwitcherClient(participant, timeout)
        name = client.check().name
        if name:
            client.release()
    return name


def restore_mode(where: DdsConfig, name: str, timeout: float = 5.0) -> None:
    """Start a mode, unless another program publishes LowCmd."""
    with Participant(where.domain, where.interface) as participant:
        client = MotionSwitcherClient(participant, timeout)
        active = client.check().name
        if not active and (others := participant.commanders()):
            raise SafetyError(
                f"The mode {name} would conflict with a publisher on {LOWCMD.name}: "
                f"{', '.join(map(participant.owner, others))}.",
                "Stop it first.",
            )
        if active != name:
            client.select(name)
