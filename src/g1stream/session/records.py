"""Records: what stream and recorder write as JSON into a session file, and what is read back.

`SessionInfo` is known before the first sample, `StreamSummary` and `RecorderSummary` at the end.
None stands for what is not known; units are part of the names.
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
from g1stream.types import FeedForwardKind, Phase, StreamSupport

if TYPE_CHECKING:
    from collections.abc import Mapping

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
    """What is written as JSON; its numbers are finite."""

    # A file of another version may have more fields, or fewer.
    # Each is built when it is first used: a stream starts without most of them.
    model_config = ConfigDict(
        extra="ignore", allow_inf_nan=False, validate_default=False, defer_build=True
    )


RecordT = TypeVar("RecordT", bound=BaseModel)


def read_record(
    kind: type[RecordT], values: Any, where: str = ""
) -> tuple[RecordT | None, list[str]]:
    """A record from the metadata of a session file, whoever wrote it.

    Args:
        kind: the class of the record; all its fields have defaults.
        values: as they are in the file; None where there are none.
        where: the key that they are under, for the sentences.

    Returns:
        The record without the fields whose values are not valid, None where there is no record at
        all; and a sentence for each value that was left out.
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
    keys = [f"{where}.{name}" if where else name for name in wrong]
    problems = [
        f"The metadata {k} is not valid: {values[w]!r:.60}."
        for k, w in zip(keys, wrong, strict=True)
    ]
    return record, problems + more


class Percentiles(Record):
    """Of a latency or lateness; the field that it is in names the unit."""

    p50: float
    p99: float
    p99_9: float
    max: float


class PhaseInterval(Record):
    """A phase from start to end, s on the motion's clock: its first frame is at 0."""

    phase: PhaseName
    start_s: float
    end_s: float

    @property
    def duration_s(self) -> float:
        """How long it lasted, s."""
        return self.end_s - self.start_s


class MotionInfo(Record):
    """The motion that was played.

    Attributes:
        name: of the motion.
        fps: frames per second of its file.
        frames: how many.
        sha256: of its file.
        content_sha256: of its frames, see `Motion.content_sha256`.
        source: path of its file.
        operations: what was done to the motion in the file, in this order.
        parts: the motions that it was joined of, in their order.
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
        """From the first frame to the last, s."""
        return (self.frames - 1) / self.fps if self.frames and self.fps else None


class ParametersInfo(Record):
    """The parameters of the robot that were in use, see `g1stream.robot.parameters`.

    Attributes:
        path: of their file.
        sha256: of that file.
        values: as the file has them.
    """

    path: str | None = None
    sha256: str | None = None
    values: dict[str, Any] = {}

    @classmethod
    def from_robot(cls, robot: G1) -> ParametersInfo | None:
        """Those of a robot; None where it has the default ones."""
        parameters = robot.parameters
        if parameters.path is None:
            return None
        return cls(
            path=str(parameters.path), sha256=parameters.sha256, values=dict(parameters.values)
        )

    def __str__(self) -> str:
        """In a line: the file, and how many values of each kind, or the one."""
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
        path: of its ONNX file.
        sha256: of that file.
        data_sha256: of the file beside it that has its weights; None where there is none.
        trained_mean, trained_std: of each value of the observation in training, where the network
            normalises by them; empty where it does not.
        contract: what it takes and gives, as `g1stream policy --json` prints it.
    """

    path: str | None = None
    sha256: str | None = None
    data_sha256: str | None = None
    trained_mean: list[float] = []
    trained_std: list[float] = []
    contract: dict[str, Any] = {}

    @property
    def columns(self) -> dict[str, slice]:
        """Where each term is in the observation, by name; empty where the file does not tell."""
        try:
            sizes = [(str(one["name"]), int(one["size"])) for one in self.contract["terms"]]
        except (KeyError, TypeError, ValueError, OverflowError):
            return {}
        ends = list(accumulate(size for _, size in sizes))
        if not ends or min(size for _, size in sizes) < 0:
            return {}
        return {name: slice(end - size, end) for (name, size), end in zip(sizes, ends, strict=True)}


AttachedBy = Literal["commands", "arm commands", "measured joints"]
"""What tells when a motion was played."""


