"""A session: a recording, and its tracking error, metrics, plots, videos and tables."""

from __future__ import annotations

from contextlib import suppress
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from g1stream.dds.messages import Batch
from g1stream.errors import RecordingError
from g1stream.files import begins_with, complete_file, output_errors
from g1stream.optional import extension, import_extra
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS
from g1stream.session.format import CHANNELS
from g1stream.session.recording import Recording, has_essentials
from g1stream.session.source import SessionFiles, files_of
from g1stream.session.streams import STREAMS, PolicyStream
from g1stream.session.writer import SessionWriter

if TYPE_CHECKING:
    import os
    from collections.abc import Mapping, Sequence

    import pandas
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from g1stream.analysis.metrics import Metrics
    from g1stream.analysis.summary import Summary
    from g1stream.analysis.tracking import Tracking
    from g1stream.motion.motion import Motion
    from g1stream.types import Camera

__all__ = ["Session", "open_session"]

#: First bytes of bags other than MCAP: SQLite, and files compressed as a whole.
_BAGS: Final = (b"SQLite format 3", b"\x28\xb5\x2f\xfd")
_EXPORT: Final = "export", "Tables need"
_AXES: Final = {3: ("x", "y", "z"), 4: ("w", "x", "y", "z")}


def open_session(path: str | os.PathLike[str]) -> Session:
    """Open a session or a log of another program. It also opens files of killed recorders.

    Args:
        path: session file, bag, or log; `docs/anyones-session.md` lists
            the supported logs.

    Raises:
        ConfigError: the extra that reads it is not installed.
        RecordingError: there is no such file, or it is no session, or it is damaged.
    """
    path = Path(path)
    foreign = path.suffix.lower() == ".csv" or any(
        begins_with(files_of(path)[0], magic) for magic in _BAGS
    )
    source = None if foreign else SessionFiles(path)
    if source and (has_essentials(source.topics) or not source.has_joint_states):
        return Session(source)
    return Session(extension("open_log")(path))


