"""The streams of a session: samples of a topic as arrays, read when they are first used."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Final, NamedTuple, TypeVar

import numpy as np
from foxglove_schemas_protobuf.Log_pb2 import Log
from google.protobuf.message import DecodeError

from g1stream.clock import have_one_clock
from g1stream.dds import messages
from g1stream.errors import RecordingError
from g1stream.events import GUARD, LOWCMD_TIMEOUT
from g1stream.input_limits import LATEST_NS, NUMBER
from g1stream.session.records import ClockStep, PhaseInterval
from g1stream.text import counted
from g1stream.types import MAX_GAP_NS, Floats, Ints, Phase

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from g1stream.dds.messages import Topic

__all__ = [
    "LEAST_STEP_NS",
    "MAX_GAP_NS",
    "STREAMS",
    "ArmCommandStream",
    "BaseStream",
    "CommandStream",
    "LogEvent",
    "MeasuredStream",
    "Neighbours",
    "PolicyStream",
    "ReferenceStream",
    "Stream",
    "StreamT",
    "TorsoImuStream",
    "Warnings",
    "delays_of_steps",
    "neighbours",
    "read_only",
    "without_steps",
]

_TIMES: Final = ("log_time", "publish_time")

LEAST_STEP_NS: Final = 10_000_000
"""Least step of a clock that is taken out of times."""

#: Time around a step in which the clock is looked at, ns, and fewest messages on either side.
_NEAR_STEP, _FEWEST = 1_000_000_000, 5

StreamT = TypeVar("StreamT", bound="Stream")


class _OnOneClock(NamedTuple):
    """The properties of a `Stream` that follow from its two times."""

    published: Ints
    steps: tuple[ClockStep, ...]
    offset: int
    latency: Ints


class Stream:
    """N samples of one topic, oldest first; all arrays are read-only.

    Columns are read from the file when they are first used: the two times alone, any other column
    together with all that are not read yet. `read` reads only those that it names. Columns of
    float32 are converted to float64 when an attribute is first read; `rows` does not convert the
    whole column. An index, slice or boolean mask gives a stream of these
    samples: `session.measured[mask]`.

    A stream of this class has only the times of the messages of some topic. Subclasses say where
    their samples come from: the `topic` in the file, the `source` on the wire, and in `paths` the
    IDL field of a column that has another name there.

    Args:
        load: reads columns by name, floats in any precision; without it there are only the
            `columns` given.
        start: tells time 0 of the motion's clock; that of this stream alone if None.
        published: computes `published`; without it, it follows from the two times.
        host_steps: steps of the clock of the recorder's machine.
        columns: those that are known already.

    Attributes:
        log_time: (N,) int64, when the recorder received each, ns since the epoch.
        publish_time: (N,) int64, when its producer published it, ns since the epoch.
    """

    topic: ClassVar[str]
    source: ClassVar[Topic]
    paths: ClassVar[Mapping[str, str]] = MappingProxyType({})

    log_time: Ints
    publish_time: Ints
    _load: Callable[[list[str]], Mapping[str, NDArray[Any]]] | None
    _start: Callable[[], int] | None
    _published: Callable[[], Ints] | None
    _host_steps: Sequence[ClockStep]
    _recorded: dict[str, NDArray[Any]]

    def __init__(
        self,
        load: Callable[[list[str]], Mapping[str, NDArray[Any]]] | None = None,
        start: Callable[[], int] | None = None,
        published: Callable[[], Ints] | None = None,
        host_steps: Sequence[ClockStep] = (),
        **columns: NDArray[Any],
    ) -> None:
        self.__dict__.update(columns, _load=load, _start=start, _published=published)
        self.__dict__.update(_recorded={}, _host_steps=host_steps)

    @classmethod
    def wire_fields(cls) -> dict[str, str]:
        """Column -> path in the IDL, of all that comes from the samples themselves."""
        names = () if cls is Stream else cls.__annotations__
        return {name: cls.paths.get(name, name) for name in names}

    def read(self: StreamT, *columns: str) -> StreamT:
        """Read columns of a file in one pass, all if none are named; the stream itself.

        Raises:
            RecordingError: the file is damaged, or the stream has no such column.
        """
        missing = self.missing(*columns)
        if missing:
            if self._load is None:
                raise AttributeError(f"{type(self).__name__} has no {', '.join(missing)}")
            self.keep(dict(self._load(missing)))
        return self

    def missing(self, *columns: str) -> list[str]:
        """Which of some columns and the times are not read yet; of all columns if none are named.

        Raises:
            RecordingError: the stream has no such column.
        """
        known = self.wire_fields()
        if unknown := [name for name in columns if name not in known and name not in _TIMES]:
            raise RecordingError(
                f"{type(self).__name__} has no column {unknown[0]!r}.",
                f"Choose from {', '.join((*_TIMES, *known))}.",
            )
        wanted = dict.fromkeys((*_TIMES, *(columns or known)))
        return [name for name in wanted if name not in self.__dict__ and name not in self._recorded]

    def keep(self, columns: dict[str, NDArray[Any]]) -> None:
        """Take in columns that were read, floats in any precision."""
        for name, values in columns.items():
            kept = self._recorded if values.dtype == np.float32 else self.__dict__
            kept[name] = values

    def drop(self, *columns: str) -> None:
        """Let go of columns that take memory; they are read again when they are next used."""
        for name in columns if self._load else ():
            self.__dict__.pop(name, None)
            self._recorded.pop(name, None)

    def recorded(self, column: str) -> NDArray[Any]:
        """(N, ...) a column: float32 as on the wire, unless it has been converted to float64.

        Raises:
            RecordingError: the file is damaged, or the stream has no such column.
        """
        self.read(column)
        values = self._recorded.get(column)
        return self.__dict__[column] if values is None else values

    def rows(self, column: str, index: Any) -> NDArray[Any]:
        """Some samples of a column, as a numpy index gives them, floats as float64; see `read`."""
        return _as_float64(self.recorded(column)[index])

    if not TYPE_CHECKING:  # so that a type checker knows the columns, and no others

        def __getattr__(self, name: str) -> Any:
            if name not in _TIMES and name not in self.wire_fields():
                raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
            if name not in self._recorded:
                self.read(*(_TIMES if name in _TIMES else ()))
            if name in self._recorded:
                self.__dict__[name] = _as_float64(self._recorded.pop(name))
            return self.__dict__[name]

    def __len__(self) -> int:
        return len(self.log_time)

    def __getitem__(
        self: StreamT, index: slice | NDArray[np.bool_] | NDArray[np.integer[Any]]
    ) -> StreamT:
        """The samples of a slice, a boolean mask (N,), or indices.

        Raises:
            TypeError: the index is a number, which would leave no stream; or a name.
        """
        if not isinstance(index, (slice, np.ndarray)):
            raise TypeError(
                f"a stream takes a slice or an array, not {index!r}: "
                f"stream[5:6] is the sixth sample, stream.{next(iter(self.wire_fields()), 'time')} "
                "a column"
            )

        def load(names: list[str]) -> Mapping[str, NDArray[Any]]:
            self.read(*names)
            return {name: read_only(self.recorded(name)[index]) for name in names}

        return type(self)(load, self._zero, lambda: read_only(self.published[index]))

    def __repr__(self) -> str:
        columns = ", ".join(self.wire_fields())
        return f"<{type(self).__name__}: {counted(len(self), 'sample')} of {columns or 'a topic'}>"

    @cached_property
    def time(self) -> Floats:
        """(N,) s, publish times on the motion's clock: its first frame is at 0."""
        # Nanoseconds since the epoch need more digits than a float has; the differences do not.
        start = max(-LATEST_NS, min(self._zero(), LATEST_NS))
        return read_only((self.published - start) / 1e9)

    @cached_property
    def published(self) -> Ints:
        """(N,) ns, publish times on the recorder's clock, as if no clock had been set."""
        return self._published() if self._published else self._on_one_clock.published

    def _zero(self) -> int:
        return self._start() if self._start else self.start_ns

    @property
    def start_ns(self) -> int:
        """When the first sample was published, ns since the epoch on the recorder's clock."""
        return int(self.published.min())

    @property
    def clock_offset(self) -> int:
        """Offset to add to publish times to get the recorder's clock, ns.

        If half of the messages seem to arrive before they are sent, or to take longer than they do
        on one machine, the clocks of producer and recorder differ. The offset is then the median of
        log_time - publish_time, which is too large by the usual latency; the two cannot be
        separated.
        """
        return self._on_one_clock.offset

    @property
    def latency(self) -> Ints:
        """(N,) ns, log_time - publish_time as if no clock had been set, with the offset."""
        return self._on_one_clock.latency

    @property
    def clock_steps(self) -> tuple[ClockStep, ...]:
        """Steps of the producer's clock alone, such as that of a robot, in its own time."""
        return self._on_one_clock.steps

    @cached_property
    def _on_one_clock(self) -> _OnOneClock:
        if not len(self):
            return _OnOneClock(self.publish_time, (), 0, self.publish_time)
        # Producers on the recorder's machine have its clock.
        logged, times = (
            without_steps(one, self._host_steps) for one in (self.log_time, self.publish_time)
        )
        steps = []
        for row, step in _own_steps(logged, times):
            steps.append(ClockStep(at_ns=int(self.publish_time[row]), step_ns=step))
            times[row:] -= step
        latency = read_only(logged - times)
        median = int(np.median(latency))
        offset = 0 if have_one_clock(median) else median
        return _OnOneClock(read_only(times + offset), tuple(steps), offset, latency)


