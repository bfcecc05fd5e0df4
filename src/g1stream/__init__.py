"""Play a reference motion on a Unitree G1 over DDS, and know exactly how well it went."""

from g1stream._version import __version__

__all__ = ["__version__"]
