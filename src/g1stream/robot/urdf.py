"""Read the URDF of a G1, and check it.

yourdfpy parses the elements but checks little. Therefore the numbers are checked before, and the
requirements of a G1 after it: one tree of links, 29 motors by name, unit axes and limits. Importing
yourdfpy takes 0.6 s, so robots.jsonl has its results for the URDFs in this package, by the SHA-256
of their text. MuJoCo reads the same text with its masses, in programs that simulate or compute
torques.
"""

from __future__ import annotations

import io
import json
import re
from copy import deepcopy
from functools import lru_cache
from hashlib import sha256
from importlib import resources
from typing import TYPE_CHECKING, Any, Final
from xml.etree import ElementTree as ET

import numpy as np

from g1stream.errors import RobotError
from g1stream.input_limits import NUMBER, URDF_LINKS
from g1stream.robot.joints import JOINT_NAMES, JOINT_SETS, N_JOINTS, JointSet
from g1stream.robot.rotations import wxyz_from_xyzw
from g1stream.text import counted

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from g1stream.types import Floats

__all__ = [
    "KEPT_ROBOTS",
    "check_numbers",
    "known_robot",
    "parse_urdf",
    "parse_with_yourdfpy",
    "poses_of",
    "read_kinematics",
    "read_urdf",
    "with_fixed_joints",
    "with_prefixed_links",
    "without_world",
]

KEPT_ROBOTS: Final = 8
"""Number of robots in caches of data derived from a URDF; each session has a URDF, and a process
may read many sessions."""

_LIMITS: Final = ("lower", "upper", "velocity", "effort")
#: Limits of joints that a robot does not have, rad, rad/s and N·m; no value exceeds them.
_NO_LIMITS: Final = (-1e3, 1e3, 1e3, 1e3)
_AXIS_TOLERANCE: Final = 1e-3  # above the error of rounding to four digits
#: Count of numbers in an attribute.
_COUNTS: Final = {
    **dict.fromkeys(("xyz", "rpy", "size", "scale"), 3),
    **dict.fromkeys((*_LIMITS, "radius", "length"), 1),
    "rgba": 4,
}


@lru_cache(maxsize=KEPT_ROBOTS)
def parse_urdf(text: str, source: str) -> ET.Element:
    """Parse a URDF; returns its cached root element, do not change it.

    Raises:
        RobotError: the text is not XML, or not a URDF.
    """
    if "<!DOCTYPE" in text:  # nested entities fill the memory, external ones refer to files
        raise RobotError(
            f"{source} has a document type declaration (<!DOCTYPE).",
            "Remove it; a URDF does not need it, and entities are not supported.",
        )
    try:
        root = ET.fromstring(text)
    except ET.ParseError as error:
        line, column = error.position
        raise RobotError(
            f"{source} is not XML: line {line}, column {column + 1}.",
            "Use a URDF file; convert a xacro file first.",
        ) from error
    if root.tag != "robot":
        raise RobotError(
            f"{source} is not a URDF: its root element is <{root.tag}>, not <robot>.",
            "Use a URDF file; MJCF, SDF and USD files are not supported.",
        )
    return root


def without_world(text: str, source: str) -> str:
    """Remove links above the pelvis that only position it, such as `world`.

    These links have no content, and only one joint below them, which is fixed or floating. The
    position of the pelvis comes from the motion.

    Raises:
        RobotError: the text is not XML, or not a URDF.
    """
    if known_robot(text) is not None:
        return text
    root = parse_urdf(text, source)
    links = {link.get("name"): link for link in root.findall("link")}
    below: dict[str | None, list[ET.Element]] = {name: [] for name in links}
    for joint in root.findall("joint"):
        below.setdefault(_end(joint, "parent"), []).append(joint)
    children = {_end(joint, "child") for joints in below.values() for joint in joints}
    name = next((name for name in links if name not in children), None)
    gone: list[ET.Element] = []
    while name in links and not len(links[name]) and len(below[name]) == 1:
        (joint,) = below[name]
        if joint.get("type") not in ("fixed", "floating"):
            break
        gone += links.pop(name), joint
        name = _end(joint, "child")
    if not gone:
        return text
    rest = ET.Element(root.tag, root.attrib)
    rest.extend(element for element in root if element not in gone)
    return ET.tostring(rest, encoding="unicode")


