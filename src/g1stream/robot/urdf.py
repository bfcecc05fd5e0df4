"""Reads the kinematics of a G1 from a URDF, or says why that is not possible.

A URDF has two readers. This one parses the XML once with ElementTree; the shapes (visuals.py) and
the text for MuJoCo (mujoco_spec.py) are made from the same elements. The other is MuJoCo, which
reads masses and inertias, in programs that simulate or compute torques.

yourdfpy, which takes a second to import and does not check what it reads, is the independent reader
that the tests compare this one with. MuJoCo alone is slow to import, and fails on missing meshes.
"""

from __future__ import annotations

from copy import deepcopy
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Final
from xml.etree import ElementTree as ET

import numpy as np

from g1stream.errors import RobotError
from g1stream.input_limits import NUMBER, URDF_LINKS
from g1stream.robot.joints import JOINT_NAMES, JOINT_SETS, N_JOINTS, JointSet
from g1stream.robot.rotations import quat_from_rpy
from g1stream.text import counted

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["KEPT_ROBOTS", "numbers", "parse_urdf", "read_kinematics", "with_prefixed_links"]

KEPT_ROBOTS: Final = 8
"""What is made from a URDF is kept for so many: each session brings one, and a process may read
many sessions."""

_LIMITS: Final = ("lower", "upper", "velocity", "effort")
#: Of joints that a robot does not have: rad, rad/s and N·m that nothing passes.
_NO_LIMITS: Final = (-1e3, 1e3, 1e3, 1e3)
_AXIS_TOLERANCE: Final = 1e-3  # more than rounding to four digits


class _DocumentTypeError(ValueError):
    """A document type declaration, which may define entities."""


class _TreeBuilder(ET.TreeBuilder):
    """Refuses entities: nested ones fill the memory, external ones name other files."""

    def doctype(self, name: str, pubid: str | None, system: str | None) -> None:
        raise _DocumentTypeError


@lru_cache(maxsize=KEPT_ROBOTS)
def parse_urdf(text: str, source: str) -> ET.Element:
    """The root element of a URDF text; of the same text the same one, not to be changed.

    Raises:
        RobotError: it is not XML, or not a URDF.
    """
    try:
        root: ET.Element = ET.fromstring(text, ET.XMLParser(target=_TreeBuilder()))
    except _DocumentTypeError as error:
        raise RobotError(
            f"{source} has a document type declaration (<!DOCTYPE).",
            "Remove it: a URDF needs none, and the entities it may define are not supported.",
        ) from error
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


def with_prefixed_links(root: ET.Element, prefix: str) -> str:
    """A URDF for viewers: links named as their frames, and no shapes but those to be looked at.

    Args:
        root: of a URDF; it is not changed.
        prefix: put before the names of links, such as `measured/`.
    """
    root = deepcopy(root)
    for link in root.findall("link"):
        link.set("name", prefix + link.get("name", ""))
        for collision in link.findall("collision"):
            link.remove(collision)
    for end in root.iterfind("joint/*[@link]"):
        end.set("link", prefix + end.get("link", ""))
    return ET.tostring(root, encoding="unicode")


def numbers(
    element: ET.Element | None, key: str, count: int, where: str, default: str = ""
) -> list[float]:
    """The numbers in an attribute of an element, or those of `default` where it is missing.

    Raises:
        RobotError: they are not `count` numbers of a sane size; says where.
    """
    text = default if element is None else element.get(key, default)
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        values = []
    if len(values) != count or not all(abs(value) <= NUMBER for value in values):
        tag = "" if element is None else f" in its <{element.tag}>"
        raise RobotError(
            f"{where} has {key}={text!r:.80}{tag}.",
            f"Give {count} finite number{'s' * (count > 1)}, at most {NUMBER:g}.",
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
    joints = {joint.get("name", ""): joint for joint in root.findall("joint")}
    joint_set = _joint_set(joints, source)
    present = {JOINT_NAMES[i] for i in range(N_JOINTS) if i not in joint_set.absent}
    link_names, joint_above = _sort_links(root, source)
    n_links = len(link_names)
    parent, joint_of_link = np.full(n_links, -1), np.full(n_links, -1)
    xyz, rpy, axis = np.zeros((3, n_links, 3))
    for link, link_name in enumerate(link_names[1:], start=1):
        joint = joint_above[link_name]
        name = joint.get("name", "")
        where = f"{source}: the joint {name!r}"
        parent[link] = link_names.index(_end(joint, "parent"))
        xyz[link] = numbers(joint.find("origin"), "xyz", 3, where, "0 0 0")
        rpy[link] = numbers(joint.find("origin"), "rpy", 3, where, "0 0 0")
        if name in present:
            joint_of_link[link] = JOINT_NAMES.index(name)
            axis[link] = _unit_axis(joint, where)
    limits = [
        _limits(joints[name], f"{source}: the joint {name!r}") if name in present else _NO_LIMITS
        for name in JOINT_NAMES
    ]
    lower, upper, velocity, effort = np.transpose(limits).copy()
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
            name
            for name, joint in joints.items()
            if joint.get("type") != "fixed" and name not in JOINT_NAMES
        ),
        "joint_set": joint_set,
    }


