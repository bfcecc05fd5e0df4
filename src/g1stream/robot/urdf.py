"""Reads the kinematics of a 29-joint G1 from a URDF, or says why that is not possible.

A URDF has two readers. This one parses the XML once with ElementTree; the shapes (visuals.py) and
the text for MuJoCo (mujoco_spec.py) are made from the same elements. The other is MuJoCo, which
reads masses and inertias, in programs that simulate or compute torques.

Alternatives:

- yourdfpy takes a second to import, because of trimesh, and does not check what it reads. All that
  it would save after those checks is the conversion of three attributes. It is the independent
  reader that the tests compare this one with.
- MuJoCo alone takes long to import, and fails on missing meshes.
- A file compiled from the default URDF would save 3 of the 4 ms that reading it takes.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import lru_cache
from math import isfinite
from typing import TYPE_CHECKING, Any, Final
from xml.etree import ElementTree as ET

import numpy as np

from g1stream.errors import RobotError
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.rotations import quat_from_rpy

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["numbers", "parse_urdf", "read_kinematics"]

_USE_29_JOINTS: Final = "Use the URDF of a G1 with 29 joints, such as g1_29dof_rev_1_0.urdf."
_MAKE_ONE_TREE: Final = "Connect all links to one root link, each by one joint to its parent."
_LIMITS: Final = ("lower", "upper", "velocity", "effort")
_AXIS_TOLERANCE: Final = 1e-3  # more than rounding to four digits


@dataclass(frozen=True)
class _Joint:
    name: str
    type: str
    parent: str | None
    child: str | None
    xyz: list[float]
    rpy: list[float]
    axis: list[float]
    limits: list[float]  # those that are given, in the order of _LIMITS


@lru_cache(maxsize=4)
def parse_urdf(text: str, source: str) -> ET.Element:
    """The root element of a URDF text; of the same text the same one, not to be changed.

    Raises:
        RobotError: it is not XML, or not a URDF.
    """
    try:
        root = ET.fromstring(text)
    except ET.ParseError as error:
        line, column = error.position
        raise RobotError(
            f"{source} is not XML: line {line}, column {column + 1}.",
            "Give a URDF file; a xacro file must be converted first.",
        ) from error
    if root.tag != "robot":
        raise RobotError(
            f"{source} is not a URDF: its root element is <{root.tag}>, not <robot>.",
            "Give a URDF file; MJCF, SDF and USD files are not supported.",
        )
    return root


def numbers(
    element: ET.Element | None, key: str, count: int, where: str, default: str = ""
) -> list[float]:
    """The numbers in an attribute of an element, or those of `default` where it is missing.

    Raises:
        RobotError: they are not `count` finite numbers; says where.
    """
    text = default if element is None else element.get(key, default)
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        values = []
    if len(values) != count or not all(map(isfinite, values)):
        tag = "" if element is None else f" in its <{element.tag}>"
        raise RobotError(
            f"{where} has {key}={text!r}{tag}.",
            f"Give {count} finite number{'s' * (count > 1)}.",
        )
    return values


def read_kinematics(root: ET.Element, source: str) -> dict[str, Any]:
    """Links, joints and limits: the fields of `G1` from `name` on.

    Args:
        root: of a URDF; shapes and masses in it are not read.
        source: name of the URDF for errors.

    Raises:
        RobotError: the links are not one tree, or the joints are not a G1's.
    """
    links = [_name(element, source) for element in root.findall("link")]
    joints = [_read_joint(element, source) for element in root.findall("joint")]
    _check_names(links, joints, source)
    by_name = {joint.name: joint for joint in joints}
    _check_joints(by_name, source)
    link_names, joint_above = _sort_links(links, joints, source)

    n_links = len(link_names)
    parent, joint_of_link = np.full(n_links, -1), np.full(n_links, -1)
    xyz, rpy, axis = np.zeros((3, n_links, 3))
    for link, name in enumerate(link_names[1:], start=1):
        joint = joint_above[name]
        parent[link] = link_names.index(str(joint.parent))
        xyz[link], rpy[link] = joint.xyz, joint.rpy
        if joint.name in JOINT_NAMES:
            joint_of_link[link] = JOINT_NAMES.index(joint.name)
            axis[link] = _unit_axis(joint, source)
    limits = np.array([_check_limits(by_name[name], source) for name in JOINT_NAMES])
    lower, upper, velocity, effort = limits.T.copy()
    return {
        "name": root.get("name", ""),
        "link_names": link_names,
        "parent": parent,
        "joint_of_link": joint_of_link,
        "origin_pos": xyz.copy(),
        "origin_quat_wxyz": quat_from_rpy(rpy),
        "axis": axis.copy(),
        "joint_names": JOINT_NAMES,
        "lower": lower,
        "upper": upper,
        "velocity": velocity,
        "effort": effort,
        "ignored_joints": tuple(
            joint.name
            for joint in joints
            if joint.type != "fixed" and joint.name not in JOINT_NAMES
        ),
    }


def _name(element: ET.Element, source: str) -> str:
    name = element.get("name")
    if name is None:
        raise RobotError(f"{source} has a {element.tag} without a name.", "Name it.")
    return name


def _read_joint(element: ET.Element, source: str) -> _Joint:
    name = _name(element, source)
    where = f"{source}: the joint {name!r}"
    ends = []
    for tag in ("parent", "child"):
        end = element.find(tag)
        if end is None:
            raise RobotError(f"{where} has no <{tag}>.", _MAKE_ONE_TREE)
        ends.append(end.get("link"))
    origin, axis, limit = (element.find(tag) for tag in ("origin", "axis", "limit"))
    return _Joint(
        name=name,
        type=element.get("type", ""),
        parent=ends[0],
        child=ends[1],
        xyz=numbers(origin, "xyz", 3, where, "0 0 0"),
        rpy=numbers(origin, "rpy", 3, where, "0 0 0"),
        axis=numbers(axis, "xyz", 3, where, "1 0 0"),
        limits=[
            numbers(limit, key, 1, where)[0]
            for key in _LIMITS
            if limit is not None and key in limit.attrib
        ],
    )


def _check_names(links: list[str], joints: list[_Joint], source: str) -> None:
    """Names are unique, and joints connect links that exist."""
    for kind, names in (("link", links), ("joint", [joint.name for joint in joints])):
        for name, count in Counter(names).items():
            if count > 1:
                raise RobotError(
                    f"{source} has {count} {kind}s named {name!r}.", f"Give each {kind} one name."
                )
    for joint in joints:
        for link in (joint.parent, joint.child):
            if link not in links:
                raise RobotError(
                    f"{source}: the joint {joint.name!r} names a link {link!r} that does not "
                    "exist.",
                    "Correct the link's name, or add the link.",
                )


def _check_joints(joints: Mapping[str, _Joint], source: str) -> None:
    """The 29 joints exist and turn; all others stay where they are at zero."""
    missing = [n for n in JOINT_NAMES if n not in joints or joints[n].type == "fixed"]
    if missing:
        raise RobotError(
            f"{source} lacks {len(missing)} of the G1's {len(JOINT_NAMES)} moving joints: "
            f"{', '.join(missing)}.",
            _USE_29_JOINTS,
        )
    for name, joint in joints.items():
        if name in JOINT_NAMES and joint.type != "revolute":
            raise RobotError(
                f"{source}: the joint {name!r} is of type {joint.type!r}, not 'revolute'.",
                _USE_29_JOINTS,
            )
        if joint.type in ("floating", "planar"):
            raise RobotError(
                f"{source}: the joint {name!r} is {joint.type}.",
                "Remove it and the link above it: the root link moves freely without it.",
            )


def _sort_links(
    links: list[str], joints: list[_Joint], source: str
) -> tuple[tuple[str, ...], dict[str | None, _Joint]]:
    """The links, depth first in the file's order, and the joint above each but the root."""
    joint_above: dict[str | None, _Joint] = {}
    for joint in joints:
        if other := joint_above.get(joint.child):
            raise RobotError(
                f"{source}: the link {joint.child!r} has two parents, through the joints "
                f"{other.name!r} and {joint.name!r}.",
                _MAKE_ONE_TREE,
            )
        joint_above[joint.child] = joint

    roots = [link for link in links if link not in joint_above]
    if len(roots) != 1:
        raise RobotError(
            f"{source} has {len(roots)} root links{': ' if roots else ''}{', '.join(roots)}.",
            _MAKE_ONE_TREE,
        )
    ordered: list[str] = []
    waiting = roots
    while waiting:
        ordered.append(waiting.pop())
        below = [str(joint.child) for joint in joints if joint.parent == ordered[-1]]
        waiting.extend(reversed(below))
    if unreached := [link for link in links if link not in ordered]:
        raise RobotError(
            f"{source}: the links {', '.join(unreached)} are not connected to the root.",
            _MAKE_ONE_TREE,
        )
    return tuple(ordered), joint_above


def _unit_axis(joint: _Joint, source: str) -> Any:
    length = float(np.linalg.norm(joint.axis))
    if abs(length - 1) > _AXIS_TOLERANCE:
        raise RobotError(
            f"{source}: the axis of the joint {joint.name!r} is {joint.axis}, not a unit vector.",
            "Scale it to length 1.",
        )
    return np.array(joint.axis) / length


def _check_limits(joint: _Joint, source: str) -> list[float]:
    if len(joint.limits) < len(_LIMITS):
        raise RobotError(
            f"{source}: the joint {joint.name!r} lacks a limit.",
            f"Give it a <limit> with {', '.join(_LIMITS)}.",
        )
    lower, upper, velocity, effort = joint.limits
    if lower >= upper or velocity <= 0 or effort <= 0:
        raise RobotError(
            f"{source}: the joint {joint.name!r} cannot move: lower {lower}, upper {upper}, "
            f"velocity {velocity}, effort {effort}.",
            "Make lower less than upper, velocity and effort positive.",
        )
    return joint.limits
