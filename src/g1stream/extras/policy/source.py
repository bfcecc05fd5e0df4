"""Targets from a learned policy that keeps the robot on its feet.

The policy runs at its own rate in the robot's time. Its target is repeated between its steps. The
observed reference is the target of the motion. Before and after the motion the robot stands.
"""

from __future__ import annotations

import logging
import math
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.control.gains import Gains
from g1stream.control.sources import Changed, Mode, Source, Status, Traits, join_with_rests
from g1stream.dds.messages import ODOMMODESTATE, PolicyStep
from g1stream.errors import ConfigError
from g1stream.extras.policy.contract import PolicyContract, read_contract
from g1stream.extras.policy.feet_load import FeetLoad
from g1stream.extras.policy.held_motion import check_motion
from g1stream.extras.policy.network import Network
from g1stream.extras.policy.observation import Body, body
from g1stream.extras.policy.observer import Observer
from g1stream.extras.policy.odometry import OF_BASE, Odometry
from g1stream.motion.blend import minimum_jerk
from g1stream.motion.limits import Interval
from g1stream.motion.motion import Motion
from g1stream.robot.rotations import (
    quat_conj,
    quat_from_axis_angle,
    quat_from_yaw,
    quat_mul,
    tilt_of,
    yaw_of,
)
from g1stream.session.records import PolicyInfo
from g1stream.types import Phase

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from g1stream.config import Config
    from g1stream.control.reading import Reading
    from g1stream.control.sources import Moment
    from g1stream.control.targets import Setpoint
    from g1stream.dds.messages import Topic
    from g1stream.robot.model import G1
    from g1stream.types import Floats

__all__ = ["TILTED", "BackToStanding", "PolicyTargets"]

_LOGGER = logging.getLogger(__name__)

TILTED: Final = 0.6
"""Tilt of the pelvis against the reference that counts as a fall, rad. Two policies that danced
for two minutes, in simulators that stalled, were tilted by at most 0.41."""

#: Time to move from the still pose to the motion and back, s.
_BLEND: Final = 1.0
#: A fall within this time after the begin of the motion has begun while the robot stood, s.
_FALLING: Final = 0.5
#: A robot that falls earlier than this, s, also falls with a shorter `--stand`.
_SOON: Final = 1.0
#: PLAY begins when the feet have carried this fraction of the weight for this time, s, because a
#: policy kicks while its feet are in the air.
_CARRIED: Final = 0.1, 0.5
_LOAD_PERIOD: Final = 0.02
#: Most repetitions of an action in a row because the new one is late or not finite.
_REPEATED: Final = 2
_UP: Final = np.array([0.0, 0.0, 1.0])


