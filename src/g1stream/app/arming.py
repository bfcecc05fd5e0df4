"""Arming: reports what will be sent to which robot, and asks, before the first command."""

from __future__ import annotations

import time
from contextlib import closing
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from g1stream.dds.domain import Participant
from g1stream.dds.endpoints import RawReader
from g1stream.dds.messages import LOWSTATE, LowState
from g1stream.errors import SafetyError, WireError
from g1stream.network import is_local_only, network_name, require_interface
from g1stream.robot.joints import JOINT_GROUPS, JOINT_NAMES, N_JOINTS
from g1stream.robot.rotations import tilt_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from g1stream.config import WiderValue
    from g1stream.control.plan import Plan
    from g1stream.control.reading import Reading
    from g1stream.doctor.facts import Finding
    from g1stream.types import Floats

#: Time to listen for LowState for the findings, s.
_LISTEN: Final = 0.5
_POLL: Final = 0.005  # s


@dataclass(frozen=True)
class LimbDistance:
    """Distance of a limb from the motion's first frame, and the gains that move it there."""

    limb: str  # its name, such as `left arm`
    joint: str  # the joint that is furthest from the first frame
    distance: float  # first frame minus measured angle of that joint, rad
    kp: tuple[float, float]  # lowest and highest gain, N·m/rad
    kd: tuple[float, float]  # lowest and highest gain, N·m·s/rad


@dataclass(frozen=True)
class ArmingReport:
    """Robot, distance to the first frame, limits and findings, before commands are sent."""

    domain: int  # DDS domain
    interface: str  # in use; `CYCLONEDDS_URI` if that selects it
    tilt: float  # tilt of the pelvis, rad
    limbs: tuple[LimbDistance, ...]  # distances from the measured pose to the first frame
    ramp: float  # length of RAMP, s
    peak_speed: float  # the highest speed of a joint in RAMP, rad/s
    limits: dict[str, Any]  # the settings of [safety] and the profile's constants, by name
    wider: tuple[WiderValue, ...]  # settings that are less careful than the profile `robot`
    # Whether a mode is active as the receiver needs it; a warning if that is not known.
    motion_service: Finding
    findings: tuple[Finding, ...]  # of `g1stream doctor`

    @property
    def furthest(self) -> LimbDistance:
        """The limb whose joint is furthest from the first frame."""
        return max(self.limbs, key=lambda limb: abs(limb.distance))


def require_arming(interface: str, *, armed: bool) -> None:
    """Refuse to command anything but loopback without arming.

    Raises:
        WireError: there is no such interface.
        SafetyError: the interface is not the loopback, and `armed` is False.
    """
    require_interface(interface)
    if not (armed or is_local_only(interface)):
        raise SafetyError(
            f"Commands on {network_name(interface)} may move a robot and must be armed.",
            "Add --arm (in Python: arm=), after the checks in docs/real-robot.md.",
        )


def confirm_arming(
    participant: Participant, plan: Plan, arm: Callable[[ArmingReport], bool] | None
) -> None:
    """Ask for confirmation before anything is sent. There is nothing to ask without `arm`.

    Raises:
        SafetyError: it was not confirmed, or the receiver's check failed.
        WireError: no plausible LowState is received.
    """
    if arm is None:
        if plan.receiver.carries:  # in a simulator, too, nothing would move without a mode
            plan.receiver.check(participant)
    elif not arm(inspect_for_arming(participant, plan)):
        raise SafetyError(
            f"Arming on {plan.config.dds.interface} was not confirmed; nothing was sent.",
            "Run it again, and type the name of the interface.",
        )


def inspect_for_arming(participant: Participant, plan: Plan) -> ArmingReport:
    """Inspect the robot, its motion service and the network. It publishes no command.

    Raises:
        SafetyError: a mode of the motion service is active and would also send commands, or the
            receiver needs one and none is active.
        WireError: no plausible LowState is received.
    """
    # Imported late, so that the guard starts meanwhile; loopback needs nothing of the doctor.
    from g1stream.control.targets import Ramp
    from g1stream.doctor.facts import Facts, ok, warning
    from g1stream.doctor.findings import evaluate
    from g1stream.doctor.inspection import inspect_host, inspect_participant

    config, kind, service = plan.config, plan.robot.joint_set, "motion service"
    cause, remedy = plan.receiver.check(participant)
    state = _plausible_state(participant, plan)
    first = plan.trajectory.sample(plan.interval.start).joint_pos
    distance = np.where(plan.moved, first - state.q.astype(np.float64), 0.0)
    ramp = Ramp.for_distance(distance, round(1e9 * config.stream.ramp), config.constants.ramp_speed)
    wire = inspect_participant(participant, _LISTEN)
    host = inspect_host(config.realtime)
    allowed = kind.allowed(config.safety.mode_machine)
    findings = evaluate(Facts(wire, host, allowed, via=config.stream.via))
    if kind.absent:
        cause = (
            f"On a {kind}, each joint is assumed to have the same motor number as with "
            f"{N_JOINTS}; this has not been confirmed on a robot."
        )
        play_one = "play one joint (--joints left_elbow_joint), and check that this joint moves."
        findings.append(warning("motors", cause, f"Hang the robot, {play_one}"))
    return ArmingReport(
        domain=participant.domain,
        interface=network_name(participant.interface),
        tilt=tilt_of(state.imu.quat_wxyz),
        limbs=_limbs(distance, plan),
        ramp=ramp.length / 1e9,
        peak_speed=ramp.peak_speed,
        limits=config.safety.model_dump() | config.constants._asdict(),
        wider=tuple(config.wider_than_robot()),
        motion_service=warning(service, cause, remedy) if remedy else ok(service, cause),
        findings=tuple(findings),
    )


def _plausible_state(participant: Participant, plan: Plan) -> Reading:
    from g1stream.control.lowstate import LowStateChecks

    config, state = plan.config, LowState()
    checks = LowStateChecks(plan.robot, plan.held, config.safety, config.constants)
    deadline = time.monotonic() + config.stream.wait
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
        f"The pose of the robot is unknown: {checks.unknown(time.monotonic_ns())}, after "
        f"stream.wait = {config.stream.wait:g} s.",
        f"Run: g1stream doctor --domain {participant.domain} --interface {participant.interface}",
    )


def _limbs(distance: Floats, plan: Plan) -> tuple[LimbDistance, ...]:
    found = []
    for limb, joints in JOINT_GROUPS.items():
        indices = list(joints)
        furthest = max(indices, key=lambda joint: abs(distance[joint]))
        gains = (plan.gains.kp[indices], plan.gains.kd[indices])
        kp, kd = ((float(one.min()), float(one.max())) for one in gains)
        found.append(LimbDistance(limb, JOINT_NAMES[furthest], float(distance[furthest]), kp, kd))
    return tuple(found)
