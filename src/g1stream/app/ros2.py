"""Publish the measured robot and its ghost as ROS 2 does, so that RViz shows them.

It runs as a process of its own beside the program that starts it. To the robot and to the stream it
is one more subscriber, best effort, so that neither waits for it.
"""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np

from g1stream.child_process import optional_child, run_child
from g1stream.dds.domain import Participant
from g1stream.dds.endpoints import RawReader, RawWriter
from g1stream.dds.messages import (
    LOWSTATE,
    REFERENCE,
    SPORTMODESTATE,
    LowState,
    Reference,
    SportModeState,
)
from g1stream.dds.ros2 import (
    JOINT_STATES,
    ROBOT_DESCRIPTION,
    TF,
    encode_joint_state,
    encode_string,
    encode_tf,
)
from g1stream.realtime import lower_priority
from g1stream.robot.kinematics import local_transforms
from g1stream.robot.model import G1
from g1stream.view.encoders import GHOST_PREFIX, IDENTITY_POSE, WORLD_FRAME, link_frames
from g1stream.view.measured_base import MeasuredBase

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from g1stream.child_process import Parent
    from g1stream.config import Config
    from g1stream.dds.endpoints import RawSample
    from g1stream.dds.ros2 import Ros2Topic
    from g1stream.types import Floats

__all__ = ["publishing_for_ros2"]


@contextmanager
def publishing_for_ros2(
    config: Config, abandoned: Callable[[], bool] = lambda: False
) -> Iterator[None]:
    """Publish for ROS 2 from a process of its own, where `dds.ros_tf` is set.

    Args:
        config: all settings.
        abandoned: asked while the process starts; True ends the wait for it.

    Raises:
        ChildError: it cannot. Once it publishes, its failure is only logged.
    """
    if not config.dds.ros_tf:
        yield
        return
    with optional_child("ros2", config, "nothing is published for ROS 2 any more", abandoned):
        yield


class _Publisher:
    """Publishes the newest state and reference for ROS 2.

    The measured robot has the links' own names as frames, as RViz and other programs of ROS expect;
    the ghost, the reference's joints on the measured pelvis, has the prefix `ghost/`.
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
            _writer(participant, topic) for topic in (TF, JOINT_STATES, ROBOT_DESCRIPTION)
        )
        self._description.write(encode_string(robot.urdf))

    def publish(self) -> None:
        """Publish what has been received since the last time."""
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
        attitude = state.quaternion.astype(float)[np.newaxis]
        self._publish_tf(time_ns, self._frames, q, *self._base.poses(np.array([time_ns]), attitude))
        names = self._robot.joint_names
        columns = q.tolist(), dq.tolist(), tau.tolist()
        self._joint_states.write(encode_joint_state(time_ns, names, *columns))

    def _publish_tf(
        self,
        time_ns: int,
        frames: tuple[list[str], list[str]],
        joint_pos: Floats,
        root_pos: Floats,
        root_quat_wxyz: Floats,
    ) -> None:
        poses = local_transforms(self._robot, joint_pos[np.newaxis], root_pos, root_quat_wxyz)
        self._tf.write(encode_tf(time_ns, *frames, poses.pos[0], poses.quat_wxyz[0]))


def _writer(participant: Participant, topic: Ros2Topic) -> RawWriter:
    return RawWriter(participant, topic, topic.depth, latched=topic.latched)


def _run_child(parent: Parent) -> None:
    """Publish for the program that started this process: the startup message is its config."""
    lower_priority()
    config: Config = parent.startup_message
    robot = G1.load(config.robot)
    with Participant(config.dds.domain, config.dds.interface) as participant:
        publisher = _Publisher(participant, robot)
        parent.ready()
        while not parent.done.wait(1 / config.record.tf_rate):
            publisher.publish()


if __name__ == "__main__":
    run_child(_run_child)