def _as_float64(values: NDArray[Any]) -> NDArray[Any]:
    return read_only(values.astype(np.float64)) if values.dtype == np.float32 else values


def read_only(values: NDArray[Any]) -> NDArray[Any]:
    """The same array, made read-only."""
    values.setflags(write=False)
    return values


class ReferenceStream(Stream):
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
        first = playing[self.published[playing].argmin()]
        return int(self.published[first]) - round(float(self.motion_time[first]) * 1e9)

    @property
    def phases(self) -> list[PhaseInterval]:
        """The phases in order; see `Recording.phases`."""
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


def delays_of_steps(published: Ints, states: NDArray[np.unsignedinteger[Any]]) -> Floats:
    """(N,) s from the publish times (N,) ns of LowStates, 0 where unknown, to those of commands."""
    delays: Floats = np.where(states > 0, (published - states.astype(np.int64)) / 1e9, np.nan)
    return delays


class PolicyStream(Stream):
    """The steps of a learned policy, each with the publish time of the command that it made first.

    Attributes:
        tick: (N,) of the Reference beside that command.
        step: (N,) step of the policy, 0 when it took over the robot.
        repeated: (N,) number of consecutive repetitions of the last finite action because the new
            one was not finite; 0 for a finite action.
        state_published: (N,) uint64, ns since the epoch: `publish_time` of the observed LowState;
            0 if unknown.
        state_received: (N,) uint64, ns since the epoch, when the streamer received it.
        state_age: (N,) s from its reception to the observation.
        motion_time: (N,) s, of the observed reference.
        inference_time: (N,) s in the network; 0 in a rollout, where computing takes no time.
        n_observation: (N,) number of observed values.
        observation: (N, K) float32, input of the network.
        action: (N, 29) float32, output of the network, motor order.
        terms: columns of `observation` by term; empty if they are unknown.
    """

    topic = "/policy"
    source = messages.POLICY

    tick: NDArray[np.uint64]
    step: NDArray[np.uint32]
    repeated: NDArray[np.uint32]
    state_published: NDArray[np.uint64]
    state_received: NDArray[np.uint64]
    state_age: Floats
    motion_time: Floats
    inference_time: Floats
    n_observation: NDArray[np.uint32]
    observation: NDArray[np.float32]
    action: NDArray[np.float32]

    terms = MappingProxyType[str, slice]({})

    def keep(self, columns: dict[str, NDArray[Any]]) -> None:
        """Keep observation and action as the float32 that the network saw, without padding."""
        exact: dict[str, NDArray[Any]] = {
            name: columns.pop(name) for name in ("observation", "action") if name in columns
        }
        super().keep(columns)
        if "observation" in exact:
            width = int(self.read("n_observation").n_observation.max(initial=0))
            exact["observation"] = read_only(exact["observation"][:, :width].copy())
        self.__dict__.update(exact)

    def __getitem__(
        self, index: slice | NDArray[np.bool_] | NDArray[np.integer[Any]]
    ) -> PolicyStream:
        """The samples of a slice, a boolean mask (N,), or indices."""
        part = super().__getitem__(index)
        part.terms = self.terms
        return part

    @cached_property
    def delay(self) -> Floats:
        """(N,) s from the publish time of the LowState to that of the command; nan if unknown."""
        return read_only(delays_of_steps(self.publish_time, self.state_published))


