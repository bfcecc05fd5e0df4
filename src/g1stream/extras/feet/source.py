"""Torques for a robot on its own feet: it hangs until the feet carry it, then it balances.

docs/feet.md describes how the feet take over the weight.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from g1stream.config import Config
from g1stream.control.reading import ImuReading
from g1stream.control.sources import (
    Changed,
    HeldTorques,
    Mode,
    Moment,
    Source,
    Status,
    Traits,
)
from g1stream.control.targets import LOWERED, Setpoint
from g1stream.errors import ConfigError
from g1stream.extras.feet.balance import Balance
from g1stream.extras.feet.squat import Squat
from g1stream.extras.physics.standing import stand_or_explain
from g1stream.motion.blend import minimum_jerk
from g1stream.motion.limits import Interval
from g1stream.motion.motion import Motion
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS
from g1stream.robot.model import G1
from g1stream.robot.rotations import quat_rotate_inverse
from g1stream.robot.soles import SIDES
from g1stream.types import Floats, Phase

#: The feet stand from the first fraction of the weight, and stop standing below the second one.
_LANDS, _LIFTS = 0.1, 0.05
#: Between these fractions, the torque blends from that of a hanging to that of a standing robot.
_HANGS, _STANDS = 0.05, 0.25
#: PLAY begins when the feet have carried this fraction for this time, s.
_CARRIED: Final = 0.9, 1.0
#: From this fraction on, a squat is more stable than the external support.
_SQUATS: Final = 0.5
#: Time constant of the measured fraction, s.
_LOAD: Final = 0.1
_UP: Final = np.array([0.0, 0.0, 1.0])
#: The joints that turn a sole about y and about x, (2, 2).
_ANKLES: Final = np.array(
    [
        [JOINT_NAMES.index(f"{side}_ankle_{axis}_joint") for axis in ("pitch", "roll")]
        for side in SIDES
    ]
)


class StandingTorques(Source):
    """The torque of a hanging robot, and of one on its feet once they carry it.

    The bridge of g1stream holds the pelvis until PLAY begins and lowers the robot in RAMP, so the
    feet take over the weight at the end of RAMP. Elsewhere the robot is assumed to hang from a band
    at its torso, and the measured load on the feet decides; RAMP waits until they carry it.

    At the end of HOLD the robot squats, and can be damped in the squat. The part of a motion that
    is not played becomes a pause, so it need not be balanced.
    """

    def __init__(self, config: Config, robot: G1, *, simulated: bool = True) -> None:
        super().__init__(config, robot, simulated=simulated)
        self._config, self._robot = config, robot
        self._hanging = HeldTorques(config, robot, simulated=simulated)
        self._period, robots = config.stream.period / 1e9, self._hanging.robots
        self.traits = Traits(way_down=Squat(robot))
        self._balances = {one.name: Balance(one, self._period) for one in robots}
        self.balance = self._balances[robots[0].name]
        self._lowered_by_bridge = False
        self._landed = False
        self._load = self._carried_for = 0.0

    @property
    def status(self) -> Status:
        balance, awaited = self.balance, ""
        if not self._lowered_by_bridge and self._carried_for <= _CARRIED[1]:
            awaited = (
                f"the feet carry {100 * max(0.0, self._load):.0f} % of the weight; lower "
                f"the robot until they carry {100 * _CARRIED[0]:.0f} %, and release it in PLAY"
            )
        return Status(
            balance.fall,
            balance.fault,
            awaited,
            # At most a band carries the rest.
            stands=not self._lowered_by_bridge and self._load > _SQUATS,
            margins=balance.worst,
        )

    def prepare(self, motion: Motion) -> Changed:
        motion, _, rests = super().prepare(motion)
        settings, robot = self._config.stream, self._robot
        asked = Interval.from_config(settings, motion).frames(motion)
        standing = stand_or_explain(motion, robot, asked, robot.select(settings.played_joints))
        how = str(standing)
        if not how:
            return Changed(standing.motion, rests=rests)
        changed = replace(standing.motion, operations=(*motion.operations, how))
        return Changed(changed, f"{motion.name} is played {how}", rests)

    def begin(self, first: Setpoint, announced: str | None, robot: str | None) -> Mode:
        if announced not in (None, "free"):
            raise ConfigError(
                f"The simulator holds the robot ({announced}), so it does not stand on its feet.",
                "Start it with --support free, or stream without --support feet.",
            )
        self._lowered_by_bridge = announced == "free"
        mode = super().begin(first, announced, robot)
        name = self._hanging.hold("hanging", robot)
        self.balance = self._balances[name]
        self.balance.begin(first)
        return mode._replace(robot=name)

    def command(self, moment: Moment) -> Setpoint:
        phase, ramped, target, measured, age, *_ = moment
        if moment.fault:
            return target
        balance, imu = self.balance, measured.imu
        if phase is not Phase.RAMP:
            tau = balance.torque(target, measured, age)
            balance.watch(target)
            return target._replace(tau=tau)
        if self._lowered_by_bridge:
            share = minimum_jerk((ramped - LOWERED) / (1.0 - LOWERED))[0]
            tau = balance.torque(target, measured, age, share=share, planted=False)
            return target._replace(tau=tau)
        hanging = self._hanging.command(moment)
        if ramped < 1.0:  # moving legs would look loaded
            return hanging._replace(q=target.q + _levelled(target, imu))
        loaded = None if self._landed or self._load > _HANGS else 0.0
        standing = balance.torque(target, measured, age, share=loaded, planted=self._landed)
        self._load += (min(1.0, balance.carried) - self._load) * self._period / _LOAD
        self._landed = self._load > (_LIFTS if self._landed else _LANDS)
        if self._carried_for <= _CARRIED[1]:  # RAMP ends then, even if the load drops again
            carried = self._load > _CARRIED[0]
            self._carried_for = self._carried_for + self._period if carried else 0.0
        stands = minimum_jerk((self._load - _HANGS) / (_STANDS - _HANGS))[0]
        return target._replace(
            q=target.q + (1.0 - stands) * _levelled(target, imu),
            tau=hanging.tau + stands * (standing - hanging.tau),
        )


def _levelled(target: Setpoint, imu: ImuReading) -> Floats:
    """Ankle angles (29,), rad, with which a tilted robot lands on flat soles.

    The tilt against the target is that between the directions of gravity in the pelvis frame.
    """
    up = quat_rotate_inverse(imu.quat_wxyz.astype(np.float64), _UP)
    tilt = np.cross(up, quat_rotate_inverse(target.root_quat_wxyz, _UP))
    change = np.zeros(N_JOINTS)
    change[_ANKLES[:, 0]] = -tilt[1]
    change[_ANKLES[:, 1]] = -tilt[0]
    return change
