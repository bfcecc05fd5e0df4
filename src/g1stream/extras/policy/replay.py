"""Replays a recorded session through its policy, and compares observations and actions.

Recorded observations give the recorded actions bit for bit if network, runtime and processor are
the same. Observations recomputed from the recorded LowStates and References are compared with the
recorded ones term by term. Targets, gains and torques of the commands that were sent are compared
with those of the contract. This also compares two runners of a policy.
"""

from __future__ import annotations

from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from g1stream.errors import ConfigError, RecordingError
from g1stream.extras.policy.contract import PolicyContract, read_contract, recorded_contract
from g1stream.extras.policy.network import Network
from g1stream.extras.policy.observation import body
from g1stream.extras.policy.observer import Observer
from g1stream.extras.policy.odometry import OF_BASE
from g1stream.robot.joints import JOINT_NAMES
from g1stream.session.records import PolicyInfo, Record
from g1stream.session.streams import CommandStream
from g1stream.text import counted, labelled, table
from g1stream.types import Phase

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from g1stream.app.session import Session
    from g1stream.extras.policy.contract import Term
    from g1stream.session.streams import PolicyStream
    from g1stream.types import Floats

__all__ = ["ActionDifference", "PolicyReplay", "SentDifference", "TermDifference", "replay_policy"]

#: Rounding of single precision for values of this size; larger differences count.
_SAME: Final = 1e-5
_LABEL: Final = 16
#: Most ticks between the Reference of a step and that of its command.
_NEAR: Final = 64
#: Most ticks by which that differs from step to step, as ticks are skipped.
_APART: Final = 2
#: References within `_APART` ticks that differ by less are alike, rad, rad/s and m: those of two
#: successive ticks then differ by less than `_SAME`.
_ALIKE: Final = 3.0 * _SAME
#: Motion times that differ by less are equal, s.
_SAME_TIME: Final = 1e-6


#: Reasons why observations cannot be recomputed.
_LACKS: Final = "their LowState or Reference is not in the session or not known"
_LATER: Final = "the session lacks an earlier step that they need"


class ActionDifference(Record, frozen=True):
    """The first action that differs from the recorded one.

    Attributes:
        step: policy step, from 0.
        time_s: time on the motion's clock.
        joint: joint of the action, the first in motor order.
        recorded, replayed: the actions; None if not finite.
    """

    step: int
    time_s: float
    joint: str
    recorded: float | None
    replayed: float | None


class TermDifference(Record, frozen=True):
    """Difference between a recomputed term and the recorded one, over all steps.

    Attributes:
        max_abs: largest difference, in the units of the observation including the scale; None
            if no step could be recomputed.
        step: first step that differs by more than 1e-5; None if none does.
        time_s: time of that step, on the motion's clock.
    """

    max_abs: float | None
    step: int | None = None
    time_s: float | None = None


class SentDifference(Record, frozen=True):
    """A quantity of the commands that were sent at the steps in PLAY, beside the contract.

    Attributes:
        share: fraction of its values that are those of the contract. Limits of position, speed and
            torque change some positions and velocities.
        joint: joint whose value is another one in most steps, the one with the largest difference;
            None if there is none.
        difference: median of sent - contract for that joint: rad, rad/s, N·m, N·m/rad, N·m·s/rad.
    """

    share: float
    joint: str | None = None
    difference: float | None = None


