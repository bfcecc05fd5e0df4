"""Publishes the measured robot and its ghost on ROS 2 topics for RViz.

It runs in a child process. For the robot and the stream it is another best-effort subscriber, so
that neither waits for it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any, Final

import numpy as np
from cyclonedds.idl.types import sequence
from rosbags.interfaces import Nodetype

from g1stream.child_process import Parent, run_child
from g1stream.config import Config
from g1stream.dds import types
from g1stream.dds.domain import Participant
from g1stream.dds.endpoints import RawReader, RawSample, RawWriter
from g1stream.dds.messages import (
    LOWSTATE,
    REFERENCE,
    SPORTMODESTATE,
    LowState,
    Reference,
    SportModeState,
)
from g1stream.extras.attach.recorded_motion import FramePose
from g1stream.extras.ros2.messages import STORE, joint_state, tf_message
from g1stream.realtime import lower_priority
from g1stream.robot.kinematics import local_transforms
from g1stream.robot.model import G1
from g1stream.session.format import encode_string
from g1stream.types import Floats
from g1stream.view.encoders import GHOST_PREFIX, IDENTITY_POSE, WORLD_FRAME, link_frames
from g1stream.view.measured_base import MeasuredBase


@dataclass(frozen=True)
class Ros2Topic:
    """A topic of ROS 2 on DDS.

    On DDS it has the prefix `rt`, and the type `tf2_msgs/msg/TFMessage` has the name
    `tf2_msgs::msg::dds_::TFMessage_`
    (https://design.ros2.org/articles/topic_and_service_names.html).
    """

    name: str  # name on DDS
    message: str  # type, such as `std_msgs/msg/String`
    depth: int  # number of messages that a ROS publisher keeps for slow subscribers
    latched: bool = False  # the last message is also kept for later subscribers

    @property
    def idl_type(self) -> Any:
        """The cyclonedds class that names the type on DDS."""
        return _idl_type(self.message)


# The depths are those of TransformBroadcaster, joint_state_publisher and robot_state_publisher.
TF: Final = Ros2Topic("rt/tf", "tf2_msgs/msg/TFMessage", depth=100)
JOINT_STATES: Final = Ros2Topic("rt/joint_states", "sensor_msgs/msg/JointState", depth=10)
ROBOT_DESCRIPTION: Final = Ros2Topic(
    "rt/robot_description", "std_msgs/msg/String", depth=1, latched=True
)


@cache
def _idl_type(message: str) -> Any:
    package, _, name = message.split("/")
    _, fields = STORE.fielddefs[message]
    return types.idl_struct(
        f"{package}.msg.dds_.{name}_", **{field: _idl_field(kind) for field, kind in fields}
    )


def _idl_field(description: Any) -> Any:
    kind, about = description
    if kind == Nodetype.NAME:
        return _idl_type(about)
    if kind == Nodetype.SEQUENCE:
        return sequence[_idl_field(about[0])]
    return str if about[0] == "string" else getattr(types, about[0])


class _Publisher:
    """Publishes the newest state and reference for ROS 2.

    The measured robot has the links' names as frames, as RViz and other ROS programs expect. The
    ghost, with the reference's joints and the measured pelvis, has the prefix `ghost/`.
    """

    def __init__(self, participant: Participant, robot: G1) -> None:
        self._robot = robot
        self._base = MeasuredBase()
        self._state, self._reference, self._sport = LowState(), Reference(), SportModeState()
        self._states = RawReader(participant, LOWSTATE)
        self._references = RawReader(participant, REFERENCE)
        self._positions = RawReader(participant, SPORTMODESTATE)
        self._frames = link_frames(robot, "", WORLD_FRAME)
        self._ghost_frames = link_frames(robot, GHOST_PREFIX, robot.link_names[0])
        self._tf, self._joint_states, self._description = (
            RawWriter(participant, topic, topic.depth, latched=topic.latched)
            for topic in (TF, JOINT_STATES, ROBOT_DESCRIPTION)
        )
        self._description.write(encode_string(robot.urdf))

    def publish(self) -> None:
        """Publish the data received since the last call."""
        if sample := self._references.take_latest():
            self._publish_ghost(sample)
        if sample := self._positions.take_latest():
            self._sport.load(sample.data)
            position = self._sport.position.astype(float)
            self._base.add_positions(np.array([sample.publish_time]), position[np.newaxis])
        if sample := self._states.take_latest():
            self._publish_measured(sample)

    def _publish_ghost(self, sample: RawSample) -> None:
        target, time_ns = self._reference, sample.publish_time
        target.load(sample.data)
        root = target.root_pos[np.newaxis], target.root_quat_wxyz[np.newaxis]
        self._base.add_references(np.array([time_ns]), *root)
        self._publish_tf(time_ns, self._ghost_frames, target.q, *IDENTITY_POSE)

    def _publish_measured(self, sample: RawSample) -> None:
        state, time_ns = self._state, sample.publish_time
        state.load(sample.data)
        q, dq, tau = (one.astype(float) for one in (state.q, state.dq, state.tau_est))
        pelvis = np.array([time_ns]), state.quaternion.astype(float)[np.newaxis]
        self._base.add_states(*pelvis)
        self._publish_tf(time_ns, self._frames, q, *self._base.poses(*pelvis))
        self._joint_states.write(joint_state(time_ns, self._robot.joint_names, q, dq, tau))

    def _publish_tf(
        self,
        time_ns: int,
        frames: tuple[list[str], list[str]],
        joint_pos: Floats,
        root_pos: Floats,
        root_quat_wxyz: Floats,
    ) -> None:
        poses = local_transforms(self._robot, joint_pos[np.newaxis], root_pos, root_quat_wxyz)
        rows = zip(*frames, poses.pos[0].tolist(), poses.quat_wxyz[0].tolist(), strict=True)
        self._tf.write(tf_message(FramePose(time_ns, *row) for row in rows))


def _run_child(parent: Parent) -> None:
    """Publish for a parent process. The startup message is its config."""
    lower_priority()
    config: Config = parent.startup_message
    robot = G1.of_config(config)
    with Participant(config.dds.domain, config.dds.interface) as participant:
        publisher = _Publisher(participant, robot)
        parent.ready()
        while not parent.done.wait(1 / config.record.tf_rate):
            publisher.publish()


if __name__ == "__main__":
    run_child(_run_child)
