"""Sim-to-real gap: simulation of recorded commands, and identification of parameters."""

from typing import TYPE_CHECKING

from g1stream.optional import lazily

if TYPE_CHECKING:
    from g1stream.extras.fit.excite import exciting_motion as exciting_motion
    from g1stream.extras.fit.identify import Fit as Fit
    from g1stream.extras.fit.identify import fit_parameters as fit_parameters
    from g1stream.extras.fit.simulated_session import Gap as Gap
    from g1stream.extras.fit.simulated_session import gap as gap

__all__ = ["Fit", "Gap", "exciting_motion", "fit_parameters", "gap"]

__getattr__ = lazily(
    __name__,
    {
        "exciting_motion": "excite",
        "Gap": "simulated_session",
        "gap": "simulated_session",
        "Fit": "identify",
        "fit_parameters": "identify",
    },
)