class PolicyTargets(Source):
    """Uses the targets of a policy in PLAY and HOLD, and those of the motion in RAMP.

    The bridge of g1stream lowers the robot in RAMP. Elsewhere it hangs from a band, and RAMP waits
    until an operator has lowered it onto its feet.

    Args:
        config: all settings.
        robot: the robot.
        simulated: only a simulator can be reached.

    Attributes:
        contract: the policy's contract.

    Raises:
        ConfigError: the policy or a setting cannot be used.
        SafetyError: it may not be used on a robot.
    """

    def __init__(self, config: Config, robot: G1, *, simulated: bool = True) -> None:
        settings = config.stream
        self._network = Network(settings.policy or "")
        self.contract = contract = read_contract(self._network, robot)
        _require_multiple(contract, settings.rate)
        self._step_time = 1.0 / contract.rate
        self._robot, self._settings = robot, settings
        pose = contract.in_motor_order(contract.default_pos, contract.held_pos)
        self._still = _standing(pose, robot)
        self.traits = Traits(
            Gains(
                contract.in_motor_order(contract.kp, contract.held_kp),
                contract.in_motor_order(contract.kd, contract.held_kd),
            ),
            way_down=BackToStanding(self._still, settings.stand),
            makes_targets=True,
            about=_about(contract, self._network),
        )
        self._observer, self._order = Observer(contract, robot), contract.order
        estimated = any(term.value in OF_BASE for term in contract.terms)
        self._load = FeetLoad(robot)
        self._lowered_by_bridge = False
        self._share = self._carried_for = 0.0
        self._weighed = -_LOAD_PERIOD  # time of the last check, s
        self._odometry = Odometry(robot) if estimated else None
        self._played = np.zeros((1, 2))  # begin and end of each motion, s
        self._shares = np.array([0.0, 1.0])  # of the motion that has passed at these times
        self._target: Floats | None = None
        self._next = 0.0
        self._arrived = -1  # reception of the state of the newest step, ns
        self._steps = self._repeated = self._late = 0
        self._observed: float | None = None  # in the robot's time, s
        self._fall = ""
        self._newest, self._new = PolicyStep(), False

    @property
    def status(self) -> Status:
        awaited = ""
        if self._waits:
            awaited = (
                f"the feet carry {100.0 * max(0.0, self._share):.0f} % of the weight; lower the "
                f"robot until they carry {100.0 * _CARRIED[0]:.0f} %, and release it when it stands"
            )
        step = self._newest.tobytes() if self._new else b""
        return Status(self._fall, awaited=awaited, step=step)

    @property
    def _waits(self) -> bool:
        return not self._lowered_by_bridge and self._carried_for <= _CARRIED[1]

    def prepare(self, motion: Motion) -> Changed:
        settings = self._settings
        for one in motion.split():
            check_motion(self.contract, self._network, one)
        whole = motion.duration
        motion = Interval.from_config(settings, motion).cut(motion)
        motions = motion.split() if settings.wait_for else [motion]
        changed, rests = _with_standing(motions, self._still, settings.stand)
        part_of, fps = changed.part_of, changed.fps
        stands = [part_of[round(fps * time)] for time in (0.0, *rests, changed.duration)]
        played = np.setdiff1d(part_of, [-1, *stands])
        self._played = np.array([np.flatnonzero(part_of == one)[[0, -1]] for one in played]) / fps
        if len(played) == 1:
            self._shares = np.array([settings.start, settings.start + motion.duration]) / whole
        text = f"{motion.name} begins and ends with {settings.stand:g} s of standing"
        text += ", and stands between its parts" if rests else ""
        if self._odometry:
            text += (
                f"; place and velocity of the pelvis come from {ODOMMODESTATE.name} where it is "
                "published, and else from leg odometry"
            )
        return Changed(changed, text, rests)

    def listen(self, subscribe: Callable[[Topic], Callable[[], bytes | None]]) -> None:
        if self._odometry:
            self._odometry.newest = subscribe(ODOMMODESTATE)

    def begin(self, first: Setpoint, announced: str | None, robot: str | None) -> Mode:
        if announced not in (None, "free"):
            raise ConfigError(
                f"The simulator holds the robot ({announced}), but a policy needs it on its feet.",
                "Start it with --support free.",
            )
        for doubt in self.contract.doubts(self._robot):
            _LOGGER.warning("policy: %s", doubt)
        self._lowered_by_bridge = announced == "free"
        return Mode(None, "free", self._robot.name)

    def _weigh(self, measured: Reading) -> None:
        now = measured.arrived / 1e9
        if now < self._weighed + _LOAD_PERIOD or not self._waits:
            return
        self._weighed = now
        self._share = self._load.share(measured)
        carried = self._share > _CARRIED[0]
        self._carried_for = self._carried_for + _LOAD_PERIOD if carried else 0.0

    def command(self, moment: Moment) -> Setpoint:
        target = moment.target
        self._new = False
        if moment.fault:
            return self._held(target)
        if moment.phase is Phase.RAMP:
            self._weigh(moment.measured)
            return target
        if self._target is None:
            self._next = moment.time
            self._network.begin(self.contract.feedback)
            self._observer.begin(self._state(moment), self._reference(target))
        # A step needs a new state: without one, the robot may not have obeyed the step before.
        new = moment.measured.arrived != self._arrived
        if new and moment.time > self._next - 0.5 / self._settings.rate:
            self._step(moment)
            self._arrived = moment.measured.arrived
            self._next += self._step_time
            if self._next <= moment.time:  # steps in a jump of the motion's clock are skipped
                self._next = moment.time + self._step_time
        self._watch(moment)
        return self._held(target)

    def _held(self, target: Setpoint) -> Setpoint:
        if self._target is None:
            return target
        nothing = np.zeros(len(self._target))
        return target._replace(q=self._target, dq=nothing, ddq=nothing, tau=nothing)

    def _step(self, moment: Moment) -> None:
        begun, measured = moment.clock(), moment.measured
        observation = self._observer.observe(self._state(moment), self._reference(moment.target))
        asked = moment.clock()
        action = self._network.act(observation, output=self.contract.action)
        took = (moment.clock() - asked) / 1e9
        finite = bool(np.isfinite(action).all())
        self._target = self._observer.act(action if finite else self._observer.last_action)
        self._repeated = 0 if finite else self._repeated + 1
        self._late = self._late + 1 if took > self._step_time else 0
        if max(self._repeated, self._late) > _REPEATED and not self._fall:
            late = f"take longer than {1e3 * self._step_time:g} ms, the last one {1e3 * took:.0f}"
            problem = late if self._late > _REPEATED else "are not finite"
            self._fall = f"{_REPEATED + 1} actions in a row {problem}"
        step = self._newest
        step.inference_time[()] = took
        step.tick[()], step.step[()] = moment.tick, self._steps
        step.state_published[()], step.state_received[()] = measured.stamps
        step.motion_time[()] = moment.target.motion_time
        step.state_age[()] = (begun - measured.arrived) / 1e9
        step.n_observation[()] = len(observation)
        step.observation[: len(observation)] = observation
        step.action[self._order] = action
        step.repeated[()] = self._repeated
        self._new = True
        self._steps += 1

    def _watch(self, moment: Moment) -> None:
        """Detect a fall."""
        measured = moment.measured.imu.quat_wxyz.astype(np.float64)
        tilt = tilt_of(quat_mul(measured, quat_conj(moment.target.root_quat_wxyz)))
        if tilt > TILTED and not self._fall:
            self._fall = (
                f"the robot falls: the pelvis is tilted by {tilt:.2f} rad against the reference"
            )
            time = moment.target.motion_time
            begin, end = self._motion_at(time)
            if time < begin + _FALLING or time > end + _BLEND:
                self._fall += f", while it stands {'after' if time > end else 'before'} the motion"
                if time > _SOON and self._settings.stand > _SOON:
                    self._fall += "; a shorter --stand may prevent it"

    def _state(self, moment: Moment) -> Body:
        imu = moment.measured.imu
        measured = moment.measured.q, moment.measured.dq, imu.quat_wxyz, imu.gyroscope
        state = body(*measured)
        if self._odometry:
            before, self._observed = self._observed, moment.robot_time
            passed = 0.0 if before is None else moment.robot_time - before
            self._odometry.update(state.joint_pos, state.quat_wxyz, passed)
            state = state._replace(pos=self._odometry.pos, lin_vel=self._odometry.vel)
        return state

    def _reference(self, target: Setpoint) -> Body:
        turns = target.root_quat_wxyz, target.root_ang_vel
        found = body(target.q, target.dq, *turns, target.root_pos, target.root_lin_vel)
        time = target.motion_time
        return found._replace(phase=float(np.interp(time, self._motion_at(time), self._shares)))

    def _motion_at(self, time: float) -> Floats:
        """(2,) begin and end of the motion that is played at a time, or was before it, s."""
        number = int(np.searchsorted(self._played[:, 0], time, side="right")) - 1
        found: Floats = self._played[max(0, number)]
        return found


