"""Where the facts of a policy come from: a file beside it, or what its family knows.

The families are data, in `families.toml`. A TOML file beside the policy has the same keys.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

from g1stream.config import read_toml
from g1stream.errors import ConfigError, G1StreamError
from g1stream.extras.policy.network import Network
from g1stream.extras.policy.published import facts_of
from g1stream.files import read_file
from g1stream.input_limits import SETTINGS_FILE, check_integers
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS
from g1stream.text import listed

__all__ = ["TABLE", "TERM_KEYS", "Facts", "as_list", "beside", "sources"]

TABLE: Final = read_toml(Path(__file__).with_name("families.toml"), "table of families")
"""Lines to write for missing facts, defaults, ranges, names of terms, and the families."""
#: Facts that are not single values: how they are written, and whether one is so.
_FORMS: Final[dict[str, tuple[str, Callable[[Any], bool]]]] = {
    "feedback": (
        'feedback = { h_in = "h_out" }',
        lambda given: isinstance(given, dict) and all(isinstance(v, str) for v in given.values()),
    ),
    "terms": (
        "a table [[terms]] for each term",
        lambda given: isinstance(given, list) and all(isinstance(one, dict) for one in given),
    ),
    "target_clip": (
        "target_clip = [[-1.0, 1.0]]",
        lambda given: (
            isinstance(given, list)
            and all(isinstance(one, list) and len(one) == 2 for one in given)
        ),
    ),
}
TERM_KEYS: Final = ("name", "formula", "of", "scale", "clip", "history", "behind", "newest_first")
"""Keys of a term."""


class Facts(NamedTuple):
    """Values by the names of a TOML file, their source, and whether they are only assumed."""

    where: str
    values: dict[str, Any]
    assumed: bool = False


def beside(path: Path) -> Path:
    """The path of the TOML file with facts of a policy."""
    return path.with_suffix(".toml")


def sources(network: Network) -> Iterator[Facts]:
    """The facts of each source, in order of priority.

    Raises:
        ConfigError: a source cannot be read.
    """
    own = Facts(str(beside(network.path)), {})
    if beside(network.path).exists():
        own = _facts(own.where, partial(_of_toml, beside(network.path)))
    yield own
    published = Facts("g1stream's table of published policies", facts_of(network.sha256))
    yield published
    families, sizes = TABLE["families"], [network.width, network.outputs[network.first]]
    fitting = [name for name, one in families.items() if one.get("sizes") == sizes]
    lines = " or ".join(f'family = "{name}"' for name in fitting)
    chosen = own.values.get("family", fitting[0] if len(fitting) == 1 else "")
    if chosen and chosen not in fitting:
        known = ", ".join(name for name, one in families.items() if "sizes" in one)
        raise ConfigError(
            f"{own.where} has the family {chosen!r}, which is none of networks with {sizes[0]} "
            f"values and {sizes[1]} actions.",
            f"Write {lines}." if lines else f"Remove the line; {known} have other sizes.",
        )
    told = "joint_names" in {*own.values, *published.values}
    for name, family in families.items():
        about, file = family["about"], network.path.parent / family.get("file", "")
        if family.get("metadata") in network.metadata:
            read = partial(_of_metadata, family, network.metadata)
            yield _facts("metadata of the ONNX file", read)
            told = True
        elif file.is_file():
            yield _facts(str(file), partial(_of_yaml, family, file))
            told = True
        elif name in fitting and not (told or chosen):
            which = " or ".join(families[one]["about"] for one in fitting)
            raise ConfigError(
                f"{network.path} may be of {which}: they have {sizes[0]} values and {sizes[1]} "
                "actions, but other gains and another default pose.",
                f"Write to {own.where}: {lines}.",
            )
        elif name != chosen:
            continue
        like = families.get(family.get("like"), {})
        yield Facts(f"the family {about}", like.get("facts", {}) | family.get("facts", {}))
        yield Facts(f"assumed: default of {about}", family.get("assumed", {}), assumed=True)


def _facts(where: str, read: Callable[[], dict[str, Any]]) -> Facts:
    """The facts that a reader finds in a source, which may have any content."""
    try:
        values = read()
        limits = [one["clip"] for one in values.get("terms") or () if "clip" in one]
        for _lowest, _highest in (*limits, *(values.get("target_clip") or ())):
            pass  # each is a pair
        return Facts(where, values)
    except G1StreamError:
        raise
    except Exception as error:
        raise ConfigError(
            f"The facts of the policy cannot be read from {where}: "
            f"{' '.join(str(error).split())[:200]}.",
            "Give the original file of the training, or write the facts to a TOML file beside it.",
        ) from error


def _of_toml(path: Path) -> dict[str, Any]:
    values = read_toml(path, "policy file")
    for key, (form, is_right) in _FORMS.items():
        if key in values and not is_right(values[key]):
            raise ConfigError(f"In {path}, {key} is {str(values[key])[:60]}.", f"Write {form}.")
    of_terms = {key for term in values.get("terms", []) for key in {**term}}
    keys = [*TABLE["lines"], *TABLE["optional"]]
    for what, given, valid in (("", {*values}, keys), ("a term of ", of_terms, TERM_KEYS)):
        if unknown := sorted(given - {*valid}):
            raise ConfigError(
                f"The unknown keys {listed(unknown)} are in {what}{path}.",
                f"Choose from {', '.join(valid)}.",
            )
    return values


def _parsed(text: str) -> Any:
    """A value of metadata: JSON, or text, where a list is "a,b" and one of lists "a;b,c;d"."""
    try:
        return json.loads(text)
    except ValueError:
        parts = [part.split(";") if ";" in part else part for part in text.split(",")]
        return parts if len(parts) > 1 else text


def _of_metadata(family: Mapping[str, Any], metadata: Mapping[str, str]) -> dict[str, Any]:
    return _of_family(family, {key: _parsed(text) for key, text in metadata.items()})


def _of_yaml(family: Mapping[str, Any], path: Path) -> dict[str, Any]:
    import yaml

    values = yaml.safe_load(read_file(path, SETTINGS_FILE))
    check_integers(values)
    return _of_family(family, values)


def _of_family(family: Mapping[str, Any], told: Any) -> dict[str, Any]:
    """The facts that a family finds in a file or in metadata."""
    facts = {name: _at(told, paths) for name, paths in family["paths"].items()}
    other: dict[str, Any] = {k: _at(told, paths) for k, paths in family.get("from", {}).items()}
    period, per_action, motors = map(other.get, ("period", "per_action", "motors"))
    if period or (per_action and other["per_second"]):
        facts["rate"] = 1.0 / period if period else other["per_second"] / per_action
    if (factor := other.get("action_factor")) is not None and facts["action_scale"] is None:
        facts["action_scale"] = {"*": factor}
        if other["by_effort"]:
            pairs = zip(as_list(other["effort"]), as_list(facts["kp"]), strict=True)
            facts["action_scale"] = [factor * most / kp for most, kp in pairs]
    if other.get("joint_ids") not in (None, [*range(N_JOINTS)]):
        raise ValueError("its action has only the joints of joint_ids")
    if isinstance(motors, list) and all(motor in range(N_JOINTS) for motor in motors):
        facts["joint_names"] = [JOINT_NAMES[motor] for motor in motors]
        for name in ("kp", "kd"):
            if len(as_list(facts[name])) >= len(motors):
                facts[name] = [facts[name][motor] for motor in motors]
    if other.get("by_step"):
        facts["history_by"] = "step"
    rows = _rows(family, told)
    return facts | {"terms": rows and [_row(one) for one in rows]}


def _rows(family: Mapping[str, Any], told: Any) -> list[dict[str, Any]] | None:
    """The terms that a family finds: in a table, in a list, or in a list for each key."""
    if "columns" not in family:
        rows, history = _at(told, family["terms"]), _at(told, family.get("history", "-"))
        if isinstance(rows, dict):
            tables = sorted(rows.items()) if family.get("sorted") else rows.items()
            rows = [
                {"name": name} | (one if isinstance(one, dict) else {})
                for name, one in tables
                if not isinstance(one, bool)  # settings beside the terms
            ]
        return [{"history_length": history} | one for one in rows] if rows else None
    columns = {name: as_list(_at(told, paths)) for name, paths in family["columns"].items()}
    names, command = columns["name"], as_list(_at(told, family["command"]) or "command")[0]
    for key, column in columns.items():
        if column != [None] and len(column) != len(names):
            raise ValueError(f"{','.join(map(str, column))} is the {key} of {len(names)} terms")
    columns["name"] = [command if name == "command" else name for name in names]
    return [
        {key: column[i] for key, column in columns.items() if column != [None]}
        for i in range(len(names) if names != [None] else 0)
    ]


def _row(term: Mapping[str, Any]) -> dict[str, Any]:
    """A term with the keys of a TOML file. A history of 0 steps has one."""
    row = {key: term[key] for key in ("name", "scale", "clip") if term.get(key) is not None}
    try:
        return row | {"history": float(term.get("history_length") or 0) or 1}
    except ValueError:  # which is refused
        return row | {"history": term["history_length"]}


def as_list(value: Any) -> list[Any]:
    """A list, or the only value of one."""
    return value if isinstance(value, list) else [value]


def _at(values: Any, paths: str | list[str]) -> Any:
    """The value at the first of some paths, nested keys with dots between; None without one."""
    for path in as_list(paths):
        found = values
        for key in path.split("."):
            if isinstance(found, list):
                found = found[int(key)] if key.isdigit() and int(key) < len(found) else None
            else:
                found = found.get(key) if isinstance(found, dict) else None
        if found is not None:
            return found
    return None
