"""A reference for a session that was recorded without one: the motion when it was played."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from g1stream.analysis.alignment import find_plays
from g1stream.dds.messages import REFERENCE, encode_samples, played_bits
from g1stream.errors import ConfigError, RecordingError
from g1stream.input_limits import NUMBER
from g1stream.motion.trajectory import Trajectory
from g1stream.robot.joints import JOINT_GROUPS
from g1stream.robot.rotations import is_unit, quat_from_yaw, quat_mul, quat_rotate, yaw_of
from g1stream.session.records import AttachedInfo, MotionInfo, StreamSummary, read_record
from g1stream.session.source import ExtendedSource, MemorySource
from g1stream.session.streams import (
    ArmCommandStream,
    BaseStream,
    CommandStream,
    MeasuredStream,
    ReferenceStream,
)
from g1stream.session.writer import attach_motion
from g1stream.text import counted
from g1stream.types import Floats, Ints, Phase

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from g1stream.analysis.alignment import Alignment, Play
    from g1stream.motion.motion import Motion
    from g1stream.motion.spline import TrajectoryPoint
    from g1stream.session.recording import Recording

__all__ = ["encode_references", "with_motion"]

#: References a second of the session, Hz.
_RATE: Final = 500
#: What is compared with the motion, in words.
_COMPARED: Final[dict[type[CommandStream | MeasuredStream], str]] = {
    CommandStream: "commands",
    ArmCommandStream: "arm commands",
    MeasuredStream: "measured joints",
}
#: A pelvis that goes less far has not moved, m.
_MOVED: Final = 0.05
#: Commands carry the motion where they are nearer to it than the robot is, by this factor, or that
#: near, rad: the next of 30 frames a second is off by 0.011 rad in a dance.
_NEARER: Final = 0.5
_EXACT: Final = 0.03


class _Found(NamedTuple):
    """Where the motion is in a stream, whose first sample is at `zero` ns."""

    by: str
    zero: int
    alignment: Alignment


def with_motion(session: Recording, motion: Motion, play: int = 1) -> ExtendedSource:
    """The session with a reference: the motion, found by the joints that were recorded.

    Commands tell when it was played, where they carry joint targets of it, else measured joints.
    References are 500 a second. Their publish times are those of the motion on the recorder's
    clock; log times are the same. Joints that do not follow count as not played: of commands each,
    of measured joints only a whole limb. Heading and place of the reference are those of the
    measured pelvis when it begins, as far as these are known; its height is the motion's.

    Args:
        session: without a reference.
        motion: what was played, or a part of it.
        play: which time, from 1, where it was played several times.

    Raises:
        RecordingError: the session has a reference, or neither commands nor a state; the motion was
            not played in it; or several places in the motion are as likely.
        ConfigError: it was not played that often.
    """
    if session.topics.get(ReferenceStream.topic):
        raise RecordingError(
            f"{session.path} has a reference already.",
            "Use it as it is, or give a session that was recorded without one.",
        )
    trajectory = Trajectory(motion)
    found = _find(session, trajectory)
    plays, rival = found.alignment.plays, found.alignment.rival
    if not plays:
        near = (
            f" The nearest is {rival.seconds:.1f} s from {rival.first:.1f} s on, with a similarity "
            f"of {rival.similarity:.2f}."
            if rival
            else ""
        )
        raise RecordingError(
            f"{motion.name} was not played in {session.path}, by its {found.by}.{near}",
            "Give the motion that was played; at least some 3 s of it must be in the session.",
        )
    if found.alignment.ambiguous and rival:
        raise RecordingError(
            f"It cannot be told what of {motion.name} was played in {session.path}: from "
            f"{plays[0].first:.1f} s on it is similar by {plays[0].similarity:.2f}, from "
            f"{rival.first:.1f} s on by {rival.similarity:.2f}.",
            "Give only the part of the motion that was played (--trim), or a longer session.",
        )
    if not 1 <= play <= len(plays):
        raise ConfigError(
            f"{motion.name} was played {counted(len(plays), 'time')} in {session.path}, and {play} "
            "is asked for.",
            f"Give a number from 1 to {len(plays)}.",
        )
    chosen = plays[play - 1]
    info = AttachedInfo(
        by=found.by,
        start_s=chosen.start,
        speed=chosen.speed,
        first_s=chosen.first,
        last_s=chosen.last,
        similarity=chosen.similarity,
        rmse_rad=chosen.rmse,
        rival=rival.similarity if rival else None,
        play=play,
        plays=len(plays),
        starts_s=[one.start for one in plays],
    )
    added = MemorySource()
    start = found.zero + round(chosen.start * 1e9)
    _write_references(added, session, trajectory, chosen, start, info)
    of_motion = MotionInfo.from_motion(motion)
    added.add_metadata(
        {
            "attached": info.model_dump(mode="json"),
            "motion": of_motion.model_dump(mode="json", exclude_unset=True),
        }
    )
    attach_motion(added, of_motion, start)
    return ExtendedSource(session.source, added)


def _find(session: Recording, trajectory: Trajectory) -> _Found:
    """Where the motion is in the session, by what tells it best."""
    found = []
    for kind, by in _COMPARED.items():
        if not session.topics.get(kind.topic):
            continue
        stream = session.stream(kind)
        if isinstance(stream, CommandStream) and (stream.read("kp").kp == 0.0).all():
            continue  # torques without targets
        q = stream.read("q").q
        published = stream.published
        sane = np.flatnonzero((np.abs(q) < NUMBER).all(axis=1))
        _, first = np.unique(published[sane], return_index=True)
        rows = sane[first]
        if len(rows) < 2:
            continue
        zero = int(published[rows[0]])
        times = (published[rows] - zero) / 1e9
        found.append(_Found(by, zero, find_plays(times, q[rows], trajectory)))
    if not found:
        raise RecordingError(
            f"{session.path} has neither commands nor states to compare with a motion.",
            "Record rt/lowcmd or rt/lowstate.",
        )
    best = min(found, key=_distance)
    # The robot is never nearer to the motion than the targets that it is given, unless they are
    # there for their torques, as those of a learned policy.
    by_command, by_robot = _distance(found[0]), _distance(found[-1])
    return found[0] if by_command < max(_NEARER * by_robot, _EXACT) else best


def _distance(found: _Found) -> float:
    """rad, by which the best play is off; infinite without one."""
    plays = found.alignment.plays
    return max(plays, key=lambda one: one.explained).rmse if plays else float("inf")


def _write_references(
    added: MemorySource,
    session: Recording,
    trajectory: Trajectory,
    play: Play,
    start: int,
    info: AttachedInfo,
) -> None:
    """Write the references of a play whose first frame is at `start` ns; complete `info`."""
    stream, _ = read_record(StreamSummary, session.metadata.get("stream"))
    first, last = play.first / play.speed, play.last / play.speed
    seconds = first + np.arange(int((last - first) * _RATE + 1e-6) + 1) / _RATE
    at = play.speed * seconds
    published = start + np.round(seconds * 1e9).astype(np.int64)
    if not info.by_robot and stream and stream.preview_s:
        published += round(stream.preview_s * 1e9)
    point = trajectory.sample_many(at)
    turn, place = _heading_and_place(session, point, published, info)
    samples = encode_references(point, at, play.speed, _played(play, info), turn, place)
    added.write_batch(ReferenceStream.topic, samples, published, published)


def encode_references(
    point: TrajectoryPoint,
    at: Floats,
    speed: float,
    played: NDArray[np.bool_],
    turn: Floats,
    place: Floats,
) -> NDArray[np.uint8]:
    """(N, size) References in PLAY, as a stream of ours would have published them.

    Args:
        point: N points of the motion.
        at: (N,) s since its first frame.
        speed: seconds of the motion in a second.
        played: (29,) which joints play it.
        turn: (4,) wxyz, about the first point, by which the motion is turned.
        place: (3,) m, where that point is put.
    """
    values = {
        "tick": np.arange(len(at)),
        "motion_time": at,
        "phase": np.full(len(at), int(Phase.PLAY)),
        "played": np.full(len(at), played_bits(played)),
        "q": point.joint_pos,
        "dq": speed * point.joint_vel,
        "ddq": speed**2 * point.joint_acc,
        "root_pos": place + quat_rotate(turn, point.root_pos - point.root_pos[0]),
        "root_quat_wxyz": quat_mul(turn, point.root_quat_wxyz),
        "root_lin_vel": speed * quat_rotate(turn, point.root_lin_vel),
        "root_ang_vel": speed * point.root_ang_vel,
    }
    return encode_samples(REFERENCE, values, len(at))


def _played(play: Play, info: AttachedInfo) -> NDArray[np.bool_]:
    """(29,) which joints count as played."""
    if not info.by_robot:
        return play.joints
    # A joint that does not follow may be one that is stuck.
    played = play.joints.copy()
    for joints in JOINT_GROUPS.values():
        played[list(joints)] = play.joints[list(joints)].any()
    return np.asarray(played)


def _heading_and_place(
    session: Recording, point: TrajectoryPoint, published: Ints, info: AttachedInfo
) -> tuple[Floats, Floats]:
    """How to move N points of the motion so that the first is where the pelvis was then.

    Completes `info`.

    Returns:
        The turn (4,) wxyz about the vertical through the first point, and where that is, (3,) m.
    """
    turn, place = quat_from_yaw(0.0), point.root_pos[0].copy()
    if session.topics.get(MeasuredStream.topic):
        state = session.measured
        quats = state.read("imu_quat_wxyz").imu_quat_wxyz
        valid = np.flatnonzero(is_unit(quats))
        if len(valid):
            near = valid[_nearest(state.published[valid], published[0])]
            info.heading_from = "imu"
            turn = quat_from_yaw(float(yaw_of(quats[near]) - yaw_of(point.root_quat_wxyz[0])))
    if session.topics.get(BaseStream.topic):
        base = session.stream(BaseStream)
        position = base.read("position").position
        sane = np.flatnonzero((np.abs(position) < NUMBER).all(axis=1))
        if len(sane):
            times = base.published[sane]
            info.place_from = "sportmodestate"
            place[:2] = position[sane[_nearest(times, published[0])], :2]
            played = position[sane[(times >= published[0]) & (times <= published[-1])]]
            if len(played):
                way, asked = (np.ptp(one[:, :2], axis=0).max() for one in (played, point.root_pos))
                info.moves = bool(way > max(_MOVED, 0.5 * asked))
    return turn, place


def _nearest(times: Ints, at: np.int64) -> int:
    return int(np.abs(times - at).argmin())
