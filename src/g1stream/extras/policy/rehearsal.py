"""A rehearsal of a policy in lockstep, and which contracts near its own stand where it falls.

A wrong contract falls in the simulator, while its first actions are as near to the motion as those
of the right one: where the motion is tracked perfectly, joints, velocities and actions are alike.
"""

from __future__ import annotations

import logging
import shutil
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import combinations
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from g1stream.analysis.summary import Summary
from g1stream.app.rollout import rollout
from g1stream.config import Config, StreamConfig
from g1stream.errors import G1StreamError, SafetyError
from g1stream.extras.policy.contract import PolicyContract, Term
from g1stream.extras.policy.families import beside
from g1stream.extras.policy.held_motion import check_motion
from g1stream.extras.policy.network import Network
from g1stream.extras.policy.plausibility import ORDERS
from g1stream.motion.motion import Motion
from g1stream.session.records import Record
from g1stream.text import labelled, table

__all__ = ["Rehearsal", "Trial", "rehearse_policy", "require_standing", "slight_changes"]

_LOGGER = logging.getLogger(__name__)

#: Shortest time to stand, s.
_BRIEFLY: Final = 0.5
#: Terms that trainings scale, and the scale in Unitree's and NVIDIA's examples for legged robots.
_SCALED: Final = {
    "base_lin_vel": 2.0,
    "base_ang_vel": 0.25,
    "projected_gravity": 1.0,
    "joint_vel_rel": 0.05,
}
_FACTORS: Final = 0.5, 2.0
#: Facts by joint of the policy.
_BY_JOINT: Final = "default_pos", "action_offset", "action_scale", "target_clip", "kp", "kd"

#: A contract with this share of the RMSE follows the motion closer. With the torso, which they were
#: trained with, instead of the pelvis as the anchor, two dances have 0.65 and 0.73.
_CLOSER: Final = 0.9

Changes = dict[str, Any]


class Trial(Record, frozen=True):
    """How a rehearsal with a contract ended.

    Attributes:
        contract: what differs from the contract of the files; "" for nothing.
        stood_s: time from the start of PLAY to the end, s; 0 without PLAY.
        reason: why it ended early; "" if the robot stood to the end.
        rmse_rad: RMSE of all joints, rad; None without PLAY.
        playable: whether the contract can be played.
    """

    contract: str
    stood_s: float
    reason: str
    rmse_rad: float | None = None
    playable: bool = True


class Rehearsal(Record, frozen=True):
    """A rehearsal of a policy.

    Attributes:
        tried_s: length of PLAY if the robot stands to the end, s.
        stand_s: time for which it stands before and after the motion, s.
        own: how it ended with the contract of the files.
        longer: how it ended with the default `--stand`, if `stand_s` is shorter.
        near: how it ended with contracts near that of the files, the best first: all if the robot
            fell, and the other anchor if it stood.
    """

    tried_s: float
    stand_s: float
    own: Trial
    longer: Trial | None
    near: list[Trial]

    @property
    def stands(self) -> bool:
        """Whether the robot stands to the end with the contract of the files."""
        return not self.own.reason

    @property
    def doubts(self) -> list[str]:
        """Contracts with which a robot that stands follows the motion closer, in sentences."""
        own = self.own.rmse_rad or 0.0
        return [
            f"with {one.contract} the joints are {one.rmse_rad:.3f} rad (RMSE) from the motion, "
            f"instead of {own:.3f}: check this fact"
            for one in self.near
            if self.stands and not one.reason and one.rmse_rad and one.rmse_rad < _CLOSER * own
        ]

    def __str__(self) -> str:
        stand = f"with {self.stand_s:g} s of standing before and after the motion"
        texts = [f"stands to the end, {self.tried_s:.1f} s, {stand}"]
        if self.own.reason:
            texts = [f"ends after {self.own.stood_s:.2f} of {self.tried_s:.1f} s, {stand}"]
            texts.append(self.own.reason)
        if self.longer:
            advice = ": give --stand 0.5" if self.stands else ""
            text = f"with the default --stand it ends after {self.longer.stood_s:.2f} s{advice}"
            texts.append(text)
        rows = [["contract", "stood, s", "RMSE, rad", ""]]
        for one in (self.own, *self.near):
            rmse = "" if one.rmse_rad is None else f"{one.rmse_rad:.3f}"
            ended = "ends early" if one.playable else "cannot be played"
            ended = ended if one.reason else "stands to the end"
            rows.append([one.contract or "as it is", f"{one.stood_s:.2f}", rmse, ended])
        lines = [labelled("rehearsal       ", text) for text in texts]
        if not self.stands:
            best = f"none of {len(self.near)} contracts near it stands: look at the motion, too"
            if self.near and not self.near[0].reason:
                best = f"it stands with {self.near[0].contract}: check these facts"
            lines.append(labelled(" " * 16, best))
        return "\n".join([*lines, "", *table(rows, {0, 3})])


