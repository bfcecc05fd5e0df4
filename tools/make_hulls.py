"""Writes the package's hulls.json: convex hulls of a G1's links, for collisions between them.

    python tools/make_hulls.py --mjcf unitree_mujoco/unitree_robots/g1/g1_29dof.xml

The hulls of g1_29dof_rev_1_0 are made of what Unitree's URDF of that name gives its links for
collision, as the PyPI package example-robot-data (our extra `meshes`) has it: meshes, cylinders,
and the four spheres under each sole together. Those of g1_29dof are made of what unitree_mujoco's
model collides. Both are BSD-3-Clause. Feet and rubber hands, whose outlines neither collides, get
hulls of their visual meshes, marked as not solid.

A hull keeps some of its mesh's vertices: the extreme ones of 26 directions, then always the one
that is farthest outside, until none is by more than TOLERANCE. It never reaches beyond its mesh.
The same bytes come out of every run. A line is printed for each hull.
"""

from __future__ import annotations

import argparse
import itertools
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from xml.etree import ElementTree as ET

import mujoco
import numpy as np
from scipy.spatial import ConvexHull

from make_robot_urdf import REFERENCE, ROBOT_DIR

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

OUTPUT: Final = ROBOT_DIR / "hulls.json"
#: How far a vertex of a mesh may be outside its hull, m.
TOLERANCE: Final = 0.0005
#: Points around a cylinder or a sphere.
ROUND: Final = 32
#: Meshes that Unitree's models show but do not collide, and that other links can reach.
VISUAL: Final = ("_ankle_roll_link", "_rubber_hand")


def main() -> None:
    parser = argparse.ArgumentParser(description="Write the package's hulls.json.")
    parser.add_argument("--mjcf", type=Path, required=True, help="unitree_mujoco's g1_29dof.xml")
    parser.add_argument("--out", type=Path, default=OUTPUT, help="file to write")
    args = parser.parse_args()

    found: list[dict[str, Any]] = []
    for revision, model in (
        ("g1_29dof_rev_1_0", unitree_urdf()),
        ("g1_29dof", mujoco.MjModel.from_xml_path(str(args.mjcf))),
    ):
        for link, solid, points in shapes(model):
            hull = simplified(points)
            same = {"link": link, "solid": solid, "vertices": (hull * 1e6).round().tolist()}
            known = [one for one in found if one | {"revisions": []} == same | {"revisions": []}]
            for one in known:
                one["revisions"].append(revision)
            if not known:
                found.append({"revisions": [revision], **same})
            ratio = ConvexHull(hull).volume / ConvexHull(points).volume
            print(
                f"{revision:17} {link:26} {len(hull):4} vertices, {ratio:.3f} of the volume, "
                f"deviation {1e3 * deviation(hull, points):.2f} mm"
            )
    for one in found:
        one["vertices"] = [round(x / 1e6, 6) for row in one["vertices"] for x in row]
    lines = (json.dumps(one, separators=(",", ":")) for one in found)
    args.out.write_text("[\n" + ",\n".join(lines) + "\n]\n", encoding="utf-8")
    print(f"wrote {args.out}: {args.out.stat().st_size} bytes")


def unitree_urdf() -> Any:
    """MuJoCo's model of Unitree's g1_29dof_rev_1_0.urdf, fixed links as bodies of their own."""
    root = ET.fromstring(REFERENCE.read_text(encoding="utf-8"))
    for old in root.findall("mujoco"):
        root.remove(old)
    settings = {"discardvisual": "false", "fusestatic": "false", "strippath": "true"}
    settings["meshdir"] = str(REFERENCE.parents[1] / "meshes")
    ET.SubElement(ET.SubElement(root, "mujoco"), "compiler", settings)
    return mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))


def shapes(model: Any) -> Iterator[tuple[str, bool, Array]]:
    """Link, whether it collides, and points in the link's frame, m, of each outline."""
    for body in range(model.nbody):
        name, soles = model.body(body).name, []
        for geom in np.flatnonzero(model.geom_bodyid == body).tolist():
            kind, solid = model.geom_type[geom], bool(model.geom_contype[geom])
            if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
                soles.append(points_of(model, geom))
            elif kind == mujoco.mjtGeom.mjGEOM_MESH and not solid:
                mesh = model.mesh(model.geom_dataid[geom]).name
                if mesh.endswith(VISUAL):
                    yield name, False, points_of(model, geom)
            elif solid and body:  # not the floor
                yield name, True, points_of(model, geom)
        if soles:
            yield name, True, np.concatenate(soles)


def points_of(model: Any, geom: int) -> Array:
    """Points whose hull is that of a mesh, a cylinder or a sphere, in its link's frame, m."""
    kind, size = model.geom_type[geom], model.geom_size[geom]
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = model.geom_dataid[geom]
        start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        points = model.mesh_vert[start : start + count].astype(float)
    elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        points = np.concatenate([ring(size[0], z) for z in (-size[1], size[1])])
    else:
        heights = size[0] * np.cos(np.linspace(0, np.pi, ROUND // 2 + 1))
        points = np.concatenate([ring(np.sqrt(max(size[0] ** 2 - z**2, 0)), z) for z in heights])
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
    placed: Array = points @ rotation.reshape(3, 3).T + model.geom_pos[geom]
    return placed


def ring(radius: float, height: float) -> Array:
    """Points on a circle about the z axis."""
    turn = np.linspace(0, 2 * np.pi, ROUND, endpoint=False)
    return np.column_stack([radius * np.cos(turn), radius * np.sin(turn), np.full(ROUND, height)])


def simplified(points: Array) -> Array:
    """The vertices (V, 3) of a hull that no point is farther outside of than TOLERANCE."""
    points = points[ConvexHull(points).vertices]
    directions = np.array(list(itertools.product((-1, 0, 1), repeat=3)))
    chosen = list(dict.fromkeys((points @ directions.T).argmax(axis=0).tolist()))
    hull = ConvexHull(points[chosen], incremental=True)
    while True:
        outside = (points @ hull.equations[:, :3].T + hull.equations[:, 3]).max(axis=1)
        farthest = int(outside.argmax())
        if outside[farthest] <= TOLERANCE:
            kept: Array = hull.points[np.sort(hull.vertices)]
            return kept
        hull.add_points(points[farthest : farthest + 1])


def deviation(hull: Array, points: Array) -> float:
    """By how much more the points reach than the hull in any of 20,000 directions, m."""
    directions = np.random.default_rng(0).normal(size=(20_000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    points = points[ConvexHull(points).vertices]
    outer, inner = ((directions @ one.T).max(axis=1) for one in (points, hull))
    return float((outer - inner).max())


if __name__ == "__main__":
    main()