class BackToStanding:
    """Targets from any pose to a still one, in which the robot stands until it is damped.

    A `g1stream.control.targets.WayDown`.

    Args:
        still: two frames of the pose, on the floor.
        seconds: time to stand.
    """

    def __init__(self, still: Motion, seconds: float) -> None:
        self.length = _BLEND + seconds
        self._pose, self._height = still.joint_pos[0], float(still.root_pos[0, 2])

    def possible(self, target: Setpoint) -> bool:
        """Always true, because a policy can stand from any pose."""
        return True

    def plan(self, standing: Setpoint) -> Callable[[float, Floats], Setpoint]:
        """The way from a target at rest, by the time since its start, s, and joints."""
        way = self._pose - standing.q
        rise = np.array([0.0, 0.0, self._height - standing.root_pos[2]])
        upright = quat_from_yaw(yaw_of(standing.root_quat_wxyz))
        turn = quat_mul(quat_conj(standing.root_quat_wxyz), upright)
        turn = np.copysign(1.0, turn[0]) * turn  # the shorter rotation
        sine = float(np.linalg.norm(turn[1:]))  # of half the angle
        angle = 2.0 * math.atan2(sine, float(turn[0]))
        axis = turn[1:] / sine if sine else _UP

        def target(elapsed: float, near: Floats) -> Setpoint:
            progress, rate, change = minimum_jerk(min(1.0, elapsed / _BLEND))
            turned = quat_from_axis_angle(axis, np.asarray(progress * angle))
            return standing._replace(
                q=standing.q + progress * way,
                dq=rate / _BLEND * way,
                ddq=change / _BLEND**2 * way,
                root_pos=standing.root_pos + progress * rise,
                root_quat_wxyz=quat_mul(standing.root_quat_wxyz, turned),
                root_lin_vel=rate / _BLEND * rise,
                root_ang_vel=rate / _BLEND * angle * axis,
                root_lin_acc=change / _BLEND**2 * rise,
                root_ang_acc=change / _BLEND**2 * angle * axis,
            )

        return target


