"""Torques of arms and waist of a robot that its own controller carries."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

from g1stream.control.sources import HeldTorques, Mode

if TYPE_CHECKING:
    from g1stream.control.targets import Setpoint

__all__ = ["CarriedTorques"]

_LOGGER = logging.getLogger(__name__)


class CarriedTorques(HeldTorques):
    """Torques for a pelvis at rest in the attitude that the IMU measures, whatever the legs do."""

    def begin(self, first: Setpoint, announced: str | None, robot: str | None) -> Mode:
        kind = self._kind or ("dynamics" if announced else "velocity")
        if kind == "dynamics":
            name = self.hold("bolted", robot)
            _LOGGER.info("feed-forward: dynamics, at the measured attitude of the pelvis")
            return Mode(kind, robot=name)
        _LOGGER.warning(
            "feed-forward: %s only: arms and waist sag under their weight; "
            "--feedforward dynamics compensates for it",
            kind,
        )
        return Mode(kind)