class AttachedInfo(Record):
    """Where a motion was found in a session that was recorded without a reference.

    Attributes:
        by: what was compared with the motion. By measured joints a robot that is late cannot be
            told from a motion that began later.
        start_s: when the motion's first frame was or would have been played, after the first sample
            of what was compared.
        speed: seconds of the motion in a second of the session.
        first_s, last_s: the part of the motion that was played.
        similarity: normalised cross-correlation of all joints' velocities in that part, up to 1.
        rmse_rad: of the positions compared, without the mean error of each joint.
        rival: similarity of the second best place in the motion; None where no other is similar.
        play, plays: which time it is that the motion was played in the session, from 1, and how
            often it was.
        starts_s: when each of them began, with the part that was played, after the first sample.
        heading_from: of the reference: imu, or none, where it is the motion's own.
        place_from: of the reference: sportmodestate, or none, likewise.
        moves: whether the measured pelvis went about as far as the motion's, which tells that the
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
        """Whether the robot told when the motion began, so that no delay of it is known."""
        return self.by == "measured joints"


class ClockStep(Record):
    """CLOCK_REALTIME was set by `step_ns` when, after that, it was `at_ns`."""

    at_ns: Int | None = None
    step_ns: Int


class SessionInfo(Record):
    """What is known of a session before its first sample: the file's metadata as it begins.

    Attributes:
        g1stream: version that recorded it.
        versions: of the packages that it used.
        log: what was made of the log of another program; empty of a session.
        host, domain, interface: where it was recorded.
        log_clock: that of the log times; of a rollout it begins with "simulated".
        clock_steps: when it was set while this was recorded, and by how much.
        motion: what is played.
        gains: kp in N·m/rad and kd in N·m·s/rad, 29 each, motor order.
        joints: names of those that play the motion; None in files of earlier versions: all.
        absent: names of those that the robot does not have.
        policy: that plays; None where none does.
        params: parameters of the robot that were given; None for the default ones.
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
        policy: PolicyInfo | None = None,
    ) -> SessionInfo:
        """Describe a motion that is about to be played.

        Args:
            config: all settings.
            robot: that plays it.
            motion: what is played.
            gains: arrays (29,) by the names in `Gains`.
            policy: that plays it.
        """
        params = ParametersInfo.from_robot(robot)
        told: dict[str, Any] = {"policy": policy} if policy else {}
        told |= {"params": params} if params else {}
        return cls(
            **told,
            motion=MotionInfo.from_motion(motion),
            gains={name: values.tolist() for name, values in gains.items()},
            joints=[
                JOINT_NAMES[i] for i in np.flatnonzero(robot.select(config.stream.played_joints))
            ],
            absent=[JOINT_NAMES[i] for i in robot.joint_set.absent],
            config=config.model_dump(mode="json"),
        )


class Finding(Record):
    """The result of a check: why no command was sent, or what the doctor says.

    Attributes:
        about: what was checked, in a word or two.
        cause: what was found.
        remedy: what to do about it; empty where there is nothing to do.
    """

    about: str
    cause: str
    remedy: str = ""


class FeedForwardChange(Record):
    """The feed-forward torque was switched off, or on again.

    Attributes:
        motion_time_s: when in the motion.
        kind: of feed-forward from then on.
        reason: why; empty where the reason to do without is gone.
    """

    motion_time_s: float
    kind: FeedForwardKind
    reason: str = ""


class BalanceSummary(Record):
    """How near a robot on its feet was to falling: the worst values of PLAY and HOLD.

    Attributes:
        capture_margin_m: from the capture point to the edge of the soles; negative outside.
        tilt_rad: of the pelvis against the reference.
        height_error_m: of the pelvis, above or below the reference.
        feet_error_m: of the one foot's place beside the other, while both stand: it slipped, or
            was put down elsewhere.
        carried: share of the weight on the feet; the rest is in the air, or hangs from a band.
        lifts: how often a foot was lifted.
        unsolved_ticks: without forces of the floor that keep the robot on its feet.
    """

    capture_margin_m: float
    tilt_rad: float
    height_error_m: float
    feet_error_m: float
    carried: float
    lifts: Int
    unsolved_ticks: Int


