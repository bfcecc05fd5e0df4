"""Writes the package's robots: g1_29dof_rev_1_0.urdf, and g1_29dof.urdf where --mjcf is given.

Names, frames, limits, masses and inertias of the first are read from Unitree's
g1_29dof_rev_1_0.urdf as the PyPI package example-robot-data (our extra `meshes`) has it. The second
is the older revision that unitree_mujoco simulates: the same links and joints with the figures of
its unitree_robots/g1/g1_29dof.xml. The shapes are our own: primitives fitted by eye to the outline
of the robot, listed in robot_shapes.py. To run again after a change there:

    python tools/make_robot_urdf.py --mjcf unitree_mujoco/unitree_robots/g1/g1_29dof.xml
"""

# What an element must have is not checked: the two files are fixed.
# mypy: disable-error-code="union-attr,arg-type"

from __future__ import annotations

import argparse
import sysconfig
from copy import deepcopy
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
from scipy.spatial.transform import Rotation

from robot_shapes import COLORS, SHAPES, Shape

ROBOT_DIR = Path(__file__).resolve().parents[1] / "src/g1stream/robot"
REFERENCE = Path(
    sysconfig.get_path("purelib"),
    "cmeel.prefix/share/example-robot-data/robots/g1_description/urdf/g1_29dof_rev_1_0.urdf",
)
#: Mass and inertia of links whose own are counted elsewhere, kg and kg m^2.
NOTHING = "0.000000001"
HEADER = """
  The Unitree G1 with 29 joints, made by tools/make_robot_urdf.py: edit that, not this.
  Names, frames, limits, masses and inertias: {source} (BSD-3-Clause).
  Shapes: primitives of g1stream's own.
"""


def main() -> None:
    parser = argparse.ArgumentParser(description="Write the package's URDFs.")
    parser.add_argument("--reference", type=Path, default=REFERENCE, help="figures to take over")
    parser.add_argument("--mjcf", type=Path, help="unitree_mujoco's g1_29dof.xml")
    parser.add_argument("--out", type=Path, default=ROBOT_DIR, help="directory to write to")
    args = parser.parse_args()

    reference = ET.fromstring(args.reference.read_text(encoding="utf-8"))
    urdf = make_urdf(reference, "g1_29dof_rev_1_0", "Unitree's g1_29dof_rev_1_0")
    (args.out / "g1_29dof_rev_1_0.urdf").write_text(urdf, encoding="utf-8")
    if args.mjcf:
        revised = with_figures_of(args.mjcf, reference)
        urdf = make_urdf(revised, "g1_29dof", "unitree_mujoco's g1_29dof.xml")
        (args.out / "g1_29dof.urdf").write_text(urdf, encoding="utf-8")


def make_urdf(reference: ET.Element, name: str, source: str) -> str:
    """The reference's figures with our shapes, as URDF text."""
    robot = ET.Element("robot", name=name)
    robot.append(ET.Comment(HEADER.format(source=source)))
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
