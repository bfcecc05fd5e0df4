# Made by `make docs`.
from g1stream._version import __version__ as __version__
from g1stream.analysis.summary import Summary as Summary
from g1stream.analysis.tracking import Tracking as Tracking
from g1stream.app.convert import convert as convert
from g1stream.app.record import record as record
from g1stream.app.rollout import rollout as rollout
from g1stream.app.session import Session as Session
from g1stream.app.session import open_session as open_session
from g1stream.app.sim import simulate as simulate
from g1stream.app.stream import stream as stream
from g1stream.config import Config as Config
from g1stream.config import load_config as load_config
from g1stream.errors import ConfigError as ConfigError
from g1stream.errors import G1StreamError as G1StreamError
from g1stream.errors import MotionError as MotionError
from g1stream.errors import RecordingError as RecordingError
from g1stream.errors import RobotError as RobotError
from g1stream.errors import SafetyError as SafetyError
from g1stream.errors import SimError as SimError
from g1stream.errors import WireError as WireError
from g1stream.extras import fit as fit
from g1stream.extras import library as library
from g1stream.extras import physics as physics
from g1stream.extras import report as report
from g1stream.extras.live.live import live as live
from g1stream.motion.motion import Motion as Motion
from g1stream.motion.readers import load_motion as load_motion
from g1stream.robot.joints import JOINT_NAMES as JOINT_NAMES
from g1stream.robot.model import G1 as G1
from g1stream.types import Phase as Phase

__all__: list[str]
_HOME: dict[str, str]
_EXTRAS: tuple[str, ...]
