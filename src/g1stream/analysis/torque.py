"""Joint torques, their limits, and the work of the motors."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from g1stream.analysis.tracking import blocks, rms
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS
from g1stream.session.recording import once
from g1stream.session.records import Record
from g1stream.session.streams import MAX_GAP_NS, CommandStream
from g1stream.types import Floats

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from g1stream.session.recording import Recording
    from g1stream.session.streams import Stream

__all__ = ["JointTorque", "TorqueMetrics", "commanded_torque", "torque_metrics"]

_COMMANDED: Final = ("q", "dq", "tau", "kp", "kd")
"""The columns of a command that determine its torque."""

#: A motor at this fraction of its limit, or more, is at its limit.
_SATURATED: Final = 0.99


class JointTorque(Record):
    """The torque of a joint, as estimated by its motor.

    Attributes:
        limit_nm: the smaller of the motor's limit and the URDF's effort.
        rms_nm: root mean square.
        p99_nm, max_nm: percentile and maximum of its absolute value.
        use: p99_nm / limit_nm.
        saturated: fraction of the states at 99 % of the limit or more.
        commanded_rmse_nm: root mean square of commanded - estimated; None without commands.
        commanded_beyond: fraction of the states with a commanded torque above the limit.
        work_j: integral of |tau dq|; None without reported velocities.
        net_work_j: integral of tau dq: delivered minus absorbed work.
    """

    limit_nm: float
    rms_nm: float
    p99_nm: float
    max_nm: float
    use: float
    saturated: float
    commanded_rmse_nm: float | None = None
    commanded_beyond: float | None = None
    work_j: float | None = None
    net_work_j: float | None = None


class TorqueMetrics(Record):
    """The torque of the motors in PLAY, or in the whole session if no motion was played.

    Attributes:
        in_play: whether only PLAY is used.
        duration_s: length without gaps.
        rms_nm: over all joints.
        use: the highest `use` of a joint.
        most_used: name of that joint.
        saturated: fraction of the states with at least one joint at its limit.
        commanded_rmse_nm: over all joints.
        work_j, net_work_j: sums over all joints.
        power_w: work_j per second.
        joints: by name.
    """

    in_play: bool
    duration_s: float
    rms_nm: float
    use: float
    most_used: str
    saturated: float
    commanded_rmse_nm: float | None = None
    work_j: float | None = None
    net_work_j: float | None = None
    power_w: float | None = None
    joints: dict[str, JointTorque]


def torque_metrics(
    session: Recording,
    limits: Floats,
    states: NDArray[np.intp] | None,
    joints: Sequence[int] | None = None,
) -> TorqueMetrics | None:
    """The torque metrics of some or all states; None if the robot reports no torques.

    Args:
        session: session with LowStates.
        limits: (29,) N·m.
        states: (N,) indices of the LowStates to use; all if None.
        joints: motor indices of the joints to use; all if None.
    """
    measured = session.measured.read("q", "dq", "tau")
    chosen = np.arange(len(measured)) if states is None else states
    times = measured.published[chosen]
    order = np.argsort(times, kind="stable")
    order = order[_finite(measured, ("q", "dq", "tau"))[chosen[order]]]
    chosen, times = chosen[order], times[order]
    if not any(measured.rows("tau", chosen[part]).any() for part in blocks(len(chosen))):
        return None
    commanded = commanded_torque(session) if session.topics.get(CommandStream.topic) else None
    seconds = np.diff(times) / 1e9
    seconds[seconds * 1e9 > MAX_GAP_NS] = 0.0
    counted = list(range(N_JOINTS) if joints is None else joints)
    # Trapezoidal rule: each state counts for half of the interval on either side.
    weights = 0.5 * (np.append(seconds, 0.0) + np.append(0.0, seconds))
    squares, greatest, work, net_work = np.zeros((4, N_JOINTS))
    saturated, known, beyond, apart = np.zeros((4, N_JOINTS))
    at_limit = 0
    for part in blocks(len(chosen)):
        rows = chosen[part]
        tau = measured.rows("tau", rows)
        size, power = np.abs(tau), tau * measured.rows("dq", rows)
        squares += np.square(tau).sum(axis=0)
        greatest = np.maximum(greatest, size.max(axis=0))
        limited = size >= _SATURATED * limits
        saturated += limited.sum(axis=0)
        at_limit += int(limited[:, counted].any(axis=1).sum())
        work += weights[part] @ np.abs(power)
        net_work += weights[part] @ power
        if commanded is not None:
            asked = commanded[rows]
            there = np.isfinite(asked).all(axis=1)
            known += there.sum()
            apart += np.square(asked[there] - tau[there]).sum(axis=0)
            beyond += (np.abs(asked[there]) > limits).sum(axis=0)
    n = len(chosen)
    # Joint by joint: the absolute values of all of them would take as much memory as the torques.
    p99 = [np.percentile(np.abs(measured.rows("tau", (chosen, joint))), 99.0) for joint in counted]
    columns: dict[str, Floats] = {
        "limit_nm": limits[counted],
        "rms_nm": np.sqrt(squares / n)[counted],
        "p99_nm": np.array(p99),
        "max_nm": greatest[counted],
        "use": np.array(p99) / limits[counted],
        "saturated": saturated[counted] / n,
    }
    duration = float(seconds.sum())
    if any(measured.rows("dq", chosen[part]).any() for part in blocks(n)):
        columns |= {"work_j": work[counted], "net_work_j": net_work[counted]}
    if known.any():
        columns["commanded_rmse_nm"] = np.sqrt(apart / known)[counted]
        columns["commanded_beyond"] = (beyond / known)[counted]
    total: dict[str, float] = {}
    if "work_j" in columns:
        total = {key: float(columns[key].sum()) for key in ("work_j", "net_work_j")}
        total |= {"power_w": total["work_j"] / duration} if duration else {}
    if "commanded_rmse_nm" in columns:
        total["commanded_rmse_nm"] = float(rms(columns["commanded_rmse_nm"]))
    names = [JOINT_NAMES[joint] for joint in counted]
    return TorqueMetrics(
        in_play=states is not None,
        duration_s=duration,
        rms_nm=float(rms(columns["rms_nm"])),
        use=float(columns["use"].max()),
        most_used=names[int(columns["use"].argmax())],
        saturated=at_limit / n,
        **total,
        joints={
            name: JointTorque(**{key: float(values[i]) for key, values in columns.items()})
            for i, name in enumerate(names)
        },
    )


@once
def commanded_torque(session: Recording) -> Floats:
    """(M, 29) N·m, float32, torque of the newest command at each of the M LowStates.

    It is tau + kp (q - measured) + kd (dq - measured). It is nan if the command is more than
    100 ms old, or if command or state is not finite. The session must have both.
    """
    measured = session.measured.read("q", "dq")
    instants, times = measured.published, session.command.published
    order = np.argsort(times, kind="stable")
    before = np.searchsorted(times[order], instants, side="right") - 1
    newest = order[before.clip(0)]
    known = (before >= 0) & (instants - times[newest] <= MAX_GAP_NS)
    torque: NDArray[Any] = np.full((len(known), N_JOINTS), np.nan, np.float32)
    states = np.flatnonzero(known)
    states = states[np.argsort(newest[states], kind="stable")]
    numbers = newest[states]
    # The commands are not kept: those of an hour take 1 GB.
    for start, asked in session.blocks(CommandStream, _COMMANDED):
        first, end = np.searchsorted(numbers, (start, start + len(asked["q"])))
        rows, at = states[first:end], numbers[first:end] - start
        with np.errstate(all="ignore"):
            torque[rows] = (
                asked["tau"][at]
                + asked["kp"][at] * (asked["q"][at] - measured.rows("q", rows))
                + asked["kd"][at] * (asked["dq"][at] - measured.rows("dq", rows))
            )
        torque[rows[~np.isfinite(torque[rows]).all(axis=1)]] = np.nan
    return torque


def _finite(stream: Stream, columns: Sequence[str]) -> NDArray[np.bool_]:
    """(N,) which samples are finite in these columns (N, 29)."""
    finite = np.ones(len(stream), dtype=bool)
    for name in columns:
        values = stream.recorded(name)
        for part in blocks(len(finite)):
            finite[part] &= np.isfinite(values[part]).all(axis=1)
    return finite
