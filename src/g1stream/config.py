"""The settings of every program: each is declared here, once.

A TOML file has one table for each class below; what it leaves out keeps its default, and a flag on
the command line goes over both. To add a setting, and its flag, add a field with `setting`; then
`python tools/make_sim_toml.py` writes it into configs/sim.toml.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from g1stream.errors import ConfigError
from g1stream.types import STREAM_RATE, FeedForwardKind, Support

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pydantic.fields import FieldInfo
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
    "accepted",
    "load_config",
    "read_toml",
    "setting",
    "settings",
]

#: Config files that come with the package, found by name: `--config robot`.
SHIPPED: Final = Path(__file__).with_name("configs")

#: The greatest gains that are ever sent, Nm/rad and Nm s/rad: beyond any that a G1 is run with.
MAX_KP, MAX_KD = 500.0, 50.0

#: Commands with the same flags: those that go on DDS, play a motion, write a session file.
_DDS = ("demo", "stream", "sim", "record", "replay", "doctor")
_PLAY = ("stream", "replay")
_RECORD = ("stream", "replay", "record")
_ROBOT = (*_DDS, "motion")


def setting(
    default: Any,
    description: str,
    unit: str = "",
    *,
    flag: tuple[str, ...] = (),
    example: Any = None,
    **limits: Any,
) -> Any:
    """A field of a table: the one place where a setting is declared.

    Its check, its flag and that flag's help, and its lines in configs/sim.toml all come from here.

    Args:
        default: without a config file and a flag; None for a setting that is unset.
        description: what it means, without its unit.
        unit: SI symbol, empty where it has none.
        flag: subcommands on which `--name` goes over the config file.
        example: a value to show where there is no default.
        limits: `ge`, `gt`, `le`, `lt` and the other limits that pydantic knows.
    """
    about: Any = {"unit": unit, "flag": flag}
    examples = None if example is None else [example]
    return Field(
        default, description=description, examples=examples, json_schema_extra=about, **limits
    )


class _Table(BaseModel):
    # Strict: TOML has a type for everything, so that "yes" is no bool and true is no number.
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class DdsConfig(_Table):
    """Where on DDS."""

    domain: int = setting(
        1, "DDS domain; simulators use 1, the robot uses 0", flag=_DDS, ge=0, le=232
    )
    interface: str = setting(
        "lo", "network interface; lo stays on this machine", flag=_DDS, min_length=1
    )


class StreamConfig(_Table):
    """How a motion is played."""

    rate: float = setting(STREAM_RATE, "LowCmd per second", "Hz", flag=_PLAY, ge=10.0, le=2000.0)
    wait: float = setting(
        10.0,
        "longest wait for a first LowState and for a subscriber of LowCmd; discovery alone may "
        "take 2 s",
        "s",
        ge=1.0,
    )
    ramp: float = setting(
        3.0,
        "time from the measured pose to the first frame",
        "s",
        flag=_PLAY,
        ge=0.2,
        le=60.0,
    )
    hold: float = setting(1.0, "time at the last frame", "s", ge=0.0)
    damp: float = setting(1.0, "time of damping at the end", "s", ge=0.5, le=10.0)
    start: float = setting(0.0, "where in the motion to start", "s", flag=_PLAY, ge=0.0)
    duration: float | None = setting(
        None,
        "how much of the motion to play; to its end if unset",
        "s",
        flag=(*_PLAY, "demo"),
        example=10.0,
        gt=0.0,
    )
    loop: bool = setting(False, "play again and again until stopped", flag=_PLAY)
    damp_kd: float = setting(3.0, "gain of every joint while damping", "Nm s/rad", ge=0.5, le=10.0)
    feedforward: FeedForwardKind | None = setting(
        None,
        "what commands carry beside the position: nothing, velocity, or velocity and torque; if "
        "unset, dynamics for a simulator on this machine that says how it holds the robot, and "
        "velocity otherwise",
        flag=(*_PLAY, "demo"),
        example="velocity",
    )
    support: Support | None = setting(
        None,
        "how the robot is held, which the torque depends on (a wrong value tracks worse than no "
        "torque); as the simulator says if unset",
        flag=_PLAY,
        example="bolted",
    )
    preview: float | None = setting(
        None,
        "commands are ahead of the motion by this, as they act a little later; if unset, one "
        "period of them for g1stream's own simulator, and 0 otherwise",
        "s",
        example=0.002,
        ge=0.0,
        le=0.1,
    )
    correction: Path | None = setting(
        None,
        "correction of the joint targets that `g1stream learn` made; refused for another motion, "
        "rate, gains, support or feed-forward",
        flag=("stream",),
        example="better.npz",
        strict=False,
    )
    time_scale: float | None = setting(
        None,
        "simulated over real time, which velocities are corrected by; measured from the joints if "
        "unset; 1 on a robot",
        example=1.0,
        ge=0.5,
        le=1.05,
    )


class RealtimeConfig(_Table):
    """How punctual the loop asks to be; it runs without what the system does not grant."""

    priority: int = setting(50, "SCHED_FIFO priority; 0: an ordinary process", ge=0, le=99)
    cpu: int | None = setting(
        None, "the only CPU of the loop; an isolated one, or any, if unset", example=3, ge=0
    )


class SafetyConfig(_Table):
    """When to stop; docs/safety.md explains each threshold."""

    position_margin: float = setting(
        0.0, "how far targets are kept from the joint limits", "rad", ge=0.0, le=0.5
    )
    state_timeout: float | None = setting(
        None,
        "age of the last LowState that stops, and longest stall of the loop; 0.1 s if unset, and "
        "0.5 s on the loopback interface, where a simulator shares this machine",
        "s",
        example=0.1,
        gt=0.0,
    )
    max_tilt: float = setting(1.0, "pelvis tilt that stops", "rad", gt=0.0, le=3.2)
    max_joint_speed: float = setting(60.0, "measured joint speed that stops", "rad/s", gt=0.0)
    mode_machine: tuple[int, ...] = setting(
        (0, 5),
        "robots that may be commanded: 5 is the 29-joint G1, 0 a simulator that does not say",
        min_length=1,
        strict=False,  # TOML and JSON know lists only
    )
    allow_second_writer: bool = setting(
        False, "play although another publisher is on rt/lowcmd; dangerous", flag=_PLAY
    )


class GainsConfig(_Table):
    """Servo gains over those of Unitree's example, by joint.

    Each table maps a joint name, or a pattern such as "*_knee_joint", to a gain; later entries go
    over earlier ones, and joints that nothing names keep the example's gain.
    """

    kp: dict[str, Annotated[float, Field(ge=0.0, le=MAX_KP)]] = Field(default_factory=dict)
    kd: dict[str, Annotated[float, Field(ge=0.0, le=MAX_KD)]] = Field(default_factory=dict)


class RecordConfig(_Table):
    """How a session file is written."""

    tf_rate: float = setting(100.0, "link poses (/tf) per second", "Hz", gt=0.0, le=2000.0)
    batch: float = setting(0.05, "received samples are handled this often", "s", gt=0.0, le=0.5)
    split_size: float | None = setting(
        None,
        "split the recording into parts of this size (NAME/NAME_0.mcap ...); one file if unset",
        "MB",
        flag=_RECORD,
        example=1000.0,
        gt=0.0,
    )
    split_duration: float | None = setting(
        None,
        "split the recording into parts of this duration; one file if unset",
        "s",
        flag=_RECORD,
        example=600.0,
        gt=0.0,
    )
    auto_name: bool = setting(False, "put the time, UTC, into the file's name", flag=_RECORD)


class SimConfig(_Table):
    """How the MuJoCo bridge holds the robot and answers."""

    support: Support = setting(
        "bolted",
        "what holds the pelvis; bolted: the world; hanging: an elastic band at the torso; "
        "follow: the reference that is streamed; free: nothing, once the motion begins",
        flag=("sim", "demo"),
    )
    rate: float = setting(500.0, "LowState per second", "Hz", flag=("sim",), ge=50.0, le=1000.0)
    command_timeout: float = setting(
        0.5, "time without a LowCmd after which the motors only damp; 0: never", "s", ge=0.0
    )
    duration: float | None = setting(
        None,
        "stop after this; when interrupted if unset",
        "s",
        flag=("sim",),
        example=60.0,
        gt=0.0,
    )
    viewer: bool = setting(False, "open MuJoCo's viewer", flag=("sim", "demo"))


class Config(_Table):
    """All settings of a session."""

    robot: Path | None = setting(
        None,
        "revision g1_29dof_rev_1_0 or g1_29dof (which unitree_mujoco simulates), or a URDF file "
        "of the robot; if unset, g1_29dof_rev_1_0, and for feed-forward the one that fits better",
        flag=_ROBOT,
        example="g1_29dof",
        strict=False,
    )
    dds: DdsConfig = DdsConfig()
    stream: StreamConfig = StreamConfig()
    realtime: RealtimeConfig = RealtimeConfig()
    safety: SafetyConfig = SafetyConfig()
    gains: GainsConfig = GainsConfig()
    record: RecordConfig = RecordConfig()
    sim: SimConfig = SimConfig()


def settings() -> dict[str, FieldInfo]:
    """Every setting by its name in a TOML file, such as `stream.rate`; a table of gains is one."""
    found: dict[str, FieldInfo] = {}
    for name, field in Config.model_fields.items():
        table = field.annotation
        if isinstance(table, type) and issubclass(table, _Table):
            found |= {f"{name}.{key}": inner for key, inner in table.model_fields.items()}
        else:
            found[name] = field
    return found


def accepted(field: FieldInfo) -> str:
    """The values that a setting accepts, such as `10 to 2000`; empty where any of its type."""
    for kind in (field.annotation, *get_args(field.annotation)):
        if get_origin(kind) is Literal:
            *others, last = get_args(kind)
            return f"{', '.join(others)} or {last}"
    limits = {
        name: getattr(limit, name)
        for limit in field.metadata
        for name in ("ge", "gt", "le")
        if hasattr(limit, name)
    }
    if "gt" in limits:
        return f"above {limits['gt']:g}" + (f", at most {limits['le']:g}" if "le" in limits else "")
    if "le" in limits:
        return f"{limits['ge']:g} to {limits['le']:g}"
    return f"{limits['ge']:g} or more" if "ge" in limits else ""


def load_config(path: Path | str | None = None, over: Mapping[str, Any] | None = None) -> Config:
    """Read a TOML file and put other values over it.

    Args:
        path: the TOML file, or the name of one that comes with the package: robot, sim; defaults
            alone when None.
        over: values that go over the file's, keyed like `stream.rate`; None values do not count,
            and tables, such as `gains.kp`, are put over the file's entry by entry.

    Raises:
        ConfigError: the file cannot be read, is not TOML, or a value does not fit; names it.
    """
    values = read_toml(_found(path)) if path else {}
    given = {key: value for key, value in (over or {}).items() if value is not None}
    for key, value in given.items():
        table, _, name = key.rpartition(".")
        below = values.setdefault(table, {}) if table else values
        if isinstance(below, dict):  # otherwise the file is at fault, which is reported below
            entries = below.get(name)
            if isinstance(value, dict) and isinstance(entries, dict):
                # In the order in which they count: what goes over comes last.
                kept = {k: v for k, v in entries.items() if k not in value}
                below[name] = kept | value
            else:
                below[name] = value
    try:
        return Config.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        in_file = path and not any(f"{key}.".startswith(f"{flag}.") for flag in given)
        raise _explained(first, key, f" in {path}" if in_file else "") from error


def _found(path: Path | str) -> Path:
    """A path as it is given, or the shipped file of that name where there is no such file."""
    shipped = SHIPPED / f"{path}.toml"
    return shipped if shipped.is_file() and not Path(path).is_file() else Path(path)


def read_toml(path: Path, what: str = "config") -> dict[str, Any]:
    """The tables of a TOML file.

    Raises:
        ConfigError: it cannot be read, or is not TOML; calls it `what`.
    """
    try:
        with path.open("rb") as file:
            values: dict[str, Any] = tomllib.load(file)
    except OSError as error:
        names = ", ".join(sorted(file.stem for file in SHIPPED.glob("*.toml")))
        raise ConfigError(
            f"The {what} {path} cannot be read: {error.strerror}.",
            f"Check the path; configs that come with g1stream are {names}.",
        ) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(
            f"The {what} {path} is not valid TOML: {error}.",
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
        f"The setting {key} = {value!r}{where} is invalid: {message[0].lower()}{message[1:]}.",
        "Correct the value; configs/sim.toml lists every setting with its meaning.",
    )
