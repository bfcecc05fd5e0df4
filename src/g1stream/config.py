"""The settings of every program, their defaults and their checks.

A TOML file has one table for each class below; what it leaves out keeps its default, and a flag on
the command line goes over both.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from g1stream.errors import ConfigError
from g1stream.types import STREAM_RATE, FeedForwardKind, Support

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pydantic_core import ErrorDetails

__all__ = [
    "Config",
    "DdsConfig",
    "GainsConfig",
    "RealtimeConfig",
    "RecordConfig",
    "SafetyConfig",
    "SimConfig",
    "StreamConfig",
    "load_config",
    "read_toml",
]

Seconds = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]


#: The greatest gains that are ever sent, Nm/rad and Nm s/rad: beyond any that a G1 is run with.
MAX_KP, MAX_KD = 500.0, 50.0


class _Table(BaseModel):
    # Strict: TOML has a type for everything, so that "yes" is no bool and true is no number.
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class DdsConfig(_Table):
    """Where on DDS."""

    domain: int = Field(1, ge=0, le=232, description="simulators use 1, the robot uses 0")
    interface: str = Field("lo", min_length=1, description="network interface")


class StreamConfig(_Table):
    """How a motion is played."""

    rate: float = Field(STREAM_RATE, ge=10.0, le=2000.0, description="LowCmd per second, Hz")
    wait: float = Field(
        10.0,
        ge=1.0,
        allow_inf_nan=False,
        description="longest wait for a first LowState, s; discovery alone may take 2 s",
    )
    ramp: float = Field(
        3.0, ge=0.2, le=60.0, description="from the measured pose to the first frame, s"
    )
    hold: Seconds = Field(1.0, description="stay at the last frame, s")
    damp: float = Field(1.0, ge=0.5, le=10.0, description="damp before letting go, s")
    start: Seconds = Field(0.0, description="where in the motion to start, s")
    duration: Positive | None = Field(None, description="how much of it to play, s; all if unset")
    loop: bool = Field(False, description="play again and again until stopped")
    damp_kd: float = Field(3.0, ge=0.5, le=10.0, description="gain while damping, Nm s/rad")
    feedforward: FeedForwardKind | None = Field(
        None,
        description="what commands carry beside q; if unset, dynamics for a simulator on this "
        "machine that says how it holds the robot, and velocity for everybody else",
    )
    support: Support | None = Field(
        None, description="how the robot is held; if unset, as the simulator says"
    )
    preview: float | None = Field(
        None,
        ge=0.0,
        le=0.1,
        description="commands are ahead of the motion by this, s; one period of them if unset",
    )


class RealtimeConfig(_Table):
    """How punctual the loop asks to be; what the system does not grant is gone without."""

    priority: int = Field(50, ge=0, le=99, description="of SCHED_FIFO; 0: an ordinary process")
    cpu: int | None = Field(
        None, ge=0, description="the only CPU of the loop; an isolated one, or any, if unset"
    )


class SafetyConfig(_Table):
    """When to stop; each threshold is explained in docs/safety.md."""

    position_margin: float = Field(0.0, ge=0.0, le=0.5, description="kept from joint limits, rad")
    state_timeout: Positive = Field(0.1, description="LowState older than this stops, s")
    max_tilt: float = Field(1.0, gt=0.0, le=3.2, description="pelvis tilt that stops, rad")
    max_joint_speed: Positive = Field(60.0, description="measured joint speed that stops, rad/s")
    mode_machine: tuple[int, ...] = Field(
        (0, 5),
        min_length=1,
        strict=False,  # TOML and JSON know lists only
        description="robots that may be commanded: 5 is the 29-joint G1, 0 a simulator",
    )
    allow_second_writer: bool = Field(False, description="play although somebody else commands")


class GainsConfig(_Table):
    """Servo gains by joint.

    Each table maps a joint name, or a pattern such as `*_knee_joint`, to a gain; later entries go
    over earlier ones, and joints that nothing names keep the default.
    """

    kp: dict[str, Annotated[float, Field(ge=0.0, le=MAX_KP)]] = Field(default_factory=dict)
    kd: dict[str, Annotated[float, Field(ge=0.0, le=MAX_KD)]] = Field(default_factory=dict)


class RecordConfig(_Table):
    """What a session file holds."""

    tf_rate: float = Field(100.0, gt=0.0, le=2000.0, description="link poses per second, Hz")
    batch: float = Field(0.05, gt=0.0, le=0.5, description="samples are handled this often, s")
    split_size: Positive | None = Field(None, description="begin a new file after so many MB")
    split_duration: Positive | None = Field(None, description="begin a new file after so long, s")
    auto_name: bool = Field(False, description="put the time into the file's name")


class SimConfig(_Table):
    """How the MuJoCo bridge holds and answers."""

    support: Support = Field("bolted", description="what holds the pelvis")
    rate: float = Field(500.0, ge=50.0, le=1000.0, description="LowState per second, Hz")
    command_timeout: Seconds = Field(
        0.5, description="without a command for so long the motors only damp, s; 0: never"
    )
    duration: Positive | None = Field(None, description="stop by itself after this, s")
    viewer: bool = Field(False, description="open MuJoCo's viewer")


class Config(_Table):
    """All settings of a session."""

    robot: Annotated[Path, Field(strict=False)] | None = Field(
        None, description="URDF; the built-in G1 if unset"
    )
    dds: DdsConfig = DdsConfig()
    stream: StreamConfig = StreamConfig()
    realtime: RealtimeConfig = RealtimeConfig()
    safety: SafetyConfig = SafetyConfig()
    gains: GainsConfig = GainsConfig()
    record: RecordConfig = RecordConfig()
    sim: SimConfig = SimConfig()


def load_config(path: Path | None = None, over: Mapping[str, Any] | None = None) -> Config:
    """Read a TOML file and put other values over it.

    Args:
        path: the TOML file; defaults alone when None.
        over: values that go over the file's, keyed like `stream.rate`; None values do not count,
            and tables, such as `gains.kp`, are put over the file's entry by entry.

    Raises:
        ConfigError: the file cannot be read, is not TOML, or a value does not fit; names it.
    """
    values = read_toml(path) if path else {}
    given = {key: value for key, value in (over or {}).items() if value is not None}
    for key, value in given.items():
        table, _, name = key.rpartition(".")
        settings = values.setdefault(table, {}) if table else values
        if isinstance(settings, dict):  # otherwise the file is at fault, which is told below
            below = settings.get(name)
            if isinstance(value, dict) and isinstance(below, dict):
                # In the order in which they count: what goes over comes last.
                kept = {k: v for k, v in below.items() if k not in value}
                settings[name] = kept | value
            else:
                settings[name] = value
    try:
        return Config.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        in_file = path and not any(f"{key}.".startswith(f"{flag}.") for flag in given)
        raise _explained(first, key, f" in {path}" if in_file else "") from error


def read_toml(path: Path, kind: str = "config") -> dict[str, Any]:
    """The tables of a TOML file, which errors call a file of this kind.

    Raises:
        ConfigError: it cannot be read, or is not TOML.
    """
    try:
        with path.open("rb") as file:
            values: dict[str, Any] = tomllib.load(file)
    except OSError as error:
        raise ConfigError(
            f"The {kind} {path} cannot be read: {error.strerror}.", "Check the path."
        ) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(
            f"The {kind} {path} is not valid TOML: {error}.",
            "Fix the syntax on that line; configs/sim.toml is an example.",
        ) from error
    return values


def _explained(error: ErrorDetails, key: str, where: str) -> ConfigError:
    value = error["input"]
    if error["type"] == "extra_forbidden":
        parent = Config.model_fields.get(key.split(".", maxsplit=1)[0])
        table = parent.annotation if parent and "." in key else Config
        known = ", ".join(getattr(table, "model_fields", {}))
        return ConfigError(f"There is no setting {key}{where}.", f"Choose from {known}.")
    if error["type"] in ("model_type", "dict_type"):
        return ConfigError(
            f"The setting {key} = {value!r}{where} is not a table.",
            f"Write [{key}] and its settings below it, as in configs/sim.toml.",
        )
    message = error["msg"]
    return ConfigError(
        f"The setting {key} = {value!r}{where} does not fit: {message[0].lower()}{message[1:]}.",
        "Correct the value; configs/sim.toml lists every setting with its meaning.",
    )
