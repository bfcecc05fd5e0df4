"""Torque, its limits, and the work that the motors did."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.analysis.tracking import rms
from g1stream.foxglove.tracking_error import MAX_GAP_NS
from g1stream.robot.joints import JOINT_NAMES
from g1stream.session.metrics import JointTorque, TorqueMetrics
from g1stream.session.streams import Command
from g1stream.types import Floats, Ints

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from g1stream.session.session import Session
    from g1stream.session.streams import Measured, Stream

__all__ = ["COMMAND_COLUMNS", "commanded_torque", "torque_metrics"]

COMMAND_COLUMNS: Final = ("q", "dq", "tau", "kp", "kd")
"""The columns of the commands that are read."""

#: A motor at this share of its limit, or more, is at its limit.
_SATURATED: Final = 0.99


def torque_metrics(
    session: Session,
    limits: Floats,
    states: NDArray[np.intp] | None,
    joints: Sequence[int] | None = None,
) -> TorqueMetrics | None:
    """The metrics of some states, or of all; None where the robot reports no torques.

    Args:
        session: with LowStates.
        limits: (29,) Nm.
        states: (N,) which LowStates; all of them if None.
        joints: motor indices of those that count; all if None.
    """
    measured = session.measured.read("q", "dq", "tau")
    chosen = np.arange(len(measured)) if states is None else states
    times = (measured.publish_time + measured.clock_offset)[chosen]
    order = np.argsort(times, kind="stable")
    finite = _finite(measured, ("q", "dq", "tau"))
    order = order[finite[chosen[order]]]
    chosen, times = chosen[order], times[order]
    if not measured.tau[chosen].any():
        return None
    seconds = np.diff(times) / 1e9
    seconds[seconds * 1e9 > MAX_GAP_NS] = 0.0
    has_velocity = measured.dq[chosen].any()
    command = around = None
    if session.topics.get(Command.topic):
        command = session.command.read(*COMMAND_COLUMNS)
        around = _newest(command, times)
    saturated = np.zeros(len(times), dtype=bool)
    found: list[dict[str, float]] = []
    # Joint by joint, as all states of all joints at once would take a few times the memory.
    counted = range(len(limits)) if joints is None else joints
    for joint in counted:
        limit = float(limits[joint])
        tau = measured.tau[chosen, joint]
        size = np.abs(tau)
        at_limit = size >= _SATURATED * limit
        saturated |= at_limit
        p99 = float(np.percentile(size, 99.0))
        figures = {
            "limit_nm": limit,
            "rms_nm": float(rms(tau)),
            "p99_nm": p99,
            "max_nm": float(size.max()),
            "use": p99 / limit,
            "saturated": float(at_limit.mean()),
        }
        if has_velocity:
            power = tau * measured.dq[chosen, joint]
            figures["work_j"] = _integral(np.abs(power), seconds)
            figures["net_work_j"] = _integral(power, seconds)
        if command is not None and around is not None:
            known, newest = around
            asked = _commanded(command, newest, measured, chosen[known], joint)
            figures["commanded_rmse_nm"] = float(rms(asked - tau[known]))
            figures["commanded_beyond"] = float((np.abs(asked) > limit).mean())
        found.append(figures)
    columns = {key: np.array([one[key] for one in found]) for key in found[0]}
    names = [JOINT_NAMES[joint] for joint in counted]
    duration, commanded = float(seconds.sum()), columns.get("commanded_rmse_nm")
    work = columns.get("work_j")
    return TorqueMetrics(
        in_play=states is not None,
        duration_s=duration,
        rms_nm=float(rms(columns["rms_nm"])),
        use=float(columns["use"].max()),
        most_used=names[int(columns["use"].argmax())],
        saturated=float(saturated.mean()),
        commanded_rmse_nm=None if commanded is None else float(rms(commanded)),
        work_j=None if work is None else float(work.sum()),
        net_work_j=None if work is None else float(columns["net_work_j"].sum()),
        power_w=None if work is None or not duration else float(work.sum()) / duration,
        joints={name: JointTorque(**figures) for name, figures in zip(names, found, strict=True)},
    )


def commanded_torque(session: Session) -> Floats:
    """(M, 29) Nm that the newest command asks of each state.

    nan where it is more than 100 ms old, or where command or state is not finite.

    Args:
        session: with commands and states.
    """
    measured, command = session.measured.read("q", "dq"), session.command.read(*COMMAND_COLUMNS)
    times = measured.publish_time + measured.clock_offset
    torque: Floats = np.full(measured.q.shape, np.nan)
    if around := _newest(command, times):
        known, newest = around
        for joint in range(torque.shape[1]):
            torque[known, joint] = _commanded(
                command, newest, measured, np.flatnonzero(known), joint
            )
    return torque


def _integral(values: Floats, seconds: Floats) -> float:
    """Integral of values (N,) over intervals (N - 1,) s, by trapezoids."""
    return float(seconds @ (0.5 * (values[1:] + values[:-1])))


def _finite(stream: Stream, columns: Sequence[str]) -> NDArray[np.bool_]:
    """(N,) which samples are finite in these columns (N, 29)."""
    finite = [np.isfinite(getattr(stream, name)).all(axis=1) for name in columns]
    return np.asarray(np.all(finite, axis=0))


def _newest(command: Command, instants: Ints) -> tuple[NDArray[np.bool_], NDArray[np.intp]] | None:
    """Of instants (N,) which have a finite command as the newest, and that; None where none has."""
    times = command.publish_time + command.clock_offset
    order = np.argsort(times, kind="stable")
    before = np.searchsorted(times[order], instants, side="right") - 1
    newest = order[before.clip(0)]
    known = (before >= 0) & (instants - times[newest] <= MAX_GAP_NS)
    known &= _finite(command, COMMAND_COLUMNS)[newest]
    return (known, newest[known]) if known.any() else None


def _commanded(
    command: Command,
    commands: NDArray[np.intp],
    measured: Measured,
    states: NDArray[np.intp],
    joint: int,
) -> Floats:
    """(N,) Nm that commands ask of a motor: tau + kp (q - measured) + kd (dq - measured)."""
    at = commands, joint
    away = command.q[at] - measured.q[states, joint]
    faster = command.dq[at] - measured.dq[states, joint]
    torque: Floats = command.tau[at] + command.kp[at] * away + command.kd[at] * faster
    return torque
