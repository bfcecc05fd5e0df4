"""From batches of wire samples to every message of a session file. Needs no DDS participant."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.dds.messages import Log, Samples
from g1stream.dds.topics import LOG, LOWSTATE, REFERENCE, SPORTMODESTATE
from g1stream.foxglove.encoders import (
    MEASURED_PREFIX,
    JointStatesTemplate,
    TransformsEncoder,
    encode_log,
)
from g1stream.foxglove.measured_base import MeasuredBase
from g1stream.foxglove.scene import encode_robot_description, encode_scene
from g1stream.foxglove.tracking_error import Track, TrackingError
from g1stream.session.format import CHANNELS, MessageBatch
from g1stream.types import Ints

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from g1stream.dds.messages import Batch
    from g1stream.robot.model import G1

__all__ = ["CHANNEL_OF", "Decimator", "MessagePipeline"]

CHANNEL_OF: Final = {c.dds_topic: c.topic for c in CHANNELS.values() if c.dds_topic}
"""The topic in the file that holds a DDS topic's samples byte for byte, by the DDS topic's name."""

_REFERENCE_OPACITY: Final = 0.3


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

    Each batch gives the samples themselves, byte for byte, and what viewers show of them:
    transforms, joint states, the tracking error and log lines.

    Args:
        robot: whose links and joints.
        tf_rate: transforms per second, Hz.

    Attributes:
        base: the measured pelvis's pose in the world of the reference.

    Raises:
        ConfigError: a link of the robot has the name of the world's frame.
    """

    def __init__(self, robot: G1, tf_rate: float) -> None:
        self.base = MeasuredBase()
        self._robot = robot
        self._tf = TransformsEncoder(robot)
        self._measured_tf = TransformsEncoder(robot, MEASURED_PREFIX)
        fields = ("position", "velocity", "acceleration", "effort")
        self._joints = JointStatesTemplate(robot.joint_names, fields)
        self._error_joints = JointStatesTemplate(robot.joint_names, fields[:2])
        self._tracking_error = TrackingError(len(robot.joint_names))
        self._reference_decimator = Decimator(tf_rate)
        self._state_decimator = Decimator(tf_rate)
        self._log = Log()

    def file_header(self, time_ns: int) -> list[MessageBatch]:
        """What viewers need once: the scene with both robots, the reference translucent; the URDF.

        Args:
            time_ns: log and publish time, ns since the epoch.

        Raises:
            RobotError: the URDF has a shape that cannot be read.
        """
        opacities = {"": _REFERENCE_OPACITY, MEASURED_PREFIX: 1.0}
        payloads = {
            "/scene": encode_scene(time_ns, self._robot, opacities),
            "/robot_description": encode_robot_description(self._robot),
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
        made.append(self._from_errors(self._tracking_error.take()))
        return [messages for messages in made if len(messages.payloads)]

    def _from_references(self, batch: Batch) -> list[MessageBatch]:
        samples = Samples(REFERENCE, batch.data)
        logged, published = _times(batch)
        q, dq, root_pos = samples["q"], samples["dq"], samples["root_pos"]
        root_quat = samples["root_quat_wxyz"]
        self.base.add_references(published, root_pos, root_quat)
        self._tracking_error.add_references(Track(published, logged, q, dq))
        joints = self._joints.encode(published, q, dq, samples["ddq"], samples["tau"])
        few = self._reference_decimator.pick(published)
        tf = self._tf.encode(published[few], q[few], root_pos[few], root_quat[few])
        return [
            MessageBatch("/reference/joint_states", joints, logged, published),
            MessageBatch("/tf", tf, logged[few], published[few]),
        ]

    def _from_states(self, batch: Batch) -> list[MessageBatch]:
        samples = Samples(LOWSTATE, batch.data)
        logged, published = _times(batch)
        q, dq, ddq, tau = (
            samples[f"motor_state.{name}"].astype(float) for name in ("q", "dq", "ddq", "tau_est")
        )
        self._tracking_error.add_states(Track(published, logged, q, dq))
        joints = self._joints.encode(published, q, dq, ddq, tau)
        few = self._state_decimator.pick(published)
        imu_quats = samples["imu_state.quaternion"][few].astype(float)
        positions, quats = self.base.poses(published[few], imu_quats)
        tf = self._measured_tf.encode(published[few], q[few], positions, quats)
        return [
            MessageBatch("/measured/joint_states", joints, logged, published),
            MessageBatch("/measured/tf", tf, logged[few], published[few]),
        ]

    def _from_errors(self, errors: Track) -> MessageBatch:
        payloads = self._error_joints.encode(errors.publish_times, errors.q, errors.dq)
        topic = "/tracking_error/joint_states"
        return MessageBatch(topic, payloads, errors.log_times, errors.publish_times)

    def _from_log(self, batch: Batch) -> MessageBatch:
        lines = []
        for data, published in zip(batch.data, batch.publish_times, strict=True):
            self._log.load(data)
            lines.append(
                encode_log(published, int(self._log.level), self._log.name, self._log.text)
            )
        return MessageBatch("/log", lines, *_times(batch))


def _times(batch: Batch) -> tuple[Ints, Ints]:
    return np.array(batch.log_times), np.array(batch.publish_times)
