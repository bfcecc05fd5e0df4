"""A policy's contract: its inputs and outputs, and the source of each fact.

A fact comes from the first of these sources that has it: a TOML file beside the policy, the table
of published policies, the metadata of the ONNX file (whole_body_tracking and mjlab; holosoma),
Unitree's deploy.yaml beside it. If none has it, an error shows the line to write to the TOML file;
docs/policy.md lists them.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from fnmatch import fnmatchcase
from itertools import combinations
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from pydantic import ValidationError

from g1stream.config import read_toml
from g1stream.dds.messages import PolicyStep
from g1stream.errors import ConfigError
from g1stream.extras.policy.network import Network
from g1stream.extras.policy.observation import ALIASES, TERMS
from g1stream.extras.policy.published import facts_of
from g1stream.files import read_file
from g1stream.input_limits import SETTINGS_FILE, check_integers
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS
from g1stream.robot.model import G1
from g1stream.session.records import PolicyInfo, Record
from g1stream.text import counted, labelled, listed, table
from g1stream.types import Floats

__all__ = ["RATE_ASSUMED", "PolicyContract", "Term", "read_contract", "recorded_contract"]

RATE_ASSUMED: Final = "assumed: default of whole_body_tracking and mjlab"
"""Origin of the rate if no file has it."""

_LABEL: Final = 16
#: Larger values are an error: N·m/rad, N·m·s/rad, and rad for an action of 1.
_MOST: Final = {"kp": 500.0, "kd": 50.0, "action_scale": 5.0}
#: The line to write for a missing fact.
_LINES: Final = {
    "rate": "rate = 50.0",
    "joint_names": 'joint_names = ["left_hip_pitch_joint", ...]',
    "default_pos": 'default_pos = { "*_knee_joint" = 0.3, ... }',
    "action_scale": 'action_scale = { "*" = 0.25 }',
    "kp": 'kp = { "*_knee_joint" = 99.1, ... }',
    "kd": 'kd = { "*_knee_joint" = 6.3, ... }',
    "terms": '[[terms]] with name = "base_ang_vel", and scale and history where they are not 1',
    "anchor": 'anchor = "torso_link"',
}
#: Facts with a default: no limit, no lag, and a history that is filled with the first step.
_OPTIONAL: Final = ("clip", "lag", "history_start")
#: What stands in a history for the steps before the first one, in words.
_HISTORY_STARTS: Final = {"first step": "the first step repeated", "zeros": "zeros"}
#: Keys beside the terms in a deploy.yaml.
_BESIDE_TERMS: Final = ("use_gym_history", "scale_first")
#: Keys of a term in a TOML file.
_TERM_KEYS: Final = ("name", "scale", "history")
#: Most steps in the history of a term.
_MOST_STEPS: Final = 100


class Term(Record, frozen=True):
    """A part of the observation.

    Attributes:
        name: name in `TERMS`.
        named: name in the file.
        size: number of values, of all steps.
        history: number of steps, the oldest first.
        scale: factor for all values, or one for each value of a step.
        formula: formula in words, including the frame.
    """

    name: str
    named: str
    size: int
    history: int = 1
    scale: list[float]
    formula: str


class PolicyContract(Record, frozen=True):
    """The inputs and outputs of a policy. Arrays are in the policy's joint order, `joint_names`.

    A target is `default_pos + action_scale * action`, rad, with `kp`, N·m/rad, and `kd`,
    N·m·s/rad.

    Attributes:
        path: path of the ONNX file.
        rate: steps per second.
        terms: terms of the observation, in order.
        clip: largest magnitude of a value of the observation; None without a limit.
        anchor: link whose attitude is compared with the reference's; None if no term needs it.
        reference: source of the tracked motion: the network itself, a given motion, or none.
        lag: number of steps by which the observed reference is behind the current one.
        history_start: what stands in a history for the steps before the first one.
        origin: source of each field.
    """

    path: str
    rate: float
    joint_names: list[str]
    default_pos: list[float]
    action_scale: list[float]
    kp: list[float]
    kd: list[float]
    terms: list[Term]
    clip: float | None
    anchor: str | None
    reference: Literal["in the policy", "a motion", "none"]
    lag: int
    history_start: Literal["first step", "zeros"] = "first step"
    origin: dict[str, str]

    @property
    def remembers(self) -> bool:
        """Whether an observation has values of earlier steps, besides the last action."""
        return self.lag > 0 or any(term.history > 1 for term in self.terms)

    @property
    def order(self) -> np.ndarray[Any, np.dtype[np.intp]]:
        """Motor index of each of the policy's joints, (29,)."""
        return np.array([JOINT_NAMES.index(name) for name in self.joint_names])

    def in_motor_order(self, values: Sequence[float] | Floats) -> Floats:
        """Values of the policy's joints (29,) in motor order."""
        ordered = np.empty(N_JOINTS)
        ordered[self.order] = values
        return ordered

    def __str__(self) -> str:
        width = sum(term.size for term in self.terms)
        isaac = "motor order" if self.joint_names == list(JOINT_NAMES) else "another order"
        facts = {
            "policy": self.path,
            "rate": f"{self.rate:g} Hz",
            "tracks": {
                "in the policy": "the motion in the policy",
                "a motion": "a given motion",
                "none": "no motion: it follows a commanded velocity, or stands",
            }[self.reference]
            + (f", {counted(self.lag, 'step')} behind" if self.lag else ""),
            "joints": f"{len(self.joint_names)}, {isaac}",
            "anchor": self.anchor or "",
            "observation": f"{counted(width, 'value')}"
            + (f", clipped to +-{self.clip:g}" if self.clip else ""),
            "history": "the oldest step first; steps before the first one: "
            + _HISTORY_STARTS[self.history_start]
            if any(term.history > 1 for term in self.terms)
            else "",
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


class _Facts(NamedTuple):
    """Values by the names of `PolicyContract`, and their source."""

    where: str
    values: dict[str, Any]


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
        ConfigError: a fact is missing or wrong, or facts contradict each other.
    """
    path, robot = network.path, robot or G1.default()
    values: dict[str, Any] = {}
    origin: dict[str, str] = {}
    for facts in _sources(network):
        for name, value in facts.values.items():
            if value is not None and name not in values:
                values[name], origin[name] = value, facts.where
    where = f"the policy {path}"
    terms = [_term(one, where) for one in values.get("terms", [])]
    counts = Counter(term.name for term in terms)
    if twice := [term.named for term in terms if counts[term.name] > 1]:
        raise ConfigError(
            f"The observation of {where} has one term several times: {listed(twice)}.",
            "Give each term once, with its history if it has one.",
        )
    uses_anchor = any(term.name.startswith("motion_anchor") for term in terms)
    needed = [name for name in _LINES if name != "anchor" or uses_anchor]
    missing = [name for name in needed if name not in values]
    if missing:
        raise ConfigError(
            f"Facts of {where} are missing: {', '.join(missing)}.",
            f"Write to {_beside(path)}: {'; '.join(_LINES[name] for name in missing)}.",
        )
    named = values["joint_names"]
    names = [str(name) for name in (named if isinstance(named, list) else [named])]
    _check_joints(names, network, where)
    arrays = {
        name: _joint_values(values[name], names, name, where)
        for name in ("default_pos", "action_scale", "kp", "kd")
    }
    _check_ranges(arrays, names, robot, where)
    _check_width(terms, network, where)
    rate = _number(values["rate"], "rate", where)
    if not 1.0 <= rate <= 1000.0:
        raise _wrong("rate", rate, where, "between 1 and 1000 Hz")
    tracks = any(term.name.startswith("motion_") for term in terms)
    if uses_anchor and values["anchor"] not in robot.link_names:
        raise _wrong("anchor", values["anchor"], where, "a link of the robot, such as torso_link")
    clip, lag = (_number(values.get(name, 0), name, where) for name in ("clip", "lag"))
    if clip < 0.0 or lag not in range(10):
        raise _wrong("clip, lag", f"{clip:g}, {lag:g}", where, "at least 0, and 0 to 9")
    history_start = values.get("history_start", "first step")
    if str(history_start) not in _HISTORY_STARTS:
        raise _wrong("history_start", history_start, where, " or ".join(map(repr, _HISTORY_STARTS)))
    return PolicyContract(
        path=str(path),
        rate=rate,
        joint_names=names,
        terms=terms,
        clip=clip or None,
        anchor=str(values["anchor"]) if uses_anchor else None,
        reference=("in the policy" if network.holds_motion else "a motion") if tracks else "none",
        lag=int(lag) if tracks else 0,
        history_start=history_start,
        origin={name: one for name, one in origin.items() if name != "anchor" or uses_anchor},
        **{name: value.tolist() for name, value in arrays.items()},
    )


def _beside(path: Path) -> Path:
    return path.with_suffix(".toml")


def _sources(network: Network) -> Iterator[_Facts]:
    """The facts of each source, in order of priority."""
    own, told = _beside(network.path), "metadata of the ONNX file"
    if own.exists():
        yield _facts(str(own), lambda: _of_toml(own))
    name, known = facts_of(network.sha256)
    if known:
        yield _Facts(f"g1stream's table of published policies, {name}", known)
    if "observation_names" in network.metadata:
        yield _facts(told, lambda: _of_tracking(network.metadata))
        yield _Facts(RATE_ASSUMED, {"rate": 50.0})
    elif "dof_names" in network.metadata:
        yield _facts(told, lambda: _of_holosoma(network.metadata))
    deploy = network.path.with_name("deploy.yaml")
    if deploy.exists():
        yield _facts(str(deploy), lambda: _of_deploy(deploy))
        yield _Facts("assumed: default of Unitree's runner", {"anchor": "torso_link"})


def _facts(where: str, read: Callable[[], dict[str, Any]]) -> _Facts:
    """The facts that a reader finds in a source, which may have any content."""
    try:
        return _Facts(where, read())
    except (
        ArithmeticError,
        AttributeError,
        LookupError,
        RecursionError,
        TypeError,
        ValueError,
    ) as error:
        raise ConfigError(
            f"The facts of the policy cannot be read from {where}: {str(error)[:100]}.",
            "Give the original file of the training, or write the facts to a TOML file beside it.",
        ) from error


def _of_toml(path: Path) -> dict[str, Any]:
    values = read_toml(path, "policy file")
    unknown = sorted(set(values) - set(_LINES) - set(_OPTIONAL))
    if unknown:
        raise ConfigError(
            f"{path} has the unknown keys {listed(unknown)}.",
            f"Choose from {', '.join([*_LINES, *_OPTIONAL])}.",
        )
    terms = values.get("terms")
    if terms is not None:
        if not (isinstance(terms, list) and all(isinstance(t, dict) for t in terms)):
            raise ConfigError(
                f"In {path}, terms is not a list of tables.", f"Write {_LINES['terms']}."
            )
        if extra := sorted({key for term in terms for key in term} - set(_TERM_KEYS)):
            raise ConfigError(
                f"A term in {path} has the unknown keys {listed(extra)}.",
                f"Choose from {', '.join(_TERM_KEYS)}.",
            )
    return values


def _of_tracking(metadata: Mapping[str, str]) -> dict[str, Any]:
    """Facts from whole_body_tracking and mjlab, in comma-separated lists."""

    def split(key: str) -> list[str] | None:
        return metadata[key].split(",") if metadata.get(key) else None

    commands = split("command_names") or ["motion"]
    names = split("observation_names") or []
    lengths: list[Any] = split("observation_history_lengths") or ["1"] * len(names)
    if len(lengths) == len(names):
        lengths = [_history(one) for one in lengths]
    else:  # which is refused
        lengths = [f"{','.join(lengths)} for {len(names)} terms"] * len(names)
    return {
        "joint_names": split("joint_names"),
        "default_pos": split("default_joint_pos"),
        "action_scale": split("action_scale"),
        "kp": split("joint_stiffness"),
        "kd": split("joint_damping"),
        "terms": [
            {
                "name": commands[0] if name == "command" else name,
                "history": length,
            }
            for name, length in zip(names, lengths, strict=True)
        ],
        "anchor": metadata.get("anchor_body_name") or None,
    }


def _history(text: str) -> float | str:
    """The steps of a term in metadata, where 0 means one; a text that is no number as it is."""
    try:
        return float(text) or 1.0
    except ValueError:
        return text


def _of_holosoma(metadata: Mapping[str, str]) -> dict[str, Any]:
    """Facts from holosoma: JSON values, and the training configuration if it is included.

    The terms are sorted by name. If the configuration says so, an action of 1 moves a target by
    `action_scale` times the deflection at which the servo reaches the joint's torque limit.
    """
    read = {key: _json(metadata.get(key)) for key in ("dof_names", "kp", "kd")}
    facts: dict[str, Any] = {"joint_names": read["dof_names"], "kp": read["kp"], "kd": read["kd"]}
    config = _json(metadata.get("experiment_config"))
    if not isinstance(config, dict):
        return facts
    group = _at(config, "observation", "groups", "actor_obs")
    terms = _at(group, "terms")
    if isinstance(terms, dict):
        history = _at(group, "history_length") or 1
        facts["terms"] = [
            _given(name, terms[name]) | {"history": history} for name in sorted(terms)
        ]
    # Its runner reads the reference of the next step after the observation.
    facts |= {"lag": 1, "history_start": "zeros"}
    facts["clip"] = _at(config, "observation", "clip_observations")
    facts["default_pos"] = _at(config, "robot", "init_state", "default_joint_angles")
    scale = _at(config, "robot", "control", "action_scale")
    effort = _at(config, "robot", "dof_effort_limit_list")
    if _at(config, "robot", "control", "action_scales_by_effort_limit_over_p_gain"):
        known = all(isinstance(one, list) for one in (effort, read["kp"]))
        facts["action_scale"] = (
            [scale * e / p for e, p in zip(effort, read["kp"], strict=True)] if known else None
        )
    elif scale is not None:
        facts["action_scale"] = {"*": scale}
    fps = _at(config, "simulator", "config", "sim", "fps")
    every = _at(config, "simulator", "config", "sim", "control_decimation")
    facts["rate"] = fps / every if fps and every else None
    motion = ("command", "setup_terms", "motion_command", "params", "motion_config")
    facts["anchor"] = next(iter(_at(config, *motion, "body_name_ref") or []), None)
    return facts


def _of_deploy(path: Path) -> dict[str, Any]:
    """Facts from Unitree's deploy.yaml, interpreted as in its C++ runner."""
    import yaml

    try:
        values = yaml.safe_load(read_file(path, SETTINGS_FILE))
        check_integers(values)
    except (OSError, yaml.YAMLError, ValueError, RecursionError) as error:
        raise ConfigError(
            f"{path} cannot be read: {' '.join(str(error).split())[:200]}.",
            "Give the file as Unitree's training writes it, or remove it.",
        ) from error
    period = _at(values, "step_dt")
    action = _at(values, "actions", "JointPositionAction")
    observations = _at(values, "observations")
    motors = _at(values, "joint_ids_map")
    terms = None
    if isinstance(observations, dict):
        if observations.get("use_gym_history"):
            raise ConfigError(
                f"According to {path}, the policy observes all terms of a step before those of "
                "the next (use_gym_history), which is not supported.",
                "Give a policy that was trained without it.",
            )
        terms = [
            _given(name, one) | {"history": _at(one, "history_length") or 1}
            for name, one in observations.items()
            if name not in _BESIDE_TERMS
        ]
    for key, usual in (("clip", None), ("joint_ids", [*range(N_JOINTS)])):
        if _at(action, key) not in (None, usual):
            raise ConfigError(
                f"{path} has {key} for its actions (actions.JointPositionAction), which is not "
                "supported.",
                "Give a policy that was trained without it.",
            )
    known = isinstance(motors, list) and all(
        isinstance(motor, int) and 0 <= motor < N_JOINTS for motor in motors
    )
    return {
        "rate": 1.0 / period if isinstance(period, int | float) and period > 0 else None,
        "joint_names": [JOINT_NAMES[motor] for motor in motors] if known else None,
        "default_pos": _at(action, "offset") or _at(values, "default_joint_pos"),
        "action_scale": _at(action, "scale"),
        "kp": _in_order(_at(values, "stiffness"), motors),
        "kd": _in_order(_at(values, "damping"), motors),
        "terms": terms,
    }


def _in_order(values: Any, motors: Any) -> Any:
    """Reorder values by motor to the policy's joints, because deploy.yaml has gains by motor."""
    if isinstance(values, list) and isinstance(motors, list) and len(values) >= len(motors):
        return [values[motor] for motor in motors]
    return values


def _json(text: str | None) -> Any:
    return json.loads(text) if text else None


def _at(values: Any, *keys: str) -> Any:
    """The value at nested keys; None if there is none."""
    for key in keys:
        values = values.get(key) if isinstance(values, dict) else None
    return values


def _given(name: str, term: Any) -> dict[str, Any]:
    """A term of a configuration as in a TOML file; with a clip, which `_term` refuses."""
    found = {key: _at(term, key) for key in ("scale", "clip")}
    return {"name": name} | {key: value for key, value in found.items() if value is not None}


def _term(given: Mapping[str, Any], where: str) -> Term:
    named = str(given.get("name", ""))
    name = ALIASES.get(named, named)
    if name not in TERMS:
        raise ConfigError(
            f"The observation of {where} has the unknown term {named!r}.",
            f"Known terms are {', '.join(TERMS)}.",
        )
    if "clip" in given:
        raise ConfigError(
            f"In {where}, the term {named} has limits of its own, which are not supported.",
            "Write the terms, and clip for the whole observation, to a TOML file beside it.",
        )
    size, formula, _ = TERMS[name]
    scale, history = given.get("scale", 1.0), given.get("history", 1)
    values = scale if isinstance(scale, list) else [scale]
    factors = [_number(value, f"scale of {named}", where) for value in values]
    if len(factors) not in (1, size):
        raise ConfigError(
            f"In {where}, the term {named} has {counted(size, 'value')} but "
            f"{counted(len(factors), 'scale')}.",
            "Give one scale, or a scale for each value.",
        )
    if isinstance(history, bool) or history not in range(1, _MOST_STEPS + 1):
        raise _wrong(f"history of {named}", history, where, f"a number from 1 to {_MOST_STEPS}")
    return Term(
        name=name,
        named=named,
        size=size * int(history),
        history=int(history),
        scale=factors,
        formula=formula,
    )


def _number(value: Any, name: str, where: str) -> float:
    try:
        number = float(value)
    except (OverflowError, TypeError, ValueError):
        number = np.nan
    if not np.isfinite(number):
        raise _wrong(name, value, where, "a finite number")
    return number


def _wrong(name: str, value: Any, where: str, valid: str) -> ConfigError:
    return ConfigError(
        f"In {where}, {name} is {(repr if isinstance(value, str) else str)(value)[:60]}.",
        f"It must be {valid}. A TOML file beside the policy overrides it.",
    )


def _check_joints(names: list[str], network: Network, where: str) -> None:
    strange = [name for name in names if name not in JOINT_NAMES]
    if strange:
        raise ConfigError(
            f"{where[0].upper()}{where[1:]} is for another robot: a G1 has no "
            f"{listed(strange, 3)}.",
            f"Give a policy for a G1 with {N_JOINTS} joints.",
        )
    if sorted(names) != sorted(JOINT_NAMES) or network.n_actions != N_JOINTS:
        raise ConfigError(
            f"{where[0].upper()}{where[1:]} names {counted(len(set(names)), 'joint')} but has "
            f"{counted(network.n_actions, 'action')}.",
            f"Give a policy with one action for each of the {N_JOINTS} joints of a G1.",
        )


def _joint_values(given: Any, names: list[str], what: str, where: str) -> Floats:
    """A value for each of the policy's joints, from a list or a table of names and patterns."""
    if isinstance(given, dict):
        found = np.full(len(names), np.nan)
        for pattern, value in given.items():
            matching = [fnmatchcase(name, pattern) for name in names]
            if not any(matching):
                raise ConfigError(
                    f"In {where}, {what} names {pattern}, which is not a joint.",
                    'Give joint names, or patterns such as "*_knee_joint".',
                )
            found[matching] = _number(value, what, where)
        if np.isnan(found).any():
            lacking = [name for name, value in zip(names, found, strict=True) if np.isnan(value)]
            raise ConfigError(
                f"In {where}, {what} has no value for {listed(lacking, 3)}.",
                'Give one, or a default for all others first: "*" = 0.0.',
            )
        return found
    values = given if isinstance(given, list) else [given]
    if len(values) == 1:
        values = values * len(names)
    if len(values) != len(names):
        raise ConfigError(
            f"In {where}, {what} has {counted(len(values), 'value')} for "
            f"{counted(len(names), 'joint')}.",
            f"Write to the TOML file beside it: {_LINES[what]}.",
        )
    return np.array([_number(value, what, where) for value in values])


def _check_ranges(arrays: Mapping[str, Floats], names: list[str], robot: G1, where: str) -> None:
    for what, most in _MOST.items():
        lowest = -most if what == "action_scale" else 0.0
        wrong = (arrays[what] < lowest) | (arrays[what] > most)
        if wrong.any():
            at = int(wrong.argmax())
            value = f"{arrays[what][at]:g}"
            raise _wrong(f"{what} of {names[at]}", value, where, f"{lowest:g} to {most:g}")
    motors = [JOINT_NAMES.index(name) for name in names]
    beyond = np.maximum(robot.lower[motors] - arrays["default_pos"], 0.0)
    beyond = np.maximum(beyond, arrays["default_pos"] - robot.upper[motors])
    if beyond.max() > 0.0:
        worst = int(beyond.argmax())
        low, high = robot.lower[motors[worst]], robot.upper[motors[worst]]
        value = f"{arrays['default_pos'][worst]:g}"
        valid = f"within the joint's limits, {low:.3f} to {high:.3f} rad"
        raise _wrong(f"default_pos of {names[worst]}", value, where, valid)


def _check_width(terms: Sequence[Term], network: Network, where: str) -> None:
    """Raise if the width of the terms differs from the network's input; suggest terms."""
    most = len(PolicyStep().observation)
    if network.width > most:
        raise ConfigError(
            f"The network of {where} takes {network.width} values, but a step that is recorded "
            f"has room for {most}.",
            "Give a policy with a narrower observation.",
        )
    total = sum(term.size for term in terms)
    if total == network.width:
        return
    lacking = network.width - total
    sizes = {term.name: term.size for term in terms}
    if lacking > 0:
        sizes = {name: one.size for name, one in TERMS.items() if name not in sizes}
    fitting = [
        " and ".join(some)
        for number in (1, 2)
        for some in combinations(sizes, number)
        if sum(sizes[name] for name in some) == abs(lacking)
    ]
    histories = []
    for term in terms:
        more, rest = divmod(lacking, term.size // term.history)
        if not rest and 1 <= term.history + more <= _MOST_STEPS:
            histories.append(f"{term.named} {term.history + more}")
    steps, rest = divmod(network.width, total or network.width + 1)
    if not rest and 1 < steps <= _MOST_STEPS:
        histories.append(f"each term {steps} times as many")
    guess = f" Terms as wide as the difference: {listed(fitting, 4)}." if fitting else ""
    if histories and (not fitting or any(term.history > 1 for term in terms)):
        guess += f" Or steps of history: {listed(histories, 4)}."
    raise ConfigError(
        f"The network of {where} takes {network.width} values, but the given terms have "
        f"{total}: {', '.join(f'{term.named} {term.size}' for term in terms)}.",
        f"Give the terms of the training in the TOML file beside it.{guess}",
    )
