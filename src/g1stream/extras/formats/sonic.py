"""The directory of SONIC (GR00T-WholeBodyControl): tables with a header, 50 Hz."""

from __future__ import annotations

import io
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from g1stream.errors import MotionError
from g1stream.extras.formats.decimals import write_rows
from g1stream.extras.formats.evidence import poses_of
from g1stream.extras.formats.orders import names_in_order
from g1stream.extras.formats.write import Layout, Output
from g1stream.input_limits import CSV_LINE
from g1stream.robot.joints import N_JOINTS

if TYPE_CHECKING:
    from pathlib import Path

    from g1stream.extras.formats.write import Take
    from g1stream.motion.readers import MotionFile, Poses
    from g1stream.types import Floats

__all__ = ["SONIC", "open_sonic"]

#: The tables, and their columns per body.
_TABLES: Final = {
    "joint_pos": 0,
    "joint_vel": 0,
    "body_pos": 3,
    "body_quat": 4,
    "body_lin_vel": 3,
    "body_ang_vel": 3,
}
_FPS: Final = 50
_LEG: Final = ("hip_roll", "knee", "ankle_roll")
_ARM: Final = ("shoulder_roll", "elbow", "wrist_yaw")
_BODIES: Final = (
    "pelvis",
    *(f"{side}_{part}_link" for side in ("left", "right") for part in _LEG),
    "torso_link",
    *(f"{side}_{part}_link" for side in ("left", "right") for part in _ARM),
)


def open_sonic(file: MotionFile) -> Poses:
    """Open a directory of SONIC: tables with a header, 50 Hz.

    Joints are in Isaac Lab's order, unless the positions of several bodies show another one.

    Raises:
        MotionError: a table cannot be read.
    """
    arrays: dict[str, Any] = {"fps": float(_FPS)}
    digest = b""
    for name in ("joint_pos", "body_pos", "body_quat"):
        path = file.path / f"{name}.csv"
        if name != "joint_pos" and not path.exists():
            continue
        one = replace(file, path=path)
        values = _numbers_below_header(one.content, f"{file.path.name}/{path.name}")
        if width := _TABLES[name]:
            if values.shape[1] % width:
                raise MotionError(
                    f"{file.path.name}/{path.name} has {values.shape[1]} columns.",
                    f"Give it {width} columns for each body.",
                )
            values = values.reshape(len(values), -1, width)
        arrays[name] = values
        digest += one.content
    bodies, quats = arrays.get("body_pos"), arrays.get("body_quat")
    if bodies is None and quats is not None:  # SONIC reads this, too
        arrays["body_pos"] = np.zeros((*quats.shape[:2], 3))
    tells = bodies is not None and bodies.shape[1] >= len(_BODIES)
    if not tells and file.joint_order is None:
        arrays["joint_names"] = names_in_order("isaaclab")
    return poses_of(replace(file, data=digest), "directory of SONIC", arrays)


def _numbers_below_header(content: bytes, name: str) -> Floats:
    """The numbers (T, N) of a CSV whose first line names its columns.

    Raises:
        MotionError: it has no numbers.
    """
    _, _, rows = content.partition(b"\n")
    try:
        if not rows.strip() or max(map(len, content.split(b"\n"))) > CSV_LINE:
            raise ValueError
        return np.loadtxt(io.BytesIO(rows), delimiter=",", comments=None, ndmin=2)
    except ValueError:
        raise MotionError(
            f"{name} is not a table of numbers below a header.",
            "Give each line a number for each column that the first line names.",
        ) from None


def _write(take: Take, path: Path) -> None:
    """Write what SONIC's C++ reader reads: a table for each array, and a list of the bodies.

    A body's number is its index in Isaac Lab's order of all bodies.
    """
    states, n_bodies = take.states(), len(take.links)
    names = {
        "joint_pos": [f"joint_{i}" for i in range(N_JOINTS)],
        "joint_vel": [f"joint_vel_{i}" for i in range(N_JOINTS)],
        "body_pos": [f"body_{i}_{axis}" for i in range(n_bodies) for axis in "xyz"],
        "body_quat": [f"body_{i}_{axis}" for i in range(n_bodies) for axis in "wxyz"],
        "body_lin_vel": [f"body_{i}_vel_{axis}" for i in range(n_bodies) for axis in "xyz"],
        "body_ang_vel": [f"body_{i}_angvel_{axis}" for i in range(n_bodies) for axis in "xyz"],
    }
    for name, columns in names.items():
        values = getattr(states, name if name.startswith("joint") else f"{name}_w")
        with (path / f"{name}.csv").open("wb") as file:
            file.write((",".join(columns) + "\n").encode())
            write_rows(file, values.reshape(take.n_frames, -1), take.motion.name)
    joint_of_link = take.robot.joint_of_link[take.links].tolist()
    numbers = [0 if joint < 0 else 1 + take.joints.index(joint) for joint in joint_of_link]
    (path / "metadata.txt").write_text(
        f"Metadata for: {take.motion.name}\n{'=' * 30}\n\nBody part indexes:\n"
        f"[{' '.join(map(str, numbers))}]\n\nTotal timesteps: {take.n_frames}\n",
        encoding="utf-8",
    )


SONIC: Final = Output(
    _write,
    "",
    _FPS,
    Layout("isaaclab", of_centre=True, bodies=_BODIES),
    (*(f"{name}.csv" for name in _TABLES), "metadata.txt", "info.txt"),
)
