"""Play a reference motion on a Unitree G1 over DDS, and know exactly how well it went.

    import g1stream

    motion = g1stream.load_motion("dance.csv")
    summary = g1stream.stream(motion, record="session.mcap")
    session = g1stream.open_session("session.mcap")
    print(session.summary())  # what is in it and how well it went
    session.tracking().rmse  # (29,) rad
    session.reference.q, session.measured.q  # numpy arrays with both clocks beside them

What the names stand for is loaded when it is first used, so that importing costs nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from g1stream._version import __version__

if TYPE_CHECKING:
    from g1stream.analysis.delay import Delay
    from g1stream.analysis.tracking import Tracking
    from g1stream.app.convert import Conversion, ConvertReport, convert
    from g1stream.app.live import live
    from g1stream.app.record import record
    from g1stream.app.replay import replay
    from g1stream.app.rollout import rollout
    from g1stream.app.sim import simulate
    from g1stream.app.stream import stream
    from g1stream.config import Config, load_config
    from g1stream.dds.messages import LowState, Samples
    from g1stream.errors import G1StreamError
    from g1stream.extras.library.compute import LibraryCase
    from g1stream.extras.library.rows import JointRow, MotionRow
    from g1stream.extras.library.run import LibraryRun, run_library
    from g1stream.extras.library.table import Library, open_library
    from g1stream.extras.physics.measure import motion_physics
    from g1stream.extras.physics.result import MotionPhysics
    from g1stream.extras.physics.stance import Standing
    from g1stream.extras.physics.stand import stand
    from g1stream.extras.report.compare import Comparison, compare
    from g1stream.extras.report.page import report
    from g1stream.motion.motion import Motion
    from g1stream.motion.trajectory import Trajectory, TrajectoryPoint
    from g1stream.robot.joints import JOINT_NAMES
    from g1stream.robot.model import G1
    from g1stream.session.metrics import Metrics
    from g1stream.session.motions import load_motion
    from g1stream.session.session import Message, Session, open_session
    from g1stream.session.stream import Stream
    from g1stream.session.streams import Base, Command, LogEvent, Measured, Reference, TorsoImu
    from g1stream.session.summary import PhaseInterval, Summary, TrackingSummary
    from g1stream.sim.noise import SensorNoise
    from g1stream.sim.robot import SimReport

__all__ = [
    "G1",
    "JOINT_NAMES",
    "Base",
    "Command",
    "Comparison",
    "Config",
    "Conversion",
    "ConvertReport",
    "Delay",
    "G1StreamError",
    "JointRow",
    "Library",
    "LibraryCase",
    "LibraryRun",
    "LogEvent",
    "LowState",
    "Measured",
    "Message",
    "Metrics",
    "Motion",
    "MotionPhysics",
    "MotionRow",
    "PhaseInterval",
    "Reference",
    "Samples",
    "SensorNoise",
    "Session",
    "SimReport",
    "Standing",
    "Stream",
    "Summary",
    "TorsoImu",
    "Tracking",
    "TrackingSummary",
    "Trajectory",
    "TrajectoryPoint",
    "__version__",
    "compare",
    "convert",
    "live",
    "load_config",
    "load_motion",
    "motion_physics",
    "open_library",
    "open_session",
    "record",
    "replay",
    "report",
    "rollout",
    "run_library",
    "simulate",
    "stand",
    "stream",
]

_HOME = {
    "Base": "session.streams",
    "Command": "session.streams",
    "Comparison": "extras.report.compare",
    "Config": "config",
    "Conversion": "app.convert",
    "ConvertReport": "app.convert",
    "Delay": "analysis.delay",
    "G1": "robot.model",
    "G1StreamError": "errors",
    "JOINT_NAMES": "robot.joints",
    "JointRow": "extras.library.rows",
    "Library": "extras.library.table",
    "LibraryCase": "extras.library.compute",
    "LibraryRun": "extras.library.run",
    "LogEvent": "session.streams",
    "LowState": "dds.messages",
    "Measured": "session.streams",
    "Message": "session.session",
    "Metrics": "session.metrics",
    "Motion": "motion.motion",
    "MotionPhysics": "extras.physics.result",
    "MotionRow": "extras.library.rows",
    "PhaseInterval": "session.summary",
    "Reference": "session.streams",
    "Samples": "dds.messages",
    "SensorNoise": "sim.noise",
    "Session": "session.session",
    "SimReport": "sim.robot",
    "Standing": "extras.physics.stance",
    "Stream": "session.streams",
    "Summary": "session.summary",
    "TorsoImu": "session.streams",
    "Tracking": "analysis.tracking",
    "TrackingSummary": "session.summary",
    "Trajectory": "motion.trajectory",
    "TrajectoryPoint": "motion.trajectory",
    "compare": "extras.report.compare",
    "convert": "app.convert",
    "live": "app.live",
    "load_config": "config",
    "load_motion": "session.motions",
    "motion_physics": "extras.physics.measure",
    "open_library": "extras.library.table",
    "open_session": "session.session",
    "record": "app.record",
    "replay": "app.replay",
    "report": "extras.report.page",
    "rollout": "app.rollout",
    "run_library": "extras.library.run",
    "simulate": "app.sim",
    "stand": "extras.physics.stand",
    "stream": "app.stream",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'g1stream' has no attribute {name!r}")
    return getattr(import_module(f"g1stream.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
