"""Conditions of --fail-if: they compare a value with a number or a multiple of the base value."""

from __future__ import annotations

import operator
import re
from difflib import get_close_matches
from math import isfinite
from typing import TYPE_CHECKING, Final, NamedTuple

from g1stream.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

__all__ = ["AS_ASKED", "FailIf"]

_OPERATORS: Final = {"<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge}
_FORM: Final = re.compile(
    r"\s*([\w.]+)\s*([<>]=?)\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?)\s*(\*\s*base)?\s*",
    re.ASCII | re.IGNORECASE,
)

AS_ASKED: Final = ("completed", "played", "success")
"""Names of values that are 1 for runs that were played as asked."""

#: Conditions that are tested unless a given one has one of these names.
_DEFAULT: Final = ("completed < 1", "played < 1")


class FailIf(NamedTuple):
    """A condition `NAME OP NUMBER` or `NAME OP NUMBER * base`. OP is one of `< <= > >=`.

    A `default` condition was not given by the user, and does not hold for unknown values.
    """

    text: str
    name: str
    holds_for: Callable[[float, float], bool]
    number: float
    of_base: bool
    default: bool = False

    @classmethod
    def parse_all(
        cls, texts: Sequence[str], names: Sequence[str], with_base: Sequence[str] = ()
    ) -> list[FailIf]:
        """Parse conditions, and add those that fail runs that were not played as asked.

        Otherwise a run that was stopped before its difficult part would pass for its small error.
        """
        given = [cls.parse(text, names, with_base) for text in texts]
        if not given or any(one.name in AS_ASKED for one in given):
            return given
        return [*given, *(cls.parse(text, names)._replace(default=True) for text in _DEFAULT)]

    @classmethod
    def parse(cls, text: str, names: Sequence[str], with_base: Sequence[str] = ()) -> FailIf:
        """Parse a condition."""
        match = _FORM.fullmatch(text)
        if not match or not isfinite(number := float(match[3])):
            remedy = "Give NAME OP NUMBER with OP one of < <= > >=, such as 'rmse > 0.02'"
            remedy += ", or NAME OP NUMBER * base." if with_base else "."
            raise ConfigError(f"The condition {text!r:.200} is not valid.", remedy)
        name, of_base = match[1], bool(match[4])
        if name not in names:
            close = ", ".join(get_close_matches(name, names))
            meant = f"Close matches: {close}. " * bool(close)
            whole = ", ".join(one for one in names if "." not in one)
            joint = "" if whole.count(",") == len(names) - 1 else f", or one such as {names[-1]}"
            raise ConfigError(
                f"The condition {text!r:.200} uses the unknown name {name}.",
                f"{meant}Choose from {whole}{joint}.",
            )
        if of_base and name not in with_base:
            raise ConfigError(
                f"The condition {text!r:.200} compares with a base, but {name} has no base value.",
                f"Give only a number, such as '{name} {match[2]} {match[3]}'.",
            )
        return cls(text.strip(), name, _OPERATORS[match[2]], number, of_base)

    def holds(self, value: float | None, base: float | None = None) -> bool | None:
        """Whether the condition holds; None if the value, or the base that it needs, is unknown.

        A default condition does not hold for an unknown value.
        """
        factor = base if self.of_base else 1.0
        if value is None or factor is None or not (isfinite(value) and isfinite(factor)):
            return False if self.default else None
        return self.holds_for(value, self.number * factor)
