"""The source of targets of a learned policy that keeps the robot on its feet.

The policy runs at its own rate within the loop: in between its target is repeated. The reference
that it observes is the target of the motion, before which and after which the robot stands.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.control.gains import Gains
from g1stream.control.sources import Source
from g1stream.dds.messages import POLICY, PolicyStep
from g1stream.errors import ConfigError, SafetyError
from g1stream.extras.policy.contract import PolicyContract, read_contract
from g1stream.extras.policy.first_actions import begin, first_actions, frame_of, state_of
from g1stream.extras.policy.network import Network
from g1stream.extras.policy.observation import Inputs, ReferenceFrame, RobotState, observe
from g1stream.motion.limits import Interval
from g1stream.motion.motion import Motion
from g1stream.robot.rotations import quat_from_yaw, yaw_of
from g1stream.session.records import PolicyInfo
from g1stream.types import Phase

if TYPE_CHECKING:
    from g1stream.config import Config
    from g1stream.control.reading import Reading
    from g1stream.control.sources import Moment
    from g1stream.control.targets import Target
    from g1stream.robot.model import G1
    from g1stream.types import Floats, StreamSupport

__all__ = ["PolicyTargets", "with_standing"]

#: From the still pose to the motion and back, s.
_BLEND: Final = 1.0
#: m by which the pelvis is higher when RAMP begins: no leg is longer by more.
_LIFT: Final = 0.4
#: Terms of what LowState does not have.
_OF_BASE: Final = ("base_lin_vel", "motion_anchor_pos_b")
#: How many times in a row an action may be repeated because the new one is not finite.
_REPEATED: Final = 2
_ORIGIN: Final = np.zeros(3)


class PolicyTargets(Source):
    """The targets of a policy in PLAY and HOLD; in RAMP those of the motion.

    Args:
        config: all settings in force.
        robot: the robot.
        simulated: nothing but a simulator is reached.
        complete: every joint gets its torque.

    Attributes:
        contract: of the policy.

    Raises:
        ConfigError: the policy cannot be used, or the settings do not go with it.
        SafetyError: it may not be used on a robot.
    """

    needed = True
    support: StreamSupport | None = "free"
    lift = _LIFT
    cuts = True
    tells = POLICY

    def __init__(
        self, config: Config, robot: G1, *, simulated: bool = True, complete: bool = True
    ) -> None:
        settings = config.stream
        _require_free(config, simulated=simulated, complete=complete)
        self._network = Network(settings.policy or "")
        self.contract = contract = read_contract(self._network, robot)
        self._robot, self._settings = robot, settings
        self._every = _ticks_per_step(contract, settings.rate)
        self.step_time = 1.0 / contract.rate
        self.gains = Gains(
            contract.in_motor_order(contract.kp), contract.in_motor_order(contract.kd)
        )
        self._terms = [(term.name, np.array(term.scale)) for term in contract.terms]
        self._default = np.array(contract.default_pos)
        self._scale = np.array(contract.action_scale)
        self._action = np.zeros(len(self._default))
        self._target: Floats | None = None
        self._ticks = self._repeated = 0
        self._alignment = np.array([1.0, 0.0, 0.0, 0.0]), (_ORIGIN, _ORIGIN)
        self._fall = ""
        self._told, self._new = PolicyStep(), False

    @property
    def name(self) -> str | None:
        return self._robot.name

    @property
    def fall(self) -> str:
        return self._fall

    def change(self, motion: Motion) -> tuple[Motion, str]:
        part = Interval.from_config(self._settings, motion)
        if self._settings.start or self._settings.duration is not None:
            motion = motion.trim(part.start, part.start + (part.length or 0.0))
        first_actions(self.contract, self._network, self._robot, motion)
        pose = self.contract.in_motor_order(self.contract.default_pos)
        changed = with_standing(motion, pose, self._robot, self._settings.stand)
        return (
            changed,
            f"{motion.name} is played with {self._settings.stand:g} s of standing at either end",
        )

    def begin(self, support: StreamSupport, announced: str | None, robot: str | None) -> None:
        if announced not in (None, "free"):
            raise ConfigError(
                f"The simulator holds the robot ({announced}); a policy stands on its feet.",
                "Start it with --support free.",
            )

    def observe(self, phase: Phase, measured: Reading, scale: float) -> None:
        self._told.time_scale[()] = scale

    def command(self, moment: Moment) -> Target:
        target = moment.target
        if moment.phase is Phase.RAMP:
            self._target = None
            return target
        if self._target is None:
            self._ticks, self._action = 0, np.zeros(len(self._default))
            self._alignment = self._aligned(moment)
        if self._ticks % self._every == 0 or self._target is None:
            self._step(moment)
        self._ticks += 1
        return self.repeated(target)

    def repeated(self, target: Target) -> Target:
        if self._target is None:
            return target
        nothing = np.zeros(len(self._target))
        return target._replace(q=self._target, dq=nothing, ddq=nothing, tau=nothing)

    def told(self) -> bytes:
        new, self._new = self._new, False
        return self._told.tobytes() if new else b""

    def about(self) -> PolicyInfo | None:
        network = self._network
        mean, std = network.normaliser() or ((), ())
        return PolicyInfo(
            trained_mean=list(mean),
            trained_std=list(std),
            path=str(network.path.absolute()),
            sha256=network.sha256,
            data_sha256=network.data_sha256,
            contract=self.contract.model_dump(mode="json"),
        )

    def _step(self, moment: Moment) -> None:
        yaw0, origin = self._alignment
        begun, measured = moment.clock(), moment.measured
        inputs = Inputs(
            self._state(moment),
            self._reference(moment.target),
            yaw0,
            origin,
            self.contract.order,
            self._default,
            self._action,
            np.zeros(3),
            np.full(2, np.pi),
        )
        observation = observe(self._terms, inputs)
        if self.contract.clip:
            observation = np.clip(observation, -self.contract.clip, self.contract.clip)
        asked = moment.clock()
        action = self._network.act(observation)
        told = self._told
        told.inference_time[()] = (moment.clock() - asked) / 1e9
        told.tick[()], told.step[()] = moment.tick, self._ticks // self._every
        told.state_published[()], told.state_received[()] = measured.stamps
        told.motion_time[()] = moment.target.motion_time
        told.state_age[()] = (begun - measured.received) / 1e9
        told.n_observation[()] = len(observation)
        told.observation[: len(observation)] = observation
        told.action[self.contract.order] = action
        self._new = True
        if np.isfinite(action).all():
            self._action, self._repeated = action, 0
        else:
            self._repeated += 1
            if self._repeated > _REPEATED:
                self._fall = self._fall or "the policy's actions are not finite"
        told.repeated[()] = self._repeated
        self._target = self.contract.in_motor_order(self._default + self._scale * self._action)

    def _aligned(self, moment: Moment) -> tuple[Floats, tuple[Floats, Floats]]:
        return begin(self._state(moment).anchor, self._reference(moment.target).anchor)

    def _state(self, moment: Moment) -> RobotState:
        measured, imu = moment.measured, moment.measured.imu
        values = (measured.q, measured.dq, imu.quat_wxyz, imu.gyroscope)
        return state_of(self.contract, self._robot, *values)

    def _reference(self, target: Target) -> ReferenceFrame:
        pose = target.root_pos, target.root_quat_wxyz
        return frame_of(self.contract, self._robot, target.q, target.dq, *pose)


def with_standing(motion: Motion, pose: Floats, robot: G1, seconds: float) -> Motion:
    """A motion that begins and ends with a still pose on the floor.

    Args:
        motion: in between, with a second of blend before and after it.
        pose: (29,) rad, motor order.
        robot: whose soles stand.
        seconds: of the pose at either end.
    """
    n = max(2, round(seconds * motion.fps) + 1)
    heading = quat_from_yaw(yaw_of(motion.root_quat_wxyz[0]))
    place = motion.root_pos[0] * [1.0, 1.0, 0.0]
    still = replace(
        motion.frames(0, 2),
        name="stand",
        joint_pos=np.repeat(pose[None], n, axis=0),
        root_pos=np.repeat(place[None], n, axis=0),
        root_quat_wxyz=np.repeat(heading[None], n, axis=0),
        source=None,
        sha256=None,
        operations=(),
    ).on_floor(robot)
    # Its operations would be told with those of the motion.
    still = replace(still, operations=())
    return still.then(motion, _BLEND).then(still, _BLEND)


def _ticks_per_step(contract: PolicyContract, rate: float) -> int:
    ticks = rate / contract.rate
    if ticks < 1.0 or abs(ticks - round(ticks)) > 1e-6:
        raise ConfigError(
            f"stream.rate = {rate:g} Hz is no multiple of the {contract.rate:g} Hz of the policy.",
            f"Give a multiple, such as --rate {contract.rate * 10:g}.",
        )
    base = [term.name for term in contract.terms if term.name in _OF_BASE]
    if base:
        raise ConfigError(
            f"The policy observes {' and '.join(base)}, which LowState does not have.",
            "Give a policy that was trained without state estimation.",
        )
    return round(ticks)


def _require_free(config: Config, *, simulated: bool, complete: bool) -> None:
    """Refuse settings with which a policy cannot keep the robot on its feet."""
    settings = config.stream
    if not simulated:
        raise SafetyError(
            f"--policy on {config.dds.interface}: it has been tried in simulators only, and a "
            "robot that falls breaks.",
            "Use the loopback interface.",
        )
    if settings.support not in (None, "free") or settings.feedforward not in (None, "dynamics"):
        raise ConfigError(
            "A policy commands a robot that stands freely, at every tick.",
            "Leave out --support and --feedforward.",
        )
    if settings.loop or settings.joints or settings.via != "lowcmd" or not complete:
        raise ConfigError(
            "A policy plays a motion once, with all 29 joints, on rt/lowcmd.",
            "Leave out --loop, --joints, --others and --via.",
        )
