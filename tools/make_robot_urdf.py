"""Writes the package's robots, and robots.jsonl: what yourdfpy reads of each.

Names, frames, limits, masses and inertias of g1_29dof_rev_1_0 are read from Unitree's URDF as the
PyPI package example-robot-data (our extra `meshes`) has it. g1_29dof is the older revision that
unitree_mujoco simulates: the same links and joints with the figures of its
unitree_robots/g1/g1_29dof.xml; without --mjcf it stays as it is. The G1s with fewer joints are the
first with joints fixed at 0, and with the figures of `VARIANTS`. The shapes are our own: primitives
fitted by eye to the outline of the robot, listed in robot_shapes.py. To run again after a change
there, or to how URDFs are read:

    python tools/make_robot_urdf.py --mjcf unitree_mujoco/unitree_robots/g1/g1_29dof.xml
"""

# What an element must have is not checked: the two files are fixed.
# mypy: disable-error-code="union-attr,arg-type"

from __future__ import annotations

import argparse
import json
import sysconfig
from copy import deepcopy
from dataclasses import fields, replace
from hashlib import sha256
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
from scipy.spatial.transform import Rotation

from g1stream.robot.joints import JOINT_NAMES, JOINT_SETS, JointSet
from g1stream.robot.model import G1
from g1stream.robot.shapes import parse_visuals
from g1stream.robot.urdf import parse_urdf, read_kinematics, with_fixed_joints
from robot_shapes import COLORS, SHAPES, Shape

ROBOT_DIR = Path(__file__).resolve().parents[1] / "src/g1stream/robot"
REFERENCE = Path(
    sysconfig.get_path("purelib"),
    "cmeel.prefix/share/example-robot-data/robots/g1_description/urdf/g1_29dof_rev_1_0.urdf",
)
#: Mass and inertia of links whose own are counted elsewhere, kg and kg m^2.
NOTHING = "0.000000001"
HEADER = """
  The Unitree G1 with {count} joints, made by tools/make_robot_urdf.py: edit that, not this.
  Names, frames, limits, masses and inertias: {source} (BSD-3-Clause).
  Shapes: primitives of g1stream's own.
"""


#: Where links of a G1 with fewer joints differ: origins of joints, m, inertials of links (kg, m,
#: and xx xy xz yy yz zz in kg m^2), and links without a mass, which a moving one gets as a gram.
VARIANTS: dict[str, Any] = {
    "g1_23dof": {
        "origins": {"waist_yaw_joint": "-0.0039635 0 0", "waist_roll_joint": "0 0 0.044"},
        "inertials": {
            f"{side}_wrist_roll_link": {
                "mass": 0.35692864,
                "origin": (0.1079465665, sign * 0.00163511945, 0.00202244863),
                "inertia": (
                    *(0.00019613494735, sign * -0.00000419816908, -0.0000395086058),
                    *(0.00200280358206, sign * 0.00000249774203, 0.00194181412808),
                ),
            }
            for side, sign in (("left", 1), ("right", -1))
        },
        "massless": [
            *("waist_yaw_link", "waist_roll_link"),
            *(
                f"{side}_{link}"
                for side in ("left", "right")
                for link in ("wrist_pitch_link", "wrist_yaw_link", "rubber_hand")
            ),
        ],
    }
}
MASSLESS = {"mass": 1e-3, "origin": (0, 0, 0), "inertia": (1e-7, 0, 0, 1e-7, 0, 1e-7)}