class StreamSummary(Record):
    """What the stream counted.

    Attributes:
        reason: why it ended early; empty when it ended as asked.
        start_s: where in the motion it was to begin.
        slowed: factor by which the motion was slowed to fit the joints' speeds; 1 where it was not.
        commands: LowCmds written.
        rate_hz, nominal_rate_hz: LowCmds per second, achieved and asked for.
        lateness_us: of each write against its deadline; a skipped tick has no write.
        skipped_ticks: left out because they were a whole period late or more.
        worst_work_us: longest time from a write to the end of the tick's computation.
        ramp_s: length of RAMP.
        ramp_speed_rad_s: highest speed of `ramp_joint`, the joint with the longest way, in it.
        delay_s: by which the motion ended later, because the loop stalled.
        waited_s: by which it ended later, because it kept to the robot's time; None where it does
            not.
        clamped_ticks: joint -> ticks at which its target was held at a position limit, most first.
        speed_limited_ticks: joint -> ticks at which its target was held back to its highest speed.
        torque_limited_ticks: joint -> ticks at which its target was brought nearer to the measured
            position, because the servo would have asked for more torque than the motor has.
        saturated_ticks: joint -> ticks at which its feed-forward torque was held at its limit.
        feedforward: what commands carried beside the position when RAMP began.
        support: how the robot was taken to be held.
        preview_s: by which commands were ahead of the reference (`stream.preview`).
        feedforward_changes: when the torque was switched off and on again, in order.
        balance: of a robot on its feet.
        robot: name of the model that feed-forward torques were computed with.
        time_scale: median of simulated over real time, where it was measured.
        command_delay_s: longest age of the commands that the motors' torques followed, because
            they had waited in a queue; 0 where it was below 0.1 s, None where it is unknown.
        states_used: LowStates that were the newest at a tick.
        states_wrong_crc: LowStates that were dropped because of their CRC.
        states_received: all of them.
        states_lost: LowStates that did not arrive, by the ticks of those that did; None where the
            publisher is not our own bridge, whose ticks number its LowStates.
        dds_lost: LowStates that DDS itself reports as lost.
        tick_jumps: steps of LowState's tick that skipped at least one; of another publisher than
            our bridge no more than a hint, because unitree_mujoco's ticks jump without a loss.
        states_malformed: samples on the topic that were no LowState.
        state_restarts: how often the ticks of LowState began anew.
        commands_dropped: LowCmds that could not be written at once.
        realtime: what was asked of the system to be on time, and what it granted.
        findings: where no command was sent, what DDS shows of why, and what to do.
        lateness_histogram_us: lower edge of a 1 us bin -> ticks.
    """

    reason: str | None = None
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
    command_delay_s: float | None = None
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
    """How long the messages of a topic took.

    Attributes:
        hosts: of the publishers.
        median_ns: of log minus publish time, in the last minutes.
        clock_offset_estimate_ns: where a publisher is on another host, that median as the offset
            between the clocks, transit included.
    """

    hosts: list[str] = []
    median_ns: Int | None = None
    clock_offset_estimate_ns: Int | None = None


class MeasuredTf(Record):
    """How the measured robot was placed in the world of the reference.

    Attributes:
        yaw_offset_rad: what was added to the measured yaw; None where no attitude was known.
        position_from: sportmodestate, reference or none.
    """

    yaw_offset_rad: float | None = None
    position_from: str | None = None


class RecorderSummary(Record):
    """What a recording holds, and what it lacks; topics are those of the file.

    Attributes:
        path: the file, or the directory of its parts.
        paths: the files.
        removed: whether they were removed, because nothing was received.
        first_ns, last_ns: log times of the first and the last sample, since the epoch.
        counts: messages by topic.
        absent: topics of DDS that nobody published.
        lost: by topic, samples known to be lost.
        malformed: by topic, samples that were not of its type and are not in the file.
        publishers: by topic of the state and of commands, the programs that published at the same
            time; empty where there was one.
        dropped_datagrams: received by the kernel, and discarded because its buffer was full; of
            which topic is not known.
        stopped: why the recording ended before it was told to; empty when it did not.
        realtime_minus_monotonic_ns: the two clocks of this host, at the first and last reading.
        clock_steps: when CLOCK_REALTIME was set, and by how much.
        delays: by topic.
        measured_tf: how the measured robot was placed.
        warnings: those in the log, as `g1stream.session.streams.warnings_in` tells them.
    """

    path: str = ""
    paths: list[str] = []
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
        """Whether, as far as is known, everything published until the end is in the file."""
        lacking = (self.dropped_datagrams, *self.lost.values(), *self.malformed.values())
        return not self.stopped and not any(lacking)
