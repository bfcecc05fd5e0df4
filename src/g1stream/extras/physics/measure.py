"""Physics of a motion: contacts, collisions and torques for each way to hold the robot.

There is no simulation. Every frame is analysed alone, with the velocities and accelerations of the
spline through the frames. docs/physics.md has the formulas, thresholds and sources.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, Final, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from g1stream.config import SafetyConfig
from g1stream.errors import ConfigError
from g1stream.extras.physics.batch_dynamics import BatchInverseDynamics
from g1stream.extras.physics.footing import CannotStandError
from g1stream.extras.physics.ground import (
    FRICTION,
    LIFTED,
    Flags,
    beyond_support,
    floor_forces,
    stretches,
    touching,
    zero_moment_point,
)
from g1stream.extras.physics.result import (
    Cause,
    Collision,
    Excess,
    Foot,
    MotionPhysics,
    TorquePeak,
    Verdict,
)
from g1stream.extras.physics.stance import stand_part
from g1stream.extras.physics.standing import find_instead
from g1stream.motion.motion import Motion
from g1stream.motion.trajectory import Trajectory
from g1stream.robot.dynamics import GRAVITY
from g1stream.robot.hulls import Hull, SelfCollision, read_hulls
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS
from g1stream.robot.kinematics import LinkPoses, pose_blocks
from g1stream.robot.model import G1
from g1stream.robot.rotations import rotation_matrices
from g1stream.robot.soles import SIDES, Soles
from g1stream.types import Floats, StreamSupport, Support

__all__ = ["Loads", "motion_physics", "movement_loads"]

# Limits, and the longest time beyond them; docs/physics.md explains the values.
_TOUCHING: Final = 1.0  # penetration depth of two links, mm
_OUTSIDE: Final = 10.0  # distance of the centre of pressure outside of the support polygon, mm
_UNSUPPORTED: Final = 0.2  # force without a contact that can exert it, over the weight
_SUNK: Final = 10.0  # depth below the floor, mm
_SKATING: Final = 100.0  # speed of a corner that touches the floor, mm/s
_TIPS: Final = 0.1  # time in which a robot on its feet begins to fall, s
_SAGS: Final = 0.5  # time in which a joint without enough torque leaves its place, s
_SWINGS: Final = 0.5  # time in which a hanging pelvis turns, s


class _Frames(NamedTuple):
    """Properties of T frames that need no dynamics."""

    fps: float  # frames per second
    first: int  # index of the first frame in the motion
    corners: Floats  # (T, 8, 3) m, world, of the soles
    touches: Flags  # (T, 8) whether a corner touches the floor
    speeds: Floats  # (T, 8) m/s, horizontal
    # Height (T,) of each link's lowest point, m, without the feet; infinite above the floor.
    heights: dict[str, Floats]
    # Penetration depth (T,) of each pair of links, m.
    depths: dict[tuple[str, str], Floats]


def motion_physics(
    motion: Motion,
    robot: G1 | None = None,
    *,
    max_tilt: float | None = None,
    played: Flags | None = None,
    frames: range | None = None,
    suggest: bool = False,
    trajectory: Trajectory | None = None,
    progress: Callable[[float], None] = lambda fraction: None,
) -> MotionPhysics:
    """The physics of a motion: contacts, collisions, centre of pressure and torques.

    docs/physics.md has the formulas, and the computing time.

    Args:
        motion: the motion; the floor is at height 0.
        robot: the G1; the default one if None.
        max_tilt: `safety.max_tilt`, rad; if None as there, by the support.
        played: (29,) the joints that play it, for support feet; all if None.
        frames: consecutive frames that are played, two or more; all if None.
        suggest: search for alternatives if it cannot be played with support feet.
        trajectory: spline through its frames; made if None.
        progress: called with the fraction done, 0 to 1.

    Raises:
        RobotError: the dynamics or the soles of this robot are unknown.
    """
    robot, frames = robot or G1.default(), frames or range(motion.n_frames)
    trajectory, soles = trajectory or Trajectory(motion), Soles(robot)
    known, look = _without_dynamics(motion, frames, robot, soles, progress)
    loads = movement_loads(
        trajectory, robot, soles, known.corners, known.touches, look, first=frames.start
    )
    root_quat_wxyz = motion.root_quat_wxyz[frames.start : frames.stop]
    tilt = np.arccos(rotation_matrices(root_quat_wxyz.T)[2, 2].clip(-1.0, 1.0))
    beyond = _beyond_support(known, loads)
    safety = SafetyConfig(max_tilt=max_tilt)

    def tilted(support: Support, values: Floats, longest: float) -> Excess | None:
        limit = safety.tilt_limit(support)
        return _excess(known, "tilt", "rad", values, limit, longest=longest)

    everywhere = _self_collision(known)
    found: dict[Support, list[Excess | None]] = {
        "bolted": [everywhere],
        "hanging": [everywhere, tilted("hanging", loads.hanging_tilt, _SWINGS)],
        "follow": [everywhere, tilted("follow", tilt, 0.0)],
        "free": [everywhere, tilted("free", tilt, 0.0), *_on_its_feet(known, loads, beyond)],
    }
    for support, excesses in found.items():
        over = partial(_excess, known, longest=_TIPS if support == "free" else _SAGS)
        tau, limit = np.abs(loads.tau[support]), robot.torque_limit
        excesses.append(over("torque", "N·m", tau, limit, JOINT_NAMES))
    verdicts: dict[StreamSupport, Verdict] = {}
    for support, excesses in found.items():
        against = sorted(filter(None, excesses), key=lambda excess: not excess.forbids)
        verdicts[support] = Verdict(support=support, excesses=tuple(against))
    verdicts["feet"] = _on_planted_feet(trajectory, robot, played, frames, suggest)
    stands = known.touches.any(axis=1)
    pressed = np.isfinite(beyond)
    worst = int(np.nanargmax(beyond)) if pressed.any() else None
    return MotionPhysics(
        motion=motion.name,
        first_frame=known.first,
        frames=len(frames),
        fps=motion.fps,
        robot=robot.name,
        mass_kg=loads.mass,
        verdicts=verdicts,
        tilt_rad=float(tilt.max()),
        hanging_tilt_rad=float(loads.hanging_tilt.max()),
        feet=tuple(_foot(known, robot.link_names[link], i) for i, link in enumerate(soles.links)),
        supported_share=float(stands.mean()),
        inside_share=float((beyond[pressed] <= 0.0).mean()) if pressed.any() else None,
        margin_mm=None if worst is None else -1e3 * float(beyond[worst]),
        margin_frame=None if worst is None else known.first + worst,
        collisions=_collisions(known, robot),
        torques={
            support: _peaks(known, tau, robot.torque_limit) for support, tau in loads.tau.items()
        },
    )


def _on_planted_feet(
    trajectory: Trajectory, robot: G1, played: Flags | None, frames: range, suggest: bool
) -> Verdict:
    motion = trajectory.motion
    if not robot.present.all():
        return Verdict(support="feet", refused="the robot lacks joints that it would need")
    try:
        standing = stand_part(motion, robot, frames, played, trajectory)
    except CannotStandError as error:
        instead = find_instead(motion, robot, frames, error, played) if suggest else ""
        return Verdict(support="feet", refused=error.why, instead=instead)
    except ConfigError:
        return Verdict(support="feet", refused="only some joints of the legs play it")
    return Verdict(support="feet", changed=str(standing) or "as it is")


def _without_dynamics(
    motion: Motion, frames: range, robot: G1, soles: Soles, progress: Callable[[float], None]
) -> tuple[_Frames, Callable[[slice, LinkPoses], None]]:
    """Feet and contacts, and a function that adds the links of some frames."""
    feet = [robot.link_names[link] for link in soles.links]
    hulls = [hull for hull in read_hulls(robot) if hull.link not in feet]
    collision = SelfCollision(robot)
    n_frames, pose = len(frames), _pose(motion, frames.start, len(frames))
    corners, joint_pos = soles.path(*pose), pose[0]
    heights = {hull.link: np.full(n_frames, np.inf) for hull in hulls}
    depths: dict[tuple[str, str], Floats] = {}

    def look(part: slice, poses: LinkPoses) -> None:
        for link, height in _lowest(robot, hulls, poses):
            heights[link][part] = np.minimum(heights[link][part], height)
        for pair, depth in collision.depths(joint_pos[part]).items():
            depths.setdefault(pair, np.zeros(n_frames))[part] = depth
        progress(part.stop / n_frames)

    touch = touching(corners, motion.fps)
    return _Frames(motion.fps, frames.start, corners, *touch, heights, depths), look


def _pose(motion: Motion, first: int, n_frames: int) -> tuple[Floats, Floats, Floats]:
    """Joints (T, 29), position (T, 3) and attitude (T, 4) of the pelvis in some frames."""
    part = slice(first, first + n_frames)
    return motion.joint_pos[part], motion.root_pos[part], motion.root_quat_wxyz[part]


def _lowest(robot: G1, hulls: Sequence[Hull], poses: LinkPoses) -> Iterator[tuple[str, Floats]]:
    """The height (T,) of each hull's lowest point, m; infinite above the floor."""
    links = [robot.link_index(hull.link) for hull in hulls]
    w, x, y, z = poses.quat_wxyz.T[:, links]
    # The world's vertical in the links' frames is the last row of their matrices.
    up = np.stack([2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)])
    for number, hull in enumerate(hulls):
        height, own = poses.pos.T[2, links[number]], up[:, number]
        centre, radius = hull.sphere
        near = height + centre @ own < radius
        if near.any():
            lowest = np.full(len(height), np.inf)
            lowest[near] = height[near] + (hull.vertices @ own[:, near]).min(axis=0)
            yield hull.link, lowest