def main() -> None:
    parser = argparse.ArgumentParser(description="Write the package's URDFs and robots.jsonl.")
    parser.add_argument("--reference", type=Path, default=REFERENCE, help="figures to take over")
    parser.add_argument("--mjcf", type=Path, help="unitree_mujoco's g1_29dof.xml")
    parser.add_argument("--out", type=Path, default=ROBOT_DIR, help="directory to write to")
    args = parser.parse_args()

    reference = ET.fromstring(args.reference.read_text(encoding="utf-8"))
    first, *fewer = JOINT_SETS
    source = "Unitree's g1_29dof_rev_1_0"
    robots = {first.name: make_urdf(reference, first, source)}
    for one in fewer:
        if one.name in VARIANTS:
            robots[one.name] = make_urdf(with_joints_of(one, reference), one, source)
    other = "g1_29dof"
    robots[other] = (ROBOT_DIR / f"{other}.urdf").read_text(encoding="utf-8")
    if args.mjcf:
        revised = with_figures_of(args.mjcf, reference)
        kind = replace(first, name=other)
        robots[other] = make_urdf(revised, kind, "unitree_mujoco's g1_29dof.xml")
    for name, urdf in robots.items():
        (args.out / f"{name}.urdf").write_text(urdf, encoding="utf-8")
    for one in fewer:  # the others only lack joints of the first
        absent = [JOINT_NAMES[joint] for joint in one.absent]
        robots.setdefault(one.name, with_fixed_joints(robots[first.name], one.name, absent))
    lines = [json.dumps(read_by_yourdfpy(one), separators=(",", ":")) for one in robots.values()]
    (args.out / "robots.jsonl").write_text("\n".join([*lines, ""]), encoding="utf-8")


def read_by_yourdfpy(urdf: str) -> dict[str, Any]:
    """What `g1stream.robot.urdf.known_robot` returns of a URDF."""
    robot = G1("made", urdf, **read_kinematics(parse_urdf(urdf, "made"), "made"))
    values = {
        field.name: getattr(robot, field.name)
        for field in fields(G1)
        if field.name not in ("source", "urdf", "joint_set", "capped", "parameters")
    }
    values = {
        key: one.tolist() if isinstance(one, np.ndarray) else one for key, one in values.items()
    }
    visuals = [list(vars(visual).values()) for visual in parse_visuals(robot)]
    found = {"sha256": sha256(urdf.encode()).hexdigest(), **values}
    return {**found, "joint_set": robot.joint_set.name, "visuals": visuals}


def with_joints_of(kind: JointSet, reference: ET.Element) -> ET.Element:
    """The reference with the joints fixed that a kind of G1 lacks, and with its figures."""
    robot, figures = deepcopy(reference), VARIANTS[kind.name]
    absent = {JOINT_NAMES[i] for i in kind.absent}
    for joint in robot.iter("joint"):
        name = joint.get("name")
        if name in absent:
            joint.set("type", "fixed")
        if name in figures.get("origins", {}):
            joint.find("origin").set("xyz", figures["origins"][name])
    inertials = dict.fromkeys(figures.get("massless", ()), MASSLESS) | figures.get("inertials", {})
    for link in robot.iter("link"):
        if one := inertials.get(link.get("name")):
            for old in link.findall("inertial"):
                link.remove(old)
            inertial = ET.Element("inertial")
            ET.SubElement(inertial, "origin", xyz=plain(one["origin"]), rpy="0 0 0")
            ET.SubElement(inertial, "mass", value=plain(one["mass"]))
            keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
            ET.SubElement(
                inertial, "inertia", dict(zip(keys, map(plain, one["inertia"]), strict=True))
            )
            link.insert(0, inertial)
    return robot


def make_urdf(reference: ET.Element, kind: JointSet, source: str) -> str:
    """The reference's figures with our shapes, as URDF text."""
    robot = ET.Element("robot", name=kind.name)
    robot.append(ET.Comment(HEADER.format(count=int(kind.present.sum()), source=source)))
    for color, rgba in COLORS.items():
        ET.SubElement(ET.SubElement(robot, "material", name=color), "color", rgba=rgba)
    for element in reference:
        if element.tag == "link":
            robot.append(make_link(element))
        elif element.tag == "joint":
            robot.append(with_plain_numbers(element))
    ET.indent(robot)
    return ET.tostring(robot, encoding="unicode") + "\n"


