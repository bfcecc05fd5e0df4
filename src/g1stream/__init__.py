"""Play a reference motion on a Unitree G1 over DDS, and measure how well the robot tracked it.

    import g1stream

    motion = g1stream.load_motion("dance.csv")
    summary = g1stream.stream(motion, record="session.mcap")
    session = g1stream.open_session("session.mcap")
    print(session.summary())  # contents and tracking quality
    session.tracking().rmse  # (29,) rad
    session.reference.q, session.measured.q  # numpy arrays; the streams have log and publish times

Modules are loaded when a name is first used, so importing the package is fast.
"""

from importlib import import_module
from typing import Any

from g1stream._version import __version__

#: Name -> its module. Type checkers read `__init__.pyi`, which `make docs` writes.
_HOME = {
    name: module
    for module, names in {
        "analysis.metrics": ("Metrics",),
        "analysis.summary": ("Summary",),
        "analysis.tracking": ("Delay", "ErrorStats", "Tracking", "TrackingSummary"),
        "app.convert": ("Conversion", "ConvertReport", "convert"),
        "app.live": ("live",),
        "app.record": ("record",),
        "app.rollout": ("rollout",),
        "app.session": ("Session", "open_session"),
        "app.sim": ("simulate",),
        "app.stream": ("stream",),
        "config": ("Config", "load_config"),
        "dds.messages": ("LowState", "Samples"),
        "errors": ("G1StreamError",),
        "extras.fit.excite": ("exciting_motion",),
        "extras.fit.gap": ("Gap", "gap"),
        "extras.fit.identify": ("Fit", "fit_parameters"),
        "extras.library.compute": ("LibraryCase",),
        "extras.library.run": ("LibraryRun", "run_library"),
        "extras.library.table": ("JointRow", "Library", "MotionRow", "open_library"),
        "extras.physics.measure": ("motion_physics",),
        "extras.physics.result": ("MotionPhysics",),
        "extras.physics.stance": ("Standing",),
        "extras.physics.stand": ("stand",),
        "extras.report.compare": ("Comparison", "compare"),
        "extras.report.page": ("report",),
        "motion.motion": ("Motion",),
        "motion.readers": ("load_motion",),
        "motion.spline": ("TrajectoryPoint",),
        "motion.trajectory": ("Trajectory",),
        "robot.joints": ("JOINT_NAMES",),
        "robot.model": ("G1",),
        "session.recording": ("Message",),
        "session.records": ("PhaseInterval", "PolicyInfo"),
        "session.streams": (
            "BaseStream",
            "CommandStream",
            "LogEvent",
            "MeasuredStream",
            "PolicyStream",
            "ReferenceStream",
            "Stream",
            "TorsoImuStream",
        ),
        "sim.robot": ("SensorNoise", "SimReport"),
    }.items()
    for name in names
}

__all__ = ["__version__", *_HOME]  # noqa: PLE0604


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'g1stream' has no attribute {name!r}")
    return getattr(import_module(f"g1stream.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
