"""Compares a run that the training side has written with a policy's contract, term by term.

The observation of each step is computed from the state in the file and compared with the one in the
file; then the action of the file's observation with the one in the file.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from g1stream.errors import ConfigError
from g1stream.extras.policy.contract import PolicyContract
from g1stream.extras.policy.held_motion import check_motion, held_frame
from g1stream.extras.policy.network import Network
from g1stream.extras.policy.observation import Body, body
from g1stream.extras.policy.observer import Observer, pelvis_poses
from g1stream.extras.policy.plausibility import ORDERS
from g1stream.extras.policy.rehearsal import slight_changes
from g1stream.files import read_file
from g1stream.input_limits import UNPACKED
from g1stream.motion.motion import Motion
from g1stream.motion.npz import read_npy, unzip
from g1stream.robot.model import G1
from g1stream.robot.rotations import is_unit, quat_conj, quat_mul, quat_rotate, sign_continuous
from g1stream.session.records import Record
from g1stream.text import labelled, listed, table
from g1stream.types import Floats

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["Difference", "GoldenRun", "compare_golden"]

#: Arrays of the file and their numbers of columns; -1 is the number of the policy's joints.
_STATE: Final = {
    "joint_pos": -1,
    "joint_vel": -1,
    "root_pos_w": 3,
    "root_quat_w": 4,
    "root_lin_vel_b": 3,
    "root_ang_vel_b": 3,
}
#: Values that differ by less than this share of the term's largest value, or of 1, are alike.
_ALIKE: Final = 1e-4
_UNKNOWN: Final = np.full(3, np.nan)
#: Values below this share of the term's largest one show no factor.
_SMALL: Final = 0.01


class Difference(Record, frozen=True):
    """A term, or the action, beside that in the file.

    Attributes:
        max_abs: largest difference, in the units of the observation including the scale.
        step: first step that differs; None if none does.
        relation: how the values in the file follow from ours; "" if none differs.
    """

    max_abs: float
    step: int | None = None
    relation: str = ""


class GoldenRun(Record, frozen=True):
    """Result of comparing a golden run.

    Attributes:
        path: path of the file.
        steps: number of its steps.
        left_out: number of first steps that were not compared, as steps before them are unknown.
        aligned: whether heading and place of the reference were aligned with the robot's at the
            first step, as a runner does; in a training both have the same world.
        terms: differences by term, in order.
        action: difference of the action of the observation in the file.
    """

    path: str
    steps: int
    left_out: int
    aligned: bool
    terms: dict[str, Difference]
    action: Difference

    @property
    def same(self) -> bool:
        """Whether all terms and the action are those of the file."""
        return all(one.step is None for one in (*self.terms.values(), self.action))

    def __str__(self) -> str:
        both = {**self.terms, "action": self.action}
        first = next((name for name, one in both.items() if one.relation), None)
        verdict = f"{first} differs: {both[first].relation}" if first else "all terms are the same"
        compared = f"{self.steps - self.left_out} of {self.steps} steps of {self.path}"
        lines = [labelled("golden run      ", one) for one in (compared, verdict)]
        rows = [["term", "largest difference", "first step", "in the file"]]
        for name, one in both.items():
            step = "" if one.step is None else str(one.step)
            rows.append([name, f"{one.max_abs:.2g}", step, one.relation or "the same"])
        return "\n".join([*lines, "", *table(rows, {0, 3})])


def compare_golden(
    path: Path, network: Network, contract: PolicyContract, motion: Motion | None = None
) -> GoldenRun:
    """Compare a run that the training side has written with a policy's contract.

    Args:
        path: NPZ file of N steps in order: joint_pos (N, joints) rad and joint_vel (N, joints)
            rad/s in the policy's order; of the pelvis root_pos_w (N, 3) m and root_quat_w (N, 4)
            wxyz in the world, root_lin_vel_b (N, 3) m/s and root_ang_vel_b (N, 3) rad/s in its own
            axes; obs (N, width) without noise, action (N, joints) as the network gave it. Optional:
            time_step (N,), the frame of the motion at the policy's rate; 0 to N - 1 without it.
        network: the network.
        contract: its contract.
        motion: the tracked motion; None for the motion in the policy.

    Raises:
        ConfigError: the file cannot be read, lacks an array, or has one of another shape; or the
            policy tracks a motion and there is none.
        MotionError: as of `check_motion`.
    """
    run, reference = _read(path, contract, network), _reference(network, contract, motion)
    left_out = contract.memory
    if len(run["obs"]) <= left_out:
        raise ConfigError(
            f"{path} has {len(run['obs'])} steps, of which {left_out} cannot be compared.",
            "Write more steps.",
        )
    theirs = run["obs"][left_out:]

    def observed(contract: PolicyContract, *, aligned: bool) -> Floats:
        return _observations(run, contract, reference, aligned=aligned)[left_out:]

    both = {aligned: observed(contract, aligned=aligned) for aligned in (False, True)}
    aligned = min(both, key=lambda one: float(np.mean(np.abs(both[one] - theirs))))
    ours = both[aligned]
    terms, start = {}, 0
    for term in contract.terms:
        at = slice(start, start := start + term.size)

        def elsewhere(at: slice = at) -> str:
            width = at.stop - at.start
            for about, changes in slight_changes(contract):
                changed = contract.model_copy(update=changes)
                with suppress(ConfigError):  # a held motion may lack the other anchor
                    found = (observed(changed, aligned=one)[:, at] for one in both)
                    if any(_alike(one, theirs[:, at]) for one in found):
                        return f"that of {about}"
            for begin in range(theirs.shape[1] - width + 1):
                if _alike(ours[:, at], theirs[:, begin : begin + width]) and ours[:, at].any():
                    return f"at values {begin} to {begin + width - 1} instead of {at.start}"
            return ""

        names = contract.joint_names if term.size == len(contract.joint_names) else []
        pair = ours[:, at], theirs[:, at]
        terms[term.name] = _difference(*pair, names, left_out, elsewhere)
    network.begin(contract.feedback)
    acted = np.array([network.act(one, output=contract.action) for one in run["obs"]])
    if not np.isfinite(acted).all():
        raise ConfigError(
            f"{network.path} gives actions that are not finite for obs in {path}.",
            "Write the observations of this policy.",
        )
    return GoldenRun(
        path=str(path),
        steps=len(run["obs"]),
        left_out=left_out,
        aligned=aligned,
        terms=terms,
        action=_difference(acted, run["action"], contract.joint_names, 0),
    )


def _read(path: Path, contract: PolicyContract, network: Network) -> dict[str, NDArray[Any]]:
    """The arrays of a file."""
    try:
        files = unzip(read_file(path, UNPACKED))
        found = {name.removesuffix(".npy"): read_npy(data) for name, data in files.items()}
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) else error
        raise ConfigError(f"{path} cannot be read: {why}.", "Give one of numpy.savez.") from error
    joints = len(contract.joint_names)
    columns = {**_STATE, "obs": network.width, "action": joints}
    if lacking := [name for name in columns if name not in found]:
        raise ConfigError(f"{path} lacks {listed(lacking)}.", f"Write {', '.join(columns)}.")
    n_steps, run = len(np.atleast_1d(found["obs"])), {}
    found.setdefault("time_step", np.arange(n_steps))
    shapes = {name: (n_steps, joints if n < 0 else n) for name, n in columns.items()}
    for name, shape in (*shapes.items(), ("time_step", (n_steps,))):
        values = found[name]
        if isinstance(values, bytes) or values.dtype.kind not in "fiu" or values.shape != shape:
            what = "objects" if isinstance(values, bytes) else f"{values.shape} {values.dtype}"
            raise ConfigError(
                f"{name} in {path} has {what} instead of {shape} numbers.",
                "Write the steps of one robot, a row for each.",
            )
        if not np.isfinite(values).all():
            raise ConfigError(f"{name} in {path} has a number that is not finite.", "Correct it.")
        run[name] = values.astype(np.float64)
    if not is_unit(run["root_quat_w"]).all():
        raise ConfigError(f"root_quat_w in {path} has another norm than 1.", "Correct it.")
    return run


def _reference(
    network: Network, contract: PolicyContract, motion: Motion | None
) -> Callable[[PolicyContract, int], Body]:
    """The reference of a time step, with the anchor of a contract.

    As in whole_body_tracking, joints are linear between frames, with central differences.
    """
    if motion is None:
        if contract.reference == "a motion":
            raise ConfigError(
                f"The policy {contract.path} tracks a motion, and none is given.", "Give --motion."
            )
        return lambda contract, step: _held(network, contract, max(step, 0))
    check_motion(contract, network, motion)
    sampled = [one for _, one in motion.samples(contract.rate, 0, motion.n_frames)]
    pos, quat = (
        np.concatenate([getattr(one, name) for one in sampled])
        for name in ("root_pos", "root_quat_wxyz")
    )
    quat = sign_continuous(quat)
    at, frames = np.arange(len(pos)) * motion.fps / contract.rate, np.arange(motion.n_frames)
    joint_pos = np.transpose([np.interp(at, frames, one) for one in motion.joint_pos.T])
    joint_vel, lin_vel, turn = (np.zeros_like(one) for one in (joint_pos, pos, quat))
    if len(joint_pos) > 1:
        joint_vel, lin_vel, turn = (
            np.gradient(one, 1.0 / contract.rate, axis=0) for one in (joint_pos, pos, quat)
        )
    ang_vel = 2.0 * quat_mul(quat_conj(quat), turn)[:, 1:]

    def frame(contract: PolicyContract, step: int) -> Body:
        i = min(max(step, 0), len(pos) - 1)
        found = body(joint_pos[i], joint_vel[i], quat[i], ang_vel[i], pos[i], lin_vel[i])
        return found._replace(phase=i / (contract.rate * motion.duration))

    return frame


def _held(network: Network, contract: PolicyContract, step: int) -> Body:
    """The reference of a step of the motion in a policy, which has no velocities of the pelvis."""
    q, dq, *anchor = held_frame(network, contract, step)
    (pos,), (quat,) = pelvis_poses(contract.anchor, G1.default(), q[None], *anchor)
    return Body(q, dq, quat, _UNKNOWN, pos, _UNKNOWN)


def _observations(
    run: Mapping[str, NDArray[Any]],
    contract: PolicyContract,
    reference: Callable[[PolicyContract, int], Body],
    *,
    aligned: bool,
) -> Floats:
    """Observations (N, width) of the states in the file."""
    observer, found = Observer(contract, G1.default()), []
    for step in range(len(run["obs"])):
        joint_pos = contract.in_motor_order(run["joint_pos"][step], contract.held_pos)
        joint_vel = contract.in_motor_order(run["joint_vel"][step])
        pos, quat = run["root_pos_w"][step], run["root_quat_w"][step]
        lin_vel = quat_rotate(quat, run["root_lin_vel_b"][step])
        state = body(joint_pos, joint_vel, quat, run["root_ang_vel_b"][step], pos, lin_vel)
        wanted = state
        if contract.reference != "none":
            wanted = reference(contract, int(run["time_step"][step]))
        if aligned and not step:
            observer.begin(state, wanted)
        found.append(observer.observe(state, wanted))
        observer.last_action = run["action"][step]
    return np.array(found)


def _difference(
    ours: Floats,
    theirs: Floats,
    names: Sequence[str],
    first: int,
    elsewhere: Callable[[], str] = lambda: "",
) -> Difference:
    """Compare values (N, K), the first row of which is step `first`; K names, if they are known."""
    apart = np.abs(ours - theirs)
    rows = np.flatnonzero(~(apart <= _tolerance(theirs)).all(axis=1))  # NaN differs
    most = float(apart.max())
    if not len(rows):
        return Difference(max_abs=most)
    row, at = int(rows[0]), int(apart[rows[0]].argmax())
    relation = elsewhere() or _relation(ours, theirs, names)
    if not relation:
        relation = (
            f"value {at}{_of(names, at)} is {theirs[row, at]:.4g} instead of {ours[row, at]:.4g}"
        )
    return Difference(max_abs=most, step=first + row, relation=relation)


def _relation(ours: Floats, theirs: Floats, names: Sequence[str]) -> str:
    """How `theirs` follows from `ours`: by factors, a constant or an order; "" if it does not."""
    if not theirs.any():
        return "zeros"
    offset = np.mean(theirs - ours, axis=0)
    if len(ours) > 2 and _alike(ours + offset, theirs) and np.ptp(ours, axis=0).any():
        at = int(np.abs(offset).argmax())
        return f"ours plus a constant, {offset[at]:.4g} in value {at}{_of(names, at)}"
    power = np.maximum((ours**2).sum(axis=0), np.finfo(float).tiny)
    moved = np.abs(theirs).max(axis=0) > _SMALL * np.abs(theirs).max()
    order, factors = [], []
    for at, column in enumerate(theirs.T):
        fitted = column @ ours / power  # a factor for each of our columns
        fits = (np.abs(ours * fitted - column[:, None]) <= _tolerance(theirs)).all(axis=0)
        if not fits.any():
            return ""
        order.append(at if fits[at] or not moved[at] else int(fits.argmax()))
        factors.append(fitted[order[-1]])
    told, common = [], float(np.median(np.array(factors)[moved]))
    apart = np.flatnonzero(moved & (np.abs(np.array(factors) / common - 1.0) > _SMALL)).tolist()
    if apart:
        pairs = [f"{factors[one]:.4g} in value {one}{_of(names, one)}" for one in apart]
        told.append(f"ours x {listed(pairs, 3)}")
    elif abs(common - 1.0) > _ALIKE:
        told.append(f"ours x {common:.4g}")
    if wrong := [one for one in np.flatnonzero(moved) if order[one] != one]:
        there = [names[at] for at in order if names]
        known = [one for one, of in ORDERS.items() if there == [x for x in of if x in there]]
        pairs = [f"value {one} is our {order[one]}{_of(names, order[one])}" for one in wrong]
        told.append(
            f"in {known[0]}" if names and known else f"in another order: {listed(pairs, 3)}"
        )
    return ", ".join(told)


def _of(names: Sequence[str], at: int) -> str:
    return f" ({names[at]})" if names else ""


def _alike(ours: Floats, theirs: Floats) -> bool:
    return bool((np.abs(ours - theirs) <= _tolerance(theirs)).all())


def _tolerance(theirs: Floats) -> float:
    return _ALIKE * max(1.0, float(np.abs(theirs).max()))