def _end(joint: ET.Element, tag: str) -> str:
    """The link at the `parent` or `child` end of a joint."""
    end = joint.find(tag)
    return "" if end is None else end.get("link", "")


def with_fixed_joints(text: str, name: str, joints: Iterable[str]) -> str:
    """The text of a URDF in this package, renamed, with some of its joints fixed at 0."""
    text = re.sub('<robot name="[^"]*">', f'<robot name="{name}">', text, count=1)
    for joint in joints:
        moving = f'<joint name="{joint}" type='
        text = text.replace(f'{moving}"revolute">', f'{moving}"fixed">')
    return text


def with_prefixed_links(root: ET.Element, prefix: str) -> str:
    """Make a URDF for viewers, with links named like their frames, and without collision shapes.

    Args:
        root: root element of a URDF; it is not changed.
        prefix: prefix of link names, such as `measured/`.
    """
    root = deepcopy(root)
    for link in root.findall("link"):
        link.set("name", prefix + link.get("name", ""))
        for collision in link.findall("collision"):
            link.remove(collision)
    for end in root.iterfind("joint/*[@link]"):
        end.set("link", prefix + end.get("link", ""))
    return ET.tostring(root, encoding="unicode")


@lru_cache(maxsize=KEPT_ROBOTS)
def known_robot(text: str) -> dict[str, Any] | None:
    """The entry of robots.jsonl for a URDF in this package; None for another URDF.

    It has the fields of `read_kinematics` as JSON values, and the fields of each `Visual` under
    `visuals`. tools/make_robot_urdf.py writes it.
    """
    lines = resources.files(__package__).joinpath("robots.jsonl").read_text(encoding="utf-8")
    start = f'{{"sha256":"{sha256(text.encode()).hexdigest()}"'
    line = next((one for one in lines.splitlines() if one.startswith(start)), "null")
    known: dict[str, Any] | None = json.loads(line)
    return known


def read_urdf(text: str, source: str) -> dict[str, Any]:
    """Read the fields of `G1` from `name` on, see `read_kinematics`."""
    known = known_robot(text)
    if known is None:
        return read_kinematics(parse_urdf(text, source), source)
    others = {
        "name": known["name"],
        "link_names": tuple(known["link_names"]),
        "ignored_joints": tuple(known["ignored_joints"]),
        "joint_set": next(one for one in JOINT_SETS if one.name == known["joint_set"]),
    }
    numbers = known.keys() - others.keys() - {"sha256", "visuals"}
    return {key: np.array(known[key]) for key in numbers} | others


def check_numbers(element: ET.Element, where: str) -> None:
    """Check the numbers in the attributes of an element and its descendants.

    Args:
        element: an element of a URDF.
        where: description of the element for the error.

    Raises:
        RobotError: an attribute has a wrong count of numbers, or a number is not finite or too
            large.
    """
    for part in element.iter():
        for key, text in part.items():
            count = _COUNTS.get(key, 0)
            try:
                numbers = [float(word) for word in text.split()] if count else []
            except ValueError:
                numbers = []
            if len(numbers) != count or not all(abs(number) <= NUMBER for number in numbers):
                raise RobotError(
                    f"{where} has {key}={text!r:.80} in its <{part.tag}>.",
                    f"Use {counted(count, 'finite number')} of at most {NUMBER:g}.",
                )