def _beyond_support(frames: _Frames, loads: Loads) -> Floats:
    """Distance (T,) of the centre of pressure outside of the support polygon, m.

    NaN if no foot is on the floor, or if almost no weight is on the feet.
    """
    points = zero_moment_point(loads.force, loads.moment)
    pressed = frames.touches.any(axis=1) & (loads.force[:, 2] > _UNSUPPORTED * loads.weight)
    beyond = np.full(len(points), np.nan)
    beyond[pressed] = beyond_support(
        points[pressed], frames.corners[pressed], frames.touches[pressed]
    )
    return beyond


def _self_collision(frames: _Frames) -> Excess | None:
    values = 1e3 * _columns(frames.depths, len(frames.corners))
    names = [f"{link} in {other}" for link, other in frames.depths]
    return _excess(frames, "self-collision", "mm", values, _TOUCHING, names)


def _on_its_feet(frames: _Frames, loads: Loads, beyond: Floats) -> list[Excess | None]:
    """Problems of a motion on the robot's own feet, except tilt, torque and self-collision."""
    stands, over = frames.touches.any(axis=1), partial(_excess, frames)
    force, up = loads.force, loads.force[:, 2]
    pull = np.where(stands, np.maximum(-up, 0.0), np.linalg.norm(force, axis=1))
    # Feet near the floor that are too fast to stand slide on it: they carry, and do not hold.
    near = np.where(frames.corners[..., 2] < LIFTED, 1e3 * frames.speeds, np.inf).min(axis=1)
    carried = ~stands & (near > _SKATING) & np.isfinite(near) & (pull > _UNSUPPORTED * loads.weight)
    carried &= (up > 0.0) & (np.linalg.norm(force[:, :2], axis=1) <= FRICTION * up)
    glides, pull = np.where(carried, near, 0.0), np.where(carried, 0.0, pull)
    sideways = np.linalg.norm(force[:, :2], axis=1)
    pressed = np.isfinite(beyond)
    grip = np.divide(sideways, up, out=np.zeros_like(up), where=pressed)
    feet = [f"{side} foot" for side in SIDES for _ in range(4)]
    sinks = np.maximum(-1e3 * frames.corners[..., 2], 0.0)
    slides = 1e3 * np.where(frames.touches, frames.speeds, 0.0)
    below = np.maximum(-1e3 * _columns(frames.heights, len(force)), 0.0)
    outside = 1e3 * np.where(pressed, beyond, 0.0)
    return [
        over(
            "support", "of the weight", pull / loads.weight, _UNSUPPORTED, longest=_TIPS, most=_TIPS
        ),
        over("centre of pressure", "mm", outside, _OUTSIDE, longest=_TIPS),
        over("friction", "", grip, FRICTION, longest=_TIPS),
        over("floor contact", "mm", below, _SUNK, list(frames.heights), longest=_TIPS),
        over("penetration", "mm", sinks, _SUNK, feet),
        over("skating", "mm/s", glides, _SKATING, ("both feet",), longest=_TIPS),
        over("skating", "mm/s", slides, _SKATING, feet),
    ]