class Session(Recording):
    """The samples, events, metadata and attachments of one run, and its analysis.

    Columns of a topic are read at first use, and kept. Methods that read them raise a
    RecordingError if the file is damaged, or if the session lacks a topic that they need.
    """

    def tracking(self) -> Tracking:
        """The tracking error in PLAY: how closely the robot followed the reference.

        Raises:
            RecordingError: there is no reference or no measured state to compare.
        """
        from g1stream.analysis.tracking import tracking

        return tracking(self)

    def summary(self) -> Summary:
        """The session's contents, results and problems; `print` shows them."""
        from g1stream.analysis.summarise import summarise

        return summarise(self)

    def metrics(self) -> Metrics:
        """The metrics of motion-tracking papers; docs/metrics.md defines them.

        Metrics that cannot be computed are None; without a reference only torque and timing are
        set.

        Raises:
            RecordingError: the file is damaged.
        """
        from g1stream.analysis.metrics import metrics

        return metrics(self)

    def attach(self, motion: Motion | str | Path, *, play: int = 1) -> Session:
        """The same session, with the motion that was played in it as its reference.

        For recordings of other programs, which have commands and states but no reference.
        `attached` says when the motion was played, and how reliable this is.
        `docs/anyones-session.md` describes the method.

        Args:
            motion: motion that was played completely or in part, or its file.
            play: number of the playback, from 1, if it was played several times.

        Raises:
            MotionError: the motion file cannot be read.
            RecordingError: the session already has a reference, or is a selection; the motion was
                not played in it; or several places in the motion are equally likely.
            ConfigError: it was played fewer times.
        """
        from g1stream.motion.motion import Motion
        from g1stream.motion.readers import load_motion

        if self.selected:
            raise RecordingError(
                "A motion is attached to a whole session.", "Attach it first, then select a part."
            )
        if not isinstance(motion, Motion):
            motion = load_motion(motion)
        return Session(extension("attach")(self, motion, play))

    def plot(
        self, joints: Sequence[str] | str | None = None, what: Sequence[str] | None = None
    ) -> Figure:
        """Plot some joints over time as one figure, with the phases shaded.

        By default it shows the joints that move most, the error over time and each joint's RMSE. Up
        to six `joints` replace the joints that move most. With more joints or with `what` it has a
        panel for each joint and each available quantity.

        Args:
            joints: names or patterns, such as "left_knee", "arms" or "left_*", as a list or
                separated by commas.
            what: quantities from "q", "dq", "tau" and "error": position, velocity, torque, error.

        Raises:
            ConfigError: there is no such quantity or joint.
            RecordingError: there is nothing to plot.
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
        size: tuple[int, int] = (1280, 720),
        camera: Camera = "oblique",
        force: bool = False,
    ) -> Path:
        """Write a video or a picture of the measured robot, with the reference as a ghost.

        The ghost has the reference's joints and the measured pelvis. Each frame shows time, phase
        and RMS error of all joints. If the reference or the measured state is missing, only the
        other is shown. The robot has the real G1's meshes with the extra `meshes`, otherwise
        primitive shapes. MP4 needs the extra `video`.

        Args:
            path: ends in .mp4, .gif, or .png for the frame at `start`.
            start: time of the first frame on the motion's clock, s; the session's start if None.
            duration: length, s; to the end if None or if the session is shorter.
            fps: frames per second, in the session's own time.
            size: width and height, pixels.
            camera: its position around the robot. It follows the robot.
            force: replace an existing file.

        Raises:
            ConfigError: the suffix, the size or `fps` cannot be used, or a package for MP4 is not
                installed.
            RecordingError: there is nothing to show in that time, or the file cannot be written.
            RobotError: the session's URDF cannot be used.
            SimError: there is no OpenGL to draw with.
        """
        how = {"start": start, "duration": duration, "fps": fps, "size": size, "camera": camera}
        written: Path = extension("render")(self, Path(path), **how, force=force).path
        return written

    def motion(self, fps: float | None = None) -> Motion:
        """The played motion from the reference, or the motion from which `convert` made the file.

        Args:
            fps: frame rate of the result; the rate of the reference if None.

        Raises:
            RecordingError: there is no motion in this session.
            MotionError: `fps` is not a frame rate, or leaves fewer than two frames.
        """
        from g1stream.session.motions import motion_of

        return motion_of(self, fps)

    def save(self, path: str | os.PathLike[str], *, force: bool = False) -> Path:
        """Write the session, such as a rollout or a selected part, to one MCAP file.

        Messages on g1stream's own topics are written byte for byte, with log and publish times.
        Those for viewers are left out where a bag or an earlier version has them in another type.
        The metadata and attachments are those of the whole session. A part also has the shapes and
        the description of the robot, which were published before it, at the start of the part.

        Args:
            path: file to write; its directory must exist.
            force: replace an existing file.

        Raises:
            RecordingError: the file cannot be written, or the selected part is empty.
        """
        path, whole = Path(path), Session(self.source)
        own = CHANNELS.keys() - self.source.foreign
        topics = [topic for topic, n in sorted(self.topics.items()) if n and topic in own]
        before = {topic for topic in topics if self.selected and CHANNELS[topic].latched}
        rounds = self.rounds(topic for topic in topics if topic not in before)
        first = next(rounds, {})
        if self.selected and not first:
            raise RecordingError(
                "The selected part has no messages.",
                f"Select a part of the session, {whole.phases[0].start_s:.1f} to "
                f"{whole.phases[-1].end_s:.1f} s."
                if whole.phases
                else "Select a part that begins before the session ends.",
            )
        start = min((batch.log_times[0] for batch in first.values()), default=0)
        for topic in sorted(before):
            found = list(whole.messages(topic))
            newest = ([one for one in found if one.log_time <= start] or found[:1])[-1]
            first[topic] = Batch([newest.data], [start], [newest.publish_time])
        with complete_file(path, force=force) as temporary, SessionWriter(temporary) as writer:
            every = chain.from_iterable(one.items() for one in chain([first], rounds))
            # Otherwise nothing would show that the end of it is lost.
            metadata = self.metadata if self.closed else self.metadata | {"repaired": True}
            time_ns = self.start_ns if self.attachments else 0  # it reads a topic
            writer.copy(metadata, self.attachments, time_ns, every)
        return path

    def to_dataframe(self, topic: str | None = None) -> pandas.DataFrame:
        """The joints in PLAY, or a topic's samples, as a pandas table (extra `export`).

        Args:
            topic: one of `STREAMS`, such as `/lowstate`; None for reference, measurement and error.

        Returns:
            With a topic: a row for each sample. The index is `publish_time`, and `log_time` is a
            column, both in UTC with nanoseconds. `time` is in s on the motion's clock. The other
            columns have the names of the topic's stream. Arrays have a column for each joint,
            axis or term: `q.left_knee_joint`, `root_pos.x`, `imu_quat_wxyz.w`,
            `base_ang_vel.0`. Units are those of the stream.

            Without a topic: a row for each LowState in PLAY. The index is `time`, s on the motion's
            clock. Each joint that played has the columns `reference.left_knee_joint`, `measured.`
            and `error.`, rad. The error is reference - measured, as in `tracking`.

        Raises:
            ConfigError: pandas is not installed.
            RecordingError: there is no table for the topic, or there is nothing to compare.
        """
        table = import_extra("pandas", *_EXPORT)
        if topic is None:
            found = self.tracking()
            angles = {what: getattr(found, what) for what in ("reference", "measured", "error")}
            followed = {
                f"{what}.{JOINT_NAMES[joint]}": values[:, joint]
                for joint in found.joints
                for what, values in angles.items()
            }
            return table.DataFrame(followed, index=table.Index(found.time, name="time"))
        if topic not in STREAMS:
            raise RecordingError(
                f"The topic {topic} has no table.", f"Choose from {', '.join(STREAMS)}."
            )
        stream = self.stream(STREAMS[topic]).read()
        columns: dict[str, Any] = {
            "log_time": table.to_datetime(stream.log_time, unit="ns", utc=True),
            "time": stream.time,
        }
        terms = self.policy.terms if topic == PolicyStream.topic and self.policy else {}
        for name in stream.wire_fields():
            columns |= _by_joint_or_axis(name, getattr(stream, name), terms)
        index = table.to_datetime(stream.publish_time, unit="ns", utc=True)
        return table.DataFrame(columns, index=index.rename("publish_time"))

    def to_parquet(self, directory: str | os.PathLike[str]) -> list[Path]:
        """Write the tables of all topics, such as /lowstate to lowstate.parquet.

        Args:
            directory: created if missing. Existing files with these names are replaced.

        Returns:
            The written files.

        Raises:
            ConfigError: pandas or pyarrow is not installed.
            RecordingError: a file cannot be written.
        """
        import_extra("pyarrow", *_EXPORT)
        directory = Path(directory)
        with output_errors(directory), suppress(FileExistsError):
            directory.mkdir(parents=True)
        paths = []
        for topic in STREAMS:
            if self.topics.get(topic):
                path = directory / f"{topic.strip('/')}.parquet"
                table = self.to_dataframe(topic)
                with complete_file(path) as temporary:
                    table.to_parquet(temporary, engine="pyarrow")
                paths.append(path)
        return paths


def _by_joint_or_axis(
    name: str, values: NDArray[Any], terms: Mapping[str, slice]
) -> dict[str, NDArray[Any]]:
    """A column (N,) of a stream as one table column, or an array (N, K) as K columns."""
    if values.ndim == 1:
        return {name: values}
    if name == "observation":
        parts = {term: values[:, at] for term, at in terms.items()} or {name: values}
        return {f"{term}.{i}": one for term, part in parts.items() for i, one in enumerate(part.T)}
    labels = JOINT_NAMES if values.shape[1] == N_JOINTS else _AXES[values.shape[1]]
    return {f"{name}.{label}": one for label, one in zip(labels, values.T, strict=True)}
