"""From batches of raw samples to the derived channels: transforms, joint states, log lines."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from g1stream.dds.messages import Log
from g1stream.dds.topics import LOG, LOWSTATE, REFERENCE, SPORTMODESTATE
from g1stream.foxglove.encoders import MEASURED_PREFIX, JointStatesEncoder, TfEncoder, encode_log
from g1stream.foxglove.measured_base import MeasuredBase
from g1stream.foxglove.tracking_error import Track, TrackingError
from g1stream.session.samples import Samples

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from g1stream.robot.model import G1
    from g1stream.session.samples import Batch

__all__ = ["Derived", "Deriver", "Every"]


class Derived(NamedTuple):
    """Messages of one channel: payloads (T, size) uint8 or T bytes, and both times (T,) ns."""

    topic: str
    payloads: NDArray[np.uint8] | list[bytes]
    log_times: NDArray[np.int64]
    publish_times: NDArray[np.int64]


class Every:
    """Picks from stamps in order the first of each period, so that a rate is thinned evenly.

    Args:
        rate: how many a second are wanted; a slower source passes whole.
    """

    def __init__(self, rate: float) -> None:
        self._period = round(1e9 / rate)
        self._slot: int | None = None

    def pick(self, stamps_ns: NDArray[np.int64]) -> NDArray[np.intp]:
        """Indices of the stamps (T,) to keep."""
        slots = stamps_ns // self._period
        before = np.concatenate([[-1 if self._slot is None else self._slot], slots[:-1]])
        self._slot = int(slots[-1]) if len(slots) else self._slot
        return np.flatnonzero(slots != before)


class Deriver:
    """Makes the derived messages of each batch.

    Args:
        robot: whose links are shown.
        tf_rate: transforms per second, Hz.

    Attributes:
        base: where the measured pelvis is taken to be.
    """

    def __init__(self, robot: G1, tf_rate: float) -> None:
        self._tf = TfEncoder(robot)
        self._measured_tf = TfEncoder(robot, MEASURED_PREFIX)
        self._joints = JointStatesEncoder(robot)
        self._tracking = TrackingError(robot)
        self._every_reference = Every(tf_rate)
        self._every_state = Every(tf_rate)
        self._log = Log()
        self.base = MeasuredBase()

    def derive(self, batches: Mapping[str, Batch]) -> list[Derived]:
        """The messages that follow from raw samples.

        Args:
            batches: by DDS topic name, oldest first.

        Raises:
            ValueError: a sample is not of its topic's type.
        """
        made: list[Derived] = []
        if REFERENCE.name in batches:
            made += self._from_references(batches[REFERENCE.name])
        if SPORTMODESTATE.name in batches:
            batch = batches[SPORTMODESTATE.name]
            positions = Samples(SPORTMODESTATE, batch.data)["position"].astype(float)
            self.base.see_positions(np.array(batch.publish_times), positions)
        if LOWSTATE.name in batches:
            made += self._from_states(batches[LOWSTATE.name])
        if LOG.name in batches:
            made.append(self._from_log(batches[LOG.name]))
        made.append(Derived("/tracking_error/joint_states", *self._tracking.take()))
        return [derived for derived in made if len(derived.log_times)]

    def _from_references(self, batch: Batch) -> list[Derived]:
        samples = Samples(REFERENCE, batch.data)
        logged, published = _times(batch)
        q, dq, root_pos = samples["q"], samples["dq"], samples["root_pos"]
        root_quat = samples["root_quat_wxyz"]
        self.base.see_references(published, root_pos, root_quat)
        self._tracking.add_references(Track(published, logged, q, dq))
        joints = self._joints.encode(published, q, dq, samples["ddq"], samples["tau"])
        few = self._every_reference.pick(published)
        tf = self._tf.encode(published[few], q[few], root_pos[few], root_quat[few])
        return [
            Derived("/reference/joint_states", joints, logged, published),
            Derived("/tf", tf, logged[few], published[few]),
        ]

    def _from_states(self, batch: Batch) -> list[Derived]:
        samples = Samples(LOWSTATE, batch.data)
        logged, published = _times(batch)
        q, dq, ddq, tau = (
            samples[f"motor_state.{name}"].astype(float) for name in ("q", "dq", "ddq", "tau_est")
        )
        self._tracking.add_states(Track(published, logged, q, dq))
        joints = self._joints.encode(published, q, dq, ddq, tau)
        few = self._every_state.pick(published)
        imu_quats = samples["imu_state.quaternion"][few].astype(float)
        positions, quats = self.base.poses(published[few], imu_quats)
        tf = self._measured_tf.encode(published[few], q[few], positions, quats)
        return [
            Derived("/measured/joint_states", joints, logged, published),
            Derived("/measured/tf", tf, logged[few], published[few]),
        ]

    def _from_log(self, batch: Batch) -> Derived:
        lines = []
        for data, published in zip(batch.data, batch.publish_times, strict=True):
            self._log.load(data)
            lines.append(
                encode_log(published, int(self._log.level), self._log.name, self._log.text)
            )
        return Derived("/log", lines, *_times(batch))


def _times(batch: Batch) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    return np.array(batch.log_times), np.array(batch.publish_times)
