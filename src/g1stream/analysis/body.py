"""How closely the robot's links followed those of the reference, in metres.

Body-space metrics of papers use frames at the rate of a policy, 50 Hz, and velocities per frame.
Forward kinematics at every LowState would take ten times as long and give the same means. Reference
and measured robot are therefore sampled at the same times in PLAY.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from g1stream.analysis.tracking import blocks
from g1stream.robot.joints import N_JOINTS
from g1stream.robot.kinematics import BLOCK, LinkPoses, forward_kinematics
from g1stream.robot.rotations import (
    is_unit,
    quat_conj,
    quat_from_yaw,
    quat_mul,
    quat_normalize,
    quat_rotate,
    quat_rotate_inverse,
    sign_continuous,
    yaw_of,
)
from g1stream.session.records import Int, Record
from g1stream.session.streams import MAX_GAP_NS, Neighbours, neighbours
from g1stream.types import Floats, Ints

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from g1stream.analysis.tracking import Tracking
    from g1stream.robot.model import G1
    from g1stream.session.recording import Recording

__all__ = [
    "FPS",
    "MEASURED_COLUMNS",
    "REFERENCE_COLUMNS",
    "ROOT_COLUMNS",
    "BodyMetrics",
    "EndEffectorMetrics",
    "Excess",
    "Frames",
    "LinkMetrics",
    "MjlabMetrics",
    "PelvisMetrics",
    "RobotFrames",
    "TerminationMetrics",
    "body_metrics",
    "frames",
]

#: The links of BeyondMimic's tasks for the G1.
_END_EFFECTORS: Final = (
    "left_ankle_roll_link",
    "right_ankle_roll_link",
    "left_wrist_yaw_link",
    "right_wrist_yaw_link",
)
#: The bodies that BeyondMimic and mjlab track, and the one to which they attach the reference.
_TRACKED: Final = (
    "pelvis",
    *("left_hip_roll_link", "left_knee_link", "left_ankle_roll_link"),
    *("right_hip_roll_link", "right_knee_link", "right_ankle_roll_link"),
    "torso_link",
    *("left_shoulder_roll_link", "left_elbow_link", "left_wrist_yaw_link"),
    *("right_shoulder_roll_link", "right_elbow_link", "right_wrist_yaw_link"),
)
_ANCHOR: Final = "torso_link"
_DOWN: Final = np.array([0.0, 0.0, -1.0])
_MM: Final = 1e3
#: Errors at which SONIC counts a run as failed: height, m, and attitude of the pelvis, rad.
_SONIC_HEIGHT: Final = 0.25
_SONIC_ROTATION: Final = 1.0

FPS: Final = 50.0
_PERIOD: Final = round(1e9 / FPS)

ROOT_COLUMNS: Final = ("root_pos", "root_quat_wxyz", "root_lin_vel", "root_ang_vel")
REFERENCE_COLUMNS: Final = ("q", "dq", "phase", "played", "motion_time", *ROOT_COLUMNS)
MEASURED_COLUMNS: Final = ("q", "dq", "imu_quat_wxyz", "gyroscope")
"""The columns of a session that `frames` needs."""


class LinkMetrics(Record):
    """Distance of the links from those of the reference.

    Attributes:
        mpjpe_mm: mean distance, over links and frames.
        p99_mm, max_mm: over frames, of the mean over all links.
        max_at_s: time of the largest, since the motion's first frame.
        vel_mm_per_frame: mean error of the links' velocities; None with one frame.
        acc_mm_per_frame2: mean error of their accelerations; None with two frames.
        by_link_mm: mean distance of each link.
    """

    mpjpe_mm: float
    p99_mm: float
    max_mm: float
    max_at_s: float
    vel_mm_per_frame: float | None
    acc_mm_per_frame2: float | None
    by_link_mm: dict[str, float]


class EndEffectorMetrics(Record):
    """Distance of a hand or a foot from the reference's, in the pelvis's frame."""

    position_mm: float
    max_position_mm: float
    orientation_rad: float


class PelvisMetrics(Record):
    """Distance of the pelvis from the reference's; they coincide in the first frame.

    Attributes:
        orientation_rad, max_orientation_rad: mean and largest angle between the two.
        yaw_rate_rad_s: mean absolute error of the angular velocity about the pelvis's z axis.
        position_mm, max_position_mm, final_position_mm: mean, largest and last distance; None
            if the position was not measured.
        lin_vel_m_s: mean error of the velocity; None if the position was not measured.
    """

    orientation_rad: float
    max_orientation_rad: float
    yaw_rate_rad_s: float
    position_mm: float | None = None
    max_position_mm: float | None = None
    final_position_mm: float | None = None
    lin_vel_m_s: float | None = None


class Excess(Record):
    """The first time that a link was too far from the reference's.

    Attributes:
        at_s: time since the motion's first frame.
        link: name of the link.
        height_mm: error of its height, if that was too large.
        rotation_rad: error of its attitude, if that was too large.
    """

    at_s: float
    link: str
    height_mm: float | None = None
    rotation_rad: float | None = None

    def __str__(self) -> str:
        """The link, the error and the time."""
        wrong = "" if self.height_mm is None else f"{self.height_mm:.0f} mm in height"
        wrong = wrong or f"{self.rotation_rad or 0.0:.2f} rad in rotation"
        return f"{self.link} off by {wrong} at {self.at_s:.2f} s"


class TerminationMetrics(Record):
    """Largest errors of BeyondMimic's termination terms, and SONIC's failure.

    The anchor is `torso_link`, or the pelvis of a robot without that link.

    Attributes:
        max_anchor_height_mm: error of the anchor's height (`bad_anchor_pos_z_only`).
        max_gravity_difference: between the z components of the direction of gravity in the two
            anchors' frames, 0 to 2 (`bad_anchor_ori`).
        max_end_effector_height_mm: error of the height of a hand or a foot.
        sonic: first time that the height of the pelvis, a hand or a foot was off by more than
            250 mm, or the pelvis's attitude by more than 1 rad; None if there was none.
    """

    max_anchor_height_mm: float
    max_gravity_difference: float
    max_end_effector_height_mm: float
    sonic: Excess | None = None


class MjlabMetrics(Record):
    """The figures of mjlab's `evaluate` (1.6.0), over its 14 bodies of the G1, at 50 Hz.

    For all but the first and the last, mjlab moves the reference to the place of the robot's
    torso, keeping the height, and turns it to the torso's heading.

    Attributes:
        mpkpe_mm: mean distance of the bodies in the world.
        r_mpkpe_mm: the same after that.
        ee_pos_error_mm, ee_ori_error_rad: mean distance and angle of hands and feet after that.
        joint_vel_error_rad_s: mean over the frames of the RMS over the joints; None if the robot
            reports no velocities.
    """

    mpkpe_mm: float
    r_mpkpe_mm: float
    ee_pos_error_mm: float
    ee_ori_error_rad: float
    joint_vel_error_rad_s: float | None


class BodyMetrics(Record):
    """How closely the 30 bodies of the robot followed the reference in PLAY.

    Attributes:
        fps: frame rate.
        frames: number of frames.
        world: with the measured base; None if its position was not measured.
        root_relative: without the position of the base, with its attitude if that was measured.
        pelvis_frame: without position and attitude of the base: the effect of the joints alone.
        end_effectors: hands and feet, by link.
        pelvis: None if its attitude was not measured.
        terminations: None if its position was not measured.
        mjlab: None likewise, and for a robot without these bodies, or if only some joints played.
    """

    fps: float
    frames: Int
    world: LinkMetrics | None
    root_relative: LinkMetrics | None
    pelvis_frame: LinkMetrics
    end_effectors: dict[str, EndEffectorMetrics]
    pelvis: PelvisMetrics | None
    terminations: TerminationMetrics | None
    mjlab: MjlabMetrics | None


class RobotFrames(NamedTuple):
    """A robot in F frames, in the world of the reference.

    Attributes:
        q, dq: (F, 29) rad and rad/s.
        root_pos, root_lin_vel: (F, 3) m and m/s, world.
        root_quat_wxyz: (F, 4) pelvis to world.
        root_ang_vel: (F, 3) rad/s, pelvis frame.
    """

    q: Floats
    dq: Floats
    root_pos: Floats
    root_lin_vel: Floats
    root_quat_wxyz: Floats
    root_ang_vel: Floats


class Frames(NamedTuple):
    """F frames of PLAY, without the gaps of states and reference.

    Attributes:
        motion_time: (F,) s since the motion's first frame.
        consecutive: (F - 1,) whether the next frame follows without a gap.
        reference, measured: the two robots. The measured one is turned about the vertical and
            moved so that its pelvis is at the reference's in frame 0, because an IMU measures yaw
            relative to its start, and odometry has its own origin.
        has_attitude: whether an IMU measured the attitude; otherwise it is the reference's.
        has_position: whether position and attitude were measured; otherwise the position is the
            reference's.
    """

    motion_time: Floats
    consecutive: NDArray[np.bool_]
    reference: RobotFrames
    measured: RobotFrames
    has_attitude: bool
    has_position: bool


def frames(session: Recording, tracking: Tracking) -> Frames | None:
    """The frames of a session; None if PLAY is too short for one.

    Raises:
        RecordingError: the file is damaged.
    """
    reference = session.reference.read(*REFERENCE_COLUMNS)
    measured = session.measured.read(*MEASURED_COLUMNS)
    times = measured.published[tracking.states]
    numbers = np.arange((times[-1] - times[0]) // _PERIOD + 1)
    at = times[0] + numbers * _PERIOD
    states, asked = _around(times, at), _around(reference.published, at)
    known = np.intersect1d(states.instants, asked.instants)
    base, placed = session.base, asked
    if base is not None:
        placed = _around(base.published, at)
        both = np.intersect1d(known, placed.instants)
        finite = all(np.isfinite(one).all() for one in (base.position, base.velocity))
        known, base = (both, base) if finite and len(both) else (known, None)
    if not len(known):
        return None
    states, asked, placed = (
        one.where(np.isin(one.instants, known)) for one in (states, asked, placed)
    )
    done = states._replace(
        before=tracking.states[states.before], after=tracking.states[states.after]
    )
    asked_before, done_before = tracking.rows(states.before)
    asked_after, done_after = tracking.rows(states.after)
    target = RobotFrames(
        q=states.between(asked_before, asked_after),
        dq=asked.interpolate(reference.dq),
        root_pos=asked.interpolate(reference.root_pos),
        root_lin_vel=asked.interpolate(reference.root_lin_vel),
        root_quat_wxyz=quat_normalize(asked.interpolate(reference.root_quat_wxyz)),
        root_ang_vel=asked.interpolate(reference.root_ang_vel),
    )
    robot = target._replace(
        q=states.between(done_before, done_after),
        dq=done.interpolate(measured.recorded("dq")),
    )
    quat = done.interpolate(sign_continuous(measured.imu_quat_wxyz))
    # A missing IMU sends zeros.
    has_attitude = bool(is_unit(quat).all())
    has_attitude &= bool(np.isfinite(measured.gyroscope).all())
    if has_attitude:
        quat = quat_normalize(quat)
        yaw = yaw_of(target.root_quat_wxyz[0]) - yaw_of(quat[0])
        turn = quat_from_yaw(yaw)
        robot = robot._replace(
            root_quat_wxyz=quat_mul(turn, quat),
            root_ang_vel=done.interpolate(measured.gyroscope),
        )
        if base is not None:
            pos = placed.interpolate(base.position)
            robot = robot._replace(
                root_pos=target.root_pos[0] + quat_rotate(turn, pos - pos[0]),
                root_lin_vel=quat_rotate(turn, placed.interpolate(base.velocity)),
            )
    return Frames(
        motion_time=states.interpolate(tracking.motion_time[:, np.newaxis])[:, 0],
        consecutive=np.diff(known) == 1,
        reference=target,
        measured=robot,
        has_attitude=has_attitude,
        has_position=has_attitude and base is not None,
    )


def _around(times: Ints, at: Ints) -> Neighbours:
    """Neighbouring samples (N,), in any order, of instants (F,), in ns; none across a gap."""
    order = np.argsort(times, kind="stable")
    found = neighbours(times[order], at)
    found = found.where(found.gap <= MAX_GAP_NS)
    return found._replace(before=order[found.before], after=order[found.after])


def body_metrics(robot: G1, frames: Frames, joints: Sequence[int] = range(N_JOINTS)) -> BodyMetrics:
    """The metrics of the links in the world, relative to the pelvis's position and in its frame.

    Links are the 30 bodies of the G1: the pelvis and one for each joint. If only some joints were
    played, given by their motor indices, only the links that these move are used.
    """
    bodies = np.flatnonzero(_moved(robot, joints))
    names = [robot.link_names[i] for i in bodies]
    reference, measured = frames.reference, frames.measured
    ends = [names.index(name) for name in _END_EFFECTORS if name in names]
    root = robot.link_names[0]  # which is the anchor of a robot without a torso
    tracked = list(dict.fromkeys([root, *(one for one in _TRACKED if one in robot.link_names)]))
    # Without a position nothing is known of the links in the world.
    tracked = tracked if frames.has_position else []
    links = [*bodies, *map(robot.link_index, tracked)]
    n_frames = len(frames.motion_time)
    anchored = np.empty((n_frames, 6))
    alone, relative = np.empty((2, n_frames, len(bodies), 3))
    asked, done = (
        LinkPoses(np.empty((n_frames, len(ends), 3)), np.empty((n_frames, len(ends), 4)))
        for _ in range(2)
    )
    for part in blocks(n_frames, BLOCK):
        of_reference = _links(robot, reference, part, links)
        of_measured = _links(robot, measured, part, links)
        alone[part] = (of_reference[0].pos - of_measured[0].pos)[:, : len(bodies)]
        relative[part] = (of_reference[1] - of_measured[1])[:, : len(bodies)]
        if tracked:
            in_world = (
                LinkPoses(
                    pos[:, len(bodies) :] + state.root_pos[part, np.newaxis],
                    quat_mul(
                        state.root_quat_wxyz[part, np.newaxis], poses.quat_wxyz[:, len(bodies) :]
                    ),
                )
                for state, (poses, pos) in ((reference, of_reference), (measured, of_measured))
            )
            anchored[part] = _anchored(tracked, *in_world)
        for kept, (poses, _) in ((asked, of_reference), (done, of_measured)):
            kept.pos[part], kept.quat_wxyz[part] = poses.pos[:, ends], poses.quat_wxyz[:, ends]
    world = terminations = mjlab = None
    if frames.has_position:
        apart = reference.root_pos - measured.root_pos
        world = relative + apart[:, np.newaxis]
        terminations = TerminationMetrics(
            max_anchor_height_mm=float(anchored[:, 4].max() * _MM),
            max_gravity_difference=float(anchored[:, 5].max()),
            max_end_effector_height_mm=float(np.abs(world[:, ends, 2]).max(initial=0.0) * _MM),
            sonic=_first_excess(
                frames,
                [robot.link_names[0], *(names[end] for end in ends)],
                np.abs(np.column_stack([apart[:, 2], world[:, ends, 2]])),
            ),
        )
        present = np.flatnonzero(robot.present)
        if len(tracked) == len(_TRACKED) and np.isin(present, joints).all():
            means, speeds = anchored.mean(axis=0), (reference.dq - measured.dq)[:, present]
            known = measured.dq.any() and np.isfinite(speeds).all()
            mjlab = MjlabMetrics(
                mpkpe_mm=float(means[0] * _MM),
                r_mpkpe_mm=float(means[1] * _MM),
                ee_pos_error_mm=float(means[2] * _MM),
                ee_ori_error_rad=float(means[3]),
                joint_vel_error_rad_s=(
                    float(np.sqrt((speeds**2).mean(axis=1)).mean()) if known else None
                ),
            )
    return BodyMetrics(
        fps=FPS,
        frames=n_frames,
        world=None if world is None else _link_metrics(frames, names, world),
        root_relative=_link_metrics(frames, names, relative) if frames.has_attitude else None,
        pelvis_frame=_link_metrics(frames, names, alone),
        end_effectors={names[link]: _end_effector(asked, done, i) for i, link in enumerate(ends)},
        pelvis=_pelvis_metrics(frames) if frames.has_attitude else None,
        terminations=terminations,
        mjlab=mjlab,
    )


def _moved(robot: G1, joints: Sequence[int]) -> NDArray[np.bool_]:
    """(L,) the bodies that the played joints move; and the pelvis, if all joints were played."""
    bodies = robot.joint_of_link >= 0
    moved = np.isin(robot.joint_of_link, joints)
    if np.array_equal(moved, bodies):
        return np.asarray(bodies | (robot.parent < 0))
    for link in range(1, len(moved)):  # parents come before children
        moved[link] |= moved[robot.parent[link]]
    return np.asarray(moved & bodies)


def _links(
    robot: G1, state: RobotFrames, part: slice, bodies: Sequence[int]
) -> tuple[LinkPoses, Floats]:
    """Poses of L bodies in the pelvis's frame, and positions (F, L, 3) rotated by its attitude."""
    poses = forward_kinematics(robot, state.q[part], np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
    links = LinkPoses(poses.pos[:, bodies], poses.quat_wxyz[:, bodies])
    axes = quat_rotate(state.root_quat_wxyz[part, np.newaxis], np.eye(3))
    return links, links.pos @ axes


def _link_metrics(frames: Frames, names: list[str], difference: Floats) -> LinkMetrics:
    """Metrics of the differences of positions (F, L, 3) m, reference - measured."""
    distance = _norm(difference)
    of_frame = distance.mean(axis=1)
    worst = int(of_frame.argmax())
    both = frames.consecutive
    velocity = np.diff(difference, axis=0)
    vel = _mean_norm(velocity[both])
    acc = _mean_norm(np.diff(velocity, axis=0)[both[1:] & both[:-1]])
    return LinkMetrics(
        mpjpe_mm=float(of_frame.mean() * _MM),
        p99_mm=float(np.percentile(of_frame, 99.0) * _MM),
        max_mm=float(of_frame[worst] * _MM),
        max_at_s=float(frames.motion_time[worst]),
        vel_mm_per_frame=vel,
        acc_mm_per_frame2=acc,
        by_link_mm=dict(zip(names, (distance.mean(axis=0) * _MM).tolist(), strict=True)),
    )


def _mean_norm(vectors: Floats) -> float | None:
    """Mean length of vectors (F, L, 3) m, in mm; None without frames."""
    return float(_norm(vectors).mean() * _MM) if len(vectors) else None


def _norm(vectors: Floats) -> Floats:
    """(...) lengths of vectors (..., 3). numpy's norm takes twice as long."""
    length: Floats = np.sqrt(np.einsum("...k,...k", vectors, vectors))
    return length


def _end_effector(asked: LinkPoses, done: LinkPoses, link: int) -> EndEffectorMetrics:
    distance = np.linalg.norm(asked.pos[:, link] - done.pos[:, link], axis=-1)
    angle = _angle(asked.quat_wxyz[:, link], done.quat_wxyz[:, link])
    return EndEffectorMetrics(
        position_mm=float(distance.mean() * _MM),
        max_position_mm=float(distance.max() * _MM),
        orientation_rad=float(angle.mean()),
    )


def _pelvis_metrics(frames: Frames) -> PelvisMetrics:
    reference, measured = frames.reference, frames.measured
    angle = _angle(reference.root_quat_wxyz, measured.root_quat_wxyz)
    yaw_rate = np.abs(reference.root_ang_vel[:, 2] - measured.root_ang_vel[:, 2])
    distance = np.linalg.norm(reference.root_pos - measured.root_pos, axis=1) * _MM
    speed = np.linalg.norm(reference.root_lin_vel - measured.root_lin_vel, axis=1)
    known = frames.has_position
    return PelvisMetrics(
        orientation_rad=float(angle.mean()),
        max_orientation_rad=float(angle.max()),
        yaw_rate_rad_s=float(yaw_rate.mean()),
        position_mm=float(distance.mean()) if known else None,
        max_position_mm=float(distance.max()) if known else None,
        final_position_mm=float(distance[-1]) if known else None,
        lin_vel_m_s=float(speed.mean()) if known else None,
    )


def _angle(a: Floats, b: Floats) -> Floats:
    """(...) angles between rotations (..., 4), rad."""
    difference = quat_mul(quat_conj(a), b)
    angle: Floats = 2.0 * np.arctan2(
        np.linalg.norm(difference[..., 1:], axis=-1), np.abs(difference[..., 0])
    )
    return angle


def _first_excess(frames: Frames, links: list[str], heights: Floats) -> Excess | None:
    """The first excess of height errors (F, E) m, the pelvis first, or of its attitude."""
    rotation = _angle(frames.reference.root_quat_wxyz, frames.measured.root_quat_wxyz)
    shares = np.column_stack([rotation / _SONIC_ROTATION, heights / _SONIC_HEIGHT])
    beyond = (shares > 1.0).any(axis=1)
    if not beyond.any():
        return None
    first = int(beyond.argmax())
    worst = int(shares[first].argmax()) - 1
    at = float(frames.motion_time[first])
    if worst < 0:
        return Excess(at_s=at, link=links[0], rotation_rad=float(rotation[first]))
    height = float(heights[first, worst] * _MM)
    return Excess(at_s=at, link=links[worst], height_mm=height)


def _anchored(names: Sequence[str], asked: LinkPoses, done: LinkPoses) -> Floats:
    """(F, 6) errors of links (F, L) in the world, as BeyondMimic and mjlab define them.

    They are: the mean distance of the links; the same with the reference at the robot's anchor, at
    its own height and turned to the robot's heading; so the mean distance and angle of the end
    effectors; the error of the anchor's height; and the difference of gravity's z component in
    the anchors' frames. Distances are in m, angles in rad.
    """
    anchor = names.index(_ANCHOR if _ANCHOR in names else names[0])
    ends = [names.index(name) for name in _END_EFFECTORS if name in names]
    asked_quat, done_quat = asked.quat_wxyz[:, anchor], done.quat_wxyz[:, anchor]
    turn = quat_from_yaw(yaw_of(quat_mul(done_quat, quat_conj(asked_quat))))[:, np.newaxis]
    origin = done.pos[:, [anchor]].copy()
    origin[..., 2] = asked.pos[:, [anchor], 2]
    moved = origin + quat_rotate(turn, asked.pos - asked.pos[:, [anchor]])
    distance = _norm(moved - done.pos)
    angle = _angle(quat_mul(turn, asked.quat_wxyz[:, ends]), done.quat_wxyz[:, ends])
    down = [quat_rotate_inverse(quat, _DOWN)[:, 2] for quat in (asked_quat, done_quat)]
    errors = (
        _norm(asked.pos - done.pos).mean(axis=1),
        distance.mean(axis=1),
        distance[:, ends].mean(axis=1) if ends else np.zeros(len(distance)),
        angle.mean(axis=1) if ends else np.zeros(len(distance)),
        np.abs(asked.pos[:, anchor, 2] - done.pos[:, anchor, 2]),
        np.abs(down[0] - down[1]),
    )
    return np.column_stack(errors)
