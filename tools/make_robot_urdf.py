"""Writes the package's robot, g1_29dof.urdf.

Names, frames, limits, masses and inertias are read from Unitree's g1_29dof_rev_1_0.urdf as the PyPI
package example-robot-data (our extra `meshes`) has it. The shapes are our own: primitives fitted by
eye to the outline of the robot, listed in robot_shapes.py. To run again after a change there:

    python tools/make_robot_urdf.py
"""

from __future__ import annotations

import argparse
import sysconfig
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from robot_shapes import COLORS, SHAPES, Shape

ROBOT_DIR = Path(__file__).resolve().parents[1] / "src/g1stream/robot"
REFERENCE = Path(
    sysconfig.get_path("purelib"),
    "cmeel.prefix/share/example-robot-data/robots/g1_description/urdf/g1_29dof_rev_1_0.urdf",
)
HEADER = """
  The Unitree G1 with 29 joints, made by tools/make_robot_urdf.py: edit that, not this.
  Names, frames, limits, masses and inertias: Unitree's g1_29dof_rev_1_0 (BSD-3-Clause).
  Shapes: primitives of g1stream's own.
"""


def main() -> None:
    parser = argparse.ArgumentParser(description="Write the package's URDF.")
    parser.add_argument("--reference", type=Path, default=REFERENCE, help="figures to take over")
    parser.add_argument("--out", type=Path, default=ROBOT_DIR, help="directory to write to")
    args = parser.parse_args()

    urdf = make_urdf(args.reference.read_text(encoding="utf-8"))
    (args.out / "g1_29dof.urdf").write_text(urdf, encoding="utf-8")


def make_urdf(reference: str) -> str:
    """The reference's figures with our shapes, as URDF text."""
    robot = ET.Element("robot", name="g1_29dof")
    robot.append(ET.Comment(HEADER))
    for name, rgba in COLORS.items():
        ET.SubElement(ET.SubElement(robot, "material", name=name), "color", rgba=rgba)
    for element in ET.fromstring(reference):
        if element.tag == "link":
            robot.append(make_link(element))
        elif element.tag == "joint":
            robot.append(with_plain_numbers(element))
    ET.indent(robot)
    return ET.tostring(robot, encoding="unicode") + "\n"


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
