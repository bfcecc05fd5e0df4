"""Add the reference to a session that was recorded without one, from the motion."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from g1stream.dds.messages import REFERENCE, encode_samples, played_bits
from g1stream.errors import ConfigError, RecordingError
from g1stream.extras.attach.alignment import find_plays, least_similarity
from g1stream.input_limits import NUMBER
from g1stream.motion.trajectory import Trajectory
from g1stream.robot.joints import JOINT_GROUPS, JOINT_NAMES
from g1stream.robot.rotations import is_unit, quat_from_yaw, quat_mul, quat_rotate, yaw_of
from g1stream.session.records import (
    AttachedBy,
    AttachedInfo,
    MotionInfo,
    SessionInfo,
    StreamSummary,
    read_record,
)
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
from g1stream.types import MAX_GAP_NS, Floats, Ints, Phase

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    from g1stream.extras.attach.alignment import Alignment, Play
    from g1stream.motion.motion import Motion
    from g1stream.motion.spline import TrajectoryPoint
    from g1stream.session.recording import Recording

__all__ = ["Found", "Recorded", "encode_references", "find_motion", "with_motion"]

#: Rate of the references, Hz.
_RATE: Final = 500
#: Commands contain the motion if they are closer to it than the robot by this factor, or within
#: this distance, rad. In a dance the next frame at 30 fps differs by 0.011 rad.
_NEARER: Final = 0.5
_EXACT: Final = 0.03
#: A pelvis that moves less than this has not moved, m.
_MOVED: Final = 0.05


class Recorded(NamedTuple):
    """Joint positions to compare with a motion.

    Attributes:
        by: name of the source.
        published: (N,) ns.
        q: (N, 29) rad, motor order: targets, or measured positions.
    """

    by: AttachedBy
    published: Ints
    q: Floats


class Found(NamedTuple):
    """The playbacks of a motion in recorded positions. Times of plays are s after `zero`, ns."""

    by: AttachedBy
    zero: int
    alignment: Alignment

    @property
    def distance(self) -> float:
        """Error of the best playback, rad; infinite without a playback."""
        return self.alignment.best.rmse if self.alignment.best else float("inf")


def find_motion(recorded: Iterable[Recorded], trajectory: Trajectory) -> Found | None:
    """Find a motion in the most informative source; None if no source can show it.

    Commands are used if they contain joint targets of the motion, otherwise measured joints.
    Targets of a learned policy produce torques, and are no closer to the motion than the robot.

    Args:
        recorded: the sources, commands first.
        trajectory: the motion.
    """
    found: list[Found] = []
    for by, published, q in recorded:
        sane = np.flatnonzero((np.abs(q) < NUMBER).all(axis=1))
        _, once = np.unique(published[sane], return_index=True)
        rows = sane[once]
        if len(rows) and by != "measured joints":
            rows = rows[_sent_first(published[rows], q[rows])]
        if len(rows):
            zero = int(published[rows[0]])
            times = (published[rows] - zero) / 1e9
            one = Found(by, zero, find_plays(times, q[rows], trajectory))
            if not found and one.distance < _EXACT:
                return one  # the others cannot be nearer by much
            found.append(one)
    if not found:
        return None
    first, last = found[0], found[-1]
    if first.distance < _NEARER * last.distance:
        return first
    return min(found, key=lambda one: one.distance)


def _sent_first(published: Ints, q: Floats) -> NDArray[np.bool_]:
    """(N,) which commands say when their target was due: those that do not repeat a target.

    A program may repeat each target of 50 Hz at 500 Hz, and a robot that follows a repeated one is
    not late. Targets that stay for longer than a gap are rest, so they count again after it.
    """
    new = np.append(True, (q[1:] != q[:-1]).any(axis=1))
    begun = np.maximum.accumulate(np.where(new, published, published[0]))
    return np.asarray(new | (published - begun > MAX_GAP_NS))


def with_motion(session: Recording, motion: Motion, play: int = 1) -> ExtendedSource:
    """The session with a reference: the motion, found in the recorded joints.

    References have 500 Hz, from the first to the last played frame. Publish times are the motion's
    on the clock of the state, log times on the recorder's clock. Joints that do not follow count as
    not played; with measured joints only whole limbs, because a single joint may be stuck. Heading
    and place of the reference are those of the measured pelvis at the start, if they are known.
    Height is that of the motion.

    Args:
        session: session without a reference.
        motion: motion that was played completely or in part.
        play: number of the playback, from 1, if it was played several times.

    Raises:
        RecordingError: the session has a reference, or neither commands nor a state; the motion was
            not played in it; or several places in the motion are equally likely.
        ConfigError: it was played fewer times.
    """
    if session.topics.get(ReferenceStream.topic):
        raise RecordingError(
            f"{session.path} already has a reference.",
            "Use it without a motion, or give a session without a reference.",
        )
    trajectory = Trajectory(motion)
    found = find_motion(_recorded(session), trajectory)
    if found is None:
        raise RecordingError(
            f"{session.path} has neither commands nor states to compare with a motion.",
            "Record rt/lowcmd or rt/lowstate.",
        )
    plays, best, rival, ambiguous = found.alignment
    if best is None:
        near = (
            f" The most similar part is {rival.seconds:.1f} s of the motion, from "
            f"{rival.first:.1f} s on: similarity {rival.similarity:.2f} of at least "
            f"{least_similarity(rival):.2f}."
            if rival
            else ""
        )
        raise RecordingError(
            f"{motion.name} was not found in {session.path}: it is probably another motion.{near}",
            "Give the motion that was played; less than about 3 s of it are never found.",
        )
    if ambiguous and rival:
        raise RecordingError(
            f"The part of {motion.name} that was played in {session.path} is ambiguous: from "
            f"{best.first:.1f} s on the similarity is {best.similarity:.2f}, from "
            f"{rival.first:.1f} s on {rival.similarity:.2f}.",
            "Give only the part that was played: g1stream attach --start S --duration S.",
        )
    if not 1 <= play <= len(plays):
        raise ConfigError(
            f"{motion.name} was played {counted(len(plays), 'time')} in {session.path}, so there "
            f"is no number {play}.",
            f"Give a number from 1 to {len(plays)}.",
        )
    chosen = plays[play - 1]
    preview, seconds, published = _reference_times(session, found, chosen)
    at = chosen.speed * seconds
    point = trajectory.sample_many(at)
    pelvis = _pelvis(session, point, published)
    info = AttachedInfo(
        by=found.by,
        start_s=chosen.start + preview,
        speed=chosen.speed,
        first_s=chosen.first,
        last_s=chosen.last,
        similarity=chosen.similarity,
        rmse_rad=chosen.rmse,
        rival=rival.similarity if rival else None,
        play=play,
        plays=len(plays),
        starts_s=[one.span[0] + preview for one in plays],
        heading_from=pelvis.heading_from,
        place_from=pelvis.place_from,
        moves=pelvis.moves,
    )
    added, of_motion = MemorySource(), MotionInfo.from_motion(motion)
    played = _played(session, chosen, info)
    samples = encode_references(point, at, chosen.speed, played, pelvis.turn, pelvis.place)
    told = session.measured.clock_offset if session.topics.get(MeasuredStream.topic) else 0
    added.write_batch(ReferenceStream.topic, samples, published, published - told)
    added.add_metadata(
        {
            "attached": info.model_dump(mode="json"),
            "motion": of_motion.model_dump(mode="json", exclude_unset=True),
        }
    )
    attach_motion(added, of_motion, int(published[0]))
    return ExtendedSource(session.source, added)


def _recorded(session: Recording) -> Iterator[Recorded]:
    """The sources of a session that can be compared with a motion, on the recorder's clock."""
    kinds: dict[AttachedBy, type[CommandStream | MeasuredStream]] = {
        "commands": CommandStream,
        "arm commands": ArmCommandStream,
        "measured joints": MeasuredStream,
    }
    session.read(  # in one pass
        {
            CommandStream: ("q", "kp"),
            ArmCommandStream: ("q", "kp"),
            MeasuredStream: ("q", "imu_quat_wxyz"),
        }
    )
    for by, kind in kinds.items():
        if not session.topics.get(kind.topic):
            continue
        stream = session.stream(kind)
        # Commands without gains are torques.
        if isinstance(stream, CommandStream) and (stream.read("kp").kp == 0.0).all():
            continue
        yield Recorded(by, stream.published, stream.read("q").q)


