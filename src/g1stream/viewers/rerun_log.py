"""A session, or what is on DDS, as a Rerun recording: robots, joints, errors, timing, events.

Whole columns are sent at once, so that a minute of a session takes seconds. Entities:

    /measured/LINK, /ghost/LINK, /reference/LINK     poses and shapes
    /joints/JOINT/position/{reference,measured}      rad; /joints/JOINT/error: their difference
    /joints/JOINT/torque/{feed-forward,estimated,limits}     N·m
    /error/LIMB                                      RMS over its joints, rad
    /timing/{commands,states}/{interval,latency}     the longest in each 0.05 s, ms
    /phase, /log/PROGRAM

Times are on two timelines. `time` is the motion's clock, as everywhere in g1stream: publish times
since the motion's first frame, those of other hosts put on the recorder's clock. Live, where that
frame is still to come, there is `publish_time` instead. `log_time` is when it was recorded.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from g1stream.dds.messages import played_joints
from g1stream.files import complete_file
from g1stream.foxglove.encoders import IDENTITY_POSE
from g1stream.foxglove.measured_base import MeasuredBase
from g1stream.foxglove.pipeline import GHOST_TINT, REFERENCE_TINT, Decimator
from g1stream.foxglove.scene import load_mesh
from g1stream.foxglove.timing import Timing
from g1stream.foxglove.tracking_error import Track, TrackingError, by_limb
from g1stream.robot.joints import JOINT_GROUPS
from g1stream.robot.kinematics import forward_kinematics
from g1stream.robot.meshes import with_shapes
from g1stream.robot.visuals import read_visuals
from g1stream.session.streams import Base, LogEvent, Measured, Reference
from g1stream.settings import RecordConfig
from g1stream.text import short_name
from g1stream.types import Floats, Ints, Phase
from g1stream.viewers.layouts import LIMB_COLORS, MEASURED, RED, REFERENCE, worst_joints
from g1stream.viewers.rerun_layout import APPLICATION, import_rerun, rerun_layout

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from g1stream.foxglove.scene import Rgba
    from g1stream.robot.model import G1
    from g1stream.robot.visuals import Visual
    from g1stream.session.session import Session
    from g1stream.session.stream import Stream

__all__ = ["RerunLog", "log_session", "save_session"]

#: The columns that are read of each stream.
_REFERENCE: Final = ("phase", "played", "q", "dq", "tau", "root_pos", "root_quat_wxyz")
_MEASURED: Final = ("q", "dq", "tau", "imu_quat_wxyz")
_PHASES: Final = {phase.value: phase.name for phase in Phase}
#: Tinted shapes are smaller by this factor, so that surfaces that would coincide do not flicker.
_TINTED_SIZE: Final = 0.99
#: A scale that Rerun accepts, unlike 0.
_POINT: Final = 1e-3
_LEVELS: Final = {"WARNING": "WARN", "FATAL": "CRITICAL"}


def save_session(session: Session, path: Path, *, force: bool) -> Path:
    """See `Session.to_rerun`."""
    rr = import_rerun()
    blueprint = rerun_layout(worst_joints(session))
    with complete_file(path, force=force) as temporary:
        recording = rr.RecordingStream(APPLICATION)
        recording.save(temporary, default_blueprint=blueprint)
        try:
            log_session(session, recording)
        finally:
            recording.disconnect()
    return path


def log_session(session: Session, recording: Any) -> None:
    """Log all of a session.

    Args:
        session: what it does not have is left out.
        recording: a `rerun.RecordingStream`.

    Raises:
        RecordingError: the session is damaged.
        RobotError: its URDF cannot be used.
    """
    log = RerunLog(recording, session.robot, start_ns=session.start_ns)
    recording.send_recording_name(session.path.name)
    recording.send_recording_start_time_nanos(session.start_ns)
    present = session.topics.get
    if base := session.base:
        log.add_positions(base)
    measured = session.measured if present(Measured.topic) else None
    if present(Reference.topic):
        if measured is not None:  # before the first reference, its yaw is the IMU's own
            later = measured.time >= session.reference.time.min()
            log.add_states(measured[~later])
            measured = measured[later]
        log.add_references(session.reference)
    if measured is not None:
        log.add_states(measured)
    if present("/log"):
        messages = list(session.messages("/log"))
        log.add_events(
            np.array([message.publish_time for message in messages]),
            np.array([message.log_time for message in messages]),
            [LogEvent.decode(message.data) for message in messages],
        )


class RerunLog:
    """Logs what comes in, in batches or all at once, into a Rerun recording.

    Args:
        recording: a `rerun.RecordingStream`.
        robot: whose links, shapes and torque limits.
        start_ns: time 0 of the timeline `time`, ns since the epoch on the recorder's clock; None
            to have `publish_time`.
        tf_rate: poses and errors by limb per second, Hz.

    Raises:
        RobotError: a shape of the robot cannot be read.
    """

    def __init__(
        self,
        recording: Any,
        robot: G1,
        *,
        start_ns: int | None = None,
        tf_rate: float = RecordConfig().tf_rate,
    ) -> None:
        self._rr = import_rerun()
        self._recording, self._robot, self._start = recording, robot, start_ns
        shapes = with_shapes(robot)
        self._visuals = read_visuals(shapes)
        self._meshes = {v.mesh: load_mesh(shapes, v.mesh) for v in self._visuals if v.mesh}
        self._base = MeasuredBase()
        self._error = TrackingError(len(robot.joint_names))
        self._few_references, self._few_states, self._few_errors = (
            Decimator(tf_rate) for _ in range(3)
        )
        self._commands, self._states = Timing(), Timing()
        self._phase: int | None = None
        self._tints: dict[str, Rgba | None] = {
            "measured": None,
            "ghost": GHOST_TINT,
            "reference": REFERENCE_TINT,
        }
        self._static("/", self._rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        self._log_series()

    def add_references(self, stream: Reference) -> None:
        """Log targets: joints, the ghost, the reference at its own root, phases."""
        if not len(stream.read(*_REFERENCE)):
            return
        times, logged = self._times(stream), stream.log_time
        self._base.add_references(times, stream.root_pos, stream.root_quat_wxyz)
        played = played_joints(np.bitwise_or.reduce(stream.played))
        self._error.add_references(Track(times, logged, stream.q, stream.dq), played)
        at = self._at(times, logged)
        self._joints("position/reference", at, stream.q)
        self._joints("torque/feed-forward", at, stream.tau)
        few = self._few_references.pick(times)
        at, q = self._at(times[few], logged[few]), stream.q[few]
        self._poses("ghost", at, q, *IDENTITY_POSE)
        self._poses("reference", at, q, stream.root_pos[few], stream.root_quat_wxyz[few])
        self._timing("commands", self._commands, times, logged)
        before = -1 if self._phase is None else self._phase
        changes = np.flatnonzero(np.diff(stream.phase.astype(int), prepend=before))
        self._phase = int(stream.phase[-1])
        names = [_PHASES.get(int(phase), "?") for phase in stream.phase[changes]]
        states = self._rr.StateChange.columns(state=names)
        self._send("phase", self._at(times[changes], logged[changes]), states)

    def add_positions(self, stream: Base) -> None:
        """Take in positions of the pelvis."""
        if len(stream.read("position")):
            self._base.add_positions(self._times(stream), stream.position)

    def add_states(self, stream: Measured) -> None:
        """Log measured states: joints, their errors, the measured robot.

        References of their time must have been logged before, for the errors.
        """
        if not len(stream.read(*_MEASURED)):
            return
        times, logged = self._times(stream), stream.log_time
        self._error.add_states(Track(times, logged, stream.q, stream.dq))
        at = self._at(times, logged)
        self._joints("position/measured", at, stream.q)
        self._joints("torque/estimated", at, stream.tau)
        limits = np.stack([self._robot.torque_limit, -self._robot.torque_limit], axis=-1)
        ends = [0, -1]
        self._joints("torque/limits", self._at(times[ends], logged[ends]), np.stack([limits] * 2))
        few = self._few_states.pick(times)
        at, q = self._at(times[few], logged[few]), stream.q[few]
        pos, quat_wxyz = self._base.poses(times[few], stream.imu_quat_wxyz[few])
        quat_wxyz[~quat_wxyz.any(axis=-1)] = IDENTITY_POSE[1]  # no IMU: upright
        self._poses("measured", at, q, pos, quat_wxyz)
        # Before there is a reference the ghost has no pose: it is a point inside the pelvis.
        size = np.full(pos.shape, _POINT if self._phase is None else 1.0)
        self._send("ghost", at, self._transforms(pos, quat_wxyz, scale=size))
        self._timing("states", self._states, times, logged)
        self._add_errors()

    def add_events(self, published: Ints, logged: Ints, events: Sequence[LogEvent]) -> None:
        """Log events with their publish and log times (T,), ns since the epoch."""
        for program in {event.name for event in events}:
            mine = np.array([event.name == program for event in events])
            chosen = [event for event in events if event.name == program]
            lines = self._rr.TextLog.columns(
                text=[event.text for event in chosen],
                level=[_LEVELS.get(event.level, event.level) for event in chosen],
            )
            path = self._rr.new_entity_path(["log", program])
            self._send(path, self._at(published[mine], logged[mine]), lines)

    def _add_errors(self) -> None:
        errors = self._error.take()
        if not len(errors.publish_times):
            return
        self._joints("error", self._at(errors.publish_times, errors.log_times), errors.q)
        few = self._few_errors.pick(errors.publish_times)
        at = self._at(errors.publish_times[few], errors.log_times[few])
        for limb, rms in zip(
            JOINT_GROUPS, by_limb(errors.q[few], self._error.played).T, strict=True
        ):
            self._scalars(f"error/{limb}", at, rms)

    def _times(self, stream: Stream) -> Ints:
        """(T,) ns, the stream's publish times."""
        # Live, a batch may be late because this machine is busy, and not because clocks differ.
        offset = 0 if self._start is None else stream.clock_offset
        return stream.publish_time + offset

    def _at(self, published: Ints, logged: Ints) -> list[Any]:
        """Both timelines of T rows."""
        column = self._rr.TimeColumn
        if self._start is None:
            first = column("publish_time", timestamp=published.astype("datetime64[ns]"))
        else:
            first = column("time", duration=(published - self._start).astype("timedelta64[ns]"))
        return [first, column("log_time", timestamp=logged.astype("datetime64[ns]"))]

    def _joints(self, what: str, at: list[Any], values: Floats) -> None:
        """Log values (T, 29) or (T, 29, K) of the joints."""
        for joint, name in enumerate(self._robot.joint_names):
            self._scalars(f"joints/{name}/{what}", at, values[:, joint])

    def _scalars(self, path: str, at: list[Any], values: Floats) -> None:
        """Log values (T,), or (T, K) of K curves."""
        columns = self._rr.Scalars.columns(scalars=values.ravel())
        if values.ndim == 2:
            columns = columns.partition([values.shape[1]] * len(values))
        self._send(path, at, columns)

    def _timing(self, name: str, timing: Timing, times: Ints, logged: Ints) -> None:
        starts, longest = timing.longest(times, logged)
        at = self._at(times[starts], logged[starts])
        for what, values in zip(("interval", "latency"), longest.T, strict=True):
            self._scalars(f"timing/{name}/{what}", at, values)

    def _poses(
        self, name: str, at: list[Any], q: Floats, root_pos: Floats, root_quat_wxyz: Floats
    ) -> None:
        """Log the poses of all links of one of the robots, and before the first its shapes."""
        if name in self._tints:
            self._add_shapes(name, self._tints.pop(name))
        poses = forward_kinematics(self._robot, q, root_pos, root_quat_wxyz)
        for number, link in enumerate(self._robot.link_names):
            transforms = self._transforms(poses.pos[:, number], poses.quat_wxyz[:, number])
            self._send(self._rr.new_entity_path([name, link]), at, transforms)

    def _transforms(self, pos: Floats, quat_wxyz: Floats, **more: Floats) -> Any:
        quat_xyzw = np.roll(quat_wxyz, -1, axis=-1)
        return self._rr.Transform3D.columns(translation=pos, quaternion=quat_xyzw, **more)

    def _send(self, path: str, at: list[Any], columns: Any) -> None:
        self._recording.send_columns(path, at, columns)

    def _static(self, path: str, *values: Any) -> None:
        self._recording.log(path, *values, static=True)

    def _add_shapes(self, name: str, tint: Rgba | None) -> None:
        for number, visual in enumerate(self._visuals):
            path = [name, visual.link, f"{visual.kind}-{number}"]
            self._add_shape(path, visual, tint)

    def _add_shape(self, path: list[str], visual: Visual, tint: Rgba | None) -> None:
        """Log a shape of a link; a mesh that is not found is left out."""
        rr, entity = self._rr, self._rr.new_entity_path(path)
        color = np.round(255 * np.array(tint or visual.rgba)).astype(np.uint8)
        quat = rr.Quaternion(xyzw=np.roll(visual.quat_wxyz, -1))
        size = np.array(visual.size) * (_TINTED_SIZE if tint else 1.0)
        if visual.kind != "mesh":
            where = {"centers": [visual.pos], "quaternions": [quat]}
            look: dict[str, Any] = {"colors": [color], "fill_mode": "solid"}
            if visual.kind == "box":
                shape = rr.Boxes3D(half_sizes=[size / 2], **where, **look)
            elif visual.kind == "sphere":
                shape = rr.Ellipsoids3D(half_sizes=[size / 2], **where, **look)
            else:
                shape = rr.Cylinders3D(lengths=size[2:], radii=size[:1] / 2, **where, **look)
            self._static(entity, shape)
        elif "data" in (mesh := self._meshes[visual.mesh]):
            pose = rr.Transform3D(translation=visual.pos, quaternion=quat, scale=size)
            own = tint is None and not visual.coloured  # the colours that the mesh has
            look = {} if own else {"albedo_factor": color}
            model = rr.Asset3D(contents=mesh["data"], media_type=mesh["media_type"], **look)
            self._static(entity, pose, model)

    def _log_series(self) -> None:
        """Log names and colours of the curves, so that plots are readable without a layout."""
        curves = {
            "position/reference": (["reference"], [REFERENCE]),
            "position/measured": (["measured"], [MEASURED]),
            "torque/feed-forward": (["feed-forward"], [REFERENCE]),
            "torque/estimated": (["estimated"], [MEASURED]),
            "torque/limits": (["limit", "-limit"], [RED, RED]),
        }
        for joint in self._robot.joint_names:
            for what, (names, colors) in curves.items():
                self._curve(f"joints/{joint}/{what}", names, colors)
            self._curve(f"joints/{joint}/error", [short_name(joint)])
        for limb, color in zip(JOINT_GROUPS, LIMB_COLORS, strict=True):
            self._curve(f"error/{limb}", [limb], [color])
        for stream, color in (("commands", REFERENCE), ("states", MEASURED)):
            self._curve(f"timing/{stream}/interval", [f"{stream[:-1]} interval"], [color])
        self._curve("timing/commands/latency", ["command latency"], [RED])
        self._curve("timing/states/latency", ["state latency"])

    def _curve(self, path: str, names: list[str], colors: list[str] | None = None) -> None:
        # An average of what falls onto one pixel, the default, would hide single peaks.
        style: dict[str, Any] = {"names": names, "aggregation_policy": "MinMax"}
        if colors:
            style["colors"] = [_rgb(color) for color in colors]
        self._static(path, self._rr.SeriesLines(**style))


def _rgb(color: str) -> tuple[int, ...]:
    """Of a colour such as #ffa61a."""
    return tuple(bytes.fromhex(color[1:]))
