"""Reads a URDF as a G1, or says what keeps it from being one."""

from __future__ import annotations

from collections import Counter
from io import BytesIO
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree as ET

import numpy as np

from g1stream.errors import RobotError
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.rotations import quat_from_matrix
from g1stream.robot.tree import KinematicTree

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

__all__ = ["parse_urdf"]

_USE_29_JOINTS = "Use the URDF of a G1 with 29 joints, such as g1_29dof_rev_1_0.urdf."
_MAKE_ONE_TREE = "Connect all links to one root link, each by one joint to its parent."
_PARTS = {"link": (), "joint": ("origin", "parent", "child", "axis", "limit")}
_NUMBERS = {"xyz": 3, "rpy": 3, "lower": 1, "upper": 1, "velocity": 1, "effort": 1}
_AXIS_TOLERANCE = 1e-3  # more than rounding to four digits does


def parse_urdf(text: str, source: str) -> KinematicTree:
    """Read links and joints out of a URDF text.

    Args:
        text: the XML; shapes and masses in it are not looked at.
        source: what to call it in errors.

    Raises:
        RobotError: it is not a URDF, its links are not one tree, or its joints are not a G1's.
    """
    robot = _parse(text, source)
    _check_names(robot, source)
    joints = {joint.name: joint for joint in robot.joints}
    _check_joints(joints, source)
    link_names, joint_above = _sort_links(robot, source)

    n_links = len(link_names)
    parent, joint_of_link = np.full(n_links, -1), np.full(n_links, -1)
    origin, axis = np.tile(np.eye(4), (n_links, 1, 1)), np.zeros((n_links, 3))
    for link, name in enumerate(link_names[1:], start=1):
        joint = joint_above[name]
        parent[link] = link_names.index(joint.parent)
        if joint.origin is not None:
            origin[link] = joint.origin
        if joint.name in JOINT_NAMES:
            joint_of_link[link] = JOINT_NAMES.index(joint.name)
            axis[link] = _unit_axis(joint, source)

    limits = np.array([_limits(joints[name], source) for name in JOINT_NAMES])
    lower, upper, velocity, effort = limits.T.copy()
    return KinematicTree(
        name=robot.name,
        link_names=link_names,
        parent=parent,
        joint_of_link=joint_of_link,
        origin_pos=origin[:, :3, 3].copy(),
        origin_quat_wxyz=quat_from_matrix(origin[:, :3, :3]),
        axis=axis,
        joint_names=JOINT_NAMES,
        lower=lower,
        upper=upper,
        velocity=velocity,
        effort=effort,
        ignored_joints=tuple(
            name
            for name, joint in joints.items()
            if joint.type != "fixed" and name not in JOINT_NAMES
        ),
    )


def _parse(text: str, source: str) -> Any:
    """The robot, its links and joints as yourdfpy's dataclasses."""
    from yourdfpy import URDF  # takes a second to import, and the default robot does without

    xml = ET.tostring(_kinematic_part(text, source))
    return URDF.load(BytesIO(xml), build_scene_graph=False).robot


def _kinematic_part(text: str, source: str) -> ET.Element:
    """The XML with links and joints only, without shapes, masses and whatever else may be there."""
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
            "Give a URDF file; MJCF, SDF and USD files are not read.",
        )
    part = ET.Element("robot", name=root.get("name", ""))
    for element in root:
        if element.tag in _PARTS:
            part.append(_stripped(element, source))
    return part


def _stripped(element: ET.Element, source: str) -> ET.Element:
    """A link or joint with the parts that are read, after a look whether it has those it needs."""
    kept = ET.Element(element.tag, element.attrib)
    kept.extend(child for child in element if child.tag in _PARTS[element.tag])
    if "name" not in kept.attrib:
        raise RobotError(f"{source} has a {kept.tag} without a name.", "Name it.")
    for needed in ("parent", "child") if kept.tag == "joint" else ():
        if kept.find(needed) is None:
            raise RobotError(
                f"{source}: the joint {kept.get('name')!r} has no <{needed}>.", _MAKE_ONE_TREE
            )
    for part in kept:
        for key, value in part.items():
            if key in _NUMBERS and not _are_numbers(value, _NUMBERS[key]):
                raise RobotError(
                    f"{source}: the joint {kept.get('name')!r} has {key}={value!r} "
                    f"in its <{part.tag}>.",
                    "Give three finite numbers as xyz and rpy, and one as each limit.",
                )
    return kept