class PolicyReplay(Record, frozen=True):
    """Result of replaying a session through a policy.

    Attributes:
        session: path of the session.
        policy: path of the ONNX file.
        same_file: whether the file is the recorded one, by its SHA-256; None if not recorded.
        steps: number of recorded steps.
        differing: number of actions that are not bit for bit the recorded ones.
        max_abs: largest difference of an action.
        first: the first difference.
        rebuilt: number of steps whose observation could be recomputed.
        left_out: number of the other steps by reason.
        terms: differences by term, in order.
        sent: by quantity of a command: q, dq, tau, kp, kd; empty if no command of a step is known.
    """

    session: str
    policy: str
    same_file: bool | None
    steps: int
    differing: int
    max_abs: float
    first: ActionDifference | None
    rebuilt: int
    left_out: dict[str, int]
    terms: dict[str, TermDifference]
    sent: dict[str, SentDifference]

    @property
    def same(self) -> bool:
        """Whether actions and terms are the recorded ones, and commands those of the policy."""
        recomputed = all(one.step is None for one in self.terms.values())
        return not self.differing and recomputed and all(not s.joint for s in self.sent.values())

    def __str__(self) -> str:
        other = " (not the file that was recorded)" if self.same_file is False else ""
        lines = [
            labelled(f"{'session':<{_LABEL}}", self.session),
            labelled(f"{'policy':<{_LABEL}}", self.policy + other),
            labelled(f"{'actions':<{_LABEL}}", self._actions()),
            labelled(
                f"{'observations':<{_LABEL}}",
                f"{self.rebuilt} of {self.steps} recomputed from LowState and Reference"
                + "".join(f"; {n} omitted: {why}" for why, n in self.left_out.items()),
            ),
        ]
        rows = [["term", "largest difference", f"first beyond {_SAME:g}", "at s"]]
        for name, one in self.terms.items():
            first = ("", "") if one.step is None else (f"step {one.step}", f"{one.time_s:.2f}")
            rows.append([name, "" if one.max_abs is None else f"{one.max_abs:.2g}", *first])
        sent = [["sent", "as the policy has it", "joint of another value", "median difference"]]
        for name, of in self.sent.items():
            other = "" if of.difference is None else f"{of.difference:+.3g}"
            sent.append([name, f"{of.share:.1%}", of.joint or "", other])
        return "\n".join([*lines, "", *table(rows, {0}), "", *table(sent, {0, 2})])

    def _actions(self) -> str:
        first = self.first
        if first is None:
            return f"all {self.steps} equal the recorded ones, bit for bit"
        return (
            f"{self.differing} of {self.steps} differ, by up to {self.max_abs:.3g}; first at step "
            f"{first.step} ({first.time_s:.2f} s), {first.joint}: recorded "
            f"{_shown(first.recorded)}, replayed {_shown(first.replayed)}"
        )


def replay_policy(session: Session, policy: str | Path | None = None) -> PolicyReplay:
    """Replay a session through its policy, or through another one with the same contract.

    Args:
        session: session with the steps of a policy.
        policy: ONNX file; the recorded one if None.

    Raises:
        RecordingError: the session has no steps of a policy.
        ConfigError: the policy no longer exists, has changed, or has another observation.
    """
    steps, info = session.policy, session.policy_info
    if steps is None:
        raise RecordingError(
            f"{session.path} has no steps of a policy.",
            "Record a stream with --policy with this version of g1stream.",
        )
    network = Network(_file(session) if policy is None else policy)
    same = None
    if info and info.sha256:
        same = (info.sha256, info.data_sha256) == (network.sha256, network.data_sha256)
    if policy is None and same is False:
        raise ConfigError(
            f"{network.path} has changed since {session.path} was recorded: its SHA-256 differs.",
            "Give the ONNX file that played before --replay, or this one explicitly to compare it.",
        )
    contract = _contract(session, network)
    given = network.outputs.get(contract.action or network.first, 0), network.width
    recorded = len(contract.joint_names), steps.observation.shape[1]
    if given != recorded:
        raise ConfigError(
            f"{network.path} gives {counted(given[0], 'action')} for {counted(given[1], 'value')}, "
            f"but the session has {recorded[0]} for {recorded[1]}.",
            "Give the policy that was played, or one with the same contract.",
        )
    columns = PolicyInfo(contract=contract.model_dump(mode="json")).columns
    rebuilt, left_out = _observations(session, steps, contract, columns)
    return PolicyReplay(
        session=str(session.path),
        policy=str(network.path),
        same_file=same,
        steps=len(steps),
        rebuilt=int(np.isfinite(rebuilt).any(axis=1).sum()),
        left_out=left_out,
        terms={
            name: _term(steps, steps.observation[:, at] - rebuilt[:, at])
            for name, at in columns.items()
        },
        sent=_sent(session, steps, contract),
        **_actions(steps, contract, network),
    )