def _joint_set(joints: Mapping[str, ET.Element], source: str) -> JointSet:
    """The kind of G1 that has the joints that turn; all others stay where they are at zero."""
    types = {name: joint.get("type") for name, joint in joints.items()}
    missing = [name for name in JOINT_NAMES if types.get(name) != "revolute"]
    absent = tuple(map(JOINT_NAMES.index, missing))
    found = next((one for one in JOINT_SETS if one.absent == absent), None)
    if found is None:
        raise RobotError(
            f"{source} lacks {len(missing)} of the G1's {len(JOINT_NAMES)} revolute joints: "
            f"{', '.join(missing)}.",
            "Use the URDF of a G1 with 29 joints, such as g1_29dof_rev_1_0.urdf, or of "
            f"{', '.join(one.name for one in JOINT_SETS if one.absent)} with exactly its joints.",
        )
    for name, kind in types.items():
        if kind in ("floating", "planar"):
            raise RobotError(
                f"{source}: the joint {name!r} is {kind}.",
                "Remove it and the link above it: the root link moves freely without it.",
            )
    return found


def _end(joint: ET.Element, tag: str) -> str:
    """The parent or child link of a joint."""
    end = joint.find(tag)
    return "" if end is None else end.get("link", "")


def _sort_links(root: ET.Element, source: str) -> tuple[tuple[str, ...], dict[str, ET.Element]]:
    """The links, depth first in the file's order, and the joint above each but the root."""
    links = [link.get("name", "") for link in root.findall("link")]
    joints = root.findall("joint")
    if max(len(links), len(joints)) > URDF_LINKS:
        raise RobotError(
            f"{source} has {counted(len(links), 'link')} and {counted(len(joints), 'joint')}.",
            f"Give the URDF of one robot, with {URDF_LINKS} of each at most.",
        )
    joint_above = {_end(joint, "child"): joint for joint in joints}
    ordered: list[str] = []
    waiting = [link for link in links if link not in joint_above][:1]
    while waiting and len(ordered) <= len(links):
        ordered.append(waiting.pop())
        below = [_end(joint, "child") for joint in joints if _end(joint, "parent") == ordered[-1]]
        waiting.extend(reversed(below))
    named = {*links, *joint_above, *(_end(joint, "parent") for joint in joints)}
    wrong = [one for one in sorted(named) if not ordered.count(one) == links.count(one) == 1]
    if wrong:
        raise RobotError(
            f"{source}: these links are not in one tree, once each: {', '.join(map(repr, wrong))}.",
            "Connect all links to one root link, each by one joint to its parent.",
        )
    return tuple(ordered), joint_above


def _unit_axis(joint: ET.Element, where: str) -> Any:
    axis = np.array(numbers(joint.find("axis"), "xyz", 3, where, "1 0 0"))
    length = float(np.linalg.norm(axis))
    if abs(length - 1) > _AXIS_TOLERANCE:
        raise RobotError(
            f"{where} has the axis {axis}, not a unit vector.", "Scale it to length 1."
        )
    return axis / length


def _limits(joint: ET.Element, where: str) -> list[float]:
    lower, upper, velocity, effort = limits = [
        numbers(joint.find("limit"), key, 1, where)[0] for key in _LIMITS
    ]
    if lower >= upper or velocity <= 0 or effort <= 0:
        raise RobotError(
            f"{where} cannot move: lower {lower}, upper {upper}, velocity {velocity}, "
            f"effort {effort}.",
            "Make lower less than upper, velocity and effort positive.",
        )
    return limits