def parse_with_yourdfpy(elements: Iterable[ET.Element], name: str, source: str) -> Any:
    """Parse elements of a URDF into a `yourdfpy.Robot`.

    Args:
        elements: links, joints and materials, with checked numbers.
        name: name of the robot.
        source: name of the URDF for errors.

    Raises:
        RobotError: yourdfpy cannot read the elements.
    """
    import yourdfpy

    root = ET.Element("robot", name=name)
    root.extend(elements)
    file = io.BytesIO(ET.tostring(root))
    try:
        return yourdfpy.URDF.load(file, build_scene_graph=False, load_meshes=False).robot
    except Exception as error:  # a missing attribute or lxml raises errors of many types
        raise RobotError(
            f"{source} cannot be read as a URDF: {error!r:.100}.", "Correct the URDF."
        ) from error


def poses_of(origins: Iterable[Any]) -> tuple[Floats, Floats]:
    """Positions (N, 3) and quaternions wxyz (N, 4) with w >= 0, of yourdfpy's origins."""
    from scipy.spatial.transform import Rotation

    matrices = np.array([np.eye(4) if one is None else one for one in origins]).reshape(-1, 4, 4)
    if not len(matrices):
        return np.zeros((0, 3)), np.zeros((0, 4))
    quat = wxyz_from_xyzw(Rotation.from_matrix(matrices[:, :3, :3]).as_quat())
    return matrices[:, :3, 3].copy(), np.where(quat[:, :1] < 0, -quat, quat)


def read_kinematics(root: ET.Element, source: str) -> dict[str, Any]:
    """Read links, joints and limits as the fields of `G1` from `name` on.

    Args:
        root: root element of a URDF; its shapes and masses are not read.
        source: name of the URDF for errors.

    Raises:
        RobotError: the links are not one tree, or the joints are not a G1's.
    """
    robot = parse_with_yourdfpy(_skeleton(root, source), root.get("name", ""), source)
    joints = {joint.name: joint for joint in robot.joints}
    joint_set = _joint_set(joints, source)
    present = {JOINT_NAMES[i] for i in np.flatnonzero(joint_set.present)}
    link_names, joint_above = _sort_links([link.name for link in robot.links], robot.joints, source)
    above = [joint_above[name] for name in link_names[1:]]
    n_links = len(link_names)
    parent, joint_of_link = np.full(n_links, -1), np.full(n_links, -1)
    axis = np.zeros((n_links, 3))
    for link, joint in enumerate(above, start=1):
        parent[link] = link_names.index(joint.parent)
        if joint.name in present:
            joint_of_link[link] = JOINT_NAMES.index(joint.name)
            axis[link] = _unit_axis(joint, source)
    pos, quat = poses_of([None, *(joint.origin for joint in above)])
    limits = [
        _limits(joints[name], source) if name in present else _NO_LIMITS for name in JOINT_NAMES
    ]
    lower, upper, velocity, effort = np.transpose(limits).copy()
    return {
        "name": robot.name,
        "link_names": link_names,
        "parent": parent,
        "joint_of_link": joint_of_link,
        "origin_pos": pos,
        "origin_quat_wxyz": quat,
        "axis": axis,
        "lower": lower,
        "upper": upper,
        "velocity": velocity,
        "effort": effort,
        "ignored_joints": tuple(
            joint.name
            for joint in robot.joints
            if joint.type != "fixed" and joint.name not in JOINT_NAMES
        ),
        "joint_set": joint_set,
    }


def _skeleton(root: ET.Element, source: str) -> list[ET.Element]:
    """The links without their content, and the joints with only the needed elements."""
    links, joints = root.findall("link"), root.findall("joint")
    if max(len(links), len(joints)) > URDF_LINKS:
        raise RobotError(
            f"{source} has {counted(len(links), 'link')} and {counted(len(joints), 'joint')}.",
            f"Use the URDF of one robot, with at most {URDF_LINKS} of each.",
        )
    elements = [ET.Element("link", name=link.get("name", "")) for link in links]
    for joint in joints:
        name, kind = joint.get("name", ""), joint.get("type", "")
        kept = ET.Element("joint", name=name, type=kind)
        for tag in ("parent", "child"):
            ET.SubElement(kept, tag, link=_end(joint, tag))
        tags = ("origin", "axis", "limit") if name in JOINT_NAMES else ("origin",)
        kept.extend(part for part in map(joint.find, tags) if part is not None)
        check_numbers(kept, f"{source}: the joint {name!r}")
        elements.append(kept)
    return elements


