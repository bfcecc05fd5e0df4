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
    origin, axis = np.zeros((n_links, 4, 4)), np.zeros((n_links, 3))
    origin[0] = np.eye(4)
    for link, name in enumerate(link_names[1:], start=1):
        joint = joint_above[name]
        parent[link] = link_names.index(joint.parent)
        origin[link] = _origin(joint, source)
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
    from yourdfpy import URDF  # noqa: PLC0415  (takes a second, and the default robot needs none)

    root = _kinematic_part(text, source)
    try:
        return URDF.load(BytesIO(ET.tostring(root)), build_scene_graph=False).robot
    except (AttributeError, IndexError, KeyError, TypeError, ValueError) as error:
        raise RobotError(
            f"{source} is not a valid URDF: {type(error).__name__}, {error}.",
            "Correct the file; check_urdf says where it is wrong.",
        ) from error


def _kinematic_part(text: str, source: str) -> ET.Element:
    """The XML without shapes and masses, which may be of any kind and are no concern here."""
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
    for link in root.findall("link"):
        link[:] = []
    for joint in root.findall("joint"):
        if lacking := {"parent", "child"} - {part.tag for part in joint}:
            raise RobotError(
                f"{source}: the joint {joint.get('name')!r} has no <{min(lacking)}>.",
                _MAKE_ONE_TREE,
            )
    return root


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
                f"{source}: the joint {name!r} is {joint.type}, not revolute.", _USE_29_JOINTS
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


def _origin(joint: Any, source: str) -> NDArray[np.float64]:
    """The joint's frame in the parent link's, (4, 4)."""
    origin = np.eye(4) if joint.origin is None else joint.origin
    if not np.isfinite(origin).all():
        raise RobotError(
            f"{source}: the origin of the joint {joint.name!r} is not finite.",
            "Give its xyz and rpy as ordinary numbers.",
        )
    return origin


def _unit_axis(joint: Any, source: str) -> NDArray[np.float64]:
    length = float(np.linalg.norm(joint.axis))
    if joint.axis.shape != (3,) or not abs(length - 1) <= _AXIS_TOLERANCE:
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
    if not values or None in values or not np.isfinite(values).all():
        raise RobotError(
            f"{source}: the joint {joint.name!r} lacks a limit.",
            'Give it <limit lower="" upper="" velocity="" effort=""/>, all finite.',
        )
    if limit.lower >= limit.upper or limit.velocity <= 0 or limit.effort <= 0:
        raise RobotError(
            f"{source}: the joint {joint.name!r} cannot move: lower {limit.lower}, "
            f"upper {limit.upper}, velocity {limit.velocity}, effort {limit.effort}.",
            "Make lower less than upper, velocity and effort positive.",
        )
    return values
