"""Arming: what is about to happen on a robot, told before the first command."""

from __future__ import annotations

import time
from contextlib import closing
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from g1stream.control.lowstate import LowStateChecks
from g1stream.control.reading import Reading
from g1stream.control.targets import Ramp
from g1stream.dds.domain import Participant, is_local_only, network_name, require_interface
from g1stream.dds.endpoints import RawReader
from g1stream.dds.messages import ARM_SDK, LOWSTATE, LowState
from g1stream.errors import SafetyError, WireError
from g1stream.robot.joints import JOINT_GROUPS, JOINT_NAMES, N_JOINTS
from g1stream.robot.rotations import tilt_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from g1stream.control.plan import Plan
    from g1stream.doctor.facts import Finding
    from g1stream.types import Floats

#: Longest wait for the motion service, discovery included, s.
_SERVICE_TIMEOUT: Final = 3.0
#: How long LowState is listened to for the findings, s.
_LISTEN: Final = 0.5
_POLL: Final = 0.005  # s


@dataclass(frozen=True)
class LimbDistance:
    """How far a limb is from the motion's first frame, and how stiffly it is moved there."""

    limb: str  # its name, such as `left arm`
    joint: str  # the one that is furthest
    distance: float  # of that joint, first frame minus measured, rad
    kp: tuple[float, float]  # the lowest and the highest gain, N·m/rad and N·m·s/rad
    kd: tuple[float, float]


@dataclass(frozen=True)
class ArmingReport:
    """What is about to be done to which robot."""

    domain: int  # DDS domain
    interface: str  # in use; `CYCLONEDDS_URI` where that selects it
    tilt: float  # of the pelvis, rad
    limbs: tuple[LimbDistance, ...]  # distances from the measured pose to the first frame
    ramp: float  # length of RAMP, s
    peak_speed: float  # the highest speed of a joint in RAMP, rad/s
    limits: dict[str, Any]  # the safety settings in force, by name
    # that no mode is active, or with `stream.via` = arm_sdk which one is; a warning where that is
    # not known
    motion_service: Finding
    findings: tuple[Finding, ...]  # the doctor's

    @property
    def furthest(self) -> LimbDistance:
        """The limb with the joint that is furthest from the first frame."""
        return max(self.limbs, key=lambda limb: abs(limb.distance))


def require_arming(interface: str, *, armed: bool) -> None:
    """Refuse to command anything but loopback unless that was asked for.

    Raises:
        WireError: there is no such interface.
        SafetyError: the interface is not the loopback, and it is not `armed`.
    """
    require_interface(interface)
    if not (armed or is_local_only(interface)):
        raise SafetyError(
            f"Commands on {network_name(interface)} may move a robot, and need to be armed.",
            "Add --arm (in Python: arm=), after the checks in docs/real-robot.md.",
        )


def confirm_arming(
    participant: Participant, plan: Plan, arm: Callable[[ArmingReport], bool] | None
) -> None:
    """Ask before anything is sent, if there is somebody to ask: no `arm` on loopback.

    Raises:
        SafetyError: the answer is no, or the robot's own controller is in the way or missing.
        WireError: somebody is asked, and no plausible LowState is received.
    """
    if arm is None:
        if plan.topic is ARM_SDK:
            _motion_service(participant, plan)
    elif not arm(inspect_for_arming(participant, plan)):
        raise SafetyError(
            f"Arming on {plan.config.dds.interface} was not confirmed; nothing was sent.",
            "Run it again, and type the name of the interface.",
        )


