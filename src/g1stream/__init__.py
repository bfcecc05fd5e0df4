"""Play a reference motion on a Unitree G1 over DDS, and measure how well the robot tracked it.

    import g1stream

    motion = g1stream.load_motion("dance.csv")
    summary = g1stream.stream(motion, record="session.mcap")
    session = g1stream.open_session("session.mcap")
    print(session.summary())  # contents and tracking quality
    session.tracking().rmse  # (29,) rad
    session.reference.q, session.measured.q  # numpy arrays; the streams have log and publish times

Extras are modules: `g1stream.physics.motion_physics`, `g1stream.report.report`. A module is loaded
when a name of it is first used, so importing the package is fast.
"""

from importlib import import_module
from typing import Any

from g1stream._version import __version__

#: Name -> its module. Type checkers read `__init__.pyi`, which `make docs` writes.
_HOME = {
    name: module
    for module, names in {
        "analysis.summary": ("Summary",),
        "analysis.tracking": ("Tracking",),
        "app.convert": ("convert",),
        "app.record": ("record",),
        "app.rollout": ("rollout",),
        "app.session": ("Session", "open_session"),
        "app.sim": ("simulate",),
        "app.stream": ("stream",),
        "config": ("Config", "load_config"),
        "extras.live.live": ("live",),
        "errors": (
            "ConfigError",
            "G1StreamError",
            "MotionError",
            "RecordingError",
            "RobotError",
            "SafetyError",
            "SimError",
            "WireError",
        ),
        "motion.motion": ("Motion",),
        "motion.readers": ("load_motion",),
        "robot.joints": ("JOINT_NAMES",),
        "robot.model": ("G1",),
        "types": ("Phase",),
    }.items()
    for name in names
}
#: Extras with names of their own, such as `g1stream.fit.fit_parameters`.
_EXTRAS = ("fit", "library", "physics", "report")

__all__ = ["__version__", *_HOME, *_EXTRAS]  # noqa: PLE0604


def __getattr__(name: str) -> Any:
    if name in _EXTRAS:
        return import_module(f"g1stream.extras.{name}")
    if name not in _HOME:
        raise AttributeError(f"module 'g1stream' has no attribute {name!r}")
    return getattr(import_module(f"g1stream.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
