"""A session, from a file, a directory of files or memory, as numpy arrays."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from types import NoneType
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np

from g1stream.dds.messages import Samples
from g1stream.optional import extension
from g1stream.robot.model import G1
from g1stream.session.columns import CONVERTED, Columns, samples
from g1stream.session.parts import SessionFiles
from g1stream.session.stream import Stream
from g1stream.session.streams import Base, Command, LogEvent, Measured, Reference, TorsoImu
from g1stream.types import Camera, Floats, Phase

if TYPE_CHECKING:
    import os
    from collections.abc import Callable, Iterator, Mapping, Sequence

    import pandas
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from g1stream.analysis.tracking import Tracking
    from g1stream.motion.motion import Motion
    from g1stream.session.metrics import Metrics
    from g1stream.session.source import SessionSource
    from g1stream.session.summary import PhaseInterval, Summary

__all__ = ["LogEvent", "Message", "Session", "open_session"]

T = TypeVar("T")
StreamT = TypeVar("StreamT", bound=Stream)


class Message(NamedTuple):
    """One message as it is in the file.

    Attributes:
        log_time: when the recorder received it, ns since the epoch.
        publish_time: when its producer published it, ns since the epoch.
        data: its bytes; of a DDS topic exactly those of the sample, CDR header included.
    """

    log_time: int
    publish_time: int
    data: bytes


def open_session(path: str | os.PathLike[str]) -> Session:
    """Open a session file, also one whose recorder was killed.

    Args:
        path: of a session file, or of the directory of a split recording.

    Raises:
        RecordingError: there is no such file, or it is no session, or it is damaged.
    """
    return Session(SessionFiles(Path(path)))


class Session:
    """The samples, events, metadata and attachments of one run.

    Columns of a topic are read when they are first used, and kept. Whatever reads them raises a
    RecordingError where the file is damaged, or a topic that it needs is not in this session.

    Args:
        source: what it is read from; `open_session` gives the files on disk.

    Attributes:
        path: of the file or directory; of a session in memory only a name.
        paths: of the file or its parts, oldest first; empty in memory.
        absent_parts: by number of a part that is missing or cannot be read: why, a sentence.
        complete: whether everything is there and was closed properly.
        topics: number of messages by topic, in the whole session.
        metadata: what stream and recorder wrote about the session.
    """

    def __init__(self, source: SessionSource) -> None:
        self._source = source
        self.path = source.path
        self.paths = source.paths
        self.absent_parts = source.absent_parts
        self.complete = source.complete
        self.topics = source.topics
        self.metadata = source.metadata
        self._columns = Columns(source)
        self._kept: dict[object, Any] = {}

    def _once(self, what: object, make: Callable[[], T]) -> T:
        """What is made when it is first used, and kept."""
        if what not in self._kept:
            self._kept[what] = make()
        kept: T = self._kept[what]
        return kept

    def __repr__(self) -> str:
        counts = ", ".join(f"{topic} {n}" for topic, n in sorted(self.topics.items()) if n)
        whole = "" if self.complete else ", not closed by its recorder"
        return f"<Session {str(self.path)!r}: {counts}{whole}>"

    @property
    def converted(self) -> bool:
        """Whether it is what `g1stream convert` made of a motion, which nobody has played."""
        return bool(
            self.paths and self.topics.get(CONVERTED) and not self.topics.get(Reference.topic)
        )

    @property
    def reference(self) -> Reference:
        """The target at each tick, computed from the motion."""
        return self.stream(Reference)

    @property
    def command(self) -> Command:
        """The commands to the motors."""
        return self.stream(Command)

    @property
    def measured(self) -> Measured:
        """The state of the robot."""
        return self.stream(Measured)

    @property
    def base(self) -> Base | None:
        """Position of the pelvis; None where it was not published, as by a real robot."""
        return self.stream(Base) if self.topics.get(Base.topic) else None

    @property
    def torso_imu(self) -> TorsoImu | None:
        """The IMU in the torso; None where it was not published."""
        return self.stream(TorsoImu) if self.topics.get(TorsoImu.topic) else None

    def stream(self, kind: type[StreamT]) -> StreamT:
        """The samples of a DDS topic.

        Args:
            kind: one of the values of `STREAMS`.
        """
        return self._once(kind, lambda: self._make_stream(kind))

    def _make_stream(self, kind: type[StreamT]) -> StreamT:
        self._columns.require(kind.topic)
        stream = kind(
            lambda names: self._columns.of({kind: names})[kind],
            lambda: stream.since(self.start_ns),
        )
        return stream

    def read(self, columns: Mapping[type[Stream], Sequence[str]]) -> None:
        """Read columns of several streams in one pass, which takes less time than one each.

        Args:
            columns: names by stream, all of its columns if there are none. Of a topic without
                messages nothing is read.

        Raises:
            RecordingError: the file is damaged, or a stream has no such column.
        """
        streams = {kind: self.stream(kind) for kind in columns if self.topics.get(kind.topic)}
        missing = {kind: stream.missing(*columns[kind]) for kind, stream in streams.items()}
        wanted = {kind: names for kind, names in missing.items() if names}
        for kind, found in self._columns.of(wanted, as_recorded=False).items() if wanted else ():
            streams[kind].keep(found)

    @cached_property
    def robot(self) -> G1:
        """The robot of the attached URDF; the default one where none is attached.

        Raises:
            RobotError: the URDF cannot be used.
        """
        urdf = self.attachments.get("robot.urdf")
        if urdf is None:
            return G1.default()
        return G1.from_urdf(urdf.decode(errors="replace"), f"robot.urdf of {self.path}")

    @cached_property
    def attachments(self) -> dict[str, bytes]:
        """The attached files by name."""
        return self._source.attachments()

    @cached_property
    def log(self) -> list[LogEvent]:
        """The events of the session, in the order of the file."""
        return [
            LogEvent.decode(data)
            for _, batch in self._source.batches({"/log"})
            for data in batch.data
        ]

    @cached_property
    def times(self) -> dict[str, Stream]:
        """By topic, the times of its messages; of all topics, so it takes a while to read."""
        return self._read_times([topic for topic, n in sorted(self.topics.items()) if n])

    def _read_times(self, topics: Sequence[str]) -> dict[str, Stream]:
        def stream(columns: Mapping[str, NDArray[Any]]) -> Stream:
            made = Stream(lambda _: columns, lambda: made.since(self.start_ns))
            return made

        return {topic: stream(found) for topic, found in self._columns.times(topics).items()}

    def messages(self, topic: str) -> Iterator[Message]:
        """The messages of any topic, one after the other, in the order of the file."""
        self._columns.require(topic)
        for _, batch in self._source.batches({topic}):
            times = batch.log_times.tolist(), batch.publish_times.tolist()
            yield from map(Message, *times, batch.data)

    def replay_bytes(self, topic: str = Command.topic) -> Iterator[bytes]:
        """The samples of a DDS topic, bit for bit as they were published, in order."""
        return (message.data for message in self.messages(topic))

    def samples(self, kind: type[Stream], data: Sequence[bytes] | NDArray[np.uint8]) -> Samples:
        """The fields of samples of a DDS topic, from their bytes.

        Raises:
            RecordingError: one of them is not of the topic's type.
        """
        return samples(kind, data, self.path)

    @cached_property
    def start_ns(self) -> int:
        """Time 0 of the motion's clock, ns since the epoch on the recorder's clock.

        That is when the motion's first frame was or would have been published; where nothing was
        played, the first sample of the reference, or else of the commands or the state; of a
        converted motion, its first frame.
        """
        for kind in (Reference, Command, Measured):
            if self.topics.get(kind.topic):
                return self.stream(kind).start_ns
        return self._read_times([CONVERTED])[CONVERTED].start_ns

    @property
    def phases(self) -> list[PhaseInterval]:
        """The phases in order, in s on the motion's clock: its first frame is at 0.

        Each lasts until the next one begins, the last until the last sample of the reference.
        Empty where there is no reference.

        Raises:
            RecordingError: a number stands for no phase.
        """
        return self.reference.phases if self.topics.get(Reference.topic) else []

    def sel(self, phase: str | Phase | None = None, time: slice | None = None) -> Session:
        """The part of the session in a phase, in a time range, or in both.

        Streams, times, messages and the log are restricted to it, by publish time; `topics`,
        metadata and attachments are those of the whole session.

        Args:
            phase: such as `"PLAY"`.
            time: s on the motion's clock, such as `slice(2.0, 5.0)`, both included.

        Raises:
            RecordingError: there is no phase of this name.
            TypeError: `time` is not a slice.
        """
        if not isinstance(time, (slice, NoneType)):
            raise TypeError(f"time takes a slice of seconds, such as slice(2.0, 5.0), not {time!r}")
        from g1stream.session.selection import select

        return select(self, phase, time)

    def tracking(self) -> Tracking:
        """How closely the robot followed the reference in PLAY.

        Raises:
            RecordingError: there is nothing to compare.
        """
        from g1stream.analysis.tracking import tracking

        return self._once(tracking, lambda: tracking(self))

    def summary(self) -> Summary:
        """What is in the session, how well it went, and its problems; `print` shows it."""
        from g1stream.analysis.summary import summarise

        return self._once(summarise, lambda: summarise(self))

    def commanded_torque(self) -> Floats:
        """(M, 29) N·m, float32, that the newest command asked for at each of the M LowStates.

        nan where it is more than 100 ms old, or where command or state is not finite.

        Raises:
            RecordingError: there are no states or no commands.
        """
        from g1stream.analysis.torque import commanded_torque

        return self._once(commanded_torque, lambda: commanded_torque(self))

    def metrics(self) -> Metrics:
        """How well it went, in the metrics of motion-tracking papers; docs/metrics.md defines them.

        What cannot be told is None: of a session without a reference there are torque and timing.

        Raises:
            RecordingError: the file is damaged.
        """
        from g1stream.analysis.metrics import metrics

        return metrics(self)

    def plot(
        self, joints: Sequence[str] | str | None = None, what: Sequence[str] | None = None
    ) -> Figure:
        """Some joints over time, with the phases shaded, as one figure.

        Without arguments: the joints that move most, the error over time and each joint's RMSE;
        `joints` are shown instead where they are up to six. With more joints or with `what`: a
        panel for each joint and quantity, of what the session has.

        Args:
            joints: names, such as "left_knee", or regular expressions that match whole names.
            what: of "q", "dq", "tau" and "error": position, velocity, torque, tracking error.

        Raises:
            ConfigError: there is no such quantity.
            RecordingError: there is nothing to plot, or no such joint.
        """
        from g1stream.analysis.plots import plot

        return plot(self, joints, what)

    def render(
        self,
        path: str | os.PathLike[str],
        *,
        start: float | None = None,
        duration: float | None = None,
        fps: float = 25.0,
        size: tuple[int, int] = (640, 480),
        camera: Camera = "oblique",
        force: bool = False,
    ) -> Path:
        """Write a video or a picture: the measured robot, and over it the reference as a ghost.

        The ghost has the reference's joints on the measured pelvis. Time, phase and the RMS error
        of all joints are written into each frame. Without a reference or without a measured state,
        what there is is shown. The robot has the real G1's meshes with the extra `meshes`, else
        primitive shapes. MP4 needs the extra `video`.

        Args:
            path: ends in .mp4, .gif, or .png for the frame at `start`.
            start: s on the motion's clock; the beginning of the session if None.
            duration: s; to the end if None, or if that comes first.
            fps: frames per second, in the session's own time.
            size: width and height, pixels.
            camera: where it stands around the robot, which it follows.
            force: replace a file that is there.

        Raises:
            ConfigError: the suffix, the size or `fps` cannot be used, or a package for MP4 is not
                installed.
            RecordingError: there is nothing to show there, or the file cannot be written.
            RobotError: the session's URDF cannot be used.
            SimError: there is no OpenGL to draw with.
        """
        how = {"start": start, "duration": duration, "fps": fps, "size": size, "camera": camera}
        written: Path = extension("render")(self, Path(path), **how, force=force).path
        return written

    def motion(self, fps: float | None = None) -> Motion:
        """The motion that was played, as the reference has it; or what `convert` made of a motion.

        Args:
            fps: frames per second; the rate of the reference if None.

        Raises:
            RecordingError: there is no motion in this session.
            MotionError: `fps` is not a frame rate, or leaves less than two frames.
        """
        from g1stream.motion.readers import MotionFile
        from g1stream.session.motions import recorded_motion, reference_motion

        if self.converted and (recorded := recorded_motion(MotionFile(self.path, fps))):
            return recorded.motion()
        return reference_motion(self.reference, self.path, fps)

    def save(self, path: str | os.PathLike[str], *, force: bool = False) -> Path:
        """Write the session into one MCAP file: such as a rollout, or the part in a phase.

        Messages on g1stream's own topics are written byte for byte, with both their times, and the
        metadata and attachments of the whole session with them.

        Args:
            path: of the file; its directory must exist.
            force: replace a file that is there.

        Raises:
            RecordingError: the file cannot be written.
        """
        from g1stream.session.export import save

        return save(self, Path(path), force=force)

    def to_dataframe(self, topic: str) -> pandas.DataFrame:
        """The samples of a topic as a pandas table; needs the extra `export`.

        Args:
            topic: one of `STREAMS`, such as `/lowstate`.

        Returns:
            A row for each sample, indexed by `publish_time`, UTC to the nanosecond, as is the
            column `log_time`; `time` is in s on the motion's clock. Other columns are named as
            those of the topic's stream, arrays by joint or axis: `q.left_knee_joint`,
            `root_pos.x`, `imu_quat_wxyz.w`. Units are those of the stream.

        Raises:
            ConfigError: pandas is not installed.
            RecordingError: the topic is not one of those.
        """
        from g1stream.session.export import to_dataframe

        return to_dataframe(self, topic)

    def to_parquet(self, directory: str | os.PathLike[str]) -> list[Path]:
        """Write the tables of all topics: /lowstate into lowstate.parquet, and so on.

        Args:
            directory: made where it is missing. Files of these names are replaced.

        Returns:
            The files.

        Raises:
            ConfigError: pandas or pyarrow is not installed.
            RecordingError: a file cannot be written.
        """
        from g1stream.session.export import to_parquet

        return to_parquet(self, Path(directory))
