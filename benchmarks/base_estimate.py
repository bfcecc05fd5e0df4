"""Where a robot on its feet was, as the balance finds it from LowState, against SportModeState.

The balance of `--support feet` never reads SportModeState, which unitree_mujoco publishes and a
robot in low-level mode does not. Here it computes PLAY of recorded sessions again, with the newest
LowState at every tick, and what it finds is compared with SportModeState: the pelvis's position
since a second after the beginning of PLAY, horizontally and in height, and its velocity. Without a
session, that of the bundled demo with sensor noise is simulated.

    python benchmarks/base_estimate.py [SESSION.mcap ...]
"""

from __future__ import annotations

import argparse

import numpy as np

import g1stream
from g1stream.app.session import Session, open_session
from g1stream.config import Config
from g1stream.control.reading import ImuReading, Reading
from g1stream.control.targets import Setpoint
from g1stream.extras.feet.balance import Balance
from g1stream.robot.rotations import quat_conj, quat_from_yaw, quat_mul, quat_rotate, yaw_of

_SETTLED = 1.0  # s


def compare(session: Session) -> str:
    """One line of what is found in a session."""
    playing = session.sel("PLAY")
    reference, measured, base = playing.reference, session.measured, session.base
    if base is None:
        return "no SportModeState"
    times = reference.time
    newest = np.searchsorted(measured.time, times, side="right") - 1
    balance = Balance(session.robot, float(np.median(np.diff(times))))
    found = np.empty((len(times), 10))  # position, velocity, attitude
    for k, row in enumerate(newest):
        target = Setpoint(
            float(reference.motion_time[k]),
            reference.q[k],
            reference.dq[k],
            reference.ddq[k],
            np.zeros(29),
            reference.root_pos[k],
            reference.root_quat_wxyz[k],
            reference.root_lin_vel[k],
            reference.root_ang_vel[k],
            np.zeros(3),
            np.zeros(3),
        )
        if k == 0:
            balance.begin(target)
        imu = ImuReading(
            measured.imu_quat_wxyz[row], measured.gyroscope[row], measured.accelerometer[row]
        )
        reading = Reading(measured.q[row], measured.dq[row], measured.tau[row], imu)
        balance.torque(target, reading, 0.0)
        found[k] = *balance.base.pos, *balance.base.vel, *balance.base.quat_wxyz
    stated = measured.time[newest]
    given = np.concatenate([base.position, base.velocity], axis=1)
    true = np.stack([np.interp(stated, base.time, one) for one in given.T], axis=1)
    # The heading of the reference's world in the simulator's is that of the first readings.
    first = int(np.searchsorted(times, times[0] + _SETTLED))
    if first == len(times):
        return "PLAY is too short"
    yaw = yaw_of(quat_mul(measured.imu_quat_wxyz[newest[first]], quat_conj(found[first, 6:])))
    turn = quat_from_yaw(yaw)
    moved = quat_rotate(turn, found[first:, :3] - found[first, :3])
    off = moved - (true[first:, :3] - true[first, :3])
    speed = quat_rotate(turn, found[first:, 3:6]) - true[first:, 3:]
    sideways = 1e3 * np.linalg.norm(off[:, :2], axis=1).max()
    height = 1e3 * np.abs(found[first:, 2] - true[first:, 2]).max()
    return (
        f"{times[-1] - times[first]:5.1f} s: horizontally within {sideways:.1f} mm, in height "
        f"{height:.1f} mm; speed {1e3 * np.sqrt((speed**2).mean()):.1f} mm/s RMS an axis"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("sessions", nargs="*")
    args = parser.parse_args()
    for path in args.sessions:
        print(path, compare(open_session(path)), flush=True)
    if not args.sessions:
        config = Config.model_validate({"sim": {"noise": 1.0}})
        print("demo", compare(g1stream.rollout("demo", support="feet", config=config)))


if __name__ == "__main__":
    main()
