"""Session files of a robot whose every error is known, made without DDS or physics.

Each joint is asked for a sum of two sines; the measurement is the same, later, smaller, beside it
and noisy. So delay, bias, noise, gaps and clock offset are what was put in, and the metrics must
give them back (docs/metrics.md). Samples are written in batches, so that ten minutes take seconds.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from g1stream.dds.layout import CDR_HEADER, Layout
from g1stream.dds.messages import LOWCMD, LOWSTATE, REFERENCE, SPORTMODESTATE
from g1stream.extras.physics.legs import Legs
from g1stream.motion.blend import minimum_jerk
from g1stream.motion.motion import Motion
from g1stream.robot.joints import EXAMPLE_KD, EXAMPLE_KP, JOINT_NAMES, N_JOINTS
from g1stream.robot.model import G1
from g1stream.robot.rotations import quat_from_yaw, quat_rotate
from g1stream.robot.soles import Soles, bent_legs
from g1stream.session.streams import STREAMS
from g1stream.types import Floats, Ints, Phase

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import ArrayLike, NDArray

    from g1stream.dds.messages import Topic
    from g1stream.session.source import MemorySource
    from g1stream.session.writer import SessionWriter

__all__ = ["EPOCH", "SyntheticSession", "squatting", "stepping"]

EPOCH: Final = 1_700_000_000_000_000_000
"""Publish time of the first sample, ns since the epoch."""

#: Before and after PLAY, s.
_RAMP: Final = 0.5
_HOLD: Final = 0.3


@dataclass(frozen=True)
class SyntheticSession:
    """What is wrong with a robot, and how long it is recorded.

    Attributes:
        seconds: length of PLAY; RAMP of 0.5 s and HOLD of 0.3 s are around it.
        rate: commands and states per second, Hz; states are half a period after commands.
        delay: (29,) s or one for all, by which the robot is behind the reference.
        gain: by which it moves less than asked.
        bias: (29,) rad or one for all, reference - measured.
        noise: standard deviation of measured positions, rad.
        torque: (29,) N·m·s/rad or one for all: each motor's torque is so much times the velocity.
        gaps: (start, length) s, PLAY's first frame at 0, in which no LowState is recorded.
        clock_offset: of the robot's clock against the recorder's, s.
        latency: of every message, s.
        seed: of the noise.
        metadata: of the session.
    """

    seconds: float
    rate: float = 500.0
    delay: Floats | float = 0.0
    gain: float = 1.0
    bias: Floats | float = 0.0
    noise: float = 0.0
    torque: Floats | float = 0.0
    gaps: tuple[tuple[float, float], ...] = ()
    clock_offset: float = 0.0
    latency: float = 100e-6
    seed: int = 0
    metadata: Mapping[str, Any] = field(default_factory=dict)

    def joints(self, time: ArrayLike, late: ArrayLike = 0.0) -> tuple[Floats, Floats, Floats]:
        """q, dq and ddq (T, 29) of the reference at times (T,) s, or that much earlier."""
        numbers = np.arange(N_JOINTS)
        total = np.zeros((3, np.size(time), N_JOINTS))
        for amplitude, hertz in ((0.3, 0.21), (0.08, 1.3)):
            omega = 2.0 * np.pi * hertz * (1.0 + 0.03 * numbers)
            angle = omega * (np.asarray(time)[:, np.newaxis] - late) + numbers
            total[0] += amplitude * np.sin(angle)
            total[1] += amplitude * omega * np.cos(angle)
            total[2] -= amplitude * omega**2 * np.sin(angle)
        return total[0], total[1], total[2]

    def write(self, writer: SessionWriter | MemorySource) -> None:
        """Write the samples, and the metadata at the end."""
        rng = np.random.default_rng(self.seed)
        ticks = round((_RAMP + self.seconds + _HOLD) * self.rate)
        size = round(0.25 * self.rate)
        for start in range(0, ticks, size):
            ticked = np.arange(start, min(start + size, ticks))
            self._write_commands(writer, ticked)
            self._write_states(writer, ticked, rng)
        writer.add_metadata(self.metadata)

    def _write_commands(self, writer: SessionWriter | MemorySource, ticks: Ints) -> None:
        time = ticks / self.rate - _RAMP
        stamps = EPOCH + np.round(ticks * 1e9 / self.rate).astype(np.int64)
        q, dq, ddq = self.joints(time)
        in_play = (time >= -1e-9) & (time < self.seconds - 1e-9)
        phase = np.where(in_play, Phase.PLAY, np.where(time < 0.0, Phase.RAMP, Phase.HOLD))
        n = len(ticks)
        reference = {
            "tick": ticks,
            "motion_time": time.clip(0.0),
            "phase": phase,
            "q": q,
            "dq": dq,
            "ddq": ddq,
            "root_pos": np.tile([0.0, 0.0, 0.8], (n, 1)),
            "root_quat_wxyz": np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)),
        }
        command = {
            "motor_cmd.mode": np.ones((n, N_JOINTS)),
            "motor_cmd.q": q,
            "motor_cmd.dq": dq,
            "motor_cmd.kp": np.tile(EXAMPLE_KP, (n, 1)),
            "motor_cmd.kd": np.tile(EXAMPLE_KD, (n, 1)),
        }
        for topic, values in ((REFERENCE, reference), (LOWCMD, command)):
            logged = stamps + round(self.latency * 1e9)
            writer.write_batch(_NAMES[topic], _samples(topic, values, n), logged, stamps)

    def _write_states(
        self, writer: SessionWriter | MemorySource, ticks: Ints, rng: np.random.Generator
    ) -> None:
        time = (ticks + 0.5) / self.rate - _RAMP
        q, dq, ddq = self.joints(time, self.delay)
        measured = self.gain * q - self.bias + self.noise * rng.standard_normal(q.shape)
        tau = self.torque * dq
        kept = np.ones(len(time), dtype=bool)
        for start, length in self.gaps:
            kept &= (time < start) | (time >= start + length)
        n = int(kept.sum())
        stamps = EPOCH + np.round((ticks[kept] + 0.5) * 1e9 / self.rate).astype(np.int64)
        logged = stamps + round(self.latency * 1e9)
        published = stamps + round(self.clock_offset * 1e9)
        state = {
            "tick": ticks[kept],
            "motor_state.q": measured[kept],
            "motor_state.dq": self.gain * dq[kept],
            "motor_state.ddq": self.gain * ddq[kept],
            "motor_state.tau_est": tau[kept],
            "imu_state.quaternion": np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)),
        }
        base = {"position": np.tile([0.0, 0.0, 0.8], (n, 1))}
        for topic, values in ((LOWSTATE, state), (SPORTMODESTATE, base)):
            writer.write_batch(_NAMES[topic], _samples(topic, values, n), logged, published)


_NAMES: Final = {kind.source: topic for topic, kind in STREAMS.items()}


def _samples(topic: Topic, values: Mapping[str, Floats], n: int) -> NDArray[np.uint8]:
    """(n, size) samples of a topic with these fields, the others 0."""
    layout = Layout.of(topic.message.idl_type)
    rows = np.zeros((n, layout.sample_size), np.uint8)
    rows[:, : len(CDR_HEADER)] = np.frombuffer(CDR_HEADER, np.uint8)
    for path, given in values.items():
        place = layout[path]
        offsets = place.offsets[:N_JOINTS] if place.offsets.ndim else place.offsets
        octets = np.ascontiguousarray(given, place.dtype)[..., np.newaxis].view(np.uint8)
        rows[:, len(CDR_HEADER) + offsets[..., np.newaxis] + np.arange(octets.shape[-1])] = octets
    return rows


def squatting(seconds: float, *, arms: float = 0.6, fps: float = 50.0) -> Motion:
    """A motion that squats every 4 s, waves both arms and turns the waist, from rest.

    Args:
        seconds: its length.
        arms: how far the shoulders swing, rad.
        fps: frames per second.
    """
    time = np.arange(round(seconds * fps) + 1) / fps
    begun = minimum_jerk(time / 2.0)[0]

    def swing(hertz: float, phase: float = 0.0) -> Floats:
        wave: Floats = begun * np.sin(2.0 * np.pi * hertz * time + phase)
        return wave

    knee = 0.75 + 0.25 * swing(0.25)
    angles: dict[str, Floats | float] = {"waist_yaw": 0.4 * swing(0.2)}
    for side, sign in (("left", 1.0), ("right", -1.0)):
        angles |= {
            f"{side}_hip_pitch": -0.5 * knee,
            f"{side}_knee": knee,
            f"{side}_ankle_pitch": -0.5 * knee,
            f"{side}_hip_roll": 0.05 * sign,
            f"{side}_ankle_roll": -0.05 * sign,
            f"{side}_shoulder_pitch": arms * swing(0.5, 1.0 + 0.5 * sign),
            f"{side}_shoulder_roll": sign * (0.3 + 0.5 * arms * (begun + swing(0.3, -np.pi / 2))),
            f"{side}_elbow": 0.5 + 0.5 * swing(0.7),
        }
    joint_pos = np.zeros((len(time), N_JOINTS))
    for name, angle in angles.items():
        joint_pos[:, JOINT_NAMES.index(f"{name}_joint")] = angle
    root_pos = np.tile([0.0, 0.0, 0.7], (len(time), 1))
    return Motion.from_arrays(joint_pos, root_pos, fps=fps, name="squatting")


def stepping(
    places: ArrayLike, *, period: float = 1.6, swing: float = 0.8, fps: float = 50.0
) -> Motion:
    """A motion that steps: first the left foot, then the right one, and so on, from rest to rest.

    A foot is lifted by 6 cm. The pelvis stays midway between the feet, and not over the one that
    stands.

    Args:
        places: (N, 3) x and y, m, and heading, rad: where the robot would stand if both feet had
            come as far as the one that makes step k. It begins at 0, 0, 0.
        period: s from step to step.
        swing: s of it in which the foot is lifted.
        fps: frames per second.

    Raises:
        MotionError: the legs do not reach the places.
    """
    goals = np.concatenate([np.zeros((1, 3)), np.asarray(places, dtype=np.float64)])
    robot = G1.default()
    soles = Soles(robot)
    time = np.arange(round((len(goals) + 1) * period * fps) + 1) / fps
    # Where each foot would have the robot stand (T, 2, 3), and how high it is.
    stand, height = np.zeros((len(time), 2, 3)), np.zeros((len(time), 2))
    for k, goal in enumerate(goals[1:]):
        foot = k % 2
        way = minimum_jerk((time - (k + 1) * period) / swing)[0][:, np.newaxis]
        stand[:, foot] += way * (goal - goals[max(0, k - 1)])
        height[:, foot] += 0.06 * (4.0 * way * (1.0 - way))[:, 0]
    heading = stand[..., 2]
    turns = quat_from_yaw(heading)
    feet = quat_rotate(turns, np.array([[0.0, 0.1, 0.0], [0.0, -0.1, 0.0]]))
    feet[..., :2] += stand[..., :2]
    feet[..., 2] = height + soles.height
    middle = stand.mean(axis=1)
    root_pos = np.column_stack([middle[:, :2], np.full(len(time), 0.7)])
    root_quat = quat_from_yaw(middle[:, 2])
    pose = np.tile(bent_legs(0.4), (len(time), 1))
    motion = Motion.from_arrays(pose, root_pos, root_quat, fps=fps, name="stepping")
    return Legs(robot, soles, feet, turns, fps).reach(motion, root_pos)
