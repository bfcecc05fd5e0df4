"""Values of flags: how they are read, and what is said of one that does not fit."""

from __future__ import annotations

import types
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final, Literal, Union, get_args, get_origin

from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from g1stream.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

__all__ = ["flag_name", "out_of_range", "reading"]

_WANTED: Final[dict[Any, str]] = {float: "a number", int: "a whole number"}


class _UnreadableError(Exception):
    """A text that is no value of its flag's type; `remedy` says what would be one."""

    def __init__(self, text: str, remedy: str) -> None:
        super().__init__(text)
        self.text = text
        self.remedy = remedy


def flag_name(field: str) -> str:
    """A flag as the user writes it."""
    return f"--{field.replace('_', '-')}"


@contextmanager
def reading(arguments: Sequence[str]) -> Iterator[None]:
    """Read numbers and choices by rules of our own, for the length of a `with`.

    Raises:
        ConfigError: a value that is none; names its flag where only one was given that value.
    """
    registry = ConstructorRegistry()
    registry.primitive_rule(_rule)
    try:
        with registry:
            yield
    except _UnreadableError as error:
        flag = _flag_of(error.text, arguments)
        what = f"The flag {flag} cannot be" if flag else "A flag has a value that it cannot have:"
        raise ConfigError(f"{what} {error.text!r}.", error.remedy) from None


def out_of_range(flag: str, key: str, value: Any) -> ConfigError:
    """What to say of a flag whose value its setting does not allow.

    Args:
        flag: as the user writes it.
        key: of the setting, such as `stream.rate`.
        value: as it was given.
    """
    from g1stream.config import Config

    table, _, name = key.rpartition(".")
    schema = Config.model_json_schema()
    setting = schema["$defs"][Config.model_fields[table].annotation.__name__]["properties"][name]  # type: ignore[union-attr]
    shown = f"{value:g}" if isinstance(value, float) else repr(value)
    return ConfigError(
        f"The flag {flag} cannot be {shown}.", f"Give {_range(setting)} (setting {key})."
    )


def _range(setting: dict[str, Any]) -> str:
    """The values that a setting allows, of its JSON schema."""
    kind = setting.get("anyOf", [setting])[0]  # the other is null: not set
    what = {"integer": "a whole number", "number": "a number"}.get(
        kind.get("type"), "another value"
    )
    lowest, above, highest = (
        kind.get(bound) for bound in ("minimum", "exclusiveMinimum", "maximum")
    )
    if lowest is not None and highest is not None:
        return f"{what} from {lowest:g} to {highest:g}"
    if lowest is not None:
        return f"{what}, {lowest:g} or more"
    if above is not None:
        return f"{what} above {above:g}" + (f", {highest:g} at most" if highest else "")
    return what


def _flag_of(text: str, arguments: Sequence[str]) -> str | None:
    """The flag that a text was given to, or None where it could be another's, or nobody's."""
    given = []
    for before, argument in zip(["", *arguments], arguments, strict=False):
        flag, equals, value = argument.partition("=")
        if argument == text:
            given.append(before)
        elif equals and value == text:
            given.append(flag)
    (flag,) = given if len(given) == 1 else ("",)
    return flag if flag.startswith("--") and "=" not in flag else None


def _rule(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
    """How to read a number or a choice, or None of it; other types are read as tyro does."""
    kinds = [info.type]
    if get_origin(info.type) in (Union, types.UnionType):
        kinds = [kind for kind in get_args(info.type) if kind is not type(None)]
    if len(kinds) != 1:
        return None
    (kind,) = kinds
    if kind in _WANTED:
        return _spec(_number(kind), kind.__name__.upper())
    if get_origin(kind) is Literal:
        return _spec(_choice(get_args(kind)), f"{{{','.join(get_args(kind))}}}")
    return None


def _spec(read: Callable[[str], Any], metavar: str) -> PrimitiveConstructorSpec[Any]:
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar=metavar,
        instance_from_str=lambda texts: read(texts[0]),
        is_instance=lambda value: True,
        str_from_instance=lambda value: [str(value)],
    )


def _number(kind: Any) -> Callable[[str], Any]:
    def read(text: str) -> Any:
        try:
            return kind(text)
        except ValueError:
            raise _UnreadableError(text, f"Give {_WANTED[kind]}.") from None

    return read


def _choice(choices: Sequence[str]) -> Callable[[str], str]:
    def read(text: str) -> str:
        if text not in choices:
            raise _UnreadableError(text, f"Choose from {', '.join(choices)}.")
        return text

    return read
