"""Pipeline from the samples of a session to messages for viewers.

It needs no DDS participant. The recorder writes the samples themselves.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Final, NamedTuple, Protocol

import numpy as np

from g1stream.clock import have_one_clock
from g1stream.config import RecordConfig
from g1stream.dds.layout import CDR_HEADER
from g1stream.dds.messages import (
    LOWSTATE,
    ODOMMODESTATE,
    POLICY,
    REFERENCE,
    SPORTMODESTATE,
    Samples,
    played_joints,
)
from g1stream.errors import ConfigError
from g1stream.optional import extension
from g1stream.robot.joints import JOINT_GROUPS
from g1stream.robot.urdf import with_prefixed_links
from g1stream.session.format import ERROR_FIELDS, MessageBatch, encode_string
from g1stream.session.streams import MAX_GAP_NS, neighbours
from g1stream.types import Floats, Ints
from g1stream.view.encoders import (
    GHOST_PREFIX,
    IDENTITY_POSE,
    MEASURED_PREFIX,
    JointStatesTemplate,
    TransformsEncoder,
)
from g1stream.view.measured_base import MeasuredBase
from g1stream.view.scene import PathEncoder, encode_scene, meshes_of

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from g1stream.dds.messages import Batch
    from g1stream.robot.model import G1
    from g1stream.session.records import PolicyInfo

__all__ = ["Decimator", "MessagePipeline", "Track", "TrackingError"]

#: Red, green, blue and opacity of the ghost, and of the reference at its own root.
_GHOST_TINT: Final = (0.1, 0.6, 1.0, 0.3)
_REFERENCE_TINT: Final = (1.0, 0.65, 0.1, 0.3)
_PATH_COLOR: Final = (1.0, 0.85, 0.2, 1.0)
#: Duration of the path of the pelvis, s, and its points and messages per second, Hz.
_PATH_LENGTH, _PATH_POINTS, _PATH_LINES = 10.0, 20.0, 5.0
_FIELDS: Final = ("position", "velocity", "acceleration", "effort")
#: Maximum wait of a state for the next reference, ns.
_MAX_WAIT_NS: Final = 1_000_000_000
#: Interval of publish times for one message of /timing/*, ns.
_TIMING_SPAN: Final = 50_000_000


class MessagePipeline:
    """Makes messages for viewers from batches of samples; none with the channels raw.

    Args:
        robot: the robot.
        settings: the kinds of messages (`channels`), their rate (`tf_rate`), and whether scenes
            have meshes (`meshes`); None: the defaults.
        policy: the policy that plays, with the names of its terms; None if unknown.

    Attributes:
        base: pose of the measured pelvis in the world of the reference; None with the channels raw.

    Raises:
        ConfigError: a link of the robot has the name of the world frame, or the extra `meshes` is
            not installed.
        RobotError: a mesh cannot be read, or there are no meshes for the robot's links.
    """

    def __init__(
        self,
        robot: G1,
        settings: RecordConfig | None = None,
        policy: PolicyInfo | None = None,
    ) -> None:
        settings = settings or RecordConfig()
        raw = settings.channels == "raw"
        if raw and settings.meshes:
            raise ConfigError(
                "Meshes are for viewers, but the channels raw have no messages for viewers.",
                "Remove --meshes, or record with --channels standard.",
            )
        self._robot, self._policy = robot, policy
        self._meshes = None if raw else meshes_of(robot, simplified=settings.meshes)
        self.base = None if raw else MeasuredBase()
        self._encoders = _encoders(robot, self.base, settings) if self.base else ()

    def file_header(self, time_ns: int) -> list[MessageBatch]:
        """Messages at the start of a file: scenes of the robots, and the measured robot's URDF.

        `time_ns` is their log and publish time, ns since the epoch.

        Raises:
            RobotError: the URDF has a shape that cannot be read.
        """
        if self.base is None:
            return []
        scene = partial(encode_scene, time_ns, self._robot, self._meshes)
        payloads = {
            "/measured/scene": scene(MEASURED_PREFIX),
            "/ghost/scene": scene(GHOST_PREFIX, _GHOST_TINT, ghost=True),
            "/scene": scene(tint=_REFERENCE_TINT),
            "/measured/robot_description": encode_string(
                with_prefixed_links(self._robot.xml, MEASURED_PREFIX)
            ),
        }
        time = np.array([time_ns])
        return [MessageBatch(topic, [data], time, time) for topic, data in payloads.items()]

    def encode(self, batches: Mapping[str, Batch]) -> list[MessageBatch]:
        """Make the messages of one round of batches by DDS topic, oldest first and not empty.

        Raises:
            ValueError: a sample is not of its topic's type.
        """
        if self.base is None:
            return []
        samples = {name: _Decoded(name, batch) for name, batch in batches.items() if name in _READ}
        if reference := samples.get(REFERENCE.name):
            self.base.add_references(
                reference.published, reference["root_pos"], reference["root_quat_wxyz"]
            )
        if position := samples.get(SPORTMODESTATE.name) or samples.get(ODOMMODESTATE.name):
            self.base.add_positions(position.published, position["position"])
        if state := samples.get(LOWSTATE.name):
            self.base.add_states(state.published, state["imu_state.quaternion"])
        made = [messages for one in self._encoders for messages in one.encode(samples)]
        if POLICY.name in batches:
            made.append(extension("policy_terms")(batches[POLICY.name], self._policy))
        return [messages for messages in made if len(messages.payloads)]


_READ: Final = {topic.name: topic for topic in (REFERENCE, LOWSTATE, SPORTMODESTATE, ODOMMODESTATE)}


class _Decoded:
    """Decoded samples of a topic, with publish and log times (T,) ns, and fields by name."""

    def __init__(self, name: str, batch: Batch) -> None:
        self.published, self.logged = np.array(batch.publish_times), np.array(batch.log_times)
        self._samples = Samples(_READ[name], batch.data)
        self._fields: dict[str, Floats] = {}

    def __getitem__(self, field: str) -> Floats:
        if field not in self._fields:
            self._fields[field] = self._samples[field].astype(float, copy=False)
        return self._fields[field]

    @property
    def played(self) -> NDArray[np.bool_]:
        """(29,) the joints that play the motion in any of the references."""
        return played_joints(np.bitwise_or.reduce(self._samples["played"]))


class _Encoder(Protocol):
    """Interface that makes the messages of some topics of the file."""

    def encode(self, samples: Mapping[str, _Decoded]) -> Sequence[MessageBatch]:
        """Make the messages of one round, from its samples by DDS topic name."""


def _encoders(robot: G1, base: MeasuredBase, settings: RecordConfig) -> tuple[_Encoder, ...]:
    rate, every = settings.tf_rate, settings.channels == "full"
    return (
        _References(robot, rate, every=every),
        _States(robot, base, rate, every=every),
        _Path(base),
        _Timing("/timing/commands", REFERENCE.name),
        _Timing("/timing/states", LOWSTATE.name),
        _Errors(robot.joint_names, rate, every=every),
    )


class Decimator:
    """Keeps the first message of each period of a rate, Hz; a slower stream is unchanged."""

    def __init__(self, rate: float) -> None:
        self._period = round(1e9 / rate)
        self._last_period = -1

    def pick(self, times: Ints) -> NDArray[np.intp]:
        """Indices of the kept ones of times (T,), ns in ascending order."""
        periods = np.append(self._last_period, times // self._period)
        self._last_period = int(periods[-1])
        return np.flatnonzero(np.diff(periods))


class _References:
    """Encoder of /tf, /ghost/tf and /reference/joint_states."""

    def __init__(self, robot: G1, rate: float, *, every: bool) -> None:
        world = MEASURED_PREFIX + robot.link_names[0]
        self._few = Decimator(rate)
        self._tf = TransformsEncoder(robot, single=True)
        self._ghost_tf = TransformsEncoder(robot, GHOST_PREFIX, world=world, single=True)
        self._joints = _JointStates(
            "/reference/joint_states", robot.joint_names, _FIELDS, every=every
        )

    def encode(self, samples: Mapping[str, _Decoded]) -> Sequence[MessageBatch]:
        if (found := samples.get(REFERENCE.name)) is None:
            return []
        few = self._few.pick(found.published)
        logged, published = found.logged[few], found.published[few]
        q = found["q"][few]
        root = found["root_pos"][few], found["root_quat_wxyz"][few]
        columns = (found[name] for name in ("q", "dq", "ddq", "tau"))
        return [
            self._joints.encode(found.published, found.logged, few, *columns),
            MessageBatch("/tf", self._tf.encode(published, q, *root), logged, published),
            MessageBatch(
                "/ghost/tf", self._ghost_tf.encode(published, q, *IDENTITY_POSE), logged, published
            ),
        ]


class _States:
    """Encoder of /measured/tf and /measured/joint_states."""

    def __init__(self, robot: G1, base: MeasuredBase, rate: float, *, every: bool) -> None:
        self._few = Decimator(rate)
        self._base = base
        self._tf = TransformsEncoder(robot, MEASURED_PREFIX, single=True)
        self._joints = _JointStates(
            "/measured/joint_states", robot.joint_names, _FIELDS, every=every
        )

    def encode(self, samples: Mapping[str, _Decoded]) -> Sequence[MessageBatch]:
        if (found := samples.get(LOWSTATE.name)) is None:
            return []
        few = self._few.pick(found.published)
        logged, published = found.logged[few], found.published[few]
        pose = self._base.poses(published, found["imu_state.quaternion"][few])
        tf = self._tf.encode(published, found["motor_state.q"][few], *pose)
        columns = (found[f"motor_state.{name}"] for name in ("q", "dq", "ddq", "tau_est"))
        return [
            self._joints.encode(found.published, found.logged, few, *columns),
            MessageBatch("/measured/tf", tf, logged, published),
        ]


class _Path:
    """Encoder of /measured/path, the path of the pelvis in the last seconds."""

    def __init__(self, base: MeasuredBase) -> None:
        self._base = base
        self._line = PathEncoder("measured/path", _PATH_LENGTH, _PATH_COLOR)
        self._points, self._lines = Decimator(_PATH_POINTS), Decimator(_PATH_LINES)

    def encode(self, samples: Mapping[str, _Decoded]) -> Sequence[MessageBatch]:
        if (found := samples.get(LOWSTATE.name)) is None:
            return []
        few = self._points.pick(found.published)
        logged, published = found.logged[few], found.published[few]
        positions, _ = self._base.poses(published, found["imu_state.quaternion"][few])
        drawn = self._lines.pick(published)
        lines = self._line.encode(published, positions, published[drawn])
        return [MessageBatch("/measured/path", lines, logged[drawn], published[drawn])]


class _Timing:
    """Encoder of the longest interval and latency of a stream in each 0.05 s."""

    def __init__(self, topic: str, dds_topic: str) -> None:
        self._topic, self._dds_topic = topic, dds_topic
        self._last: int | None = None

    def encode(self, samples: Mapping[str, _Decoded]) -> Sequence[MessageBatch]:
        if (found := samples.get(self._dds_topic)) is None:
            return []
        published, logged = found.published, found.logged
        starts = np.flatnonzero(np.diff(published // _TIMING_SPAN, prepend=-1))
        previous = published[0] if self._last is None else self._last
        self._last = int(published[-1])
        intervals = np.diff(published, prepend=previous)
        values = np.stack([intervals, logged - published], axis=-1) / 1e6
        longest = np.maximum.reduceat(values, starts)
        payloads = [CDR_HEADER + row.tobytes() for row in longest]
        return [MessageBatch(self._topic, payloads, logged[starts], published[starts])]


class _Errors:
    """Encoder of /tracking_error/joint_states and /tracking_error/limbs."""

    def __init__(self, joint_names: Sequence[str], rate: float, *, every: bool) -> None:
        self._few = Decimator(rate)
        self._error = TrackingError(len(joint_names))
        self._played = np.ones(len(joint_names), dtype=bool)
        self._joints = _JointStates(
            "/tracking_error/joint_states", joint_names, ERROR_FIELDS, every=every
        )
        self._limbs = _JointStates(
            "/tracking_error/limbs", tuple(JOINT_GROUPS), ERROR_FIELDS, every=False
        )

    def encode(self, samples: Mapping[str, _Decoded]) -> Sequence[MessageBatch]:
        if found := samples.get(REFERENCE.name):
            self._played = found.played
            q, dq = found["q"], found["dq"]
            self._error.add_references(Track(found.published, found.logged, q, dq))
        if found := samples.get(LOWSTATE.name):
            q, dq = found["motor_state.q"], found["motor_state.dq"]
            one_clock = have_one_clock(int((found.logged - found.published).min()))
            times = found.published if one_clock else found.logged
            self._error.add_states(Track(times, found.logged, q, dq))
        errors = self._error.take()
        times, logged = errors.publish_times, errors.log_times
        few = self._few.pick(times)
        limbs = (_by_limb(one, self._played) for one in (errors.q, errors.dq))
        return [
            self._joints.encode(times, logged, few, errors.q, errors.dq),
            self._limbs.encode(times, logged, few, *limbs),
        ]


class _JointStates:
    """Encoder of joint states on one topic, of all times if `every`, otherwise of some."""

    def __init__(
        self, topic: str, names: Sequence[str], fields: Sequence[str], *, every: bool
    ) -> None:
        self._topic, self._every = topic, every
        self._template = JointStatesTemplate(names, fields)

    def encode(
        self, published: Ints, logged: Ints, few: NDArray[np.intp], *columns: Floats
    ) -> MessageBatch:
        """Encode times (T,), ns, or `few` of them; columns (T, J), one per field."""
        # Single precision takes half the space in a compressed file.
        chosen = slice(None) if self._every else few
        values = (column[chosen].astype(np.float32) for column in columns)
        payloads = self._template.encode(published[chosen], *values)
        return MessageBatch(self._topic, payloads, logged[chosen], published[chosen])


class Track(NamedTuple):
    """Joint states at T times: publish and log times (T,) ns, q and dq (T, 29) rad and rad/s."""

    publish_times: Ints
    log_times: Ints
    q: Floats
    dq: Floats

    def where(self, index: NDArray[np.bool_] | NDArray[np.intp] | slice) -> Track:
        """Select some of the times."""
        return Track._make(values[index] for values in self)

    def then(self, other: Track) -> Track:
        """Concatenate two tracks."""
        return Track._make(np.concatenate(pair) for pair in zip(self, other, strict=True))


class TrackingError:
    """Computes the tracking error of states and references that arrive in batches.

    The error is reference minus measured, at the publish time of each measured state, or when it
    was received if its clock differs. The reference is interpolated linearly between two samples.
    States in a gap of the reference longer than `MAX_GAP_NS` have no error.

    An error is known after the next reference has arrived. Its log time is the latest reception
    time of its samples.
    """

    def __init__(self, n_joints: int) -> None:
        times, joints = np.empty(0, dtype=np.int64), np.empty((0, n_joints))
        self._references = self._states = Track(times, times, joints, joints)

    def add_references(self, references: Track) -> None:
        """Add references."""
        together = self._references.then(references)
        # References of two writers may be interleaved.
        self._references = together.where(np.argsort(together.publish_times, kind="stable"))

    def add_states(self, states: Track) -> None:
        """Add measured states."""
        self._states = self._states.then(states)

    def take(self) -> Track:
        """Take the newly known errors; q (rad) and dq (rad/s) are reference minus measured."""
        references, states = self._references, self._states
        known = states.publish_times <= references.publish_times[-1:].max(initial=-1)
        self._states = _recent(states.where(~known))
        # Kept even if no state waits, because states may be added after later references.
        self._references = _recent(references)
        states = states.where(known)
        around = neighbours(references.publish_times, states.publish_times)
        around = around.where(around.gap <= MAX_GAP_NS)
        states = states.where(around.instants)
        return Track(
            states.publish_times,
            np.maximum(states.log_times, references.log_times[around.after]),
            around.interpolate(references.q) - states.q,
            around.interpolate(references.dq) - states.dq,
        )


def _by_limb(errors: Floats, played: NDArray[np.bool_]) -> Floats:
    """(T, 5) RMS of errors (T, 29) over the played joints (29,) of each limb; nan without any."""
    limbs = np.full((len(errors), len(JOINT_GROUPS)), np.nan)
    for limb, joints in enumerate(JOINT_GROUPS.values()):
        if members := [joint for joint in joints if played[joint]]:
            limbs[:, limb] = np.sqrt((errors[:, members] ** 2).mean(axis=1))
    return limbs


def _recent(track: Track) -> Track:
    """Remove samples that are much older than the newest one."""
    newest = track.publish_times.max(initial=0)
    return track.where(track.publish_times >= newest - _MAX_WAIT_NS)
