"""The settings of every program, and the TOML files that set them.

A TOML file has one table for each class of `g1stream.settings`; what it leaves out keeps its
default, and a flag on the command line goes over both.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from pydantic import ValidationError

from g1stream.errors import ConfigError
from g1stream.files import read_file
from g1stream.input_limits import SETTINGS_FILE
from g1stream.safety_settings import SafetyConfig
from g1stream.settings import (
    LIVE_FLAG,
    ROBOT_FLAG,
    DdsConfig,
    GainsConfig,
    RealtimeConfig,
    RecordConfig,
    SimConfig,
    StreamConfig,
    Table,
    setting,
)

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pydantic.fields import FieldInfo
    from pydantic_core import ErrorDetails

__all__ = ["SHIPPED", "Config", "load_config", "read_toml", "settings"]

#: Config files that come with the package, found by name: `--config robot`.
SHIPPED: Final = Path(__file__).with_name("configs")


class Config(Table):
    """All settings of a session."""

    robot: Path | None = setting(
        None,
        "revision g1_29dof_rev_1_0 or g1_29dof (which unitree_mujoco simulates), a G1 with fewer "
        "joints (g1_23dof, g1_29dof_lock_waist, g1_dual_arm), or a URDF file of the robot; if "
        "unset, g1_29dof_rev_1_0, and for feed-forward the revision that fits better",
        flag=ROBOT_FLAG,
        example="g1_29dof",
        strict=False,
    )
    live_port: int = setting(
        8765, "port of the WebSocket server of --live", flag=LIVE_FLAG, ge=1, le=65535
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
        if isinstance(table, type) and issubclass(table, Table):
            found |= {f"{name}.{key}": inner for key, inner in table.model_fields.items()}
        else:
            found[name] = field
    return found


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
        values: dict[str, Any] = tomllib.loads(read_file(path, SETTINGS_FILE).decode("utf-8"))
    except OSError as error:
        names = ", ".join(sorted(file.stem for file in SHIPPED.glob("*.toml")))
        raise ConfigError(
            f"The {what} {path} cannot be read: {error.strerror}.",
            f"Check the path; configs that come with g1stream are {names}.",
        ) from error
    except (ValueError, RecursionError) as error:  # not UTF-8, not TOML, or nested too deeply
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
            f"The setting {key} = {value!r:.80}{where} is not a table.",
            f"Write [{key}] and its settings below it, as in configs/sim.toml.",
        )
    message = error["msg"]
    return ConfigError(
        f"The setting {key} = {value!r:.80}{where} is invalid: {message[0].lower()}{message[1:]}.",
        "Correct the value; configs/sim.toml lists every setting with its meaning.",
    )