def _about(contract: PolicyContract, network: Network) -> PolicyInfo:
    mean, std = network.normaliser or ((), ())
    return PolicyInfo(
        trained_mean=list(mean),
        trained_std=list(std),
        path=str(network.path.absolute()),
        sha256=network.sha256,
        data_sha256=network.data_sha256,
        contract=contract.model_dump(mode="json"),
    )


def _standing(pose: Floats, robot: G1) -> Motion:
    """Two still frames of a pose (29,), rad, with the soles on the floor."""
    still = Motion(
        name="stand",
        fps=30.0,
        joint_pos=np.repeat(pose[None], 2, axis=0),
        root_pos=np.zeros((2, 3)),
        root_quat_wxyz=np.array([[1.0, 0.0, 0.0, 0.0]] * 2),
    ).on_floor(robot)
    return replace(still, operations=())  # they would be listed with those of the motion


def _with_standing(
    motions: Sequence[Motion], still: Motion, seconds: float
) -> tuple[Motion, tuple[float, ...]]:
    """Motions with a still pose for some time before, between and, for a moment, after them.

    The first pose has the place and heading of the first frame, and `Motion.then` moves the others.

    Returns:
        The motion, and the times, s, at which it rests between two motions.
    """
    first = motions[0]
    frames = max(2, round(seconds * first.fps) + 1)
    heading = quat_from_yaw(yaw_of(first.root_quat_wxyz[0]))
    place = first.root_pos[0] * [1.0, 1.0, 0.0] + still.root_pos[0]
    standing, moment = (
        replace(
            still.at_frames(np.zeros(n, np.intp)),
            fps=first.fps,
            root_pos=np.repeat(place[None], n, axis=0),
            root_quat_wxyz=np.repeat(heading[None], n, axis=0),
        )
        for n in (frames, 2)
    )
    following = ((standing, motion) for motion in motions[1:])
    joined, rests = join_with_rests(standing.then(first, _BLEND), following)
    return joined.then(moment, _BLEND), rests


def _require_multiple(contract: PolicyContract, rate: float) -> None:
    ticks = rate / contract.rate
    if ticks < 1.0 or abs(ticks - round(ticks)) > 1e-6:
        raise ConfigError(
            f"stream.rate = {rate:g} Hz is not a multiple of the policy's {contract.rate:g} Hz.",
            f"Give a multiple, such as --rate {contract.rate * 10:g}.",
        )
