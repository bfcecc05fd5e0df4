"""The joint angles of a motion over time, as a figure."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from g1stream.errors import MotionError
from g1stream.robot.joints import JOINT_GROUPS, JOINT_NAMES

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.figure import Figure

    from g1stream.motion.motion import Motion

__all__ = ["draw_motion"]


def draw_motion(motion: Motion, joints: Sequence[str] | None = None) -> Figure:
    """See `Motion.plot`."""
    from matplotlib.figure import Figure

    unknown = [joint for joint in joints or () if joint not in JOINT_NAMES]
    if unknown:
        raise MotionError(
            f"The motion {motion.name} has no joint {', '.join(unknown)}.",
            f"Its joints are {', '.join(JOINT_NAMES)}.",
        )
    panels = {
        limb.replace("_", " "): [JOINT_NAMES[i] for i in motors]
        for limb, motors in JOINT_GROUPS.items()
    }
    if joints is not None:
        panels = {"": list(joints)}
    figure = Figure(figsize=(9.0, 1.0 + 2.4 * len(panels)), layout="constrained")
    figure.suptitle(motion.name)
    times = np.arange(motion.n_frames) / motion.fps
    axes = figure.subplots(len(panels), sharex=True, squeeze=False)[:, 0]
    for axis, (limb, names) in zip(axes, panels.items(), strict=True):
        for joint in names:
            axis.plot(times, motion.joint_pos[:, JOINT_NAMES.index(joint)], label=joint)
        axis.set(title=limb, ylabel="angle (rad)")
        axis.grid(alpha=0.3)
        axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize="small")
    axes[-1].set_xlabel("time (s)")
    return figure
