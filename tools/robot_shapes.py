"""The look of a G1 in boxes, cylinders and spheres.

Every shape is given in its link's frame, in metres. Limbs are capsules: URDF has none, so each is a
cylinder with a ball at either end. What is listed for a left link is mirrored to the right one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

Vector = tuple[float, float, float]

COLORS = {"light": "0.7 0.7 0.7 1", "dark": "0.2 0.2 0.2 1", "visor": "0.05 0.05 0.07 1"}


@dataclass(frozen=True)
class Shape:
    """One primitive: seen where it has a color, touched where it collides."""

    kind: str
    size: dict[str, float | Vector]
    center: Vector
    rpy: Vector = (0.0, 0.0, 0.0)
    color: str = ""
    collides: bool = False

    def mirrored(self) -> Shape:
        """The shape on the other side of the x-z plane."""
        (x, y, z), (roll, pitch, yaw) = self.center, self.rpy
        return replace(self, center=(x, -y, z), rpy=(-roll, pitch, -yaw))


def box(size: Vector, center: Vector, color: str, roll: float = 0.0) -> list[Shape]:
    return [Shape("box", {"size": size}, center, (roll, 0.0, 0.0), color)]


def ball(center: Vector, radius: float, color: str = "", collides: bool = False) -> list[Shape]:
    return [Shape("sphere", {"radius": radius}, center, color=color, collides=collides)]


def rod(
    start: Vector, end: Vector, radius: float, color: str = "", collides: bool = False
) -> list[Shape]:
    """A cylinder between the centres of its ends."""
    a, b = np.array(start), np.array(end)
    length = float(np.linalg.norm(b - a))
    x, y, z = (b - a) / length
    cx, cy, cz = (round(float(value), 4) for value in (a + b) / 2)
    rpy = (0.0, round(float(np.arccos(z)), 4), round(float(np.arctan2(y, x)), 4))
    size: dict[str, float | Vector] = {"radius": radius, "length": round(length, 4)}
    return [Shape("cylinder", size, (cx, cy, cz), rpy, color, collides)]


def capsule(
    start: Vector, end: Vector, radius: float, color: str = "", collides: bool = False
) -> list[Shape]:
    """A rod with round ends, which reach beyond its start and end."""
    look = (radius, color, collides)
    return [*rod(start, end, *look), *ball(start, *look), *ball(end, *look)]


# Where the sole touches the ground, and how: the reference's own four spheres.
_SOLE = [
    *ball((-0.05, 0.025, -0.03), 0.005, collides=True),
    *ball((-0.05, -0.025, -0.03), 0.005, collides=True),
    *ball((0.12, 0.03, -0.03), 0.005, collides=True),
    *ball((0.12, -0.03, -0.03), 0.005, collides=True),
]

_TRUNK = {
    "pelvis": [
        *box((0.09, 0.126, 0.09), (0, 0, -0.09), "dark"),
        *rod((0, 0, -0.04), (0, 0, 0.002), 0.047, "dark"),
    ],
    "pelvis_contour_link": [
        *box((0.114, 0.13, 0.058), (0.001, 0, -0.058), "light"),
        *box((0.112, 0.091, 0.091), (0.001, 0, -0.087), "light", roll=0.7854),
    ],
    "waist_yaw_link": [*rod((0, 0, 0.002), (0, 0, 0.03), 0.042, "light")],
    "waist_roll_link": [*rod((-0.017, 0, 0), (0.017, 0, 0), 0.012, "light")],
    "torso_link": [
        *capsule((0.005, 0.026, 0.045), (0.005, 0.046, 0.252), 0.056, "light"),
        *capsule((0.005, -0.026, 0.045), (0.005, -0.046, 0.252), 0.056, "light"),
        *box((0.112, 0.09, 0.25), (0.005, 0, 0.165), "light"),
        *rod((0.005, -0.026, 0.045), (0.005, 0.026, 0.045), 0.056, "light"),
        *rod((0.004, -0.098, 0.252), (0.004, 0.098, 0.252), 0.05, "light"),
        *capsule((0, 0, 0.08), (0, 0, 0.23), 0.07, collides=True),
    ],
    "logo_link": [*box((0.004, 0.075, 0.016), (0.062, 0, 0.272), "dark")],
    "head_link": [
        *rod((-0.006, 0, 0.315), (-0.006, 0, 0.345), 0.05, "dark"),
        *rod((-0.008, 0, 0.34), (0, 0, 0.43), 0.032, "dark"),
        *ball((-0.008, 0, 0.474), 0.056, "dark", collides=True),
        *ball((0.02, 0, 0.476), 0.052, "dark"),
        *capsule((0.028, 0, 0.412), (0.036, 0, 0.47), 0.036, "visor"),
    ],
}

_FINGERS = [
    shape
    for z, reach in ((-0.032, 0.108), (-0.011, 0.124), (0.011, 0.128), (0.032, 0.12))
    for shape in rod((0.055, -0.002, 0.7 * z), (reach, -0.026, 1.1 * z), 0.008, "light")
]

_LEFT = {
    "left_hip_pitch_link": [
        *rod((0, 0.005, 0), (0, 0.052, -0.012), 0.036, "dark"),
        *rod((-0.042, 0.052, -0.0305), (0.03, 0.052, -0.0305), 0.046, "dark"),
    ],
    "left_hip_roll_link": [
        *capsule((0.034, 0, -0.002), (0.03, 0, -0.1), 0.047, "light"),
        *rod((0.03, 0, -0.1), (0.028, 0, -0.124), 0.047, "light"),
    ],
    "left_hip_yaw_link": [
        *rod((0, 0, 0), (0, 0, -0.03), 0.047, "light"),
        *capsule((0, 0, -0.03), (-0.03, 0, -0.12), 0.042, "light", collides=True),
        *capsule((-0.03, 0, -0.12), (-0.07, 0, -0.165), 0.036, "light"),
        *rod((-0.0783, -0.044, -0.1773), (-0.0783, 0.022, -0.1773), 0.047, "light"),
    ],
    "left_knee_link": [
        *rod((0, -0.016, 0), (0, 0.034, 0), 0.04, "light"),
        *capsule((0.016, 0, -0.01), (0.014, 0, -0.11), 0.036, "light", collides=True),
        *capsule((0.014, 0, -0.11), (0.012, 0, -0.17), 0.031, "light"),
        *capsule((0.012, 0, -0.17), (0.009, 0, -0.22), 0.024, "light"),
        *rod((0.009, 0, -0.22), (0.002, 0, -0.3), 0.018, "light"),
    ],
    "left_ankle_pitch_link": [*ball((0, 0, 0), 0.018, "dark")],
    "left_ankle_roll_link": [
        *box((0.138, 0.07, 0.02), (0.037, 0, -0.025), "dark"),
        *rod((-0.032, 0, -0.035), (-0.032, 0, -0.015), 0.034, "dark"),
        *rod((0.106, 0, -0.035), (0.106, 0, -0.015), 0.036, "dark"),
        *capsule((-0.03, 0, -0.008), (0.08, 0, -0.015), 0.022, "dark"),
        *_SOLE,
    ],
    "left_shoulder_pitch_link": [*rod((0, 0, -0.005), (0, 0.06, -0.01), 0.036, "light")],
    "left_shoulder_roll_link": [
        *capsule((0, 0.002, -0.002), (0, 0.006, -0.04), 0.038, "light"),
        *rod((0, 0.006, -0.04), (0, 0.006, -0.103), 0.031, "light"),
    ],
    "left_shoulder_yaw_link": [
        *capsule((0, 0, -0.005), (0.012, -0.002, -0.08), 0.032, "light", collides=True)
    ],
    "left_elbow_link": [
        *capsule((0.005, 0.002, -0.002), (0.07, 0.002, -0.01), 0.032, "light", collides=True),
        *rod((0.07, 0.002, -0.01), (0.1, 0.002, -0.01), 0.031, "light"),
    ],
    "left_wrist_roll_link": [
        *rod((0, 0, 0), (0.019, 0, 0), 0.03, "light"),
        *rod((0.019, 0, 0), (0.038, 0, 0), 0.018, "light"),
    ],
    "left_wrist_pitch_link": [
        *rod((0, 0, -0.0285), (0, 0, 0.0285), 0.022, "light"),
        *rod((0, 0, 0), (0.072, 0, 0), 0.024, "light"),
    ],
    "left_wrist_yaw_link": [*rod((-0.005, 0, 0), (0.0415, 0, 0), 0.027, "light")],
    "left_rubber_hand": [
        *box((0.06, 0.03, 0.064), (0.03, 0, 0), "light"),
        *_FINGERS,
        *rod((0.025, 0, 0.028), (0.085, -0.022, 0.06), 0.009, "light"),
        *ball((0.07, 0, 0), 0.035, collides=True),
    ],
}

_RIGHT = {
    name.replace("left_", "right_"): [shape.mirrored() for shape in shapes]
    for name, shapes in _LEFT.items()
}

SHAPES = {**_TRUNK, **_LEFT, **_RIGHT}