def _contract(session: Session, network: Network) -> PolicyContract:
    """The recorded contract, or, if there is none, that of the file."""
    info = session.policy_info
    recorded = recorded_contract(info)
    if recorded is None:
        return read_contract(network, session.robot)
    if info and info.sha256 != network.sha256:
        asked = read_contract(network, session.robot).terms
        if asked != recorded.terms:
            raise ConfigError(
                f"{network.path} observes {_listed(asked)}, but the session has "
                f"{_listed(recorded.terms)}.",
                "Give the policy that was played, or one with the same contract.",
            )
    return recorded


def _listed(terms: Sequence[Term]) -> str:
    return ", ".join(term.name for term in terms)


def _file(session: Session) -> Path:
    """The path of the recorded file."""
    info = session.policy_info
    path = Path(info.path) if info and info.path else None
    if path is None or not path.is_file():
        raise ConfigError(
            f"The policy of {session.path}, {path or 'without a recorded path'}, does not exist.",
            "Give its ONNX file before --replay.",
        )
    return path


def _actions(steps: PolicyStream, contract: PolicyContract, network: Network) -> dict[str, Any]:
    """The fields of `PolicyReplay` about actions."""
    replayed, order = np.zeros_like(steps.action), contract.order
    for i, observation in enumerate(steps.observation):
        if not steps.step[i]:
            network.begin(contract.feedback)
        elif contract.feedback and (not i or steps.step[i] != steps.step[i - 1] + 1):
            raise RecordingError(
                f"The session lacks step {steps.step[i] - 1} of a policy whose states are not "
                "recorded.",
                "Replay a session from where the policy takes over the robot.",
            )
        replayed[i, order] = network.act(observation, output=contract.action)
    differing = steps.action.view(np.uint32) != replayed.view(np.uint32)
    # NaN has many bit patterns, which are all equal here.
    differing &= ~(np.isnan(steps.action) & np.isnan(replayed))
    rows = np.flatnonzero(differing.any(axis=1))
    apart = np.abs(steps.action.astype(np.float64) - replayed)
    first = None
    if len(rows):
        at, joint = int(rows[0]), int(differing[rows[0]].argmax())
        first = ActionDifference(
            step=int(steps.step[at]),
            time_s=float(steps.time[at]),
            joint=JOINT_NAMES[joint],
            recorded=_finite(steps.action[at, joint]),
            replayed=_finite(replayed[at, joint]),
        )
    largest = float(np.max(apart[np.isfinite(apart)], initial=0.0))
    return {"differing": len(rows), "max_abs": largest, "first": first}


def _observations(
    session: Session, steps: PolicyStream, contract: PolicyContract, columns: Mapping[str, slice]
) -> tuple[Floats, dict[str, int]]:
    """Recomputed observations (N, K), NaN where not possible; and the number by reason."""
    states = _found(session.measured.publish_time, steps.state_published.astype(np.int64))
    references = _references(session, steps)
    measured, reference = session.measured, session.reference
    own = measured.q, measured.dq, measured.imu_quat_wxyz, measured.gyroscope
    turns = reference.root_quat_wxyz, reference.root_ang_vel
    its = reference.q, reference.dq, *turns, reference.root_pos, reference.root_lin_vel
    rebuilt = np.full(steps.observation.shape, np.nan)
    left_out: dict[str, int] = {}
    observer = Observer(contract, session.robot)
    aligned, before, in_a_row = not contract.anchor, -1, 0
    for i, (number, s, r) in enumerate(zip(steps.step.tolist(), states, references, strict=True)):
        known, follows = s >= 0 and r >= 0, number in (0, before + 1)
        before, in_a_row = number, in_a_row + 1 if known and follows else 0
        if known:
            state, wanted = body(*(one[s] for one in own)), body(*(one[r] for one in its))
            if not number:
                observer.begin(state, wanted)
                aligned = True
            observed = observer.observe(state, wanted)
        if aligned and (in_a_row > number or in_a_row >= contract.memory):
            rebuilt[i] = observed
        else:
            why = _LATER if known else _LACKS
            left_out[why] = left_out.get(why, 0) + 1
        if not steps.repeated[i]:
            observer.last_action = steps.action[i].astype(np.float64)[contract.order]
    for term in contract.terms:
        formulas = {name.partition(".")[0] for name in (term.name, *term.of)}
        if formulas & {*OF_BASE, "motion_phase"}:  # not in the messages
            rebuilt[:, columns[term.name]] = np.nan
    return rebuilt, left_out