def _columns(arrays: Mapping[Any, Floats], n_frames: int) -> Floats:
    """K arrays (T,) as one (T, K)."""
    columns: Floats = np.array(list(arrays.values())).reshape(-1, n_frames).T
    return columns


def _excess(
    frames: _Frames,
    cause: Cause,
    unit: str,
    values: Floats,
    limit: float | Floats,
    names: Sequence[str] = ("",),
    *,
    longest: float | None = None,
    most: float = np.inf,
) -> Excess | None:
    """The excess of values (T,) or (T, K) over a limit, a number or (K,); None without one.

    If one of the K values is beyond it for longer than `longest` s, or its integral over the time
    beyond it is more than `most`, the excess forbids the motion, and only these frames count.
    """
    values = values.reshape(len(values), -1)
    limits = np.broadcast_to(np.asarray(limit, dtype=np.float64), values.shape[1:])
    over = values > limits
    if not over.any():
        return None
    lasting = (
        over if longest is None else _lasting(over, values, longest * frames.fps, most * frames.fps)
    )
    forbids = longest is not None and bool(lasting.any())
    over = lasting if forbids else over
    frame, column = divmod(int(np.where(over, values / limits, 0.0).argmax()), values.shape[1])
    anywhere = np.asarray(over.any(axis=1))
    longest_frames = max(np.diff(edges).max() for _, edges in _stretches_by_column(over))
    return Excess(
        cause=cause,
        where=names[column],
        worst=float(values[frame, column]),
        limit=float(limits[column]),
        unit=unit,
        frame=frames.first + frame,
        time_s=(frames.first + frame) / frames.fps,
        spans=_spans(frames, anywhere),
        longest_s=int(longest_frames) / frames.fps,
        forbids=forbids,
    )


