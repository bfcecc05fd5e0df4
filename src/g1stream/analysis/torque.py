"""Torque, its limits, and the work that the motors did."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from g1stream.robot.joints import JOINT_NAMES
from g1stream.session.metrics import JointTorque, TorqueMetrics
from g1stream.types import Floats, Ints

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from g1stream.session.session import Session
    from g1stream.session.streams import Command, Measured

__all__ = ["COMMAND_COLUMNS", "torque_metrics"]

COMMAND_COLUMNS: Final = ("q", "dq", "tau", "kp", "kd")
"""The columns of the commands that are read."""

#: A motor at this share of its limit, or more, is at its limit.
_SATURATED: Final = 0.99
#: Samples further apart than this, ns, say nothing of the time between them.
_LONGEST_GAP: Final = 100_000_000


def torque_metrics(
    session: Session, limits: Floats, states: NDArray[np.intp] | None
) -> TorqueMetrics | None:
    """The metrics of some states, or of all; None where the robot reports no torques.

    Args:
        session: with LowStates.
        limits: (29,) Nm.
        states: (N,) which LowStates; all of them if None.
    """
    measured = session.measured.read("q", "dq", "tau")
    chosen = np.arange(len(measured)) if states is None else states
    times = (measured.publish_time + measured.clock_offset)[chosen]
    order = np.argsort(times, kind="stable")
    chosen, times = chosen[order], times[order]
    tau = measured.tau[chosen]
    usable = np.isfinite(tau).all(axis=1)
    chosen, times, tau = chosen[usable], times[usable], tau[usable]
    if not tau.any():
        return None
    seconds = np.diff(times) / 1e9
    seconds[seconds * 1e9 > _LONGEST_GAP] = 0.0
    size = np.abs(tau)
    at_limit = size >= _SATURATED * limits
    p99 = np.percentile(size, 99.0, axis=0)
    columns: dict[str, Any] = {
        "limit_nm": limits,
        "rms_nm": np.sqrt(np.mean(np.square(tau), axis=0)),
        "p99_nm": p99,
        "max_nm": size.max(axis=0),
        "use": p99 / limits,
        "saturated": at_limit.mean(axis=0),
    }
    dq = measured.dq[chosen]
    if dq.any() and np.isfinite(dq).all():
        power = tau * dq
        columns["work_j"] = _integral(np.abs(power), seconds)
        columns["net_work_j"] = _integral(power, seconds)
    if session.topics.get("/lowcmd"):
        command = session.command.read(*COMMAND_COLUMNS)
        around = _newest(command.publish_time + command.clock_offset, times)
        if around is not None:
            known, newest = around
            asked = _commanded(command, newest[known], measured, chosen[known])
            columns["commanded_rmse_nm"] = np.sqrt(np.mean(np.square(asked - tau[known]), axis=0))
            columns["commanded_beyond"] = (np.abs(asked) > limits).mean(axis=0)
    joints = {
        name: JointTorque(**{key: float(values[i]) for key, values in columns.items()})
        for i, name in enumerate(JOINT_NAMES)
    }
    duration, commanded = float(seconds.sum()), columns.get("commanded_rmse_nm")
    work = columns.get("work_j")
    return TorqueMetrics(
        in_play=states is not None,
        duration_s=duration,
        rms_nm=_pooled(columns["rms_nm"]),
        use=float(columns["use"].max()),
        most_used=JOINT_NAMES[int(columns["use"].argmax())],
        saturated=float(at_limit.any(axis=1).mean()),
        commanded_rmse_nm=None if commanded is None else _pooled(commanded),
        work_j=None if work is None else float(work.sum()),
        net_work_j=None if work is None else float(columns["net_work_j"].sum()),
        power_w=None if work is None or not duration else float(work.sum()) / duration,
        joints=joints,
    )


def _integral(values: Floats, seconds: Floats) -> Floats:
    """(29,) integral of values (N, 29) over intervals (N - 1,) s, by trapezoids."""
    integral: Floats = seconds @ (0.5 * (values[1:] + values[:-1]))
    return integral


def _newest(times: Ints, instants: Ints) -> tuple[NDArray[np.bool_], NDArray[np.intp]] | None:
    """Of instants (N,) which have a sample before them, and which; None where none has."""
    order = np.argsort(times, kind="stable")
    before = np.searchsorted(times[order], instants, side="right") - 1
    newest = order[before.clip(0)]
    known = (before >= 0) & (instants - times[newest] <= _LONGEST_GAP)
    return (known, newest) if known.any() else None


def _commanded(
    command: Command, commands: NDArray[np.intp], measured: Measured, states: NDArray[np.intp]
) -> Floats:
    """(N, 29) Nm that commands ask of motors: tau + kp (q - measured) + kd (dq - measured)."""
    return (
        command.tau[commands]
        + command.kp[commands] * (command.q[commands] - measured.q[states])
        + command.kd[commands] * (command.dq[commands] - measured.dq[states])
    )


def _pooled(values: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
