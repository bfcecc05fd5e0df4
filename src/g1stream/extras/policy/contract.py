"""A policy's contract: its inputs and outputs, and the source of each fact.

A fact comes from the first of the sources of `families.py` that has it. If none has it, an error
shows the line to write to the TOML file; docs/policy.md lists them.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from itertools import combinations
from typing import Any, Final, Literal

import numpy as np
from pydantic import Field, ValidationError

from g1stream.dds.messages import PolicyStep
from g1stream.errors import ConfigError
from g1stream.extras.policy.families import TABLE, TERM_KEYS, as_list, beside, sources
from g1stream.extras.policy.network import Network
from g1stream.extras.policy.observation import REPEATED, TERMS
from g1stream.extras.policy.plausibility import doubts, refuse_implausible
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS
from g1stream.robot.model import G1
from g1stream.session.records import PolicyInfo, Record
from g1stream.text import counted, labelled, listed, table
from g1stream.types import Floats

__all__ = ["PolicyContract", "Term", "read_contract", "recorded_contract"]

_LABEL: Final = 16
#: The line to write for a missing fact.
_LINES: Final[dict[str, str]] = TABLE["lines"]
#: Facts with a default; it is "" for none.
_OPTIONAL: Final[dict[str, Any]] = TABLE["optional"]
#: What stands in a history for the steps before the first one, in words.
_HISTORY_STARTS: Final = {"first step": "the first step repeated", "zeros": "zeros"}
#: Facts with a value for each joint that has an action, and for each joint.
_BY_ACTION: Final = ("default_pos", "action_offset", "action_scale", "kp", "kd")
#: JSON has no infinite numbers.
_INFINITE: Final = 1e30
_HELD: Final = ("held_pos", "held_kp", "held_kd")


class Term(Record, frozen=True):
    """A part of the observation.

    Attributes:
        name: name in the session: the formula, with a number behind it if several terms have it.
        named: name in the file.
        size: number of values, of all steps.
        history: number of steps.
        behind: steps by which the newest of them is behind the present one.
        newest_first: whether the newest step comes first.
        of: names of the terms whose values it has; empty if it has its own.
        scale: factor for all values, or one for each value of a step.
        clip: lowest and highest scaled value, each for all or for each value of a step; None
            without limits.
        formula: formula in words, including the frame.
    """

    name: str
    named: str
    size: int
    history: int = 1
    behind: int = 0
    newest_first: bool = False
    of: tuple[str, ...] = ()
    scale: list[float]
    clip: list[list[float]] | None = None
    formula: str

    @property
    def value(self) -> str:
        """Name of the formula in `TERMS`."""
        return self.name.partition(".")[0]


class PolicyContract(Record, frozen=True):
    """The inputs and outputs of a policy. Arrays are in the policy's joint order, `joint_names`.

    A target is `action_offset + action_scale * action`, rad, with `kp`, N·m/rad, and `kd`,
    N·m·s/rad. A joint without an action is held.

    Attributes:
        path: path of the ONNX file.
        rate: steps per second.
        joint_names: the joints with an action.
        default_pos: pose to which observed joint positions are relative, rad.
        action: output that is the action; the first one if empty.
        feedback: output that is a state in the next step, by the name of its input; 0 at first.
        action_offset: targets of an action of 0, rad; `default_pos` if None.
        action_clip: largest magnitude of an action; None without a limit.
        action_smoothing: share of the smoothed action before in the next one.
        target_clip: lowest and highest target by joint, (joints, 2) rad; None without limits.
        held_pos, held_kp, held_kd: (29,) for joints without an action, motor order; None without
            such joints.
        terms: terms of the observation, in order.
        clip: largest magnitude of a value of the observation; None without a limit.
        anchor: link whose attitude is compared with the reference's; None if no term needs it.
        reference: source of the tracked motion: the network itself, a given motion, or none.
        lag: number of steps by which the observed reference is behind the current one.
        history_start: what stands in a history for the steps before the first one.
        assumed: fields that no file has.
        origin: source of each field.
    """

    path: str
    rate: float
    joint_names: list[str]
    default_pos: list[float]
    action: str = ""
    feedback: dict[str, str] = Field(default_factory=dict)
    action_offset: list[float] | None = None
    action_scale: list[float]
    action_clip: float | None = None
    action_smoothing: float = 0.0
    target_clip: list[list[float]] | None = None
    kp: list[float]
    kd: list[float]
    held_pos: list[float] | None = None
    held_kp: list[float] | None = None
    held_kd: list[float] | None = None
    terms: list[Term]
    clip: float | None
    anchor: str | None
    reference: Literal["in the policy", "a motion", "none"]
    lag: int
    history_start: Literal["first step", "zeros"] = "first step"
    assumed: tuple[str, ...] = ()
    origin: dict[str, str]

    @property
    def memory(self) -> int:
        """Number of steps, the present one included, of which an observation has values."""
        return self.lag + max(one.history + one.behind for one in self.terms)

    @property
    def order(self) -> np.ndarray[Any, np.dtype[np.intp]]:
        """Motor index of each of the policy's joints, (joints,)."""
        return np.array([JOINT_NAMES.index(name) for name in self.joint_names])

    def in_motor_order(
        self, values: Sequence[float] | Floats, held: Sequence[float] | None = None
    ) -> Floats:
        """Values of the policy's joints (joints,) in motor order (29,); the others are `held`."""
        ordered = np.array(held or [0.0] * N_JOINTS)
        ordered[self.order] = values
        return ordered

    def doubts(self, robot: G1) -> list[str]:
        """Facts that are unusual for a robot, in sentences; any that cannot be are refused."""
        return doubts(vars(self), self.joint_names, robot)

    def targets(self, action: Floats) -> Floats:
        """Targets (29,), rad, in motor order, of an action (joints,)."""
        if self.action_clip is not None:
            action = np.clip(action, -self.action_clip, self.action_clip)
        offset = np.array(self.action_offset or self.default_pos)
        targets = offset + np.array(self.action_scale) * action
        if self.target_clip is not None:
            targets = np.clip(targets, *np.transpose(self.target_clip))
        return self.in_motor_order(targets, self.held_pos)

    def toml(self) -> str:
        """The facts as the text of a TOML file, which may serve another policy."""
        facts = self.model_dump(include={*_LINES, *_OPTIONAL} - {"terms"}) | {"scale_first": True}
        for names, keys in ((self.joint_names, _BY_ACTION), (JOINT_NAMES, _HELD)):
            for key in keys:
                facts[key] = dict(zip(names, facts[key], strict=True)) if facts[key] else None
        lines = [f"{key} = {_toml(one)}" for key, one in facts.items() if one not in (None, "", {})]
        for term in self.terms:
            told = term.model_dump() | {"formula": None if term.of else term.value}
            pairs = ((key, told[key]) for key in TERM_KEYS if told[key] not in (None, ()))
            lines += ["", "[[terms]]", *(f"{key} = {_toml(one)}" for key, one in pairs)]
        return "\n".join(lines)

    def __str__(self) -> str:
        width = sum(term.size for term in self.terms)
        past = [one.newest_first for one in self.terms if one.history + one.behind > 1]
        orders = [f"the {'newest' if newest else 'oldest'}" for newest in dict.fromkeys(past)]
        in_order = self.order.tolist() == sorted(self.order)
        facts = {
            "policy": self.path,
            "rate": f"{self.rate:g} Hz",
            "tracks": {
                "in the policy": "the motion in the policy",
                "a motion": "a given motion",
                "none": "no motion: it follows a commanded velocity, or stands",
            }[self.reference]
            + (f", {counted(self.lag, 'step')} behind" if self.lag else ""),
            "joints": f"{len(self.joint_names)}, {'motor' if in_order else 'another'} order",
            "anchor": self.anchor or "",
            "observation": f"{counted(width, 'value')}"
            + (f", clipped to +-{self.clip:g}" if self.clip else ""),
            "history": " and ".join(orders)
            + f" step first; steps before the first one: {_HISTORY_STARTS[self.history_start]}"
            if orders
            else "",
            "action": f"the output {self.action}" if self.action else "",
            "states": ", ".join(f"{k} is {v} of the step before" for k, v in self.feedback.items()),
        }
        lines = [labelled(f"{k:<{_LABEL}}", v) for k, v in facts.items() if v]
        rows = [["term", "size", "scale", "formula"]]
        for term in self.terms:
            low, high = min(term.scale), max(term.scale)
            scale = f"{low:g}" if low == high else f"{low:g} to {high:g}"
            size = f"{term.history} x " * (term.history > 1) + str(term.size // term.history)
            rows.append([term.name, size, scale, term.formula])
        lines += ["", *table(rows, {0, 3})]
        rows = [["joint", "default", "scale", "kp", "kd"]]
        arrays = self.default_pos, self.action_scale, self.kp, self.kd
        for name, *values in zip(self.joint_names, *arrays, strict=True):
            rows.append([name, *(f"{value:.3f}" for value in values)])
        lines += ["", *table(rows, {0}), ""]
        for where in dict.fromkeys(self.origin.values()):
            fields = [name for name, one in self.origin.items() if one == where]
            lines.append(labelled(f"{'from':<{_LABEL}}", f"{where}: {', '.join(fields)}"))
        return "\n".join(lines)


def recorded_contract(info: PolicyInfo | None) -> PolicyContract | None:
    """The contract in a session; None if it has no readable one."""
    try:
        return PolicyContract.model_validate(info.contract if info else {})
    except ValidationError:
        return None


def read_contract(network: Network, robot: G1 | None = None) -> PolicyContract:
    """Read the contract of a policy.

    Args:
        network: the policy's network.
        robot: robot whose limits the default pose must keep; the default one if None.

    Raises:
        ConfigError: the network cannot be played, a fact is missing or wrong, or facts contradict
            each other.
    """
    path, robot = network.path, robot or G1.default()
    values: dict[str, Any] = {}
    origin: dict[str, str] = {}
    assumed: list[str] = []
    for facts in sources(network):
        for name, value in facts.values.items():
            if value is not None and name not in values:
                values[name], origin[name] = value, facts.where
                assumed += [name] * facts.assumed
    where = f"the policy {path}"
    values.setdefault("feedback", network.fed_back)
    _check_playable(network, values, where)
    names = [str(name) for name in as_list(values.get("joint_names", list(JOINT_NAMES)))]
    values = {name: one for name, one in _OPTIONAL.items() if one != ""} | values
    for name, choices in TABLE["choices"].items():
        if values[name] not in choices:
            raise _wrong(name, values[name], where, " or ".join(map(repr, choices)))
    terms = _terms(values, len(names), where)
    uses_anchor = any(term.name.startswith("motion_anchor") for term in terms)
    missing = [one for one in _LINES if one not in values and (one != "anchor" or uses_anchor)]
    if missing:
        raise ConfigError(
            f"Facts of {where} are missing: {', '.join(missing)}.",
            f"Write to {beside(path)}: {'; '.join(_LINES[name] for name in missing)}.",
        )
    _check_joints(names, network.outputs[values.get("action", network.first)], where)
    arrays: dict[str, Any] = {
        name: _joint_values(values.get(name, values["default_pos"]), names, name, where)
        for name in _BY_ACTION
    }
    if len(names) < N_JOINTS:
        for name in _HELD:
            given = values.get(name, values.get(name.removeprefix("held_")))
            arrays[name] = _joint_values(given, list(JOINT_NAMES), name, where)
    if (limits := values.get("target_clip")) is not None:
        sides = [[*one] for one in zip(*limits, strict=True)]
        lows, highs = (_joint_values(one, names, "target_clip", where) for one in sides)
        arrays["target_clip"] = [[*one] for one in zip(lows, highs, strict=True)]
        if not np.all(np.subtract(highs, lows) > 0.0):
            raise _wrong("target_clip", limits, where, "lowest and highest target")
    refuse_implausible(arrays, names, robot, where)
    _check_pose(arrays["default_pos"], names, robot, where)
    _check_width(terms, network, where)
    tracks = any(term.name.startswith("motion_") for term in terms)
    if uses_anchor and values["anchor"] not in robot.link_names:
        raise _wrong("anchor", values["anchor"], where, "a link of the robot, such as torso_link")
    numbers = {
        name: _number(values[name], name, where) or None
        for name in ("clip", "action_clip")
        if name in values
    }
    return PolicyContract(
        path=str(path),
        rate=_number(values["rate"], "rate", where),
        joint_names=names,
        terms=terms,
        anchor=str(values["anchor"]) if uses_anchor else None,
        action=values.get("action", ""),
        feedback=values["feedback"],
        action_smoothing=_number(values["action_smoothing"], "action_smoothing", where),
        reference=("in the policy" if network.holds_motion else "a motion") if tracks else "none",
        lag=_steps(values["lag"], "lag", where) if tracks else 0,
        history_start=values["history_start"],
        assumed=tuple(assumed),
        origin={name: one for name, one in origin.items() if name != "anchor" or uses_anchor},
        **{"clip": None} | numbers | arrays,
    )


def _check_playable(network: Network, values: Mapping[str, Any], where: str) -> None:
    """Refuse a network that cannot be played at all, or of which nothing is known."""
    action = str(values.get("action", network.first))
    most, n_actions = len(PolicyStep().observation), network.outputs.get(action, 0)
    for kind, other in (("decoder", "encoder"), ("encoder", "decoder")):
        second = network.path.with_name(network.path.name.replace(kind, other))
        if second != network.path and second.exists() and "terms" not in values:
            raise ConfigError(
                f"{where[0].upper()}{where[1:]} is one of two networks, an encoder and a decoder "
                f"({second.name}).",
                "Export both as one network, or run them in their own program and record that: "
                "`g1stream record`.",
            )
    fed_back: dict[str, str] = values["feedback"]
    if wrong := sorted({*fed_back} - {*network.inputs} | {*fed_back.values()} - {*network.outputs}):
        raise ConfigError(
            f"The feedback in {beside(network.path)} names {listed(wrong)}, but {where} takes "
            f"{listed([*network.inputs]) or 'no state'} and gives {listed([*network.outputs])}.",
            "Write the output that is each state in the next step, by the name of its input.",
        )
    inputs = network.inputs.items()
    if left := {k: one for k, one in inputs if not network.is_state(k, fed_back.get(k))}:
        takes = ", ".join(f"{name} {size} {kind}" for name, (size, kind) in left.items())
        raise ConfigError(
            f"{where[0].upper()}{where[1:]} takes {takes} beside an observation: a state that is "
            "fed back, as float32 of the same shape, or the output of another network, such as an "
            "encoder.",
            f"Write to {beside(network.path)} which output each state is in the next step, such as "
            'feedback = { h_in = "h_out" }, or export all of it as one network.',
        )
    if not 0 < n_actions <= N_JOINTS:
        found = [name for name, size in network.outputs.items() if 0 < size <= N_JOINTS]
        raise ConfigError(
            f"The output {action} of {where} is no action: it has {counted(n_actions, 'value')}.",
            f'Write to {beside(network.path)}: action = "{found[-1]}".'
            if found
            else "Export the actor so that its first output is the action (1, joints).",
        )
    if network.width > most:
        raise ConfigError(
            f"The network of {where} takes {network.width} values, but a step that is recorded "
            f"has room for {most}.",
            "Run it in its own program and record that: `g1stream record`.",
        )
    if n_actions < N_JOINTS and "joint_names" not in values:
        raise ConfigError(
            f"{where[0].upper()}{where[1:]} has {n_actions} actions for {network.width} values, "
            "and no known family: its joints and terms are in no file.",
            f"Write all facts to {beside(network.path)}; `g1stream policy holosoma --toml` prints "
            "those of another policy.",
        )


def _terms(values: Mapping[str, Any], n_joints: int, where: str) -> list[Term]:
    """The terms of an observation. Of several with one formula, older values get a number."""
    given = [{"name": one.get("formula")} | one for one in values.get("terms") or []]
    named = [str(one["name"]) for one in given]
    if twice := [name for name in named if named.count(name) > 1]:
        raise ConfigError(
            f"The observation of {where} has one term several times: {listed(twice)}.",
            "Give each term once, with its history if it has one.",
        )
    sizes: dict[str, int] = {}  # of the terms with values of their own
    for name, one in zip(named, given, strict=True):
        one["formula"] = str(one.get("formula", TABLE["aliases"].get(name, name)))
        if (formula := TERMS.get(one["formula"])) and not one.get("of"):
            sizes[name] = formula.size + formula.by_joint * n_joints
    if values["history_by"] == "step":
        longest = max([_steps(one.get("history", 1), "history", where) for one in given], default=1)
        steps = range(longest)[::-1]
        given = [one | {"history": 1, "behind": step} for step in steps for one in given]
    terms = [_term(one, sizes, where, scale_first=values["scale_first"]) for one in given]
    counts = Counter[str]()
    for at in sorted(range(len(terms)), key=lambda at: terms[at].behind):
        counts[name := terms[at].name] += 1
        if counts[name] > 1:
            terms[at] = terms[at].model_copy(update={"name": f"{name}.{counts[name]}"})
    names = {term.named: term.name for term in terms}
    return [term.model_copy(update={"of": tuple(names[one] for one in term.of)}) for term in terms]


def _term(
    given: Mapping[str, Any], sizes: Mapping[str, int], where: str, *, scale_first: bool
) -> Term:
    named, formula = str(given["name"]), given["formula"]
    of = [str(one) for one in as_list(given.get("of", []))]
    if unknown := [one for one in of or [named] if one not in sizes]:
        own = of or formula == TABLE["aliases"].get(named, named)
        told = repr(unknown[0]) if own else f"formula {formula!r}"
        raise ConfigError(
            f"The observation of {where} has the unknown term {told}.",
            f"Known terms are {', '.join(sizes if of else TERMS)}.",
        )
    name, size = REPEATED if of else formula, sum(sizes[one] for one in of or [named])
    formula = f"those of {listed(of, 3)}" if of else TERMS[name].formula

    def values(given: Any, what: str) -> Floats:
        numbers = [
            _number(one, f"{what} of {named}", where, finite=what != "limit")
            for one in as_list(given)
        ]
        if len(numbers) not in (1, size):
            raise ConfigError(
                f"In {where}, the term {named} has {counted(size, 'value')} but "
                f"{counted(len(numbers), what)}.",
                f"Give one {what}, or a {what} for each value.",
            )
        return np.array(numbers)

    scale, clip = values(given.get("scale", 1.0), "scale"), None
    if given.get("clip") is not None:
        low, high = given["clip"]
        ends = [values(one, "limit") * (1.0 if scale_first else scale) for one in (low, high)]
        clip = np.clip(np.sort(ends, axis=0), -_INFINITE, _INFINITE)
    history = _steps(given.get("history", 1), f"history of {named}", where)
    behind = _steps(given.get("behind", 0), f"behind of {named}", where)
    newest_first = given.get("newest_first", False)
    if not isinstance(newest_first, bool):
        raise _wrong(f"newest_first of {named}", newest_first, where, "true or false")
    return Term(
        name=name,
        named=named,
        size=size * history,
        history=history,
        behind=behind,
        newest_first=newest_first,
        of=tuple(of),
        scale=scale.tolist(),
        clip=None if clip is None or np.abs(clip).min() >= _INFINITE else clip.tolist(),
        formula=formula + (f", {counted(behind, 'step')} before" if behind else ""),
    )


def _number(value: Any, name: str, where: str, *, finite: bool = True) -> float:
    low, high = TABLE["ranges"].get(name.partition(" ")[0], (-np.inf, np.inf))
    try:
        number = float(value)
    except (OverflowError, TypeError, ValueError):
        number = np.nan
    if np.isnan(number) or (finite and not np.isfinite(number)):
        raise _wrong(name, value, where, "a finite number")
    if not low <= number <= high:
        raise _wrong(name, f"{number:g}", where, f"{low:g} to {high:g}")
    return number


def _steps(value: Any, name: str, where: str) -> int:
    number = _number(value, name, where)
    if isinstance(value, bool | str) or number % 1.0:
        raise _wrong(name, value, where, "a number of steps")
    return int(number)


def _wrong(name: str, value: Any, where: str, valid: str) -> ConfigError:
    return ConfigError(
        f"In {where}, {name} is {(repr if isinstance(value, str) else str)(value)[:60]}.",
        f"It must be {valid}. A TOML file beside the policy overrides it.",
    )


def _check_joints(names: list[str], n_actions: int, where: str) -> None:
    strange = [name for name in names if name not in JOINT_NAMES]
    if strange or len({*names}) != len(names) or len(names) != n_actions:
        wrong = f"names {counted(len({*names}), 'joint')} but has {counted(n_actions, 'action')}"
        if strange:
            wrong = f"is for another robot: a G1 has no {listed(strange, 3)}"
        raise ConfigError(
            f"{where[0].upper()}{where[1:]} {wrong}.",
            f"Give one action for each joint, and each of a G1's {N_JOINTS} joints at most once.",
        )


def _joint_values(given: Any, names: list[str], what: str, where: str) -> list[float]:
    """A value for each joint, from a list or a table of names and patterns."""
    if not isinstance(given, dict):
        values = as_list(given)
        if len(values) not in (1, len(names)):
            raise ConfigError(
                f"In {where}, {what} has {counted(len(values), 'value')} for "
                f"{counted(len(names), 'joint')}.",
                f'Give one for each, or a table such as {what} = {{ "*" = 0.3 }}.',
            )
        given = dict(zip(names if len(values) > 1 else "*", values, strict=True))
    found = np.full(len(names), np.nan)
    for pattern, value in given.items():
        matching = [fnmatchcase(name, pattern) for name in names]
        if not any(matching):
            raise ConfigError(
                f"In {where}, {what} names {pattern}, which is not a joint.",
                'Give joint names, or patterns such as "*_knee_joint".',
            )
        found[matching] = _number(value, f"{what} of {pattern}", where)
    if np.isnan(found).any():
        lacking = [name for name, value in zip(names, found, strict=True) if np.isnan(value)]
        raise ConfigError(
            f"In {where}, {what} has no value for {listed(lacking, 3)}.",
            'Give one, or a default for all others first: "*" = 0.0.',
        )
    return list(map(float, found))


def _check_pose(pose: list[float], names: list[str], robot: G1, where: str) -> None:
    for name, value in zip(names, pose, strict=True):
        low, high = (limits[JOINT_NAMES.index(name)] for limits in (robot.lower, robot.upper))
        if not low <= value <= high:
            valid = f"within the joint's limits, {low:.3f} to {high:.3f} rad"
            raise _wrong(f"default_pos of {name}", f"{value:g}", where, valid)


def _check_width(terms: Sequence[Term], network: Network, where: str) -> None:
    """Raise if the width of the terms differs from the network's input; suggest terms."""
    total = sum(term.size for term in terms)
    if total == network.width:
        return
    lacking, most = network.width - total, TABLE["ranges"]["history"][1]
    sizes = {term.name: term.size for term in terms}
    if lacking > 0:
        n = network.outputs[network.first]
        sizes = {k: t.size + t.by_joint * n for k, t in TERMS.items() if k not in sizes}
    some = [*combinations(sizes, 1), *combinations(sizes, 2)]
    fitting = [
        " and ".join(one) for one in some if sum(sizes[name] for name in one) == abs(lacking)
    ]
    longer = {one.named: (one.size + lacking) * one.history / one.size for one in terms}
    steps = [f"{name} {n:g}" for name, n in longer.items() if n in range(1, int(most) + 1)]
    if total and network.width / total in range(2, int(most) + 1):
        steps.append(f"each term {network.width // total} times as many")
    guess = f" Terms as wide as the difference: {listed(fitting, 4)}." if fitting else ""
    if steps and (not fitting or any(term.history > 1 for term in terms)):
        guess += f" Or steps of history: {listed(steps, 4)}."
    raise ConfigError(
        f"The network of {where} takes {network.width} values, but the given terms have "
        f"{total}: {', '.join(f'{term.named} {term.size}' for term in terms)}.",
        f"Give the terms of the training in the TOML file beside it.{guess}",
    )


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{json.dumps(k)} = {_toml(one)}' for k, one in value.items())} }}"
    return json.dumps(value)
