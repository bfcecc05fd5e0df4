"""Records that stream and recorder write to a session file as JSON, and that readers read back.

`SessionInfo` is known before the first sample, `StreamSummary` and `RecorderSummary` at the end.
None means unknown; units are part of the names.
"""

from __future__ import annotations

from itertools import accumulate
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

import numpy as np
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainSerializer,
    ValidationError,
)

from g1stream.realtime import Grant
from g1stream.robot.joints import JOINT_NAMES
from g1stream.types import FeedForwardKind, Phase, StopKind, StreamSupport

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from g1stream.config import Config
    from g1stream.motion.motion import Motion
    from g1stream.robot.model import G1
    from g1stream.types import Floats

__all__ = [
    "AttachedInfo",
    "BalanceSummary",
    "ClockStep",
    "FeedForwardChange",
    "Finding",
    "Int",
    "MeasuredTf",
    "MotionInfo",
    "ParametersInfo",
    "Percentiles",
    "PhaseInterval",
    "PhaseName",
    "PolicyInfo",
    "Record",
    "RecorderSummary",
    "SessionInfo",
    "StreamSummary",
    "TopicDelay",
    "read_record",
]

Int = Annotated[int, Field(ge=-(2**63), lt=2**63)]
PhaseName = Annotated[
    Phase,
    BeforeValidator(
        lambda value: Phase.__members__.get(value) if isinstance(value, str) else value
    ),
    PlainSerializer(lambda phase: phase.name, return_type=str, when_used="json"),
]
"""A phase, in JSON by its name."""


class Record(BaseModel):
    """A record in JSON. Its numbers are finite."""

    # Unknown fields are ignored and missing ones get defaults, for files of other versions.
    # Models are built at first use, because a stream starts without most of them.
    model_config = ConfigDict(
        extra="ignore", allow_inf_nan=False, validate_default=False, defer_build=True
    )


RecordT = TypeVar("RecordT", bound=BaseModel)


def read_record(
    kind: type[RecordT], values: Any, where: str = ""
) -> tuple[RecordT | None, list[str]]:
    """Read a record from the metadata of a session file, and skip invalid fields.

    Args:
        kind: class of the record; all its fields have defaults.
        values: values from the file; None without values.
        where: their key, for messages.

    Returns:
        The record without fields with invalid values, or None without a record; and a sentence for
        each value that was skipped.
    """
    if values is None:
        return None, []
    if not isinstance(values, dict):
        return None, [f"The metadata {where or 'record'} is not a table: {values!r:.60}."]
    try:
        return kind.model_validate(values), []
    except ValidationError as error:
        wrong = list(dict.fromkeys(one["loc"][0] for one in error.errors()))
    record, more = read_record(kind, {k: v for k, v in values.items() if k not in wrong}, where)
    table = f"{where}." if where else ""
    problems = [f"The metadata {table}{k} is not valid: {values[k]!r:.60}." for k in wrong]
    return record, problems + more


class Percentiles(Record):
    """Percentiles of a latency or lateness. The name of the containing field gives the unit."""

    p50: float
    p99: float
    p99_9: float
    max: float


class PhaseInterval(Record):
    """A phase from start to end, s on the motion's clock, which is 0 at the first frame."""

    phase: PhaseName
    start_s: float
    end_s: float

    @property
    def duration_s(self) -> float:
        """Its duration, s."""
        return self.end_s - self.start_s