def _lasting(flags: Flags, values: Floats, n_frames: float, total: float) -> Flags:
    """The runs of True in each column of (T, K) longer than `n_frames`, or with a larger sum."""
    lasting = np.zeros_like(flags)
    for k, edges in _stretches_by_column(flags):
        for first, stop in edges:
            if stop - first > n_frames or values[first:stop, k].sum() > total:
                lasting[first:stop, k] = True
    return lasting


def _stretches_by_column(flags: Flags) -> Iterator[tuple[int, NDArray[np.intp]]]:
    """The columns of (T, K) with runs of True, and the runs."""
    for k in np.flatnonzero(flags.any(axis=0)):
        yield int(k), stretches(flags[:, k])


def _spans(frames: _Frames, flags: Flags) -> tuple[tuple[int, int], ...]:
    """First and last frame of each run of True in (T,)."""
    edges = frames.first + stretches(flags)
    return tuple((int(first), int(stop) - 1) for first, stop in edges)


def _foot(frames: _Frames, link: str, number: int) -> Foot:
    own = slice(4 * number, 4 * number + 4)
    touches, heights = frames.touches[:, own], frames.corners[:, own, 2].min(axis=1)
    stands = touches.any(axis=1)
    deepest = int(heights.argmin())
    slides = np.where(touches, 1e3 * frames.speeds[:, own], -np.inf)
    fastest = int(slides.max(axis=1).argmax())
    down = bool(stands.any())
    return Foot(
        link=link,
        contact_share=float(stands.mean()),
        height_mm=1e3 * float(heights[stands].mean()) if down else None,
        penetration_mm=max(0.0, -1e3 * float(heights[deepest])),
        penetration_frame=frames.first + deepest,
        skating_mm_s=float(slides[touches].mean()) if down else None,
        skating_max_mm_s=float(slides[fastest].max()) if down else None,
        skating_max_frame=frames.first + fastest if down else None,
    )