def inspect_for_arming(participant: Participant, plan: Plan) -> ArmingReport:
    """Look at the robot, its motion service and the network; publishes no command.

    Raises:
        SafetyError: a mode of the motion service is active, which would fight our commands, or with
            `stream.via` = arm_sdk none is.
        WireError: no plausible LowState is received.
    """
    from g1stream.doctor.facts import Facts, warning  # a loop on loopback starts without them
    from g1stream.doctor.findings import evaluate
    from g1stream.doctor.inspection import inspect_host, inspect_participant

    config, kind = plan.config, plan.robot.joint_set
    service = _motion_service(participant, plan)
    state = _plausible_state(participant, plan)
    first = plan.trajectory.sample(plan.interval.start).joint_pos
    distance = np.where(plan.played, first - state.q.astype(np.float64), 0.0)
    ramp = Ramp.for_distance(distance, round(1e9 * config.stream.ramp), config.stream.ramp_speed)
    where = participant.domain, participant.interface
    wire = inspect_participant(participant, _LISTEN)
    host = inspect_host(config.realtime)
    allowed = kind.allowed(config.safety.mode_machine)
    findings = evaluate(Facts(*where, allowed, host, wire, via=config.stream.via))
    if kind.absent:
        cause = (
            f"On a {kind}, each joint is taken to have the motor number that it has with "
            f"{N_JOINTS}; no such robot has confirmed this."
        )
        play_one = "play one joint first (--joints left_elbow_joint), and see that this one moves."
        findings.append(warning("motors", cause, f"Hang it, {play_one}"))
    return ArmingReport(
        domain=participant.domain,
        interface=network_name(participant.interface),
        tilt=tilt_of(state.imu.quat_wxyz),
        limbs=_limbs(distance, plan),
        ramp=ramp.length / 1e9,
        peak_speed=ramp.peak_speed,
        limits=config.safety.model_dump(),
        motion_service=service,
        findings=tuple(findings),
    )


def _motion_service(participant: Participant, plan: Plan) -> Finding:
    """Whether the robot's own controller is inactive, or active where it is to move the arms.

    Raises:
        SafetyError: it is active and would fight our commands; or it has to be active and is not.
    """
    from g1stream.dds.motion_switcher import MotionSwitcherClient
    from g1stream.doctor.facts import ok, warning

    arms = plan.topic is ARM_SDK
    about = "motion service"
    try:
        active = MotionSwitcherClient(participant, _SERVICE_TIMEOUT).check().name
    except WireError as error:  # a simulator has none; other publishers are refused anyway
        return warning(
            about,
            f"{error.cause} The robot's own controller may "
            + ("not be active." if arms else "be active, and would fight our commands."),
            "Go on only if you know that its onboard controller balances it."
            if arms
            else "Go on only if this is a simulator, or if you know that no mode is active.",
        )
    where = f"--domain {participant.domain} --interface {participant.interface}"
    if arms and not active:
        raise SafetyError(
            "The robot's own controller is not active, which rt/arm_sdk needs: nothing would move.",
            f"Activate it with the remote or g1stream robot restore ai {where}; a simulator has it "
            "with g1stream sim --onboard ai.",
        )
    if arms:
        return ok(about, f"mode {active} is active, and moves the arms for us")
    if active:
        raise SafetyError(
            f"The robot's own controller is active (mode {active}) and would fight our commands.",
            f"Support the robot, which goes limp, and run: g1stream robot release {where}",
        )
    return ok(about, "no mode is active")


def _plausible_state(participant: Participant, plan: Plan) -> Reading:
    checks, state = LowStateChecks(plan.robot, plan.config.safety), LowState()
    wait = plan.config.stream.wait
    deadline = time.monotonic() + wait
    with closing(RawReader(participant, LOWSTATE)) as reader:
        while time.monotonic() < deadline:
            if sample := reader.take_latest():
                state.load(sample.data)
                now = time.monotonic_ns()
                publisher = sample.sample_info.publication_handle
                measured = checks.take(state, publisher, now)
                if measured and not checks.unknown(now):
                    return measured
            time.sleep(_POLL)
    raise WireError(
        f"The pose of the robot is not known: {checks.unknown(time.monotonic_ns())}, after "
        f"stream.wait = {wait:g} s.",
        f"Run: g1stream doctor --domain {participant.domain} --interface {participant.interface}",
    )


def _limbs(distance: Floats, plan: Plan) -> tuple[LimbDistance, ...]:
    found = []
    for limb, joints in JOINT_GROUPS.items():
        indices = list(joints)
        furthest = max(indices, key=lambda joint: abs(distance[joint]))
        kp, kd = plan.gains.kp[indices], plan.gains.kd[indices]
        found.append(
            LimbDistance(
                limb,
                JOINT_NAMES[furthest],
                float(distance[furthest]),
                (float(kp.min()), float(kp.max())),
                (float(kd.min()), float(kd.max())),
            )
        )
    return tuple(found)
