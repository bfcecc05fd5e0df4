"""The columns of an array with joint angles: the pelvis, the joints, and what else is there.

The width of an array may have several readings. A quaternion of norm 1, a column that counts, and
joint limits tell which is right.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from g1stream.extras.formats.orders import some_frames
from g1stream.robot.rotations import quat_from_axis_angle

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from g1stream.types import Floats

__all__ = ["POSE", "Columns", "counts", "is_quaternion", "readings"]

POSE: Final = 7
"""Numbers of a pose, before the angles, or of an object, behind them."""
#: Numbers of a pose with an exponential map.
_MAPPED_POSE: Final = 6
#: Norms within this of 1 count as unit quaternions; within the second they may be wrong ones.
_UNIT: Final = 0.02
_ROUGHLY: Final = 0.1
#: Steps of a column that counts differ by less than this fraction of their mean.
_EVEN: Final = 0.5


class Columns(NamedTuple):
    """A reading of the columns.

    Attributes:
        angles: (T, n) rad.
        pose: (T, 7), or (T, 6) with an exponential map; None if there is none.
        extra: (T,) a column before all others, which is neither; None if there is none.
        rest: number of columns behind the angles.
    """

    angles: Floats
    pose: Floats | None = None
    extra: Floats | None = None
    rest: int = 0

    @property
    def quat_first(self) -> bool:
        """Whether the quaternion is before the position, because only there the norm is 1."""
        return self.pose is not None and _unit_columns(self.pose) == [0]

    def pose_wxyz(self) -> tuple[Floats, Floats]:
        """Position (T, 3) and quaternion (T, 4) of a pose with an exponential map."""
        assert self.pose is not None
        angle = np.linalg.norm(self.pose[:, 3:], axis=1)
        axis = self.pose[:, 3:] / np.maximum(angle, 1e-300)[:, np.newaxis]
        return self.pose[:, :3], quat_from_axis_angle(axis, angle)

    def __str__(self) -> str:
        text = f"{self.angles.shape[1]} joints"
        if self.pose is not None:
            norms = np.linalg.norm(self.pose[:, 3:], axis=1)
            text = f"the pelvis and {text}, with norms of {norms.min():.2g} to {norms.max():.2g}"
            text += " in the columns of the quaternion"
        before = "a column before " if self.extra is not None else ""
        return before + text + " and a column behind them" * bool(self.rest)


def readings(table: Floats, n_joints: Sequence[int], *, mapped: bool) -> list[Columns]:
    """The readings of an array (T, N) that are possible; several if nothing tells which is right.

    Args:
        table: the array.
        n_joints: possible numbers of joints, the usual one first.
        mapped: it is the pelvis, with an exponential map in place of a quaternion, and the joints.
    """
    width, size = table.shape[1], _MAPPED_POSE if mapped else POSE
    exact, found = [], []
    for n in n_joints:
        for extra, pose in ((0, 0), (0, size), (1, 0), (1, size)):
            first = extra + pose
            rest = width - first - n
            objects = [table[:, i : i + POSE] for i in range(first + n, width, POSE)]
            unit = pose and rest % POSE == 0 and all(map(_unit_columns, objects))
            if rest < 0 or not (unit or rest + extra <= 1):
                continue
            one = Columns(
                table[:, first : first + n],
                table[:, extra:first] if pose else None,
                table[:, 0] if extra else None,
                rest,
            )
            if mapped:
                found += [one] * (pose > 0 and not rest and not extra)
                continue
            certain = not rest if one.pose is None else bool(_unit_columns(one.pose))
            if certain and (not extra or pose or counts(table[:, 0])):
                exact.append(one)
            found.append(one)
    with_pose = [one for one in exact if one.pose is not None]
    return with_pose[:1] or exact[:1] or found


def counts(column: Floats) -> bool:
    """Whether numbers (T,) rise evenly, as times and numbers of frames do."""
    steps = np.diff(column)
    return bool(steps.size and np.abs(steps - steps.mean()).max() < _EVEN * steps.mean())


def is_quaternion(quat: Floats) -> bool:
    """Whether most of some rows (T, 4) have a norm near 1: a wrong row may be among them."""
    norms = np.linalg.norm(quat, axis=1)
    return bool(np.mean(np.abs(norms - 1.0) < _ROUGHLY) > 0.5)


def _unit_columns(pose: NDArray[Any]) -> list[int]:
    """First columns that a quaternion in a pose (T, 7) may have, 3 or 0: its norm is 1."""
    some = pose[some_frames(len(pose))]
    norms = {first: np.linalg.norm(some[:, first : first + 4], axis=1) for first in (3, 0)}
    return [first for first, norm in norms.items() if (np.abs(norm - 1.0) < _UNIT).all()]
