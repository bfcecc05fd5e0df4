"""From batches of wire samples to every message of a session file. Needs no DDS participant."""

from __future__ import annotations

import json
from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.config import RecordConfig
from g1stream.dds.messages import (
    LOG,
    LOWSTATE,
    REFERENCE,
    SPORTMODESTATE,
    Log,
    Samples,
    played_joints,
)
from g1stream.errors import ConfigError
from g1stream.robot.joints import JOINT_GROUPS
from g1stream.robot.shapes import robot_with_meshes
from g1stream.robot.urdf import with_prefixed_links
from g1stream.session.format import CHANNELS, TIMING_FIELDS, MessageBatch, encode_string
from g1stream.types import Floats, Ints
from g1stream.view.encoders import (
    GHOST_PREFIX,
    IDENTITY_POSE,
    MEASURED_PREFIX,
    JointStatesTemplate,
    TransformsEncoder,
    encode_log,
)
from g1stream.view.measured_base import MeasuredBase
from g1stream.view.scene import (
    PathEncoder,
    draw_meshes,
    encode_scene,
)
from g1stream.view.timing import Timing
from g1stream.view.tracking_error import Track, TrackingError, by_limb

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from g1stream.dds.messages import Batch
    from g1stream.robot.model import G1

__all__ = ["CHANNEL_OF", "Decimator", "MessagePipeline"]

CHANNEL_OF: Final = {c.dds_topic: c.topic for c in CHANNELS.values() if c.dds_topic}
"""The topic in the file that holds a DDS topic's samples byte for byte, by the DDS topic's name."""

#: Red, green, blue and opacity of the ghost, and of the reference at its own root.
_GHOST_TINT: Final = (0.1, 0.6, 1.0, 0.3)
_REFERENCE_TINT: Final = (1.0, 0.65, 0.1, 0.3)
_PATH_COLOR: Final = (1.0, 0.85, 0.2, 1.0)
#: How far back the path of the pelvis reaches, s, its points and its lines per second, Hz.
_PATH_LENGTH, _PATH_POINTS, _PATH_LINES = 10.0, 20.0, 5.0


