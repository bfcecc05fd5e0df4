"""A condition on metrics, such as `rmse > 1.1 * base or p99 > 0.05`.

It is a small part of Python's expressions, read with `ast` and computed here: names of metrics,
`base`, numbers, comparisons, arithmetic, `and`, `or` and `not`. Nothing else is evaluated.
A metric may be unknown, or a comparison divide by 0; then a condition that it decides is neither
true nor false.
"""

from __future__ import annotations

import ast
import operator
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any, Final

from g1stream.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping

__all__ = ["Condition"]

_ARITHMETIC: Final[dict[type[ast.operator], Callable[[float, float], float]]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
}
_COMPARISONS: Final[dict[type[ast.cmpop], Callable[[float, float], bool]]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
}
#: Longer than any condition that a person writes.
_MOST_CHARACTERS: Final = 500


class Condition:
    """A condition that can hold for metrics, beside those of a base or alone.

    `base` stands for the base's value of the one metric that is in the same comparison.

    Args:
        text: the condition.

    Raises:
        ConfigError: it is not one.
    """

    def __init__(self, text: str) -> None:
        self.text = text
        try:
            if len(text) > _MOST_CHARACTERS:
                raise ValueError
            self._tree = ast.parse(text.strip(), mode="eval").body
        except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
            raise self._error("it cannot be read") from error
        self._check(self._tree)

    @property
    def metrics(self) -> list[str]:
        """The metrics that it names."""
        names = [
            n
            for one in ast.walk(self._tree)
            if isinstance(one, ast.Compare)
            for n in _metrics_in(one)
        ]
        return list(dict.fromkeys(names))

    def holds(
        self, values: Mapping[str, float | None], base: Mapping[str, float] | None = None
    ) -> bool | None:
        """Whether it holds; None where that takes an unknown metric or division by 0.

        Args:
            values: metrics by name, None for what is not known.
            base: what `base` stands for, by metric; the condition cannot name it if None.

        Raises:
            ConfigError: one of its metrics is not among them, or has no base.
        """
        self.require(values)
        return self._truth(self._tree, values, base)

    def require(self, names: Collection[str]) -> None:
        """Check that each of its metrics is one of these names.

        Raises:
            ConfigError: one is not; it says which there are.
        """
        unknown = next((name for name in self.metrics if name not in names), None)
        if unknown is None:
            return
        parts: dict[str, list[str]] = {}
        for name in names:
            metric, dot, part = name.partition(".")
            if dot:
                parts.setdefault(metric, []).append(part)
        close = get_close_matches(unknown, names)
        known = ", ".join(name for name in names if "." not in name)
        known += "".join(
            f"; or of one of {len(of)} parts, such as {one}.{of[0]} and {one}.{of[-1]}"
            for one, of in parts.items()
        )
        meant = f"Close matches: {', '.join(close)}. " if close else ""
        raise self._error(f"there is no {unknown} here", f"{meant}Choose from {known}.")

    def _check(self, node: ast.expr) -> None:
        """Raise unless a node is a truth: a comparison, or `and`, `or` and `not` of some."""
        if isinstance(node, ast.BoolOp):
            for one in node.values:
                self._check(one)
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            self._check(node.operand)
        elif isinstance(node, ast.Compare):
            for one in (node.left, *node.comparators):
                self._check_number(one)
            if wrong := [op for op in node.ops if type(op) not in _COMPARISONS]:
                raise self._error(f"{type(wrong[0]).__name__} is not <, <=, > or >=")
            names = _metrics_in(node)
            if "base" in _names_in(node) and len(names) != 1:
                raise self._error("`base` needs one metric in its comparison, whose base it is")
        else:
            raise self._error(f"{ast.unparse(node)} is no comparison")

    def _check_number(self, node: ast.expr) -> None:
        if isinstance(node, ast.BinOp) and type(node.op) in _ARITHMETIC:
            self._check_number(node.left)
            self._check_number(node.right)
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
            self._check_number(node.operand)
        elif not _is_name(node) and not (
            isinstance(node, ast.Constant) and type(node.value) in (int, float)
        ):
            raise self._error(f"{ast.unparse(node)} is neither a number nor a metric")

    def _truth(
        self,
        node: ast.expr,
        values: Mapping[str, float | None],
        base: Mapping[str, float] | None,
    ) -> bool | None:
        if isinstance(node, ast.BoolOp):
            truths = [self._truth(one, values, base) for one in node.values]
            decisive = isinstance(node.op, ast.Or)
            return decisive if decisive in truths else None if None in truths else not decisive
        if isinstance(node, ast.UnaryOp):
            truth = self._truth(node.operand, values, base)
            return None if truth is None else not truth
        assert isinstance(node, ast.Compare)
        metrics = _metrics_in(node)
        numbers = {name: v for name in metrics if (v := values[name]) is not None}
        if "base" in _names_in(node):
            if base is None:
                raise self._error("nothing is compared here that `base` could stand for")
            if metrics[0] not in base:
                raise self._error(f"{metrics[0]} has no base")
            numbers["base"] = base[metrics[0]]
        if not numbers.keys() >= set(metrics):
            return None
        try:
            compared = [_number(one, numbers) for one in (node.left, *node.comparators)]
        except ZeroDivisionError:
            return None
        return all(
            _COMPARISONS[type(op)](a, b)
            for op, a, b in zip(node.ops, compared[:-1], compared[1:], strict=True)
        )

    def _error(self, reason: str, remedy: str = "") -> ConfigError:
        return ConfigError(
            f"The condition {self.text!r:.200} cannot be used: {reason}.",
            remedy or "Write it such as 'rmse > 0.02', or in compare 'rmse > 1.1 * base'.",
        )


def _number(node: Any, values: dict[str, float]) -> float:
    if isinstance(node, ast.BinOp):
        left, right = _number(node.left, values), _number(node.right, values)
        return _ARITHMETIC[type(node.op)](left, right)
    if isinstance(node, ast.UnaryOp):
        return -_number(node.operand, values)
    return values[ast.unparse(node)] if _is_name(node) else float(node.value)


def _is_name(node: ast.AST) -> bool:
    """Whether a node is `rmse` or `rmse.left_leg`."""
    return isinstance(node, ast.Name) or (
        isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name)
    )


def _names_in(node: ast.Compare) -> list[str]:
    inner = {id(one.value) for one in ast.walk(node) if isinstance(one, ast.Attribute)}
    names = (ast.unparse(n) for n in ast.walk(node) if _is_name(n) and id(n) not in inner)
    return list(dict.fromkeys(names))


def _metrics_in(node: ast.Compare) -> list[str]:
    return [name for name in _names_in(node) if name != "base"]
