"""What is known of a session before its first sample: the metadata that its file begins with."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import Field

from g1stream.robot.joints import JOINT_NAMES
from g1stream.session.records import Int, Record

if TYPE_CHECKING:
    from collections.abc import Mapping

    from g1stream.config import Config
    from g1stream.motion.motion import Motion
    from g1stream.robot.model import G1
    from g1stream.types import Floats

__all__ = ["MotionInfo", "SessionInfo"]


class MotionInfo(Record):
    """The motion that was played.

    Attributes:
        name: of the motion.
        fps: frames per second of its file.
        frames: how many.
        sha256: of its file.
        content_sha256: of its frames, see `Motion.content_sha256`.
        source: path of its file.
        operations: what was done to the motion in the file, in this order.
        parts: the motions that it was joined of, in their order.
    """

    name: str | None = None
    fps: Annotated[float, Field(gt=0)] | None = None
    frames: Int | None = None
    sha256: str | None = None
    content_sha256: str | None = None
    source: str | None = None
    operations: list[str] = []
    parts: list[MotionInfo] = []

    @classmethod
    def of(cls, motion: Motion) -> MotionInfo:
        """Of a motion in memory."""
        return cls(
            name=motion.name,
            fps=motion.fps,
            frames=motion.n_frames,
            sha256=motion.sha256,
            content_sha256=motion.content_sha256,
            source=str(motion.source) if motion.source else None,
            operations=list(motion.operations),
            parts=[cls.of(part) for part in motion.parts],
        )

    @property
    def duration_s(self) -> float | None:
        """From the first frame to the last, s."""
        return (self.frames - 1) / self.fps if self.frames and self.fps else None


class SessionInfo(Record):
    """What is known of a session before its first sample: the file's metadata as it begins.

    Attributes:
        g1stream: version that recorded it.
        versions: of the packages that it used.
        host, domain, interface: where it was recorded.
        log_clock: that of the log times; of a rollout it begins with "simulated".
        motion: what is played.
        gains: kp in N·m/rad and kd in N·m·s/rad, 29 each, motor order.
        joints: names of those that play the motion; None in files of earlier versions: all.
        absent: names of those that the robot does not have.
        config: all settings of the streamer.
    """

    g1stream: str | None = None
    versions: dict[str, str] = {}
    host: str | None = None
    domain: Int | None = None
    interface: str | None = None
    log_clock: str | None = None
    motion: MotionInfo | None = None
    gains: dict[str, list[float]] | None = None
    joints: list[str] | None = None
    absent: list[str] = []
    config: dict[str, Any] | None = None

    @classmethod
    def of(
        cls,
        config: Config,
        robot: G1,
        motion: Motion,
        gains: Mapping[str, Floats],
    ) -> SessionInfo:
        """Of a motion that is about to be played; `gains` are arrays by the names in `Gains`."""
        return cls(
            motion=MotionInfo.of(motion),
            gains={name: values.tolist() for name, values in gains.items()},
            joints=[
                JOINT_NAMES[i] for i in np.flatnonzero(robot.select(config.stream.played_joints))
            ],
            absent=[JOINT_NAMES[i] for i in robot.joint_set.absent],
            config=config.model_dump(mode="json"),
        )