class MotionInfo(Record):
    """The motion that was played.

    Attributes:
        name: name of the motion.
        fps: frame rate of its file.
        frames: number of frames.
        sha256: hash of its file.
        content_sha256: hash of its frames, see `Motion.content_sha256`.
        source: path of its file.
        operations: changes to the motion in the file, in order.
        parts: the motions that were joined, in order.
    """

    name: str | None = None
    fps: Annotated[float, Field(gt=0)] | None = None
    frames: Int | None = None
    sha256: str | None = None
    content_sha256: str | None = None
    source: str | None = None
    operations: list[str] = []
    parts: list[MotionInfo] = []

    @classmethod
    def from_motion(cls, motion: Motion) -> MotionInfo:
        """Describe a motion that is in memory."""
        return cls(
            name=motion.name,
            fps=motion.fps,
            frames=motion.n_frames,
            sha256=motion.sha256,
            content_sha256=motion.content_sha256,
            source=str(motion.source) if motion.source else None,
            operations=list(motion.operations),
            parts=[cls.from_motion(part) for part in motion.parts],
        )

    @property
    def duration_s(self) -> float | None:
        """Time from the first frame to the last, s."""
        return (self.frames - 1) / self.fps if self.frames and self.fps else None


class ParametersInfo(Record):
    """The robot's parameters, see `g1stream.robot.parameters`.

    Attributes:
        path: path of their file.
        sha256: hash of that file.
        values: values in the file.
    """

    path: str | None = None
    sha256: str | None = None
    values: dict[str, Any] = {}

    @classmethod
    def from_robot(cls, robot: G1) -> ParametersInfo | None:
        """The parameters of a robot; None for the default ones."""
        parameters = robot.parameters
        if parameters.path is None:
            return None
        return cls(
            path=str(parameters.path), sha256=parameters.sha256, values=dict(parameters.values)
        )

    def __str__(self) -> str:
        """One line with the file, and the values or their numbers by kind."""
        parts = [Path(self.path).name if self.path else "unknown"]
        for name, value in self.values.items():
            what = name.replace("_", " ")
            if isinstance(value, dict):
                parts.append(f"{what} of {len(value)}")
            else:
                parts.append(f"{what} {value}{' s' if name == 'command_delay' else ''}")
        return ", ".join([*parts, *([f"sha256 {self.sha256[:12]}"] if self.sha256 else [])])


