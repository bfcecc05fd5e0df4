"""Find the cause of the largest tracking error, from evidence just before it.

Causes are checked in this order. Each may cause those after it but none before it: a stall or a
contact loads a motor up to its limit, and a motor at its limit makes its joint late.

- stall: the stream sent no command for longer than a servo can hold its target without harm.
- simulator: the robot's clock was slower than the motion, or stopped for a moment.
- self-collision: links are inside each other in the reference, and the robot keeps them apart.
- position limit, speed limit: the motion exceeds it, and the stream clamped the joint's target.
- torque: the motor was at its limit.
- start: PLAY began with the error, which RAMP had left.
- lag: the joint did what was commanded its usual delay earlier.
- no feed-forward: commands had no torque, so the servo needed the error to produce it.

An error of less than a degree has no cause: the joint followed.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, Literal

import numpy as np

from g1stream.control.robot_clock import counts_messages
from g1stream.errors import RobotError
from g1stream.input_limits import NUMBER
from g1stream.robot.hulls import SelfCollision
from g1stream.robot.joints import JOINT_NAMES
from g1stream.session.records import Record, SessionInfo, StreamSummary, read_record
from g1stream.session.streams import ArmCommandStream, CommandStream, MeasuredStream
from g1stream.text import short_name
from g1stream.types import Phase

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from g1stream.analysis.tracking import Tracking
    from g1stream.app.session import Session
    from g1stream.robot.model import G1
    from g1stream.session.recording import Recording
    from g1stream.session.streams import Stream
    from g1stream.types import Floats

__all__ = ["CauseName", "WorstError", "worst_error"]

CauseName = Literal[
    "stall",
    "simulator",
    "self-collision",
    "position limit",
    "speed limit",
    "torque",
    "start",
    "lag",
    "no feed-forward",
]

#: A smaller error is no fault, rad.
_SMALL: Final = math.radians(1.0)
#: An error grows for at most this time, s: a leg swings back in that time.
_GROWTH: Final = 0.3
#: An error begins to grow at this fraction of its maximum, and its cause may be earlier by this, s.
_BEGUN, _EARLIER = 0.1, 0.1
#: Least fraction of the error that a cause must explain.
_SHARE: Final = 0.5
#: Longest harmless time between commands, s; a servo holds its last target meanwhile.
_STALL: Final = 0.02
#: Ratio of robot time to motion time below which a simulator is too slow.
_SLOW: Final = 0.8
#: A robot whose clock counts ms is behind the motion beyond this, s.
_BEHIND: Final = 0.003
#: At least this fraction of ticks that count ms must have the usual step.
_REGULAR: Final = 0.9
#: A collision is deeper than this, m; less may be rounding of the hulls.
_INSIDE: Final = 0.001
#: Links that a robot keeps apart touch within this fraction of the way to the reference.
_NEAR: Final = 0.25
#: Number of poses that are checked for collisions.
_MOST_POSES: Final = 50
#: A motor at this fraction of its limit counts as at its limit. The stream limits the expected
#: torque, which differs from the motor's by some percent.
_AT_LIMIT: Final = 0.95
#: A motor that is at its limit for this time, s, changes its joint's speed.
_LONG: Final = 0.01


class WorstError(Record):
    """The largest tracking error of a joint, and its cause.

    Attributes:
        joint: name of the joint.
        error_rad: reference - measured.
        at_s: time since the motion's first frame.
        cause: None if none was found, or if the error is below a degree and needs none.
        why: the evidence, in words; empty without a cause.
    """

    joint: str
    error_rad: float
    at_s: float
    cause: CauseName | None = None
    why: str = ""

    def __str__(self) -> str:
        """The joint, the error, the time and the evidence."""
        size = f"{math.degrees(abs(self.error_rad)):.2f} deg"
        name = self.joint.removesuffix("_joint")
        why = self.why or "no cause found" * (abs(self.error_rad) >= _SMALL)
        return f"{name} {size} at {self.at_s:.2f} s" + (f": {why}" if why else "")


def worst_error(session: Session) -> WorstError:
    """Find the largest error of a played joint, and its cause.

    Args:
        session: session with a reference and a measured state.

    Raises:
        RecordingError: the file is damaged, or there is nothing to compare.
    """
    tracking = session.tracking()
    stream, _ = read_record(StreamSummary, session.metadata.get("stream"))
    known, _ = read_record(SessionInfo, session.metadata)
    safety = (known.config or {}).get("safety", {}) if known else {}
    kept = safety.get("position_margin") if isinstance(safety, dict) else None
    margin = kept if isinstance(kept, float) else 0.0
    try:
        robot = session.robot
    except RobotError:
        robot = None
    moment = _Moment(session, tracking, stream)
    evidence: Mapping[CauseName, Callable[[], str]] = {
        "stall": moment.stall,
        "simulator": moment.slow_simulator,
        "self-collision": lambda: moment.self_collision(robot) if robot else "",
        "position limit": lambda: moment.position_limit(robot, margin) if robot else "",
        "speed limit": lambda: moment.speed_limit(robot) if robot else "",
        "torque": lambda: moment.torque_limit(robot) if robot else "",
        "start": moment.start,
        "lag": moment.lag,
        "no feed-forward": moment.no_feedforward,
    }
    found = ((cause, why) for cause, look in evidence.items() if (why := look()))
    cause, why = next(found, (None, "")) if abs(moment.error) >= _SMALL else (None, "")
    joint = JOINT_NAMES[moment.joint]
    at = float(tracking.motion_time[moment.worst])
    return WorstError(joint=joint, error_rad=moment.error, at_s=at, cause=cause, why=why)


class _Moment:
    """The time before the largest error. Each cause's method returns the evidence, or "".

    Times are s on the motion's clock, as `Stream.time`.

    Attributes:
        joint: motor index of the joint.
        worst: row of the tracking.
        error: reference - measured in that row, rad.
    """

    def __init__(
        self, session: Recording, tracking: Tracking, stream: StreamSummary | None
    ) -> None:
        self._session, self._tracking, self._stream = session, tracking, stream
        self.joint = joint = max(tracking.joints, key=tracking.max_abs.__getitem__)
        errors = tracking.error_of(joint)
        self.worst = int(np.abs(errors).argmax())
        self.error = float(errors[self.worst])
        #: The reference there, rad.
        self._target = float(tracking.rows(slice(self.worst, self.worst + 1))[0][0, joint])
        self._at = float(tracking.time[self.worst])
        self._shares = errors / (self.error or 1.0)
        growth = self._before(tracking.time, _GROWTH)
        small = tracking.time[growth[self._shares[growth] < _BEGUN]]
        #: The cause may not be earlier than this.
        self._since = float(small.max(initial=self._at - _GROWTH)) - _EARLIER
        self._rows = self._before(tracking.time, self._at - self._since)
        asked = session.reference
        order = np.argsort(asked.published, kind="stable")
        self._asked_at = asked.time[order]
        self._asked = asked.q[order, joint].clip(-NUMBER, NUMBER)
        self._phase, self._motion_at = asked.phase[order], asked.motion_time[order]
        kind = ArmCommandStream if session.topics.get(ArmCommandStream.topic) else CommandStream
        wanted: dict[type[Stream], tuple[NDArray[np.intp], Sequence[str]]] = {
            MeasuredStream: (np.sort(tracking.states[self._rows]), ("tau",))
        }
        self._sent = np.zeros(0)
        if session.topics.get(kind.topic):
            self._sent = session.stream(kind).time
            near = self._before(self._sent, self._at - self._since)
            wanted[kind] = (np.sort(near), ("q", "tau", "kp"))
        found = session.excerpts(wanted)
        self._states, self._commands = found[MeasuredStream], found.get(kind)

    def _before(self, times: Floats, seconds: float) -> NDArray[np.intp]:
        """Indices of the times in the last `seconds` before the largest error, oldest first."""
        near = np.flatnonzero((times <= self._at) & (times >= self._at - seconds))
        return near[np.argsort(times[near], kind="stable")]

    def _moved(self, seconds: float) -> float:
        """Movement of the reference in the last `seconds`, rad."""
        before, now = np.interp([self._at - seconds, self._at], self._asked_at, self._asked)
        return float(now - before)

    def _explains(self, late: float) -> bool:
        """Whether a delay of `late` s and no other error explains about this error."""
        return _SHARE <= self._moved(late) / self.error <= 2.0 - _SHARE

    def stall(self) -> str:
        times = np.sort(self._sent)
        first, end = np.searchsorted(times, (self._since, self._at))
        first = max(0, first - 1)
        gaps = np.diff(times[first : end + 1])  # including those around both ends
        if not len(gaps) or gaps.max() <= max(_STALL, 3.0 * np.median(np.diff(times))):
            return ""
        begun = times[first + int(gaps.argmax())]
        before = self._shares[self._tracking.time <= begun]
        if len(before) and before[-1] >= _SHARE:
            return ""
        return f"the stream stalled: it sent no command for {1e3 * gaps.max():.0f} ms"

    def slow_simulator(self) -> str:
        tracking = self._tracking
        rows = self._rows
        played = float(tracking.motion_time[rows[-1]] - tracking.motion_time[rows[0]])
        every = self._session.measured.tick
        ticks = every[tracking.states[rows]]
        ticks_ms = every.astype(np.int64)
        steps = ticks_ms[1:] - ticks_ms[:-1]
        times = self._session.measured.publish_time
        if not ticks.any() or counts_messages(steps, times[1:] - times[:-1]):  # ticks are no clock
            slow = self._stream and self._stream.waited_s is None and self._stream.time_scale
            pace = slow or 1.0
        else:
            passed = (int(ticks[-1]) - int(ticks[0])) % 2**32 / 1e3
            pace = passed / played if played > _EARLIER / 2 else 1.0
            behind = played - passed
            # unitree_mujoco's C++ bridge repeats and skips ticks without a stall.
            regular = np.mean(steps == np.median(steps)) > _REGULAR
            if regular and pace >= _SLOW and behind >= _BEHIND and self._explains(behind):
                return f"the simulator stalled: it was {1e3 * behind:.0f} ms behind the motion"
        if pace >= _SLOW:
            return ""
        return f"the simulator ran at {pace:.2f} of the motion's pace"

    def self_collision(self, robot: G1) -> str:
        tracking = self._tracking
        rows = self._rows[:: -(-len(self._rows) // _MOST_POSES)]
        asked, done = tracking.rows(rows)
        poses = np.concatenate([asked, done, done + _NEAR * (asked - done)])
        moved = _moved_by(robot, self.joint)
        deepest, text = _INSIDE, ""
        try:
            collision = SelfCollision(robot)
        except ValueError:  # MuJoCo does not accept the URDF
            return ""
        for pair, depths in collision.depths(poses).items():
            of_asked, of_done, near = depths.reshape(3, len(rows))
            k = int(of_asked.argmax())
            kept_apart = of_done[k] <= (1.0 - _SHARE) * of_asked[k] and near.any()
            if moved[pair[0]] == moved[pair[1]] or not kept_apart or of_asked[k] <= deepest:
                continue
            deepest = of_asked[k]
            one, other = sorted(pair, key=lambda link: not moved[link])
            text = (
                f"its {short_name(one)} is {1e3 * deepest:.1f} mm inside the {short_name(other)} "
                f"in the reference at {tracking.motion_time[rows[k]]:.2f} s"
            )
        return text

    def position_limit(self, robot: G1, margin: float) -> str:
        lower, upper = robot.lower[self.joint] + margin, robot.upper[self.joint] - margin
        asked = self._target
        held = float(np.clip(asked, lower, upper))
        if (asked - held) / self.error < _SHARE:
            return ""
        kept = f"; safety.position_margin keeps {margin:g} rad from it" if margin else ""
        return f"{asked:.3f} rad is beyond its position limit, {held:.3f} rad{kept}"

    def speed_limit(self, robot: G1) -> str:
        if self._commands is None or not len(self._commands):
            return ""
        limit = float(robot.velocity[self.joint])
        near = self._before(self._asked_at, self._at - self._since)
        # Publish times are late by as much as the loop.
        passed = np.diff(self._motion_at[near])
        moved = np.abs(np.diff(self._asked[near]))
        speeds = np.divide(moved, passed, out=np.zeros_like(moved), where=passed > 1e-6)
        missing = self._target - self._commands.q[-1, self.joint]
        if missing / self.error < _SHARE or speeds.max(initial=0.0) <= limit:
            return ""
        return (
            f"the motion moves it at {speeds.max():.1f} rad/s, and its target was limited to "
            f"{limit:g} rad/s"
        )

    def torque_limit(self, robot: G1) -> str:
        limit, sign = float(robot.torque_limit[self.joint]), np.sign(self.error)
        for text, samples in (
            ("its motor gave {:.1f} N·m, limit {:g} N·m", self._states),
            ("commands asked its motor for {:.1f} N·m, limit {:g} N·m", self._commands),
        ):
            if samples is None or len(samples) < 2:
                continue
            towards = sign * samples.tau[:, self.joint]  # towards the reference
            interval = float(np.median(np.diff(np.sort(samples.time))))
            if np.sum(towards >= _AT_LIMIT * limit) * interval >= _LONG:
                return text.format(towards.max(), limit)
        return ""

    def start(self) -> str:
        playing = np.flatnonzero((self._phase == Phase.PLAY) & (self._asked_at <= self._at))
        begun = self._asked_at[playing[0]] if len(playing) else -math.inf
        if begun < self._since:
            return ""
        first = int(np.flatnonzero(self._tracking.time >= begun)[0])
        if self._shares[first] < 1.0 - _BEGUN:
            return ""
        left = math.degrees(abs(self._shares[first] * self.error))
        return f"RAMP left it {left:.2f} deg off"

    def lag(self) -> str:
        delay = self._tracking.delays.of([self.joint]) or self._tracking.delay
        if delay is None or delay.seconds <= 0.0:
            return ""
        if not self._explains(delay.seconds):
            return ""
        speed = abs(self._moved(delay.seconds)) / delay.seconds
        return f"it is {1e3 * delay.seconds:.0f} ms late, and moves at {speed:.1f} rad/s"

    def no_feedforward(self) -> str:
        if self._commands is None or not len(self._commands) or self._session.policy is not None:
            return ""
        kp, given = self._commands.kp[-1, self.joint], self._states.tau[-1, self.joint]
        if self._commands.tau[-1].any() or kp <= 0.0 or given / kp / self.error < _SHARE:
            return ""
        return (
            f"commands have no torque, and its servo with kp {kp:g} needs the error to give "
            f"{abs(given):.1f} N·m"
        )


def _moved_by(robot: G1, joint: int) -> dict[str, bool]:
    """Whether a joint moves each link, by the link's name."""
    moved = [False] * len(robot.link_names)
    for link, parent in enumerate(robot.parent.tolist()):  # parents come before children
        moved[link] = robot.joint_of_link[link] == joint or (parent >= 0 and moved[parent])
    return dict(zip(robot.link_names, moved, strict=True))
