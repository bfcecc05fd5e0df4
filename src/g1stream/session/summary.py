"""The summary of a session: what `stream`, `record`, `demo` and `info` print, and `--json` dumps.

Field names are those of the JSON; units are part of them. None stands for what is not known.
"""

from __future__ import annotations

from typing import Any, Final

from pydantic import computed_field

from g1stream.session.info import MotionInfo
from g1stream.session.recorder_summary import RecorderSummary
from g1stream.session.records import Int, Percentiles, PhaseName, Record
from g1stream.session.stream_summary import StreamSummary

__all__ = [
    "TO_ITS_END",
    "JointTracking",
    "MessageStats",
    "PhaseInterval",
    "Summary",
    "Termination",
    "TrackingSummary",
]

TO_ITS_END: Final = 0.1
"""Played to within this of the end that was asked for, s, a motion was played to its end."""


class PhaseInterval(Record):
    """A phase from start to end, s on the motion's clock: its first frame is at 0."""

    phase: PhaseName
    start_s: float
    end_s: float

    @property
    def duration_s(self) -> float:
        """How long it lasted, s."""
        return self.end_s - self.start_s


class Termination(Record):
    """How a session ended.

    Attributes:
        reason: why the stream ended early; empty when it ended as asked, None where that is not
            known.
        undamped_in: the phase in which the stream process ended without DAMP; None where it did
            not.
        guard: what the guard process logged when it damped the robot; None where it did not.
        played_s: how long PLAY lasted.
        motion_s: how long the motion is.
        start_s: where in the motion PLAY was to begin.
    """

    reason: str | None = None
    undamped_in: PhaseName | None = None
    guard: str | None = None
    played_s: float | None = None
    motion_s: float | None = None
    start_s: float = 0.0


class MessageStats(Record):
    """The messages of a topic; for those that the recorder derives, only their number.

    Attributes:
        count: messages in the file.
        lost: samples known to be lost.
        rate_hz: messages per second from the first to the last publish time.
        gaps: publish intervals of more than 3 medians.
        longest_interval_s: between two publish times.
        latency_us: log time - publish time; where the two clocks differ, that is in it. None where
            both are a simulation's.
        clock_offset_s: what must be added to publish times to be on the recorder's clock; 0 where
            the clocks agree as far as can be seen.
    """

    count: Int
    lost: Int | None = None
    rate_hz: float | None = None
    gaps: Int | None = None
    longest_interval_s: float | None = None
    latency_us: Percentiles | None = None
    clock_offset_s: float | None = None


class JointTracking(Record):
    """The tracking error of a joint, reference - measured.

    Attributes:
        rmse_rad: root mean square.
        mean_rad: mean, such as the sag under gravity.
        max_abs_rad: the greatest error, either way.
        max_abs_at_s: when that was, since the motion's first frame.
    """

    rmse_rad: float
    mean_rad: float
    max_abs_rad: float
    max_abs_at_s: float


class TrackingSummary(Record):
    """How closely the robot followed the reference in PLAY.

    Attributes:
        rmse_rad: of all joints together.
        rmse_by_limb_rad: of the joints of each limb together.
        worst_joint: the one of the greatest RMSE.
        compared_states: LowStates that were compared with the reference.
        excluded_states: LowStates in PLAY that lie in a gap of the reference, or are not finite.
        compared_s: length of PLAY, gaps left out.
        ramp_s: length of RAMP.
        ramp_speed_rad_s: highest speed of `ramp_joint`, the joint with the longest way, in it.
        delay_s: by which the robot is behind the reference; None where that cannot be determined.
        rmse_without_delay_rad: RMSE with the reference that much later.
        rmse_without_delay_and_mean_rad: the same without each joint's mean error.
        joints: by name.
    """

    rmse_rad: float
    rmse_by_limb_rad: dict[str, float]
    worst_joint: str
    compared_states: Int
    excluded_states: Int
    compared_s: float
    delay_s: float | None
    rmse_without_delay_rad: float | None
    rmse_without_delay_and_mean_rad: float | None
    joints: dict[str, JointTracking]


class Summary(Record):
    """What is in a session and how well it went.

    Attributes:
        files_bytes: path of each file -> size, oldest first.
        complete: whether all files are there and were closed properly.
        first_ns, last_ns: log times of the first and the last message, since the epoch.
        simulated: whether its times are a simulation's, as in a rollout, and not of any clock.
        host, domain, interface: where it was recorded, or streamed.
        versions: of g1stream and the packages that it used.
        motion: what was played.
        settings: those that are not the defaults, keyed like `stream.rate`.
        gains: lowest and highest kp in N·m/rad and kd in N·m·s/rad.
        joints: names of those that played the motion; None where that is not known.
        absent: names of those that the robot does not have.
        phases: in order.
        termination: how it ended.
        feedforward_log: what was logged of feed-forward, also by a stream that was killed.
        recorder: what the recorder counted.
        tracking: how closely the robot followed.
        topics: the messages of each topic.
        attachments_bytes: name -> size.
        problems: what is wrong, a sentence each, the most important first.
        stream: what the stream counted.
    """

    files_bytes: dict[str, Int] = {}
    complete: bool | None = None
    first_ns: Int | None = None
    last_ns: Int | None = None
    simulated: bool = False
    host: str | None = None
    domain: Int | None = None
    interface: str | None = None
    versions: dict[str, str] = {}
    motion: MotionInfo | None = None
    settings: dict[str, Any] | None = None
    gains: dict[str, tuple[float, float]] | None = None
    joints: list[str] | None = None
    absent: list[str] = []
    phases: list[PhaseInterval] = []
    termination: Termination = Termination()
    feedforward_log: list[str] = []
    recorder: RecorderSummary | None = None
    tracking: TrackingSummary | None = None
    topics: dict[str, MessageStats] = {}
    attachments_bytes: dict[str, Int] = {}
    problems: list[str] = []
    stream: StreamSummary | None = None

    @computed_field  # type: ignore[prop-decorator]
    @property
    def duration_s(self) -> float | None:
        """From the first message to the last, s."""
        if self.first_ns is None or self.last_ns is None:
            return None
        return (self.last_ns - self.first_ns) / 1e9

    def __str__(self) -> str:
        from g1stream.analysis.summary_text import render

        return render(self)