class CommandStream(Stream):
    """The commands to the motors.

    Attributes:
        mode_pr: (N,) 0 if `AB_JOINTS` are pitch and roll, 1 if they are the motors A and B.
        mode_machine: (N,) the kind of G1 that it is for.
        mode: (N, 29) 1 for a motor that is enabled.
        q, dq, tau: (N, 29) targets: rad, rad/s, N·m.
        kp, kd: (N, 29) gains: N·m/rad, N·m·s/rad.
    """

    topic = "/lowcmd"
    source = messages.LOWCMD
    paths = MappingProxyType(
        {name: f"motor_cmd.{name}" for name in ("mode", "q", "dq", "tau", "kp", "kd")}
    )

    mode_pr: NDArray[np.uint8]
    mode_machine: NDArray[np.uint8]
    mode: NDArray[np.uint8]
    q: Floats
    dq: Floats
    tau: Floats
    kp: Floats
    kd: Floats


class ArmCommandStream(CommandStream):
    """The targets for arms and waist that were sent to the robot's own controller."""

    topic = "/arm_sdk"
    source = messages.COMMANDS["arm_sdk"]

    __annotations__ = CommandStream.__annotations__


class MeasuredStream(Stream):
    """The state of the robot.

    Attributes:
        tick: (N,) the robot's own clock, ms; always 0 from some simulators.
        mode_pr: (N,) as of `CommandStream`.
        mode_machine: (N,) the kind of G1 that it is.
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
    mode_pr: NDArray[np.uint8]
    mode_machine: NDArray[np.uint8]
    q: Floats
    dq: Floats
    ddq: Floats
    tau: Floats
    imu_quat_wxyz: Floats
    gyroscope: Floats
    accelerometer: Floats


class BaseStream(Stream):
    """The pelvis, as a simulator or a state estimator publishes it.

    Attributes:
        position: (N, 3) m, world.
        velocity: (N, 3) m/s, world.
    """

    topic = "/sportmodestate"
    source = messages.SPORTMODESTATE

    position: Floats
    velocity: Floats


class TorsoImuStream(Stream):
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
    kind.topic: kind
    for kind in (
        ReferenceStream,
        PolicyStream,
        CommandStream,
        ArmCommandStream,
        MeasuredStream,
        BaseStream,
        TorsoImuStream,
    )
}
"""The kind of stream of each topic that has one."""

_SERIOUS: Final = {"WARNING", "ERROR", "FATAL"}
_LEVELS: Final = {number: name for name, number in Log.Level.items()}


class LogEvent(NamedTuple):
    """One event of a session.

    Attributes:
        time_ns: when it happened, since the epoch.
        level: DEBUG, INFO, WARNING, ERROR or FATAL; otherwise UNKNOWN.
        name: name of the program that logged it.
        text: the message.
    """

    time_ns: int
    level: str
    name: str
    text: str

    @property
    def is_serious(self) -> bool:
        """Whether it is a warning or worse; what the guard logs is told apart."""
        return self.level in _SERIOUS and self.name != GUARD

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


class Warnings:
    """The warnings and errors of a log, without those of the guard.

    Messages that differ only in their numbers are counted once; the last one is shown.
    """

    def __init__(self, events: Iterable[LogEvent] = ()) -> None:
        self._last: dict[str, LogEvent] = {}
        self._counts: Counter[str] = Counter()
        self.add(events)

    def add(self, events: Iterable[LogEvent]) -> None:
        """Add the next events of the log, in its order."""
        for event in events:
            if event.is_serious:
                kind = re.sub(r"\d+", "#", f"{event.name}: {event.text}")
                self._last[kind] = event
                self._counts[kind] += 1

    def texts(self, last_command: int) -> list[str]:
        """The messages, in the order in which each first appeared.

        After the last command, at `last_command` ns since the epoch or 0 if there was none, a
        warning that commands have stopped is left out: their program has ended.
        """
        texts = []
        for kind, event in self._last.items():
            ended = event.text.startswith(LOWCMD_TIMEOUT) and 0 < last_command < event.time_ns
            if count := self._counts[kind] - ended:
                text = f"{event.name}: {event.text}"
                texts.append(text if count == 1 else f"{text} (the last of {count})")
        return texts


def without_steps(times: Ints, steps: Sequence[ClockStep]) -> Ints:
    """Times as if their clock had not been set.

    Args:
        times: (N,) ns, in the order in which they were recorded.
        steps: by which it was set. Each is taken out at the interval that is nearest to it; one
            that is no longer than a gap only within 1 s of its time. A step after the last sample
            has no effect.
    """
    times, total = times.copy(), 0
    for step in steps:
        intervals = np.diff(times)
        usual = np.median(intervals) if len(intervals) else 0.0
        off = np.abs(intervals - usual - step.step_ns)
        if abs(step.step_ns) < MAX_GAP_NS:
            after = times[1:] - ((step.at_ns or 0) - total)
            off[np.abs(after) > _NEAR_STEP] = np.inf
        if len(off) and off.min() < abs(step.step_ns) / 2:
            times[int(off.argmin()) + 1 :] -= step.step_ns
            total += step.step_ns
    return times


def _own_steps(logged: Ints, published: Ints) -> Iterator[tuple[int, int]]:
    """Steps of a producer's clock that the recorder's has not: index of the first message, and ns.

    The publish times jump where messages arrive as usual, and log_time - publish_time stays at the
    new level. Where messages are late, their log times jump.
    """
    arrived, sent = np.diff(logged), np.diff(published)
    if not len(arrived):
        return
    usual = int(np.median(arrived))
    as_usual = (arrived >= 0) & (arrived <= usual + LEAST_STEP_NS // 2)
    jumps = np.flatnonzero((np.abs(sent - arrived) >= LEAST_STEP_NS) & as_usual)
    latency, around = logged - published, max(_FEWEST, _NEAR_STEP // max(1, usual))
    edges = [0, *(jumps + 1).tolist(), len(latency)]
    for last, row, following in zip(edges, edges[1:], edges[2:], strict=False):
        before = latency[max(last, row - around) : row]
        after = latency[row : min(following, row + around)]
        if min(len(before), len(after)) < _FEWEST:
            continue
        step = int(np.median(before) - np.median(after))
        if abs(step - (sent[row - 1] - arrived[row - 1])) < abs(step) / 3:
            yield row, step


class Neighbours(NamedTuple):
    """The samples around K instants; an instant equal to a sample's time has it on both sides.

    Attributes:
        instants: (K,) which of the instants asked for.
        before, after: (K,) indices of the samples.
        gap: (K,) ns between the two.
        weight: (K,) of the later one, 0 to 1.
    """

    instants: NDArray[np.intp]
    before: NDArray[np.intp]
    after: NDArray[np.intp]
    gap: Ints
    weight: Floats

    def where(self, index: NDArray[np.bool_] | NDArray[np.intp] | slice) -> Neighbours:
        """Some of the instants, by a mask (K,), indices or a slice."""
        return Neighbours._make(values[index] for values in self)

    def interpolate(self, values: NDArray[Any]) -> Floats:
        """(K, J) the samples' values (R, J) at the instants, linearly interpolated."""
        return self.between(values[self.before], values[self.after])

    def between(self, earlier: NDArray[Any], later: NDArray[Any]) -> Floats:
        """(K, J) at the instants, of the values (K, J) before and after each."""
        found: Floats = later - earlier.astype(np.float64, copy=False)
        found *= self.weight[:, np.newaxis]
        found += earlier
        return found


def neighbours(times: Ints, instants: Ints) -> Neighbours:
    """Find the samples around each instant; instants before the first and after the last drop out.

    Args:
        times: (R,) ns, not decreasing.
        instants: (N,) ns, in any order.
    """
    after = np.searchsorted(times, instants)
    exact = np.append(times, -1)[after] == instants
    before = np.where(exact, after, after - 1)
    inside = np.flatnonzero((before >= 0) & (after < len(times)))
    before, after = before[inside], after[inside]
    gap = times[after] - times[before]
    weight = (instants[inside] - times[before]) / np.maximum(gap, 1)
    return Neighbours(inside, before, after, gap, weight)