def _are_numbers(text: str, count: int) -> bool:
    try:
        numbers = [float(word) for word in text.split()]
    except ValueError:
        return False
    return len(numbers) == count and bool(np.isfinite(numbers).all())


def _check_names(robot: Any, source: str) -> None:
    """Names are unique, and joints connect links that exist."""
    for kind, items in (("link", robot.links), ("joint", robot.joints)):
        for name, count in Counter(item.name for item in items).items():
            if count > 1:
                raise RobotError(
                    f"{source} has {count} {kind}s named {name!r}.", f"Give each {kind} one name."
                )
    links = {link.name for link in robot.links}
    for joint in robot.joints:
        for link in (joint.parent, joint.child):
            if link not in links:
                raise RobotError(
                    f"{source}: the joint {joint.name!r} names a link {link!r} that is not there.",
                    "Correct the link's name, or add the link.",
                )


def _check_joints(joints: Mapping[str, Any], source: str) -> None:
    """The 29 joints are there and turn; nothing else needs more than a position of zero."""
    lacking = [n for n in JOINT_NAMES if n not in joints or joints[n].type == "fixed"]
    if lacking:
        raise RobotError(
            f"{source} lacks {len(lacking)} of the G1's {len(JOINT_NAMES)} moving joints: "
            f"{', '.join(lacking)}.",
            _USE_29_JOINTS,
        )
    for name, joint in joints.items():
        if name in JOINT_NAMES and joint.type != "revolute":
            raise RobotError(
                f"{source}: the joint {name!r} is {joint.type or 'of no type'}, not revolute.",
                _USE_29_JOINTS,
            )
        if joint.type in ("floating", "planar"):
            raise RobotError(
                f"{source}: the joint {name!r} is {joint.type}.",
                "Remove it and the link above it: the root link moves freely without it.",
            )


def _sort_links(robot: Any, source: str) -> tuple[tuple[str, ...], dict[str, Any]]:
    """The links, depth first in the file's order, and the joint above each but the root."""
    joint_above: dict[str, Any] = {}
    for joint in robot.joints:
        if other := joint_above.get(joint.child):
            raise RobotError(
                f"{source}: the link {joint.child!r} has two parents, through the joints "
                f"{other.name!r} and {joint.name!r}.",
                _MAKE_ONE_TREE,
            )
        joint_above[joint.child] = joint

    roots = [link.name for link in robot.links if link.name not in joint_above]
    if len(roots) != 1:
        raise RobotError(
            f"{source} has {len(roots)} root links{': ' if roots else ''}{', '.join(roots)}.",
            _MAKE_ONE_TREE,
        )
    ordered: list[str] = []
    waiting = roots
    while waiting:
        ordered.append(waiting.pop())
        below = [joint.child for joint in robot.joints if joint.parent == ordered[-1]]
        waiting.extend(reversed(below))
    if unreached := [link.name for link in robot.links if link.name not in ordered]:
        raise RobotError(
            f"{source}: no way leads from the root to the links {', '.join(unreached)}.",
            _MAKE_ONE_TREE,
        )
    return tuple(ordered), joint_above


def _unit_axis(joint: Any, source: str) -> NDArray[np.float64]:
    length = float(np.linalg.norm(joint.axis))
    if abs(length - 1) > _AXIS_TOLERANCE:
        raise RobotError(
            f"{source}: the axis of the joint {joint.name!r} is {joint.axis.tolist()}, "
            "not a unit vector.",
            "Scale it to length 1.",
        )
    axis: NDArray[np.float64] = joint.axis / length
    return axis


def _limits(joint: Any, source: str) -> tuple[float, float, float, float]:
    """Lower, upper, velocity and effort of a joint of the G1."""
    limit = joint.limit
    values = limit and (limit.lower, limit.upper, limit.velocity, limit.effort)
    if not values or None in values:
        raise RobotError(
            f"{source}: the joint {joint.name!r} lacks a limit.",
            "Give it a <limit> with lower, upper, velocity and effort.",
        )
    if limit.lower >= limit.upper or limit.velocity <= 0 or limit.effort <= 0:
        raise RobotError(
            f"{source}: the joint {joint.name!r} cannot move: lower {limit.lower}, "
            f"upper {limit.upper}, velocity {limit.velocity}, effort {limit.effort}.",
            "Make lower less than upper, velocity and effort positive.",
        )
    return values