def rehearse_policy(
    network: Network,
    contract: PolicyContract,
    motion: Motion,
    said: Callable[[Trial, int], None] = lambda trial, left: None,
) -> Rehearsal:
    """Play the beginning of a motion in lockstep; if the robot falls, try contracts near it, too.

    The robot stands for the default `stream.stand`. If it falls, it is tried with the shortest one,
    because some policies cannot stand for long. If it stands, only the other anchor is tried, with
    which a robot may stand, too.

    Args:
        network: the network.
        contract: its contract.
        motion: the motion to track.
        said: called after each trial, with the number of near contracts that are left; 0 before
            they are tried.

    Raises:
        G1StreamError: the motion cannot be played with this policy.
    """
    check_motion(contract, network, motion)
    default, near = Config().stream.stand, []
    with TemporaryDirectory() as folder:
        copy = Path(folder) / network.path.name
        for name in (copy.name, *network.data):
            (copy.parent / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(network.path.parent / name, copy.parent / name)

        def tried(
            about: str, changed: PolicyContract, stand: float, left: int = 0
        ) -> tuple[Trial, float]:
            beside(copy).write_text(changed.toml(), encoding="utf-8")
            config = Config(stream=StreamConfig(policy=str(copy)))
            summary = _rehearse(motion, config, stand, config.stream.rehearse)
            ended, followed = summary.termination, summary.tracking
            trial = Trial(
                contract=about,
                stood_s=ended.played_s or 0.0,
                reason=ended.reason or "",
                rmse_rad=followed.all_joints.rmse_rad if followed else None,
            )
            said(trial, left)
            return trial, ended.motion_s or 0.0

        (own, length), stand, longer = tried("", contract, default), default, None
        if own.reason:
            stand, longer = _BRIEFLY, own
            own, length = tried("", contract, stand)
        every = [one for one in _changes(contract) if own.reason or "anchor" in one[1]]
        for n, (about, changes) in enumerate(every, 1):
            changed, left = contract.model_copy(update=changes), len(every) - n
            try:
                near.append(tried(about, changed, stand, left)[0])
            except G1StreamError as error:
                near.append(Trial(contract=about, stood_s=0.0, reason=str(error), playable=False))
    return Rehearsal(
        tried_s=length,
        stand_s=stand,
        own=own,
        longer=longer,
        near=sorted(near, key=lambda one: (bool(one.reason), -one.stood_s, one.rmse_rad or 0.0)),
    )


def require_standing(motion: Motion, config: Config) -> None:
    """Refuse a policy that fails in the simulator within the first `stream.rehearse` seconds.

    Raises:
        SafetyError: the robot falls, and `stream.beyond_limits` is not "anyway".
    """
    settings = config.stream
    seconds = min(settings.rehearse, settings.duration or settings.rehearse)
    _LOGGER.info("rehearsal: %g s in the simulator", seconds)
    reason = _rehearse(motion, config, _BRIEFLY, seconds).termination.reason
    if reason and settings.beyond_limits != "anyway":
        raise SafetyError(
            f"The policy does not play {seconds:g} s of the motion in the simulator: {reason}.",
            "Check its inputs with `g1stream policy POLICY --motion MOTION`, and the beginning of "
            "the motion with `g1stream motion MOTION` (--start leaves it out); or give --anyway.",
        )
    if reason:
        _LOGGER.warning("rehearsal: %s", reason)


def _rehearse(motion: Motion, config: Config, stand: float, seconds: float) -> Summary:
    """Play the first seconds of a motion in lockstep, without events."""
    brief = config.stream.model_copy(update={"stand": stand, "ramp": 1.0, "hold": 0.0})
    with _unlogged():
        session = rollout(
            motion, config=config.model_copy(update={"stream": brief}), seconds=seconds
        )
    return session.summary()


@contextmanager
def _unlogged() -> Iterator[None]:
    """Keep events of this thread, and of no other, from the handlers that exist."""
    thread, logger, root = threading.get_ident(), logging.getLogger("g1stream"), logging.getLogger()

    def of_others(record: logging.LogRecord) -> bool:
        return record.thread != thread or not record.name.startswith(logger.name)

    handlers = [*logger.handlers, *root.handlers]
    for one in handlers:
        one.addFilter(of_others)
    try:
        yield
    finally:
        for one in handlers:
            one.removeFilter(of_others)


def _changes(contract: PolicyContract) -> Iterator[tuple[str, Changes]]:
    """Contracts that differ by one common mistake: the difference in words, and what changes."""
    terms = contract.terms

    def with_terms(changed: dict[int, Term]) -> Changes:
        return {"terms": [changed.get(at, one) for at, one in enumerate(terms)]}

    for (i, one), (j, other) in combinations(enumerate(terms), 2):
        if one.size == other.size or j == i + 1:
            yield f"{one.name} and {other.name} exchanged", with_terms({i: other, j: one})
    for at, one in enumerate(terms):
        if (usual := _SCALED.get(one.value)) is None:
            continue
        for factor in dict.fromkeys([-1.0, *_FACTORS, usual if one.scale == [1.0] else -1.0]):
            scaled = one.model_copy(update={"scale": [factor * value for value in one.scale]})
            yield f"{one.name} x {factor:g}", with_terms({at: scaled})
    for keys in (("action_scale",), ("kp", "kd")):
        for factor in _FACTORS:
            changed = {key: [factor * one for one in getattr(contract, key)] for key in keys}
            yield f"{' and '.join(keys)} x {factor:g}", changed
    yield from slight_changes(contract)
    for order, joints in ORDERS.items():
        names = [name for name in joints if name in contract.joint_names]
        if names != contract.joint_names and contract.reference != "in the policy":
            moved = [contract.joint_names.index(name) for name in names]
            given = ((key, getattr(contract, key)) for key in _BY_JOINT)
            facts = {key: [values[at] for at in moved] for key, values in given if values}
            yield f"joints in {order}", facts | {"joint_names": names}


def slight_changes(contract: PolicyContract) -> Iterator[tuple[str, Changes]]:
    """Those of `_changes` with which a robot may stand, too."""
    if contract.anchor:
        other = "pelvis" if contract.anchor == "torso_link" else "torso_link"
        yield f"anchor {other}", {"anchor": other}
    lag = 0 if contract.lag else 1
    yield f"lag {lag}", {"lag": lag}
