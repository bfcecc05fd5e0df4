"""The robot's MuJoCo model, for the simulator and for the inverse dynamics."""

from __future__ import annotations

from copy import deepcopy
from functools import lru_cache
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree as ET

import numpy as np

from g1stream.robot.joints import ARMATURE, FRICTION, JOINT_NAMES
from g1stream.robot.urdf import KEPT_ROBOTS

if TYPE_CHECKING:
    from g1stream.robot.model import G1

__all__ = ["mujoco_spec"]


def mujoco_spec(robot: G1, *, floating: bool, shapes: bool) -> Any:
    """A `mujoco.MjSpec` of the robot's URDF, with the motors' inertia and dry friction.

    Every link is a body with the link's name, and the base is the first body of the world. Meshes
    are left out; the joints of fingers are fixed at zero.

    The caller sets the motors' viscous damping in `dof_damping` of the compiled model: in a spec it
    is a number in MuJoCo 3 and a polynomial in 4, in the model an array in both.

    Args:
        robot: has the URDF.
        floating: give the base a free joint; otherwise it is part of the world.
        shapes: keep the primitive shapes, each with a name.

    Raises:
        ValueError: MuJoCo does not accept the URDF.
    """
    import mujoco

    spec = mujoco.MjSpec.from_string(_simplified(robot, shapes))
    if floating:
        spec.worldbody.first_body().add_freejoint()
    for motor in np.flatnonzero(robot.present):
        joint = spec.joint(JOINT_NAMES[motor])
        joint.armature = ARMATURE[motor]
        joint.frictionloss = FRICTION[motor]
        joint.actfrclimited = False  # the URDF's effort; the motors have limits of their own
    return spec


@lru_cache(maxsize=KEPT_ROBOTS)
def _simplified(robot: G1, shapes: bool) -> str:
    """The URDF without meshes, finger joints and, unless wanted, shapes."""
    root = deepcopy(robot.xml)
    for settings in root.findall("mujoco"):
        root.remove(settings)
    settings = ET.SubElement(root, "mujoco")
    ET.SubElement(settings, "compiler", discardvisual="false", fusestatic="false")
    for link in root.iter("link"):
        for number, shape in enumerate([*link.iterfind("visual"), *link.iterfind("collision")]):
            if not shapes or shape.find("geometry/mesh") is not None:
                link.remove(shape)
            shape.set("name", f"{link.get('name')}_{number}")
    for joint in root.iter("joint"):
        if joint.get("name") in robot.ignored_joints:
            joint.set("type", "fixed")
    return ET.tostring(root, encoding="unicode")