def with_figures_of(mjcf: Path, reference: ET.Element) -> ET.Element:
    """The reference's links and joints with the frames, masses, inertias and limits of an MJCF.

    The MJCF counts the mass of links without a joint to the link that they are fixed to; they
    weigh nothing here. Speed
    limits, which it lacks, are the reference's.
    """
    bodies = {body.attrib["name"]: body for body in ET.parse(mjcf).iter("body")}
    robot = deepcopy(reference)
    for link in robot.iter("link"):
        inertial, body = link.find("inertial"), bodies.get(link.attrib["name"])
        if body is not None:
            link.remove(inertial)
            link.insert(0, inertial_of(body))
        elif inertial is not None:  # not without one: readers would make it up from the shapes
            inertial.find("mass").set("value", NOTHING)
            inertial.find("inertia").attrib.update(dict.fromkeys(("ixx", "iyy", "izz"), NOTHING))
            inertial.find("inertia").attrib.update(dict.fromkeys(("ixy", "ixz", "iyz"), "0"))
    for joint in robot.iter("joint"):
        name = joint.find("child").attrib["link"]
        body, imu = bodies.get(name), bodies["pelvis"].find("site[@name='imu']")
        if name == "imu_in_pelvis":
            joint.find("origin").set("xyz", imu.attrib["pos"])
        if body is None:
            continue
        place = {"xyz": body.get("pos", "0 0 0"), "rpy": rpy_of(body.get("quat"))}
        joint.find("origin").attrib.update(place)
        if joint.attrib["name"] != body.find("joint").attrib["name"]:
            raise SystemExit(f"{name}: another joint in {mjcf}")
        moving = body.find("joint").attrib
        joint.find("axis").set("xyz", moving["axis"])
        lower, upper = moving["range"].split()
        effort = moving["actuatorfrcrange"].split()[1]
        joint.find("limit").attrib.update(lower=lower, upper=upper, effort=effort)
    return robot


def inertial_of(body: ET.Element) -> ET.Element:
    """The <inertial> of a URDF for an MJCF body, in the link's axes."""
    figures = body.find("inertial").attrib
    turn = rotation(figures.get("quat")).as_matrix()
    inertia = turn @ np.diag(numbers(figures["diaginertia"])) @ turn.T
    inertial = ET.Element("inertial")
    ET.SubElement(inertial, "origin", xyz=figures["pos"], rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=figures["mass"])
    parts = {f"i{'xyz'[i]}{'xyz'[j]}": inertia[i, j] for i in range(3) for j in range(i, 3)}
    rounded = {name: plain(round(float(value), 9)) for name, value in parts.items()}
    ET.SubElement(inertial, "inertia", rounded)
    return inertial


def rpy_of(quat: str | None) -> str:
    return plain([round(float(angle), 9) + 0.0 for angle in rotation(quat).as_euler("xyz")])


def rotation(quat_wxyz: str | None) -> Rotation:
    return Rotation.from_quat(np.roll(numbers(quat_wxyz or "1 0 0 0"), -1))


def numbers(text: str) -> list[float]:
    return [float(word) for word in text.split()]


def make_link(reference: ET.Element) -> ET.Element:
    """The reference's name and inertia with our shapes."""
    link = ET.Element("link", name=reference.attrib["name"])
    for inertial in reference.findall("inertial"):
        link.append(with_plain_numbers(inertial))
    for shape in SHAPES.get(link.attrib["name"], ()):
        if shape.color:
            visual = add_geometry(link, "visual", shape)
            ET.SubElement(visual, "material", name=shape.color)
        if shape.collides:
            add_geometry(link, "collision", shape)
    return link


def add_geometry(link: ET.Element, tag: str, shape: Shape) -> ET.Element:
    """A <visual> or <collision> with the shape's origin and geometry."""
    element = ET.SubElement(link, tag)
    ET.SubElement(element, "origin", xyz=plain(shape.center), rpy=plain(shape.rpy))
    geometry = ET.SubElement(element, "geometry")
    size = {name: plain(value) for name, value in shape.size.items()}
    ET.SubElement(geometry, shape.kind, size)
    return element


def with_plain_numbers(element: ET.Element) -> ET.Element:
    """A copy whose numbers are written in one way."""
    copy = ET.Element(element.tag, {key: plain_text(text) for key, text in element.items()})
    copy.extend(with_plain_numbers(child) for child in element)
    return copy


def plain_text(text: str) -> str:
    try:
        return plain([float(word) for word in text.split()])
    except ValueError:
        return text


def plain(numbers: float | list[float] | tuple[float, ...]) -> str:
    """Numbers with the fewest digits that give the same float64, without exponents."""
    return " ".join(np.format_float_positional(x, trim="-") for x in np.atleast_1d(numbers))


if __name__ == "__main__":
    main()
