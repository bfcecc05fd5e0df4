"""The values of a sweep: every combination of values of some settings."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, Any, Final

from g1stream.config import load_config, settings
from g1stream.control.gains import resolve_gains
from g1stream.errors import ConfigError
from g1stream.robot.joints import JOINT_NAMES

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from g1stream.config import Config

__all__ = ["swept"]

#: Settings whose values in a sweep are factors.
_GAINS: Final = ("gains.kp", "gains.kd")


def swept(config: Config, sweeps: Sequence[str]) -> Iterator[tuple[dict[str, float | str], Config]]:
    """Every combination of the values of a sweep, and the settings with them.

    Args:
        config: the other settings.
        sweeps: such as `stream.rate=250,500`; the values of `gains.kp` and `gains.kd` are factors
            of the gains.

    Raises:
        ConfigError: a sweep names what is no setting, one twice, or a value that does not fit.
    """
    values: dict[str, list[float | str]] = {}
    for text in sweeps:
        name, _, given = text.partition("=")
        if name not in settings() or name in values:
            reason = "is swept twice" if name in values else "is no setting"
            raise ConfigError(
                f"{name} in --sweep {text} {reason}.",
                "Name a setting of configs/sim.toml, once: --sweep stream.rate=250,500.",
            )
        values[name] = list(dict.fromkeys(_value(one.strip()) for one in given.split(",")))
        if "" in values[name]:
            raise ConfigError(
                f"--sweep {text} lacks a value.", f"Give some: --sweep {name}=0.5,1,2."
            )
    for combination in product(*values.values()):
        chosen = dict(zip(values, combination, strict=True))
        over = {name: _setting(config, name, value) for name, value in chosen.items()}
        yield chosen, load_config(over=config.model_dump() | over)


def _value(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


def _setting(config: Config, name: str, value: float | str) -> Any:
    if name not in _GAINS:
        return int(value) if isinstance(value, float) and value.is_integer() else value
    if isinstance(value, str):
        raise ConfigError(f"{name} cannot be {value} times the gains.", "Give a number.")
    kp, kd = resolve_gains(config.gains)
    gains = value * (kp if name == "gains.kp" else kd)
    return dict(zip(JOINT_NAMES, gains.tolist(), strict=True))