def _joint_set(joints: Mapping[str, Any], source: str) -> JointSet:
    """The kind of G1 with these revolute joints; other moving joints stay at zero."""
    kinds = {name: joint.type for name, joint in joints.items()}
    for name, kind in kinds.items():
        if kind in ("floating", "planar") or (name in JOINT_NAMES and kind == "continuous"):
            remedy = "Remove it and the link above it; the root link moves freely without it."
            raise RobotError(
                f"{source}: the joint {name!r} is {kind}.",
                "Make it revolute, with limits." if kind == "continuous" else remedy,
            )
    missing = [name for name in JOINT_NAMES if kinds.get(name) != "revolute"]
    absent = tuple(map(JOINT_NAMES.index, missing))
    found = next((one for one in JOINT_SETS if one.absent == absent), None)
    if found is None:
        raise RobotError(
            f"{source} lacks {len(missing)} of the G1's {N_JOINTS} revolute joints: "
            f"{', '.join(missing)}.",
            "Use the URDF of a G1 with 29 joints, such as g1_29dof_rev_1_0.urdf, or of "
            f"{', '.join(one.name for one in JOINT_SETS if one.absent)} with exactly its joints.",
        )
    return found


def _sort_links(
    links: list[str], joints: list[Any], source: str
) -> tuple[tuple[str, ...], dict[str, Any]]:
    """The links, depth first in the file's order, and the joint above each link except the root."""
    joint_above = {joint.child: joint for joint in joints}
    ordered: list[str] = []
    waiting = [link for link in links if link not in joint_above][:1]
    while waiting and len(ordered) <= len(links):
        ordered.append(waiting.pop())
        below = [joint.child for joint in joints if joint.parent == ordered[-1]]
        waiting.extend(reversed(below))
    named = {*links, *joint_above, *(joint.parent for joint in joints)}
    wrong = [one for one in sorted(named) if not ordered.count(one) == links.count(one) == 1]
    if wrong:
        raise RobotError(
            f"{source}: these links are not exactly once in one tree: "
            f"{', '.join(map(repr, wrong))}.",
            "Connect all links to one root link, each with one joint to its parent.",
        )
    return tuple(ordered), joint_above


def _unit_axis(joint: Any, source: str) -> Floats:
    length = float(np.linalg.norm(joint.axis))
    if abs(length - 1) > _AXIS_TOLERANCE:
        raise RobotError(
            f"{source}: the joint {joint.name!r} has the axis {joint.axis}, not a unit vector.",
            "Scale it to length 1.",
        )
    axis: Floats = joint.axis / length
    return axis


def _limits(joint: Any, source: str) -> list[float]:
    where = f"{source}: the joint {joint.name!r}"
    limits: dict[str, Any] = {key: getattr(joint.limit, key, None) for key in _LIMITS}
    if missing := [key for key, value in limits.items() if value is None]:
        raise RobotError(
            f"{where} has no limit {', '.join(missing)}.",
            f"Add a <limit> with {', '.join(_LIMITS)}.",
        )
    lower, upper, velocity, effort = values = list(limits.values())
    if lower >= upper or velocity <= 0 or effort <= 0:
        raise RobotError(
            f"{where} cannot move: lower {lower}, upper {upper}, velocity {velocity}, "
            f"effort {effort}.",
            "Make lower less than upper, and velocity and effort positive.",
        )
    return values