class Decimator:
    """Thins a stream to a rate: keeps the first message of each period.

    Args:
        rate: how many a second to keep, Hz; a slower stream passes whole.
    """

    def __init__(self, rate: float) -> None:
        self._period = round(1e9 / rate)
        self._last_period = -1

    def pick(self, times: Ints) -> NDArray[np.intp]:
        """Indices of the times (T,), ns in order, to keep."""
        periods = np.append(self._last_period, times // self._period)
        self._last_period = int(periods[-1])
        return np.flatnonzero(np.diff(periods))


class MessagePipeline:
    """Makes the messages of a session file from batches of wire samples.

    Each batch gives the samples themselves, byte for byte, log lines, and what viewers show of the
    samples: transforms, joint states and the tracking error.

    Args:
        robot: whose links and joints.
        settings: which messages are made of the samples (`channels`) and how often (`tf_rate`),
            and whether scenes have meshes (`meshes`); the defaults if None.

    Attributes:
        base: the measured pelvis's pose in the world of the reference.

    Raises:
        ConfigError: a link of the robot has the name of the world's frame, or the extra `meshes`
            is not installed.
        RobotError: a mesh cannot be read, or there is none for the robot's links.
    """

    def __init__(self, robot: G1, settings: RecordConfig | None = None) -> None:
        settings = settings or RecordConfig()
        self.base = MeasuredBase()
        self._derives = settings.channels != "raw"
        if settings.meshes and not self._derives:
            raise ConfigError(
                "Meshes are for viewers, for which the channels raw have nothing.",
                "Leave out --meshes, or record --channels standard.",
            )
        self._robot = robot
        self._shown = robot_with_meshes(robot) if settings.meshes else robot
        self._meshes = draw_meshes(self._shown) if settings.meshes else {}
        self._tf = TransformsEncoder(robot, single=True)
        self._measured_tf = TransformsEncoder(robot, MEASURED_PREFIX, single=True)
        fields = ("position", "velocity", "acceleration", "effort")
        full, tf_rate = settings.channels == "full", settings.tf_rate
        self._reference_joints = _JointStates(
            "/reference/joint_states", robot.joint_names, fields, every=full
        )
        self._measured_joints = _JointStates(
            "/measured/joint_states", robot.joint_names, fields, every=full
        )
        self._error_joints = _JointStates(
            "/tracking_error/joint_states", robot.joint_names, fields[:2], every=full
        )
        self._error_limbs = _JointStates(
            "/tracking_error/limbs", tuple(JOINT_GROUPS), fields[:2], every=False
        )
        self._ghost_tf = TransformsEncoder(
            robot, GHOST_PREFIX, world=MEASURED_PREFIX + robot.link_names[0], single=True
        )
        self._tracking_error = TrackingError(len(robot.joint_names))
        self._error_decimator = Decimator(tf_rate)
        self._path = PathEncoder("measured/path", _PATH_LENGTH, _PATH_COLOR)
        self._path_points, self._path_lines = Decimator(_PATH_POINTS), Decimator(_PATH_LINES)
        self._command_timing, self._state_timing = Timing(), Timing()
        self._reference_decimator = Decimator(tf_rate)
        self._state_decimator = Decimator(tf_rate)
        self._log = Log()

    def file_header(self, time_ns: int) -> list[MessageBatch]:
        """What viewers need once: a scene for each robot, and the measured one's URDF; or nothing.

        Args:
            time_ns: log and publish time, ns since the epoch.

        Raises:
            RobotError: the URDF has a shape that cannot be read.
        """
        if not self._derives:
            return []
        scene = partial(encode_scene, time_ns, self._shown, drawn=self._meshes)
        payloads = {
            "/measured/scene": scene(MEASURED_PREFIX),
            "/ghost/scene": scene(GHOST_PREFIX, _GHOST_TINT),
            "/scene": scene(tint=_REFERENCE_TINT),
            "/measured/robot_description": encode_string(
                with_prefixed_links(self._robot.xml, MEASURED_PREFIX)
            ),
        }
        time = np.array([time_ns])
        return [MessageBatch(topic, [data], time, time) for topic, data in payloads.items()]

    def encode(self, batches: Mapping[str, Batch]) -> list[MessageBatch]:
        """The messages of one round of batches.

        Args:
            batches: by DDS topic name, each oldest first and not empty.

        Raises:
            ValueError: a sample is not of its topic's type.
        """
        made = [
            MessageBatch(CHANNEL_OF[name], batch.data, *_times(batch))
            for name, batch in batches.items()
            if name in CHANNEL_OF
        ]
        if REFERENCE.name in batches:
            made += self._from_references(batches[REFERENCE.name])
        if SPORTMODESTATE.name in batches:
            batch = batches[SPORTMODESTATE.name]
            positions = Samples(SPORTMODESTATE, batch.data)["position"].astype(float)
            self.base.add_positions(np.array(batch.publish_times), positions)
        if LOWSTATE.name in batches:
            made += self._from_states(batches[LOWSTATE.name])
        if LOG.name in batches:
            made.append(self._from_log(batches[LOG.name]))
        made += self._from_errors(self._tracking_error.take())
        return [messages for messages in made if len(messages.payloads)]

    def _from_references(self, batch: Batch) -> list[MessageBatch]:
        samples = Samples(REFERENCE, batch.data)
        logged, published = _times(batch)
        q, dq, root_pos = samples["q"], samples["dq"], samples["root_pos"]
        root_quat = samples["root_quat_wxyz"]
        self.base.add_references(published, root_pos, root_quat)
        if not self._derives:
            return []
        played = played_joints(np.bitwise_or.reduce(samples["played"]))
        self._tracking_error.add_references(Track(published, logged, q, dq), played)
        few = self._reference_decimator.pick(published)
        tf = self._tf.encode(published[few], q[few], root_pos[few], root_quat[few])
        ghost = self._ghost_tf.encode(published[few], q[few], *IDENTITY_POSE)
        joints = (q, dq, samples["ddq"], samples["tau"])
        return [
            self._reference_joints.encode(published, logged, few, *joints),
            MessageBatch("/tf", tf, logged[few], published[few]),
            MessageBatch("/ghost/tf", ghost, logged[few], published[few]),
            _timing("/timing/commands", self._command_timing, published, logged),
        ]

    def _from_states(self, batch: Batch) -> list[MessageBatch]:
        samples = Samples(LOWSTATE, batch.data)
        logged, published = _times(batch)
        q, dq, ddq, tau = (
            samples[f"motor_state.{name}"].astype(float) for name in ("q", "dq", "ddq", "tau_est")
        )
        few = self._state_decimator.pick(published)
        imu_quats = samples["imu_state.quaternion"][few].astype(float)
        positions, quats = self.base.poses(published[few], imu_quats)
        if not self._derives:
            return []
        self._tracking_error.add_states(Track(published, logged, q, dq))
        tf = self._measured_tf.encode(published[few], q[few], positions, quats)
        return [
            self._measured_joints.encode(published, logged, few, q, dq, ddq, tau),
            MessageBatch("/measured/tf", tf, logged[few], published[few]),
            self._path_of(published[few], logged[few], positions),
            _timing("/timing/states", self._state_timing, published, logged),
        ]

    def _path_of(self, published: Ints, logged: Ints, positions: Floats) -> MessageBatch:
        few = self._path_points.pick(published)
        published, logged = published[few], logged[few]
        drawn = self._path_lines.pick(published)
        lines = self._path.encode(published, positions[few], published[drawn])
        return MessageBatch("/measured/path", lines, logged[drawn], published[drawn])

    def _from_errors(self, errors: Track) -> list[MessageBatch]:
        times, logged = errors.publish_times, errors.log_times
        few = self._error_decimator.pick(times)
        limbs = (by_limb(one, self._tracking_error.played) for one in (errors.q, errors.dq))
        return [
            self._error_joints.encode(times, logged, few, errors.q, errors.dq),
            self._error_limbs.encode(times, logged, few, *limbs),
        ]

    def _from_log(self, batch: Batch) -> MessageBatch:
        lines = []
        for data, published in zip(batch.data, batch.publish_times, strict=True):
            self._log.load(data)
            lines.append(
                encode_log(published, int(self._log.level), self._log.name, self._log.text)
            )
        return MessageBatch("/log", lines, *_times(batch))


class _JointStates:
    """Joint states as messages of `topic`.

    Args:
        topic: of the file.
        names: (J) of the joints.
        fields: of `JointStatesTemplate`.
        every: encode all times that are given, not only some.
    """

    def __init__(
        self, topic: str, names: Sequence[str], fields: Sequence[str], *, every: bool
    ) -> None:
        self._topic, self._every = topic, every
        self._template = JointStatesTemplate(names, fields)

    def encode(
        self, published: Ints, logged: Ints, few: NDArray[np.intp], *columns: Floats
    ) -> MessageBatch:
        """Messages of times (T,), ns, or of the `few` of them; columns (T, J), one per field.

        Numbers are rounded to single precision, which takes half the space in a compressed file.
        """
        chosen = slice(None) if self._every else few
        values = (column[chosen].astype(np.float32) for column in columns)
        payloads = self._template.encode(published[chosen], *values)
        return MessageBatch(self._topic, payloads, logged[chosen], published[chosen])


def _times(batch: Batch) -> tuple[Ints, Ints]:
    return np.array(batch.log_times), np.array(batch.publish_times)


def _timing(topic: str, timing: Timing, published: Ints, logged: Ints) -> MessageBatch:
    starts, longest = timing.longest(published, logged)
    rows = (dict(zip(TIMING_FIELDS, row, strict=True)) for row in longest.tolist())
    payloads = [json.dumps(row).encode() for row in rows]
    return MessageBatch(topic, payloads, logged[starts], published[starts])