def _collisions(frames: _Frames, robot: G1) -> tuple[Collision, ...]:
    solid = {hull.link for hull in read_hulls(robot) if hull.solid}
    found = []
    for (link, other), depths in frames.depths.items():
        frame = int(depths.argmax())
        found.append(
            Collision(
                link=link,
                other=other,
                depth_mm=1e3 * float(depths[frame]),
                frame=frames.first + frame,
                time_s=(frames.first + frame) / frames.fps,
                spans=_spans(frames, np.greater(depths, 0.0)),
                simulated={link, other} <= solid,
            )
        )
    return tuple(sorted(found, key=lambda one: -one.depth_mm))


def _peaks(frames: _Frames, tau: Floats, limit: Floats) -> tuple[TorquePeak, ...]:
    worst = np.abs(tau).argmax(axis=0)
    beyond = (np.abs(tau) > limit).sum(axis=0)
    peaks = [
        TorquePeak(
            joint=joint,
            torque_nm=float(tau[worst[j], j]),
            limit_nm=float(limit[j]),
            frame=frames.first + int(worst[j]),
            time_s=(frames.first + int(worst[j])) / frames.fps,
            frames=int(beyond[j]),
        )
        for j, joint in enumerate(JOINT_NAMES)
    ]
    return tuple(sorted(peaks, key=lambda peak: -peak.share))


class Loads(NamedTuple):
    """Loads of T frames."""

    mass: float  # kg, of the robot
    weight: float  # N
    tau: dict[Support, Floats]  # by support, (T, 29) N·m, motor order
    # (T, 3) N, world, external force that the pelvis's movement needs; at rest it is the weight,
    # upward.
    force: Floats
    moment: Floats  # (T, 3) N·m, world, of that force about the world's origin
    hanging_tilt: Floats  # (T,) rad, tilt of the pelvis of a robot that hangs at rest


def movement_loads(
    trajectory: Trajectory,
    robot: G1,
    soles: Soles,
    corners: Floats,
    touches: Flags,
    look: Callable[[slice, LinkPoses], None],
    first: int = 0,
) -> Loads:
    """The torques for each support, and the force and moment that the pelvis's movement needs.

    Joints move on the spline through the frames, whose accelerations are largest at frames. With
    `bolted` the pelvis is upright. With `hanging` it is at rest where the pose lets it hang, with
    the mass centre below the carrier's. With `free` the floor exerts the force on the touching
    corners (T, 8, 3), (T, 8), as far as it can (`floor_forces`); an external force on the pelvis
    is the rest. `look` is called with blocks of frames and the link poses in them. The first of
    the T frames has the index `first` in the motion.
    """
    dynamics, motion = BatchInverseDynamics.of(robot), trajectory.motion
    n_frames, feet = len(corners), np.repeat(soles.links, 4).tolist()
    tau: dict[Support, Floats] = {
        support: np.zeros((n_frames, N_JOINTS)) for support in get_args(Support)
    }
    force, moment = np.zeros((2, n_frames, 3))
    hanging_tilt = np.zeros(n_frames)
    for part, poses in pose_blocks(robot, *_pose(motion, first, n_frames)):
        look(part, poses)
        point = trajectory.sample_many((first + np.arange(part.start, part.stop)) / motion.fps)
        frames = dynamics.batch(poses, point.joint_vel, point.joint_acc)
        tau["bolted"][part] = frames.bolted()
        tau["hanging"][part], hanging_tilt[part] = frames.hanging()
        led = frames.follow(point.root_ang_vel, point.root_ang_acc, point.root_lin_acc)
        tau["follow"][part], force[part] = led.tau, led.force
        moment[part] = led.moment + np.cross(point.root_pos, led.force)
        pushes = floor_forces(corners[part], touches[part], force[part], moment[part])
        tau["free"][part] = led.tau - frames.torques_of(feet, corners[part], pushes)
    return Loads(dynamics.mass, dynamics.mass * GRAVITY, tau, force, moment, hanging_tilt)
