"""How serious an event is: the levels of foxglove.Log, and of the Log that goes over the wire."""

from typing import Final

__all__ = ["ERROR", "INFO", "WARNING"]

INFO: Final = 2
WARNING: Final = 3
ERROR: Final = 4