def _sent(
    session: Session, steps: PolicyStream, contract: PolicyContract
) -> dict[str, SentDifference]:
    """The commands of the steps, which have their publish times, beside targets and gains."""
    if not session.topics.get(CommandStream.topic):
        return {}
    observer, targets = Observer(contract, session.robot), np.empty(steps.action.shape)
    for i, action in enumerate(steps.action.astype(np.float64)[:, contract.order]):
        targets[i] = observer.act(observer.last_action if steps.repeated[i] else action)
    sent, reference = session.command, session.reference
    command, asked = (
        np.array(_found(one.publish_time, steps.publish_time)) for one in (sent, reference)
    )
    rows = np.flatnonzero((command >= 0) & (asked >= 0))
    rows = rows[reference.phase[asked[rows]] == Phase.PLAY]
    if not len(rows):
        return {}
    expected: dict[str, Floats] = {
        "q": targets[rows],
        "dq": np.zeros(1),
        "tau": np.zeros(1),
        "kp": contract.in_motor_order(contract.kp, contract.held_kp),
        "kd": contract.in_motor_order(contract.kd, contract.held_kd),
    }
    found = {}
    for name, values in expected.items():
        apart = sent.rows(name, command[rows]) - values
        same = np.abs(apart) <= _SAME * np.maximum(1.0, np.abs(values))
        typical = np.where(same.mean(axis=0) < 0.5, np.median(apart, axis=0), 0.0)
        worst = int(np.abs(typical).argmax())
        other = float(typical[worst])
        found[name] = SentDifference(
            share=float(same.mean()),
            joint=JOINT_NAMES[worst] if other else None,
            difference=other or None,
        )
    return found


def _references(session: Session, steps: PolicyStream) -> list[int]:
    """Index of a Reference like the one that each step observed, -1 if none is known.

    The observed one is some ticks after that of the step's command, and has the motion time of the
    step. If several have it, as before and after a motion, it is near the median distance in ticks
    of the steps with only one. Which of these it is does not matter if they are alike. They are not
    while the robot comes to rest after an early end.
    """
    reference = session.reference
    columns = reference.q, reference.dq, reference.root_pos, reference.root_quat_wxyz
    beside = np.searchsorted(reference.publish_time, steps.publish_time)
    found = []
    for at, motion_time in zip(beside.tolist(), steps.motion_time.tolist(), strict=True):
        near = slice(max(0, at - _NEAR), at + _NEAR)
        same = np.abs(reference.motion_time[near] - motion_time) < _SAME_TIME
        found.append(np.flatnonzero(same & (reference.phase[near] >= Phase.PLAY)) + near.start)
    single = [int(of[0] - at) for of, at in zip(found, beside, strict=True) if len(of) == 1]
    usual = beside + round(median(single)) if single else beside
    indices = []
    for of, at in zip(found, usual, strict=True):
        likely = of if len(of) == 1 else of[np.abs(of - at) <= _APART]
        alike = len(likely) and all(np.ptp(one[likely], axis=0).max() < _ALIKE for one in columns)
        indices.append(int(likely[np.abs(likely - at).argmin()]) if alike else -1)
    return indices


def _found(times: Any, wanted: Any) -> list[int]:
    """The index of each wanted time among `times`; -1 if it is missing."""
    by_time = {time: i for i, time in enumerate(times.tolist())}
    return [by_time.get(time, -1) for time in wanted.tolist()]


def _term(steps: PolicyStream, difference: Floats) -> TermDifference:
    largest = np.abs(difference).max(axis=1, initial=0.0)
    known = np.isfinite(largest)
    beyond = np.flatnonzero(known & (largest > _SAME))
    most = float(largest[known].max()) if known.any() else None
    if not len(beyond):
        return TermDifference(max_abs=most)
    at = int(beyond[0])
    return TermDifference(max_abs=most, step=int(steps.step[at]), time_s=float(steps.time[at]))


def _finite(value: np.floating[Any]) -> float | None:
    return float(value) if np.isfinite(value) else None


def _shown(value: float | None) -> str:
    return "not finite" if value is None else f"{value:.9g}"