class PolicyInfo(Record):
    """The learned policy that played.

    Attributes:
        path: path of its ONNX file.
        sha256: hash of that file.
        data_sha256: hash of its external weights; None without external weights.
        trained_mean, trained_std: statistics of each observation value in training, if the network
            normalises with them; otherwise empty.
        contract: its inputs and outputs, as from `g1stream policy --json`.
    """

    path: str | None = None
    sha256: str | None = None
    data_sha256: str | None = None
    trained_mean: list[float] = []
    trained_std: list[float] = []
    contract: dict[str, Any] = {}

    @property
    def columns(self) -> dict[str, slice]:
        """Columns of each term in the observation, by name; empty if they are unknown."""
        sizes = self._sizes
        ends = accumulate(size for _, size, *_ in sizes)
        return {
            name: slice(end - size, end) for (name, size, *_), end in zip(sizes, ends, strict=True)
        }

    @property
    def newest(self) -> dict[str, slice]:
        """Columns of each term's newest step, which is the last or the first one in a history."""
        columns = self.columns
        ends = ((n, columns[n], size // steps, first) for n, size, steps, first in self._sizes)
        return {
            name: slice(at.start, at.start + size) if first else slice(at.stop - size, at.stop)
            for name, at, size, first in ends
        }

    @property
    def _sizes(self) -> list[tuple[str, int, int, bool]]:
        """Name, numbers of values and steps, and whether the newest is first; empty if unknown."""
        try:
            sizes = [
                (
                    str(one["name"]),
                    int(one["size"]),
                    int(one.get("history", 1)),
                    one.get("newest_first") is True,
                )
                for one in self.contract["terms"]
            ]
        except (AttributeError, KeyError, TypeError, ValueError, OverflowError):
            return []
        sound = all(size >= 0 and steps > 0 and not size % steps for _, size, steps, _ in sizes)
        return sizes if sound else []


AttachedBy = Literal["commands", "arm commands", "measured joints"]
"""Data in which a motion was found."""


class AttachedInfo(Record):
    """Where a motion was found in a session that was recorded without a reference.

    Attributes:
        by: data that was compared with the motion. With measured joints, a delay of the robot has
            the same effect as a later start.
        start_s: time of the motion's first frame, even if that was not played, after the first
            sample of this data.
        speed: seconds of the motion per second of the session.
        first_s, last_s: the played part of the motion.
        similarity: normalised cross-correlation of all joint velocities in that part, up to 1.
        rmse_rad: of the compared positions, without the mean error of each joint.
        rival: similarity of the second best place in the motion; None if no other is similar.
        play, plays: number of this playback in the session, from 1, and number of all.
        starts_s: start of each playback with the played part, after the first sample.
        heading_from: source of the reference's heading: imu, or none for the motion's own.
        place_from: source of the reference's place: sportmodestate, or none for the motion's own.
        moves: whether the measured pelvis moved about as far as the motion's, which means that the
            robot was not held.
    """

    by: AttachedBy = "commands"
    start_s: float = 0.0
    speed: float = 1.0
    first_s: float = 0.0
    last_s: float = 0.0
    similarity: float = 0.0
    rmse_rad: float = 0.0
    rival: float | None = None
    play: Int = 1
    plays: Int = 1
    starts_s: list[float] = []
    heading_from: str = "none"
    place_from: str = "none"
    moves: bool = False

    @property
    def by_robot(self) -> bool:
        """Whether measured joints gave the start of the motion, so that their delay is unknown."""
        return self.by == "measured joints"


class ClockStep(Record):
    """CLOCK_REALTIME was set by `step_ns`, to `at_ns`."""

    at_ns: Int | None = None
    step_ns: Int


class SessionInfo(Record):
    """The file's metadata that are known before the first sample.

    Attributes:
        g1stream: version that recorded it.
        versions: versions of the packages that it used.
        log: how another program's log was interpreted; empty for a session.
        host, domain, interface: where it was recorded.
        log_clock: clock of the log times; for a rollout it begins with "simulated".
        clock_steps: times and sizes of steps of this clock during the recording.
        motion: the motion that is played.
        gains: kp in N·m/rad and kd in N·m·s/rad, 29 each, motor order.
        joints: names of the joints that play the motion; None in files of earlier versions: all.
        absent: names of the joints that the robot lacks.
        policy: the policy that plays; None without a policy.
        params: given parameters of the robot; None for the default ones.
        config: all settings of the streamer.
    """

    g1stream: str | None = None
    versions: dict[str, str] = {}
    log: dict[str, str] = {}
    host: str | None = None
    domain: Int | None = None
    interface: str | None = None
    log_clock: str | None = None
    clock_steps: list[ClockStep] = []
    motion: MotionInfo | None = None
    gains: dict[str, list[float]] | None = None
    joints: list[str] | None = None
    absent: list[str] = []
    policy: PolicyInfo | None = None
    params: ParametersInfo | None = None
    config: dict[str, Any] | None = None

    @classmethod
    def from_config(
        cls,
        config: Config,
        robot: G1,
        motion: Motion,
        gains: Mapping[str, Floats],
        played: NDArray[np.bool_],
        policy: PolicyInfo | None = None,
    ) -> SessionInfo:
        """Describe a motion that is about to be played by the joints `played` (29,).

        `gains` has arrays (29,) by the names in `Gains`.
        """
        params = ParametersInfo.from_robot(robot)
        told: dict[str, Any] = {"policy": policy} if policy else {}
        told |= {"params": params} if params else {}
        return cls(
            **told,
            motion=MotionInfo.from_motion(motion),
            gains={name: values.tolist() for name, values in gains.items()},
            joints=[JOINT_NAMES[i] for i in np.flatnonzero(played)],
            absent=[JOINT_NAMES[i] for i in robot.joint_set.absent],
            config=config.model_dump(mode="json"),
        )


class Finding(Record):
    """Result of a check: why no command was sent, or a finding of the doctor.

    Attributes:
        about: subject of the check, in a word or two.
        cause: the finding.
        remedy: what to do; empty if nothing needs to be done.
    """

    about: str
    cause: str
    remedy: str = ""


class FeedForwardChange(Record):
    """The feed-forward torque was switched off, or on again.

    Attributes:
        motion_time_s: time in the motion.
        kind: kind of feed-forward from then on.
        reason: why; empty if the reason for the change before has ended.
    """

    motion_time_s: float
    kind: FeedForwardKind
    reason: str = ""


class BalanceSummary(Record):
    """How close a robot on its feet was to falling: the worst values of PLAY and HOLD.

    Attributes:
        capture_margin_m: from the capture point to the edge of the soles; negative outside.
        tilt_rad: tilt of the pelvis against the reference.
        height_error_m: of the pelvis, above or below the reference.
        feet_error_m: shift of one foot relative to the other while both stand: it slipped, or was
            put down elsewhere.
        carried: fraction of the weight on the feet; the rest is in the air, or hangs from a band.
        lifts: number of lifts of a foot.
        unsolved_ticks: ticks without contact forces that keep the robot on its feet.
    """

    capture_margin_m: float
    tilt_rad: float
    height_error_m: float
    feet_error_m: float
    carried: float
    lifts: Int
    unsolved_ticks: Int


class StreamSummary(Record):
    """Counters and results of the stream.

    Attributes:
        reason: why it ended early; empty if it ended as asked.
        stop: kind of that reason; None if it ended as asked.
        signal: number of the signal that ended it.
        start_s: requested start in the motion.
        slowed: factor by which the motion was slowed to keep the joints' speed limits, or 1.
        commands: number of LowCmds written.
        rate_hz, nominal_rate_hz: LowCmds per second, achieved and nominal.
        lateness_us: each write minus its deadline; a skipped tick has no write.
        skipped_ticks: ticks that were a whole period late or more.
        worst_work_us: longest time from a write to the end of the tick's computation.
        ramp_s: length of RAMP.
        ramp_speed_rad_s: highest speed in RAMP of `ramp_joint`, the joint with the longest way.
        delay_s: delay of the motion's end because the loop stalled.
        waited_s: delay of the motion's end because it followed the robot's time; None if it does
            not follow it.
        clamped_ticks: joint -> ticks in which its target was clamped to a position limit, most
            first.
        speed_limited_ticks: joint -> ticks in which its target was limited to its highest speed.
        torque_limited_ticks: joint -> ticks in which its target was moved towards the measured
            position, because the servo would have exceeded the motor's torque limit.
        saturated_ticks: joint -> ticks in which its feed-forward torque was clamped to its limit.
        feedforward: kind of feed-forward at the start of RAMP.
        support: assumed support of the robot.
        preview_s: time by which commands were ahead of the reference (`stream.preview`).
        feedforward_changes: changes of the feed-forward torque, in order.
        balance: for a robot on its feet.
        robot: name of the model of the feed-forward torques.
        time_scale: median of simulated over real time, if it was measured.
        states_used: LowStates that were the newest at a tick.
        states_wrong_crc: LowStates that were dropped because of their CRC.
        states_received: all received LowStates.
        states_lost: missing LowStates by the ticks of the others; None if the publisher is not
            g1stream's bridge, whose ticks number its LowStates.
        dds_lost: LowStates that DDS reports as lost.
        tick_jumps: steps of LowState's tick that skipped at least one. For publishers other than
            g1stream's bridge only a hint, because unitree_mujoco's ticks jump without a loss.
        states_malformed: samples on the topic that were no LowState.
        state_restarts: how often the ticks of LowState restarted.
        commands_dropped: LowCmds that could not be written at once.
        realtime: requested and granted real-time properties of the system.
        findings: causes and remedies on DDS if no command was sent.
        lateness_histogram_us: lower edge of a 1 us bin -> ticks.
    """

    reason: str | None = None
    stop: StopKind | None = None
    signal: Int | None = None
    start_s: float | None = None
    slowed: float | None = None
    commands: Int | None = None
    rate_hz: float | None = None
    nominal_rate_hz: float | None = None
    lateness_us: Percentiles | None = None
    skipped_ticks: Int | None = None
    worst_work_us: float | None = None
    ramp_s: float | None = None
    ramp_speed_rad_s: float | None = None
    ramp_joint: str | None = None
    delay_s: float | None = None
    waited_s: float | None = None
    clamped_ticks: dict[str, Int] | None = None
    speed_limited_ticks: dict[str, Int] | None = None
    torque_limited_ticks: dict[str, Int] | None = None
    saturated_ticks: dict[str, Int] | None = None
    feedforward: FeedForwardKind | None = None
    support: StreamSupport | None = None
    preview_s: float | None = None
    feedforward_changes: list[FeedForwardChange] = []
    balance: BalanceSummary | None = None
    robot: str | None = None
    time_scale: float | None = None
    states_used: Int | None = None
    states_wrong_crc: Int | None = None
    states_received: Int | None = None
    states_lost: Int | None = None
    dds_lost: Int | None = None
    tick_jumps: Int | None = None
    states_malformed: Int | None = None
    state_restarts: Int | None = None
    commands_dropped: Int | None = None
    realtime: list[Grant] = []
    findings: list[Finding] = []
    lateness_histogram_us: dict[Int, Int] | None = None  # last, as it is long


class TopicDelay(Record):
    """Latency of a topic's messages.

    Attributes:
        hosts: hosts of the publishers.
        median_ns: median of log minus publish time, in the last minutes.
        clock_offset_estimate_ns: that median as an estimate of the clocks' offset, including the
            transit time, if a publisher is on another host.
    """

    hosts: list[str] = []
    median_ns: Int | None = None
    clock_offset_estimate_ns: Int | None = None


class MeasuredTf(Record):
    """How the measured robot was placed in the world of the reference.

    Attributes:
        yaw_offset_rad: angle added to the measured yaw; None without a known attitude.
        position_from: sportmodestate, reference or none.
    """

    yaw_offset_rad: float | None = None
    position_from: str | None = None


class RecorderSummary(Record):
    """Contents of a recording, and losses. Topics are those of the file.

    Attributes:
        path: the file.
        removed: whether it was removed, because nothing was received.
        first_ns, last_ns: log times of the first and the last sample, since the epoch.
        counts: number of messages by topic.
        absent: DDS topics without a publisher.
        lost: number of samples known to be lost, by topic.
        malformed: number of samples of another type, which are not in the file, by topic.
        publishers: programs that published at the same time, by topic of the state and of commands;
            empty with one publisher.
        dropped_datagrams: datagrams that the kernel discarded because its buffer was full; their
            topic is unknown.
        stopped: why the recording ended before it was stopped; otherwise empty.
        realtime_minus_monotonic_ns: the two clocks of this host, at the first and last reading.
        clock_steps: times and sizes of steps of CLOCK_REALTIME.
        delays: by topic.
        measured_tf: how the measured robot was placed.
        warnings: warnings in the log, from `g1stream.session.streams.Warnings`.
    """

    path: str = ""
    removed: bool = False
    first_ns: Int | None = None
    last_ns: Int | None = None
    counts: dict[str, Int] = {}
    absent: list[str] = []
    lost: dict[str, Int] = {}
    malformed: dict[str, Int] = {}
    publishers: dict[str, list[str]] = {}
    dropped_datagrams: Int = 0
    stopped: str = ""
    realtime_minus_monotonic_ns: tuple[Int, Int] | None = None
    clock_steps: list[ClockStep] = []
    delays: dict[str, TopicDelay] = {}
    measured_tf: MeasuredTf | None = None
    warnings: list[str] = []

    @property
    def complete(self) -> bool:
        """Whether the file is known to have all samples published until the end."""
        lacking = (self.dropped_datagrams, *self.lost.values(), *self.malformed.values())
        return not self.stopped and not any(lacking)
