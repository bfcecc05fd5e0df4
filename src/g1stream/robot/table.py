"""A robot compiled to JSON, so that the default one loads without a URDF parser.

The table names the URDF it was made from by its hash; for another URDF it is not used.
"""

from __future__ import annotations

import json
from hashlib import sha256
from typing import TYPE_CHECKING, Any

import numpy as np

from g1stream.robot.tree import KinematicTree

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["read_table", "write_table"]

_LINK_ARRAYS = {
    "parent": np.intp,
    "joint_of_link": np.intp,
    "origin_pos": np.float64,
    "origin_quat_wxyz": np.float64,
    "axis": np.float64,
}
_JOINT_ARRAYS = dict.fromkeys(("lower", "upper", "velocity", "effort"), np.float64)


def write_table(tree: KinematicTree, urdf: str) -> str:
    """The tree read from a URDF text as JSON text, one line per link and per joint."""
    table = {
        "urdf_sha256": _hash(urdf),
        "name": tree.name,
        "ignored_joints": tree.ignored_joints,
        "links": _rows(tree, tree.link_names, _LINK_ARRAYS),
        "joints": _rows(tree, tree.joint_names, _JOINT_ARRAYS),
    }
    entries = [f"{json.dumps(key)}: {_one_row_a_line(value)}" for key, value in table.items()]
    return "{\n" + ",\n".join(entries) + "\n}\n"


def read_table(text: str, urdf: str) -> KinematicTree | None:
    """The tree of a table, or None where the table was not made from this URDF text."""
    table = json.loads(text)
    if table["urdf_sha256"] != _hash(urdf):
        return None
    links, joints = table["links"], table["joints"]
    return KinematicTree(
        name=table["name"],
        link_names=tuple(row["name"] for row in links),
        joint_names=tuple(row["name"] for row in joints),
        ignored_joints=tuple(table["ignored_joints"]),
        **_columns(links, _LINK_ARRAYS),
        **_columns(joints, _JOINT_ARRAYS),
    )


def _hash(urdf: str) -> str:
    return sha256(urdf.encode("utf-8")).hexdigest()


def _rows(
    tree: KinematicTree, names: tuple[str, ...], arrays: dict[str, type[np.generic]]
) -> list[dict[str, Any]]:
    return [
        {"name": name, **{key: getattr(tree, key)[i].tolist() for key in arrays}}
        for i, name in enumerate(names)
    ]


def _one_row_a_line(value: Any) -> str:
    if not isinstance(value, list):
        return json.dumps(value)
    return "[\n" + ",\n".join(f"  {json.dumps(row)}" for row in value) + "\n]"


def _columns(
    rows: list[dict[str, Any]], arrays: dict[str, type[np.generic]]
) -> dict[str, NDArray[Any]]:
    return {key: np.array([row[key] for row in rows], dtype) for key, dtype in arrays.items()}