def _reference_times(session: Recording, found: Found, play: Play) -> tuple[float, Floats, Ints]:
    """Preview of commands, s; and for N references the time after the motion's first frame, s,
    and the publish time on the recorder's clock, ns.
    """  # noqa: D205
    stream, _ = read_record(StreamSummary, session.metadata.get("stream"))
    ahead = found.by != "measured joints" and stream and stream.preview_s
    preview = float(ahead or 0.0)
    first, last = play.first / play.speed, play.last / play.speed
    seconds = first + np.arange(int((last - first) * _RATE + 1e-6) + 1) / _RATE
    start = found.zero + round((play.start + preview) * 1e9)
    return preview, seconds, start + np.round(seconds * 1e9).astype(np.int64)


def encode_references(
    point: TrajectoryPoint,
    at: Floats,
    speed: float,
    played: NDArray[np.bool_],
    turn: Floats,
    place: Floats,
) -> NDArray[np.uint8]:
    """(N, size) references in PLAY, encoded as the stream publishes them.

    Args:
        point: N points of the motion.
        at: (N,) s since its first frame.
        speed: seconds of the motion per second.
        played: (29,) which joints play it.
        turn: (4,) wxyz, rotation of the motion about the first point.
        place: (3,) m, new position of that point.
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


def _played(session: Recording, play: Play, info: AttachedInfo) -> NDArray[np.bool_]:
    """(29,) which joints count as played."""
    played = play.joints.copy()
    if info.by_robot:
        for joints in JOINT_GROUPS.values():
            played[list(joints)] = play.joints[list(joints)].any()
    known, _ = read_record(SessionInfo, session.metadata)
    played[[JOINT_NAMES.index(name) for name in (known.absent if known else [])]] = False
    return np.asarray(played)


class _Pelvis(NamedTuple):
    """Start of the reference: turn (4,) wxyz about the vertical, and place (3,), m."""

    turn: Floats
    place: Floats
    heading_from: str
    place_from: str
    moves: bool


def _pelvis(session: Recording, point: TrajectoryPoint, published: Ints) -> _Pelvis:
    """The turn and move that put the first of N points at the measured pelvis of that time."""
    turn, place = quat_from_yaw(0.0), point.root_pos[0].copy()
    heading_from, place_from, moves = "none", "none", False
    if session.topics.get(MeasuredStream.topic):
        state = session.measured
        quats = state.read("imu_quat_wxyz").imu_quat_wxyz
        valid = np.flatnonzero(is_unit(quats))
        if len(valid):
            near = valid[np.abs(state.published[valid] - published[0]).argmin()]
            heading_from = "imu"
            turn = quat_from_yaw(float(yaw_of(quats[near]) - yaw_of(point.root_quat_wxyz[0])))
    if session.topics.get(BaseStream.topic):
        base = session.stream(BaseStream)
        position = base.read("position").position
        sane = np.flatnonzero((np.abs(position) < NUMBER).all(axis=1))
        if len(sane):
            times, position = base.published[sane], position[sane]
            place_from = "sportmodestate"
            place[:2] = position[np.abs(times - published[0]).argmin(), :2]
            played = position[(times >= published[0]) & (times <= published[-1])]
            if len(played):
                way, asked = (np.ptp(one[:, :2], axis=0).max() for one in (played, point.root_pos))
                moves = bool(way > max(_MOVED, 0.5 * asked))
    return _Pelvis(turn, place, heading_from, place_from, moves)
